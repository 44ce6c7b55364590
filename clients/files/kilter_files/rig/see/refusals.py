"""Why a view is refused: codes with their remedies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

REMEDIES = {
    "picture_unreadable": "Save it again as PNG: it loses nothing.",
    "picture_too_large": "Give the camera's own pictures; none of a camera has so many pixels.",
    "picture_other_camera": "Leave it out, or run kilter measure see for that camera alone.",
    "picture_blurred": "Take it again when the arm rests, with a shorter exposure and more light.",
    "board_not_found": "Take it so that the board fills a quarter of the picture, lit evenly, without glare.",
    "dictionary_differs": 'Write the "dictionary" that was printed into the board\'s JSON with kilter measure board.',
    "markers_unknown": "Give the JSON of the board that was printed (kilter measure board --first-id).",
    "columns_rows_swapped": "Write the board's JSON anew with kilter measure board: --columns is the count from left to right.",
    "board_size_differs": "Count its squares from left to right (--columns) and down (--rows), and write its JSON anew.",
    "legacy_pattern": 'Set "legacy_pattern" in the board\'s JSON as the board was printed.',
    "print_mirrored": "Print the board without mirroring, or switch off the camera's mirror.",
    "board_twice": "Cover one of the boards, or print one with other numbers (kilter measure board --first-id).",
    "too_few_corners": "Show more of the board: 12 corners make a good view, 4 are the least.",
    "arm_moving": "Let the arm rest at every pose, longer than a few frames.",
    "detectors_differ": "Look at that corner: glare, a shadow, or ink that has run moves it. Take the picture again.",
    "joints_missing": "Add its row to the joint log, or leave the picture out.",
}


@dataclass(frozen=True)
class Refusal:
    """A view that is not taken: ``code``, where, and what was seen; ``corner`` is its number on the board."""

    picture: str
    code: str
    what: str
    corner: int | None = None
    board: str | None = None

    @property
    def remedy(self) -> str:
        """What to do."""
        return REMEDIES[self.code]

    def sentence(self) -> str:
        """Return the whole as people read it."""
        place = self.picture if self.corner is None else f"{self.picture}, corner {self.corner}"
        return f"{place}: {self.what}. {self.remedy}"

    def to_document(self) -> dict[str, Any]:
        """Return the refusal as the JSON file holds it."""
        document: dict[str, Any] = {
            "picture": self.picture,
            "code": self.code,
            "detail": self.what,
            "remedy": self.remedy,
        }
        if self.corner is not None:
            document |= {"corner": self.corner}
        return document if self.board is None else document | {"board": self.board}
