"""What a program sets along its text, as a tool: what is in force at a place, where the text can say it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

JUMP = None  # a control line from which or to which the program jumps


@dataclass
class InForce:
    """``control`` are lines at which a program branches, by place: 1 opens a block, -1 closes one, 0 divides it, None jumps.

    ``starts`` are the places at which subprograms begin: nothing is in force from one to the next.
    """

    control: Sequence[tuple[int, int | None]]
    starts: Sequence[int]
    settings: list[tuple[int, object]] = field(default_factory=list)

    def set(self, at: int, value: object) -> None:
        """Note a setting; they are noted in the order of the text."""
        self.settings.append((at, value))

    def at(self, place: int) -> tuple[bool, object]:
        """Return whether what is in force at a place is known, and what it is; None: nothing was set before it."""
        part = bisect_right(self.starts, place)
        inside = [(at, value) for at, value in self.settings if bisect_right(self.starts, at) == part]
        before = [(at, value) for at, value in inside if at < place]
        if not before:
            return not inside or not self._jumps(part), None
        at, value = before[-1]
        same = all(other == value for _, other in inside)
        plain = not self._jumps(part) and all(self._depth(at) == 0 for at, _ in inside)
        return self.joined(at, place) or same or plain, value

    def joined(self, first: int, second: int) -> bool:
        """Say whether the program always comes from one place to the other."""
        return bisect_right(self.starts, first) == bisect_right(self.starts, second) and not any(
            first < at < second for at, _ in self.control
        )

    def _jumps(self, part: int) -> bool:
        return any(way is None and bisect_right(self.starts, at) == part for at, way in self.control)

    def _depth(self, place: int) -> int:
        part = bisect_right(self.starts, place)
        return sum(way or 0 for at, way in self.control if at < place and bisect_right(self.starts, at) == part)
