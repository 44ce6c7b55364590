"""Set-ups of rows, the load that a robot carries by default, and rows as a job counts them."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import Finding, FindingDocument, Sentences
from kilter_files.ground import NAMED_SESSIONS
from kilter_service.campaigns.keeping import REMEDY, counted_as_nothing
from kilter_service.contract.jobs.registry import KINDS
from kilter_service.ground.core import core_effects, core_observations, core_watch
from kilter_service.ground.wire import to_metres, to_metres_if_known, to_mm
from kilter_service.jobs.kind import JobInput, JobOutput
from kilter_service.robots.store import permissible

if TYPE_CHECKING:
    from kilter_core.identify import Predictive
    from kilter_core.observations import Observations
    from kilter_core.watch import Conditions
    from kilter_service.jobs.kind import JobInput
    from kilter_service.versions.drift.wire import StoredCheck


def to_json_types(value: Any) -> Any:
    """Return a document with Python's own types, and None where a number is not finite."""
    if isinstance(value, Mapping):
        return {str(key): to_json_types(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_types(part) for part in value]
    if isinstance(value, np.ndarray):
        return to_json_types(value.tolist())
    if isinstance(value, np.generic):
        return to_json_types(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def by_campaign(rows: Sequence[Mapping[str, Any]], counts: Mapping[str, int]) -> list[dict[str, Any]]:
    """Return rows of all campaigns together, ``row`` from 0, as rows of each, from 1; ``counts`` in their order."""
    names, starts = list(counts), [0, *accumulate(counts.values())]
    out = []
    for one in rows:
        k = bisect_right(starts, one["row"], hi=len(names)) - 1
        out.append({"campaign": names[k], **one, "row": one["row"] - starts[k] + 1})
    return out


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

    def warnings(self, report: Mapping[str, Any]) -> list[FindingDocument]:
        """Say which bases and tools were fitted to rows of their own."""
        return [self._warning(which, report[f"{which}_refitted"]) for which in FRAMES if report[f"{which}_refitted"]]

    def _warning(self, which: str, refitted: Sequence[dict[str, Any]]) -> FindingDocument:
        said = ", ".join(_describe_frame(frame) for frame in refitted)
        why = "as asked" if self.own else "the frame of a pencil's sheet or a ball bar is new every time"
        return FindingDocument.make(
            f"{which}_refitted",
            f"The {which} was refitted to {said}: {why}. Errors there say nothing about where the {which} was; "
            f'with "refit": [] all rows share one {which}.',
            campaigns=[frame["campaign"] for frame in refitted if frame["campaign"] is not None],
        )


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


def remark(job: JobInput, known: Predictive) -> FindingDocument | None:
    """Say that the rows count as an instrument makes them that the fit does not name; None where they do not."""
    own = _of_another(job, known) if job.options.noise_mm is None else None
    if own is None:
        return None
    ((campaign, _),) = job.campaigns.items()
    return FindingDocument.make(
        "another_instrument",
        f"{job.names.get(campaign, campaign)} was measured with {job.instruments[campaign].name}, which the version "
        f"was not fitted to. What that may be wrong by counts as the noise of a coordinate, {to_mm(own):.3g} mm, and not the "
        f"{to_mm(known.noise):.3g} mm of the fit: smaller changes are not seen. Where it is better known, state noise_mm.",
        campaigns=[campaign],
    )


def _of_another(job: JobInput, known: Predictive) -> float | None:
    ((campaign, rows),) = job.campaigns.items()
    instrument = job.instruments.get(campaign)
    if instrument is None or instrument.name in job.fit.instruments or rows.position is None:
        return None
    far = float(np.nanmean(np.linalg.norm(rows.position, axis=1)))  # an instrument measures in its own frame
    own = float(permissible(instrument).standard(np.array([far]))[0])
    return own if np.isfinite(own) and own > known.noise else None


READ = frozenset({"moments", "payload_kg"})
THESIS = ("clearance_tilt", "backlash_load", "axial_compliance")  # of level 3 without named effects


def with_load_warning(kind: str, output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version that a default load, or none, was taken, and for which campaigns."""
    found = _default_load(job) or find_unstated_load(kind, job)
    output = _with_masses_source(kind, output, job)
    return output if found is None else output.with_warnings(found.to_document(SENTENCES))


def _with_masses_source(kind: str, output: JobOutput, job: JobInput) -> JobOutput:
    """Add to result and version which search in torques its masses are from, or that it took none of them."""
    if job.masses_from is None or output.result.get("motion"):
        return output
    masses = output.result.get("masses", {"carried": True})  # a search carries them
    if not _following(kind, job) or not (masses or {}).get("carried"):
        return output.with_warnings(Finding("options_unused", {}).to_document(SENTENCES))
    source = {"masses_from": job.masses_from}
    version = output.version and replace(output.version, report=output.version.report | source)
    return JobOutput(output.result | source, version)


def find_unstated_load(kind: str, job: JobInput) -> Finding | None:
    """Say which campaigns state no payload, where nothing counted and an effect of the job follows the load; else None."""
    if all(core_observations.is_log(rows) for rows in job.campaigns.values()):
        return None  # what it carries is part of the last body
    following = _following(kind, job) if job.no_load else []
    if not following:
        return None
    names = [job.names.get(c, c) for c in job.no_load]
    return Finding("load_not_stated", {"campaigns": list(job.no_load), "effects": following}, {"names": names})


def _following(kind: str, job: JobInput) -> list[str]:
    """Effects that the job identifies, tests or carries, by id, that read the load."""
    reading = [
        e.id for e in core_effects.EFFECTS.values() if e.needs & READ and not e.nuisance and e.stage != "measurement"
    ]
    own = [] if job.calibration is None else [e.id for e in job.calibration.model.effects]
    if kind == "gap":
        asked = [str(e if isinstance(e, str) else e.id) for e in getattr(job.options, "effects", None) or ()]
        own += asked or (reading if job.robot.has_masses else [])
    elif kind == "identify":
        asked = [str(e if isinstance(e, str) else e.id) for e in job.options.effects]
        own = asked or (list(THESIS) if job.options.level == 3 and not own else own)
    elif not KINDS[kind].against_fit:
        return []
    return [name for name in dict.fromkeys(own) if name in reading]


def _default_load(job: JobInput) -> Finding | None:
    load = job.robot.load
    if load is None or not job.default_load:
        return None
    names = [job.names.get(c, c) for c in job.default_load]
    said = {"names": names, "mass_kg": load.mass, "com_m": load.com}
    return Finding("default_load_used", {"campaigns": list(job.default_load)}, said)


def load_not_stated(said: Mapping[str, Any]) -> str:
    """Say which campaigns state no payload, and which effects follow it."""
    state = "state" if len(said["campaigns"]) > 1 else "states"
    return counted_as_nothing(f"{', '.join(said['names'])} {state}", said["effects"])


def _default_load_used(said: Mapping[str, Any]) -> str:
    at = ", ".join(f"{value * 1e3:.6g}" for value in said["com_m"])
    return (
        f"{', '.join(said['names'])}: no payload is stated, so the robot's default load counts, {said['mass_kg']:.6g} kg at "
        f"({at}) mm in the tool frame. If it carried another, state payload_kg."
    )


SENTENCES: Sentences = {
    "load_not_stated": lambda said: f"{load_not_stated(said)} {REMEDY.format(whole='campaign')}",
    "default_load_used": _default_load_used,
    "options_unused": lambda _: (
        "masses_from did nothing: no effect of this fit follows the load of links. Leave it out, or name such an effect "
        "(axial_compliance)."
    ),
}
