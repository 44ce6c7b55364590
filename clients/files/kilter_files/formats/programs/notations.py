"""What a program sets along its text, as a tool: what is in force at a place, where the text can say it.

How languages of robots write poses: numbers to a pose, and back to numbers near those that were there.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Generic, NamedTuple, TypeVar

from kilter_files.ground.units import Quaternion, from_euler, product, upright

T = TypeVar("T")
Place = tuple[int, int | None]


@dataclass
class _Part:
    """One subprogram: where it branches, how deep its blocks are before and behind each place, and whether it jumps."""

    places: list[int] = field(default_factory=list)
    depths: list[int] = field(default_factory=lambda: [0])
    jumps: bool = False

    def add(self, at: int, way: int | None) -> None:
        """Take the next place at which it branches."""
        self.places.append(at)
        self.depths.append(self.depths[-1] + (way or 0))
        self.jumps = self.jumps or way is None

    def is_plain(self, places: Sequence[int]) -> bool:
        """Say whether the program surely comes by each of these places, outside all blocks."""
        return not self.jumps and not any(self.depths[bisect_left(self.places, at)] for at in places)


NO_PART = _Part()


class Flow:
    """How a program runs through its text.

    ``control`` are lines at which it branches, by place: 1 opens a block, -1 closes one, 0 divides it, None jumps.
    ``starts`` are the places at which subprograms begin: nothing is in force from one to the next. Where one stands inside
    another, ``owners`` has the number of the subprogram that each start begins or goes on with.
    """

    def __init__(self, control: Sequence[Place], starts: Sequence[int], owners: Sequence[int] = ()) -> None:
        """Take the places, each list in the order of the text."""
        self.starts, self._owners, self._control = starts, owners, control
        self._branches = [at for at, _ in control]

    @cached_property
    def _parts(self) -> dict[int, _Part]:
        parts: defaultdict[int, _Part] = defaultdict(_Part)
        for at, way in self._control:
            parts[self.owner(at)].add(at, way)
        return parts

    def owner(self, place: int) -> int:
        """Return the number of the subprogram in which a place is."""
        k = bisect_right(self.starts, place)
        return self._owners[k - 1] if k and self._owners else k

    def part(self, number: int) -> _Part:
        """Return where a subprogram branches."""
        return self._parts.get(number, NO_PART)

    def has_unbranched_path(self, first: int, second: int) -> bool:
        """Say whether the program always comes from one place to the other."""
        between = bisect_right(self._branches, first) < bisect_left(self._branches, second)
        return not between and self.owner(first) == self.owner(second)


@dataclass
class _Settings(Generic[T]):
    """The settings of one subprogram in the order of the text, and whether each holds for all that follows it."""

    places: list[int] = field(default_factory=list)
    values: list[T] = field(default_factory=list)
    certain: bool = False


class InForce(Generic[T]):
    """What a program sets along its text; settings are noted in the order of the text, before anything is asked."""

    def __init__(self, flow: Flow, settings: Sequence[tuple[int, T]] = ()) -> None:
        """Take how the program runs, and settings by place."""
        self.flow, self.settings = flow, list(settings)
        self._by_owner: dict[int, _Settings[T]] | None = None

    def set(self, at: int, value: T) -> None:
        """Note a setting."""
        self.settings.append((at, value))

    def value_in_effect(self, place: int) -> tuple[bool, T | None]:
        """Return whether what is in force at a place is known, and what it is; None: nothing was set before it."""
        if self._by_owner is None:
            self._by_owner = self._group_by_owner()
        found = self._by_owner.get(self.flow.owner(place))
        k = -1 if found is None else bisect_left(found.places, place) - 1
        if found is None or k < 0:
            return found is None or not self.flow.part(self.flow.owner(place)).jumps, None
        return found.certain or self.flow.has_unbranched_path(found.places[k], place), found.values[k]

    def _group_by_owner(self) -> dict[int, _Settings[T]]:
        groups: dict[int, _Settings[T]] = {}
        for at, value in self.settings:
            group = groups.setdefault(self.flow.owner(at), _Settings())
            group.places.append(at)
            group.values.append(value)
        for number, group in groups.items():
            same = all(value == group.values[0] for value in group.values)
            group.certain = same or self.flow.part(number).is_plain(group.places)
        return groups


class Variable(Generic[T]):
    """The values that a variable is given along the text, by place; there is one at least."""

    def __init__(self, flow: Flow, values: Sequence[tuple[int, T]]) -> None:
        """Take how the program runs, and the values in the order of the text."""
        self.values = values
        self._places = [at for at, _ in values]
        self._force = InForce(flow, values)
        self._same = all(value == values[0][1] for _, value in values)
        owners = {flow.owner(at) for at in self._places}
        self._owner = owners.pop() if len(owners) == 1 else None

    def setting_before(self, place: int) -> tuple[int, T]:
        """Return the last value before a place in the text, whatever way the program takes, and its place.

        The last of all, where none is before.
        """
        return self.values[bisect_left(self._places, place) - 1]

    def setting_in_force(self, place: int) -> T:
        """Return the value of ``setting_before``."""
        return self.setting_before(place)[1]

    def chosen(self, place: int) -> T | None:
        """Return which value the variable has at a place; None where that is not sure."""
        if self._same:
            return self.values[0][1]
        at, value = self.setting_before(place)
        alone = at < place and self._owner == self._force.flow.owner(place)
        return value if alone and self._force.value_in_effect(place)[0] else None


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
    setting |= find_callers(((names.get(owner(at), ""), name.upper()) for at, name in called), setting) - {""}
    return [(at, name) for at, name in called if name.upper() in setting]


def find_callers(calls: Iterable[tuple[str, str]], called: Collection[str]) -> set[str]:
    """Return who calls one of these subprograms, by itself or by another; ``calls`` are who calls, and what."""
    callers: dict[str, set[str]] = {}
    for caller, name in calls:
        callers.setdefault(name, set()).add(caller)
    found, waiting = set[str](), [*called]
    while waiting:
        new = callers.get(waiting.pop(), set()) - found
        found |= new
        waiting += new
    return found


Point = tuple[float, float, float]


class Rigid(NamedTuple):
    """A frame seen from another: its origin in mm, and its unit quaternion w, x, y, z."""

    place: Point = (0.0, 0.0, 0.0)
    turn: Quaternion = (1.0, 0.0, 0.0, 0.0)

    def compose_frames(self, other: Rigid) -> Rigid:
        """Return the frame ``other``, which is seen from this one."""
        x, y, z = rotate_vector(self.turn, other.place)
        place = (self.place[0] + x, self.place[1] + y, self.place[2] + z)
        return Rigid(place, upright(product(self.turn, other.turn)))

    def inverse(self) -> Rigid:
        """Return the frame from which this one is seen, seen from this one."""
        w, x, y, z = self.turn
        back = (w, -x, -y, -z)
        a, b, c = rotate_vector(back, self.place)
        return Rigid((-a, -b, -c), back)


def rotate_vector(q: Quaternion, v: Point) -> Point:
    """Return a vector rotated by a unit quaternion."""
    _, x, y, z = product(product(q, (0.0, *v)), (q[0], -q[1], -q[2], -q[3]))
    return (x, y, z)


def of_document(pose: dict[str, float]) -> Rigid:
    """Read a pose of the contract: ``x_mm`` to ``rz_deg``."""
    angles = (math.radians(pose["rz_deg"]), math.radians(pose["ry_deg"]), math.radians(pose["rx_deg"]))
    return Rigid((pose["x_mm"], pose["y_mm"], pose["z_mm"]), from_euler(angles, "ZYX"))


def to_document(pose: Rigid) -> dict[str, float]:
    """Write a pose as the contract does."""
    z, y, x = zyx(pose.turn, 0.0)
    lengths = dict(zip(("x_mm", "y_mm", "z_mm"), pose.place, strict=True))
    return lengths | {"rx_deg": math.degrees(x), "ry_deg": math.degrees(y), "rz_deg": math.degrees(z)}


def zyx(q: Quaternion, first: float) -> Point:
    """Return the angles rad about z, y and x of a rotation; at 90 degrees about y the first is the one that is given."""
    x_axis, y_axis = rotate_vector(q, (1.0, 0.0, 0.0)), rotate_vector(q, (0.0, 1.0, 0.0))
    z_axis = rotate_vector(q, (0.0, 0.0, 1.0))
    turn = math.atan2(x_axis[1], x_axis[0]) if math.hypot(x_axis[0], x_axis[1]) > 1e-12 else first
    c, s = math.cos(turn), math.sin(turn)
    # near 90 degrees about y the first angle is rounding noise: what it took off, the last gives back
    second = math.atan2(-x_axis[2], c * x_axis[0] + s * x_axis[1])
    third = math.atan2(s * z_axis[0] - c * z_axis[1], c * y_axis[1] - s * y_axis[0])
    return (turn, second, third)


def of_vector(vector: Sequence[float]) -> Quaternion:
    """Return the quaternion of a rotation vector, rad."""
    angle = math.hypot(*vector)
    share = 0.5 if angle < 1e-12 else math.sin(angle / 2) / angle
    return upright((math.cos(angle / 2), *(share * part for part in vector)))  # type: ignore[arg-type]


def to_vector(q: Quaternion) -> list[list[float]]:
    """Return the rotation vectors rad of a rotation: the one up to 180 degrees, and that the other way round."""
    w, *xyz = upright(q)
    size = math.hypot(*xyz)
    if size < 1e-15:
        return [[0.0, 0.0, 0.0]]
    angle = 2.0 * math.atan2(size, w)
    return [[part / size * turn for part in xyz] for turn in (angle, angle - 2.0 * math.pi)]


NOT_UNIT = 1e-3  # a quaternion whose length is off by more is none


@dataclass(frozen=True)
class Notation:
    """The names of the numbers, the decimals that each is written with at least, and how the last of them rotate.

    ``mm`` is how many mm a number of the place is, ``same`` how little a number of it and of the rotation may move.
    """

    names: tuple[str, ...]
    decimals: tuple[int, ...]
    mm: float
    same: tuple[float, float]
    rotation: Callable[[Sequence[float]], Quaternion]
    numbers: Callable[[Quaternion, Sequence[float]], Sequence[float]]

    def pose(self, values: Sequence[float]) -> Rigid:
        """Return the pose of these numbers."""
        x, y, z = (value * self.mm for value in values[:3])
        return Rigid((x, y, z), self.rotation(values[3:]))

    def nearest_numbers(self, pose: Rigid, old: Sequence[float]) -> list[float]:
        """Return the numbers of a pose: of all that say the same, those nearest to the old ones."""
        return [*(value / self.mm for value in pose.place), *self.numbers(pose.turn, old[3:])]

    def is_number_changed(self, k: int, old: float, new: float) -> bool:
        """Say whether number ``k`` is another one."""
        return abs(new - old) > self.same[k >= 3]


@dataclass(frozen=True)
class Frame:
    """A frame of a program, by its numbers."""

    notation: Notation
    numbers: tuple[float, ...]

    def pose(self) -> Rigid:
        """Return where it is."""
        return self.notation.pose(self.numbers)


def _of_zyx(angles: Sequence[float]) -> Quaternion:
    z, y, x = (math.radians(angle) for angle in angles)
    return from_euler((z, y, x), "ZYX")


def _to_zyx(q: Quaternion, old: Sequence[float]) -> list[float]:
    z, y, x = zyx(q, math.radians(old[0]))
    ways = [(z, y, x), (z + math.pi, math.pi - y, x + math.pi)]
    written = [
        [_nearest_equivalent_angle(math.degrees(angle), was) for angle, was in zip(way, old, strict=True)]
        for way in ways
    ]
    return min(written, key=lambda way: max(abs(new - was) for new, was in zip(way, old, strict=True)))


def _nearest_equivalent_angle(angle: float, old: float) -> float:
    """The same angle within 180 degrees of the old one."""
    return angle + 360.0 * round((old - angle) / 360.0)


def _of_xyz(angles: Sequence[float]) -> Quaternion:
    return _of_zyx(angles[::-1])


def _to_xyz(q: Quaternion, old: Sequence[float]) -> list[float]:
    return _to_zyx(q, old[::-1])[::-1]


def _to_vector(q: Quaternion, old: Sequence[float]) -> list[float]:
    return min(to_vector(q), key=lambda way: math.dist(way, old))


def _of_quaternion(q: Sequence[float]) -> Quaternion:
    return upright((q[0], q[1], q[2], q[3]))


def _to_quaternion(q: Quaternion, old: Sequence[float]) -> list[float]:
    length = math.copysign(math.hypot(*old), sum(a * b for a, b in zip(q, old, strict=True)))
    return [part * length for part in q]


KRL = Notation(("X", "Y", "Z", "A", "B", "C"), (7,) * 3 + (9,) * 3, 1.0, (1e-7, 1e-9), _of_zyx, _to_zyx)
FANUC = Notation(("X", "Y", "Z", "W", "P", "R"), (3,) * 6, 1.0, (1e-7, 1e-9), _of_xyz, _to_xyz)
RAPID = Notation(
    ("x", "y", "z", "q1", "q2", "q3", "q4"), (7,) * 3 + (11,) * 4, 1.0, (1e-7, 1e-11), _of_quaternion, _to_quaternion
)
URSCRIPT = Notation(
    ("x", "y", "z", "rx", "ry", "rz"), (10,) * 3 + (11,) * 3, 1e3, (1e-10, 1e-11), of_vector, _to_vector
)
