"""Which rows of an identification were measured in a frame of their own: a pencil's sheet lies elsewhere every time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_files.ground import NAMED_SESSIONS

if TYPE_CHECKING:
    from kilter_core.observations import Observations

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
