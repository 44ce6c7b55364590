"""What a program sets along its text, as a tool: what is in force at a place, where the text can say it."""

from __future__ import annotations

import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache


@dataclass(frozen=True)
class _Part:
    """The settings of one subprogram: their places and values, and whether each holds for all that follows it."""

    places: list[int]
    values: list[object]
    same: bool
    plain: bool
    jumps: bool


@dataclass
class InForce:
    """``control`` are lines at which a program branches, by place: 1 opens a block, -1 closes one, 0 divides it, None jumps.

    ``starts`` are the places at which subprograms begin: nothing is in force from one to the next. Where one stands inside
    another, ``owners`` has the number of the subprogram that each start begins or goes on with.
    """

    control: Sequence[tuple[int, int | None]]
    starts: Sequence[int]
    owners: Sequence[int] = ()
    settings: list[tuple[int, object]] = field(default_factory=list)
    _parts: dict[int, _Part] = field(default_factory=dict)

    def set(self, at: int, value: object) -> None:
        """Note a setting; they are noted in the order of the text, before anything is asked."""
        self.settings.append((at, value))

    def value_in_effect(self, place: int) -> tuple[bool, object]:
        """Return whether what is in force at a place is known, and what it is; None: nothing was set before it."""
        number = self.owner(place)
        part = self._parts.get(number) or self._parts.setdefault(number, self._build_part(number))
        k = bisect_left(part.places, place) - 1
        if k < 0:
            return not part.places or not part.jumps, None
        return self.has_unbranched_path(part.places[k], place) or part.same or part.plain, part.values[k]

    def has_unbranched_path(self, first: int, second: int) -> bool:
        """Say whether the program always comes from one place to the other."""
        between = bisect_right(self.control, first, key=_place) < bisect_left(self.control, second, key=_place)
        return not between and self.owner(first) == self.owner(second)

    def chosen(self, values: Sequence[tuple[int, object]], place: int) -> object | None:
        """Return which of the values that a variable is given along the text it has at a place; None where that is not sure."""
        if all(value == values[0][1] for _, value in values):
            return values[0][1]
        force = InForce(self.control, self.starts, self.owners)
        for at, value in values:
            force.set(at, value)
        known, found = force.value_in_effect(place)
        alone = len({self.owner(at) for at in (place, *(at for at, _ in values))}) == 1
        return found if known and alone else None

    def owner(self, place: int) -> int:
        """Return the number of the subprogram in which a place is."""
        k = bisect_right(self.starts, place)
        return self.owners[k - 1] if k and self.owners else k

    def _build_part(self, number: int) -> _Part:
        control = [(at, way) for at, way in self.control if self.owner(at) == number]
        inside = [(at, value) for at, value in self.settings if self.owner(at) == number]
        jumps = any(way is None for _, way in control)
        depth, steps = 0, iter([*control, (math.inf, 0)])
        step = next(steps)
        plain = not jumps
        for at, _ in inside:
            while step[0] < at:
                depth += step[1] or 0
                step = next(steps)
            plain = plain and depth == 0
        values = [value for _, value in inside]
        same = all(value == values[0] for value in values)
        return _Part([at for at, _ in inside], values, same, plain, jumps)


@lru_cache(maxsize=2)
def calls_of_own(text: str, named: re.Pattern[str]) -> list[int]:
    """Return where a program calls its own subprograms, of which ``named`` finds the names: they may move the arm."""
    own = [*named.finditer(text)]
    names, heads = {match[1].upper() for match in own}, {match.start(1) for match in own}
    begin = "".join(sorted({re.escape(match[1][0]) for match in own})) or r"\W"  # other calls are never looked at
    calls = re.finditer(rf"(?<![\w.$])(?=[{begin}])(\w{{1,64}})[ \t]*+\(", text, re.I)
    return [match.start() for match in calls if match[1].upper() in names and match.start() not in heads]


def calls_that_set(
    text: str, named: re.Pattern[str], owner: Callable[[int], int], settings: Sequence[int]
) -> list[tuple[int, str]]:
    """Return the calls of subprograms that set something at one of these places, themselves or by a call: place and name."""
    names = {owner(match.start()): match[1].upper() for match in named.finditer(text)}
    calls = [(at, re.match(r"\w+", text[at : at + 64])) for at in calls_of_own(text, named)]
    called = [(at, found[0]) for at, found in calls if found is not None]
    setting = {names.get(owner(at), "") for at in settings} - {""}
    while (
        more := {names.get(owner(at), "") for at, name in called if name.upper() in setting} - {"", *setting}
    ) != set():
        setting |= more
    return [(at, name) for at, name in called if name.upper() in setting]


def _place(control: tuple[int, int | None]) -> int:
    return control[0]
