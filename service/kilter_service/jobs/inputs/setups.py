"""Set-ups of rows and their conditions: a sheet of a pencil has a frame of its own, for it lies elsewhere every time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_files.ground import NAMED_SESSIONS
from kilter_service.ground.core import core_watch
from kilter_service.ground.wire import to_metres, to_metres_if_known, to_mm
from kilter_service.robots.instruments.store import permissible

if TYPE_CHECKING:
    from kilter_core.identify import Predictive
    from kilter_core.observations import Observations
    from kilter_core.watch import Conditions
    from kilter_service.jobs.kind import JobInput
    from kilter_service.versions.drift.records import StoredCheck


# A tracker keeps its frame, and a base fitted to each campaign would hide that it, or the arm, has moved.
LAID_AGAIN = ("pencil", "sheet", "ballbar")
ALL_OTHERS = 0
FRAMES = ("base", "tool")


@dataclass
class Setups:
    """Numbers set-ups as the rows need them; remembers what each number means: campaign, session, device."""

    own: tuple[str, ...] | None
    devices: dict[str, str]
    known: list[tuple[str, int | None]] = field(default_factory=list)

    def number_setups(self, campaigns: Iterable[tuple[str, Observations]]) -> list[Observations]:
        """Rows with the number of their set-up; campaigns whose frame is not their own share number 0."""
        return [self._number_setups_in_rows(campaign, rows) for campaign, rows in campaigns]

    def _number_setups_in_rows(self, campaign: str, rows: Observations) -> Observations:
        if not self._has_own_frame(campaign) or (rows.position is None and rows.markers is None):
            return replace(rows, setup=np.full(len(rows), ALL_OTHERS, dtype=np.int64))
        sessions = np.zeros(len(rows), dtype=np.int64) if rows.session is None else rows.session
        found, place = np.unique(sessions, return_inverse=True)
        codes = [self._setup_number(campaign, int(number), len(found) == 1) for number in found]
        return replace(rows, setup=np.array(codes, dtype=np.int64)[place.reshape(-1)])

    def _setup_number(self, campaign: str, session: int, alone: bool) -> int:
        """The number of a set-up; a session that has a name is one set-up in all campaigns."""
        own = (campaign, None if alone and session < NAMED_SESSIONS else session)
        same = (k for k, (_, known) in enumerate(self.known, 1) if known == session and session >= NAMED_SESSIONS)
        number = next(same, len(self.known) + 1)
        if number > len(self.known):
            self.known.append(own)
        return number

    def _has_own_frame(self, campaign: str) -> bool:
        if self.own is not None:
            return bool(self.own)
        return self.devices.get(campaign, "").strip().lower() in LAID_AGAIN

    def describe_refitted_frames(self, refitted: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
        """What was refitted, by campaign and session; the campaigns that share a frame are not named one by one."""
        out = []
        for frame in refitted:
            told = {key: value for key, value in frame.items() if key != "setup"}
            campaign, session = (None, None) if frame["setup"] == ALL_OTHERS else self.known[frame["setup"] - 1]
            out.append({"campaign": campaign, "session": session, **told})
        return out

    def warnings(self, report: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Say which bases and tools were fitted to rows of their own."""
        return [self._warning(which, report[f"{which}_refitted"]) for which in FRAMES if report[f"{which}_refitted"]]

    def _warning(self, which: str, refitted: Sequence[dict[str, Any]]) -> dict[str, Any]:
        said = ", ".join(_describe_frame(frame) for frame in refitted)
        why = "as asked" if self.own else "the frame of a pencil's sheet or a ball bar is new every time"
        return {
            "code": f"{which}_refitted",
            "campaigns": [frame["campaign"] for frame in refitted if frame["campaign"] is not None],
            "message": f"The {which} was refitted to {said}: {why}. Errors there say nothing about where the {which} was; "
            f'with "refit": [] all rows share one {which}.',
        }


def _describe_frame(frame: dict[str, Any]) -> str:
    name = frame["campaign"] or "the campaigns of other devices"
    session = "" if frame["session"] is None else f" session {frame['session']}"
    moved = f"moved {frame['moved_mm']:.3g} mm, rotated {frame['turned_deg']:.3g} deg"
    return f"{name}{session} ({frame['use']}, {moved})"


QUANTILE = 1.959963984540054  # of a 95 % interval (kilter_core.types, which loads numpy)
SHIFT = ("x", "y", "z")


def build_check_conditions(job: JobInput, noise: float | None) -> Conditions:
    """Conditions of a check or a re-zeroing whose noise of a coordinate is ``noise`` m, None where nobody stated it."""
    stated = to_metres_if_known(job.options.setup_mm)
    setup = learned_setup(job.fit.agreeing) if stated is None else stated
    return core_watch.Conditions(core_watch.UNSTATED_K, setup, noise is not None)


def learned_setup(agreeing: Sequence[StoredCheck]) -> float:
    """Standard deviation (m) with which the set-up repeats, by the checks that agreed."""
    shown = [one for one in map(_shift, agreeing) if one is not None]
    shifts, sigmas = (np.array([one[k] for one in shown]).reshape(-1, 3) for k in (0, 1))
    return float(core_watch.learned_setup(shifts, sigmas))


def _shift(one: StoredCheck) -> tuple[list[float], list[float]] | None:
    """Shift (3,) m of the base that a check shows, and its standard deviations; None of one that shows it in part."""
    base = next((cause for cause in one.result.get("looked_at") or [] if cause["name"] == "base"), None)
    numbers = {number["name"]: number for number in (base or {}).get("numbers") or []}
    own = [numbers.get(name) or {} for name in SHIFT]
    if any(number.get("summed") is None or number.get("summed_u95") is None for number in own):
        return None
    return [to_metres(number["summed"]) for number in own], [
        to_metres(number["summed_u95"]) / QUANTILE for number in own
    ]


def counted_noise(job: JobInput, known: Predictive) -> float | None:
    """Noise (m) of a coordinate that is stated, else what a coarser instrument may be wrong by; None: that of the fit."""
    stated = to_metres_if_known(job.options.noise_mm)
    return _of_another(job, known) if stated is None else stated


def remark(job: JobInput, known: Predictive) -> dict[str, Any] | None:
    """Say that the rows count as an instrument makes them that the fit does not name; None where they do not."""
    own = _of_another(job, known) if job.options.noise_mm is None else None
    if own is None:
        return None
    ((campaign, _),) = job.campaigns.items()
    return {
        "code": "another_instrument",
        "message": f"{job.names.get(campaign, campaign)} was measured with {job.instruments[campaign].name}, which the version "
        f"was not fitted to. What that may be wrong by counts as the noise of a coordinate, {to_mm(own):.3g} mm, and not the "
        f"{to_mm(known.noise):.3g} mm of the fit: smaller changes are not seen. Where it is better known, state noise_mm.",
        "campaigns": [campaign],
    }


def _of_another(job: JobInput, known: Predictive) -> float | None:
    ((campaign, rows),) = job.campaigns.items()
    instrument = job.instruments.get(campaign)
    if instrument is None or instrument.name in job.fit.instruments or rows.position is None:
        return None
    far = float(np.nanmean(np.linalg.norm(rows.position, axis=1)))  # an instrument measures in its own frame
    own = float(permissible(instrument).standard(np.array([far]))[0])
    return own if np.isfinite(own) and own > known.noise else None
