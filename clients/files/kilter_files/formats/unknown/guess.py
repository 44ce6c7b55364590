"""What the columns of an unknown table mean, guessed from names, units and ranges."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from kilter_files.formats.unknown.table_shape import TableShape
from kilter_files.ground.errors import FileError
from kilter_files.ground.time_stamps import parse_stamp
from kilter_files.ground.units import SIZES, TIMESTAMP, UNKNOWN

JOINT = re.compile(r"\b(?:joint\w*|jnts?|axis\w*|axes|ax|achs\w*|gelenk\w*|\w*winkel|angles?|theta|[ajq])\b")
PLACED = re.compile(r"\b(?:positions?|pos)\b")
TOOL = re.compile(r"\b(?:tcp|tool|pose|cart\w*|xyz|flange|flansch|points?|punkt)\b")
OTHER = re.compile(
    r"\b(?:\w*torques?|\w*moment\w*|tau|efforts?|\w*currents?|\w*strom\w*|\w*vel(?:ocity|ocities|s)?|\w*speeds?|"
    r"geschw\w*|qd+|acc\w*|temp\w*|motor\w*|error|err|std|sigma|rms|u95|dev\w*|force|kraft|f|voltage|volt)\b"
)
MEASURED = re.compile(r"\b(?:act\w*|meas\w*|ist|fbk|feedback|gemessen|tracker|laser|leica|smr|reflector|reflektor)\b")
COMMANDED = re.compile(r"\b(?:cmd|command\w*|soll|target|set|ref|desired|nominal|nom|goal|plan\w*|ziel)\b")
TURNED = re.compile(
    r"\b(?:rot|rotation|quat\w*|orient\w*|q @|r @|n @)\b|^[rq]@|\b(?:std|sigma|u95|rms|unc\w*|goal|force|vel\w*|acc\w*)\b"
)
COMPUTED = re.compile(r"\b(?:tcp|flange|flansch|tool|cart\w*)\b")
ASK_INSTRUMENT = "is this an instrument's reading? What the controller computes from its joints is not a measurement"
HALF_TURN, JOINTS = 180.0, range(3, 8)
BARE = "there is no header: these lie side by side within ±180, as joints in degrees do"
VECTORS = (3, 6, 7)  # a point, a point with three angles, a point with a quaternion
ARMS = (
    ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3"),
    ("shoulder pan", "shoulder lift", "elbow", "wrist 1", "wrist 2", "wrist 3"),
    ("s", "l", "u", "r", "b", "t"),
)


@dataclass
class Entry:
    """One line under [columns]; ``remark`` says what it rests on, ``open`` that somebody has to fill it in."""

    target: str
    source: str
    unit: str | None
    remark: str = ""
    used: tuple[str, ...] = ()

    @property
    def open(self) -> bool:
        """Whether somebody has to fill in what could not be told."""
        return UNKNOWN in (self.source, self.unit)


@dataclass
class Columns:
    """The table: names that may be given, and their cells as numbers where they are numbers."""

    shape: TableShape
    names: list[str] = field(init=False)
    _numbers: dict[str, list[float] | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        choices = [name for name in self.shape.source.choices if name]
        if self.shape.form == "mat":
            choices = [name for name in choices if not name.endswith("]")]
        lists = {name.rpartition("[")[0] for name in choices if name.endswith("]")}
        self.names = [name for name in choices if name not in lists]

    def without_names(self, names: Sequence[str]) -> Columns:
        """Return the same table without some names."""
        out = Columns(self.shape)
        out.names = [name for name in self.names if name not in names]
        out._numbers = self._numbers
        return out

    def numbers(self, name: str) -> list[float] | None:
        """Return a column's numbers without the empty cells, None where it holds other things."""
        if name not in self._numbers:
            try:
                self._numbers[name] = [v for v in self.shape.source.numbers(self.key(name)) if not math.isnan(v)]
            except FileError:
                self._numbers[name] = None
        return self._numbers[name]

    def key(self, name: str) -> str | int:
        """What ``from`` is for a name: an index where the file has no header, but for an element of cells that are lists."""
        numbered = not self.shape.layout.header and self.shape.form in ("csv", "xlsx")
        return int(name) if numbered and name.isdecimal() else name

    def texts(self, name: str) -> list[str]:
        """Return a column's cells."""
        return self.shape.source.texts(self.key(name))

    def unit(self, name: str) -> str | None:
        """Return the unit that stands beside the name."""
        return self.shape.units.get(name)

    def strange(self, names: Sequence[str]) -> str:
        """What stands beside the first of the names as a unit does, and is none of those known."""
        return next((said for name in names if (said := self.shape.strange.get(name, ""))), "")

    def largest(self, names: Sequence[str]) -> float | None:
        """Return the largest size among columns, None when one of them holds no numbers."""
        found = [self.numbers(name) for name in names]
        sizes = [max(map(abs, values)) for values in found if values]
        return max(sizes) if len(sizes) == len(names) and None not in found else None


def joints(columns: Columns) -> tuple[list[Entry], list[str]]:
    """Return the lines of the joints, and other columns that might be joints."""
    named = _named_joints(columns)
    if named:
        return _single_joints(columns, named), []
    bare = _bare_joints(columns)
    if bare:
        return [Entry(f"q{k}_deg", name, "deg", BARE, (name,)) for k, name in enumerate(bare, 1)], []
    ranked = sorted(
        ((_joint_score(columns, family), family) for family in families(columns.names)), key=lambda f: -f[0]
    )
    ranked = [(score, family) for score, family in ranked if score >= 0]
    if not ranked or ranked[0][0] < 2.5:
        return [], [family.pattern for _, family in ranked]
    best = ranked[0][1]
    equal = [
        family.pattern for score, family in ranked if score == ranked[0][0] and not _has_shared_columns(family, best)
    ]
    if equal:
        told = f"could not determine which of these are the arm's joints: {', '.join([best.pattern, *equal])}"
        return [Entry("q*", UNKNOWN, joint_unit(columns, best.names[0], best.names)[0], told)], []
    others = [family.pattern for score, family in ranked[1:] if not set(family.names) & set(best.names)]
    units = {columns.unit(name) for name in best.names}
    if len(units) > 1 or columns.shape.form == "mat":
        return _single_joints(columns, best.names), others
    unit, remark = joint_unit(columns, best.names[0], best.names)
    return [Entry("q*", best.pattern, unit, remark, best.names)], others


def _has_shared_columns(one: Family, other: Family) -> bool:
    return bool(set(one.names) & set(other.names))


def _single_joints(columns: Columns, names: Sequence[str]) -> list[Entry]:
    out = []
    for number, name in enumerate(names, 1):
        unit, remark = joint_unit(columns, name, names)
        slides = unit in SIZES["length"]
        out.append(Entry(f"q{number}_{'mm' if slides else 'deg'}", name, unit, remark, (name,)))
    return out


def _bare_joints(columns: Columns) -> list[str]:
    """Columns of a table without a header that are probably joints: one run of 3 to 7 within ±180, none of them a counter.

    Its first and last go beyond 2 pi, so that neither radians nor metres are among them.
    """
    runs: list[list[str]] = [[]]
    for name in columns.names if not columns.shape.layout.header else ():
        values = columns.numbers(name)
        if values and max(map(abs, values)) <= HALF_TURN and not _counts(values):
            runs[-1].append(name)
        elif runs[-1]:
            runs.append([])
    for run in runs:
        for end in (0, -1):
            while run and (columns.largest([run[end]]) or 0.0) <= 2.0 * math.pi:
                run.pop(end)
    found = [run for run in runs if run]
    return found[0] if len(found) == 1 and len(found[0]) in JOINTS else []


def _counts(values: Sequence[float]) -> bool:
    """Whether they only rise: a row number or a time."""
    return len(values) > 1 and all(b > a for a, b in itertools.pairwise(values))


def _named_joints(columns: Columns) -> tuple[str, ...]:
    """Columns that carry the names of a maker's joints."""
    words = {name: re.sub(r"(?<=[a-z])(?=\d)", " ", name_as_words(name)) for name in columns.names}
    for arm in ARMS:
        found = []
        for joint in arm:
            fitting = [n for n, said in words.items() if re.search(rf"\b{joint}\b", said) and not OTHER.search(said)]
            measured = [n for n in fitting if not COMMANDED.search(words[n])]
            found.append((measured or fitting or [""])[0])
        if all(found) and len(set(found)) == len(arm) and columns.largest(found) is not None:
            return tuple(found)
    return ()


def _joint_score(columns: Columns, family: Family) -> float:
    said = name_as_words(family.pattern.replace("*", " "))
    if columns.largest(family.names) is None or _is_unit_length(columns, family):
        return -9.0
    unit = columns.unit(family.names[0])
    score = 3.0 if JOINT.search(said) else 1.5 if PLACED.search(said) else 0.0
    score -= 3.0 if TOOL.search(said) else 0.0
    score += 2.0 if unit in SIZES["angle"] else -4.0 if unit is not None and unit not in SIZES["length"] else 0.0
    score += (1.0 if len(family) >= 4 else 0.0) + (1.0 if MEASURED.search(said) else 0.0)
    return score - (2.0 if COMMANDED.search(said) else 0.0) - (6.0 if OTHER.search(said) else 0.0)


def _is_unit_length(columns: Columns, family: Family) -> bool:
    """Four columns whose squares add to one are a quaternion."""
    if len(family) != 4:
        return False
    parts = [columns.numbers(name) or [] for name in family.names]
    if len({len(part) for part in parts}) != 1 or not parts[0]:
        return False
    return all(abs(sum(v * v for v in row) - 1.0) < 1e-2 for row in zip(*parts, strict=True))


def joint_unit(columns: Columns, name: str, names: Sequence[str]) -> tuple[str, str]:
    """Return the unit of a joint, by itself or by the range of all of them, and what it rests on."""
    stated = columns.unit(name)
    if stated is not None:
        return stated, ""
    if said := columns.strange(names):
        return UNKNOWN, _strange(said, "angle")
    size = columns.largest(names) or 0.0
    if 13.2 < size <= 400.0:
        return "deg", f"the file states no unit; values up to {size:.4g} are degrees"
    if 0.3 < size <= 6.6:
        return "rad", f"the file states no unit; values up to {size:.4g} look like radians: check"
    return (
        UNKNOWN,
        f"the file states no unit, and values up to {size:.4g} do not decide between deg, rad and 'turn' with a scale",
    )


def _strange(said: str, quantity: str) -> str:
    """What to do with a unit that the file states and nobody knows here: a guess from the values would contradict it."""
    known = ", ".join(SIZES[quantity])
    return f"the file states [{said}], which is none of {known}: give one of these, with scale = how many of it one {said} is"


def points(columns: Columns, taken: set[str]) -> tuple[list[Entry], list[str]]:
    """Return the lines of the position or of the markers, and other triples that might be it."""
    free = [name for name in columns.names if name not in taken and columns.numbers(name)]
    found = [triple for triple in triples(free) if not TURNED.search(name_as_words(triple.pattern))]
    markers = _markers(columns, found)
    if markers:
        return markers, []
    vectors = [_as_triple(family) for family in families(free, 3) if len(family) in VECTORS]
    ranked = sorted([*found, *(t for t in vectors if t)], key=lambda triple: -_point_score(columns, triple))
    if not ranked:
        return [], []
    best = ranked[0]
    unit, remark = length_unit(columns, best.names)
    equal = [t.pattern for t in ranked[1:] if _point_score(columns, t) == _point_score(columns, best)]
    if equal:
        told = f"could not determine which of these is the position: {', '.join([best.pattern, *equal])}"
        return [Entry(f"{axis}_mm", UNKNOWN, unit, told) for axis in "xyz"], []
    said = name_as_words(best.pattern)
    if COMPUTED.search(said) and not re.search(r"\b(?:meas\w*|tracker|laser|leica|smr|gemessen)\b", said):
        remark = "; ".join(text for text in (remark, ASK_INSTRUMENT) if text)
    return _axes(best.names, unit, remark), [t.pattern for t in ranked[1:]]


def position_entries(columns: Columns, names: Sequence[str]) -> list[Entry]:
    """Return the lines of a position whose columns are known."""
    return _axes(names, *length_unit(columns, names))


def _axes(names: Sequence[str], unit: str, remark: str) -> list[Entry]:
    return [Entry(f"{axis}_mm", name, unit, remark, (name,)) for axis, name in zip("xyz", names, strict=True)]


def _as_triple(family: Family) -> Triple | None:
    """The first three of a vector that is called a point or a pose."""
    said = name_as_words(family.pattern)
    fits = TOOL.search(said) or re.search(r"\b(?:p|pos\w*|coord\w*|trans\w*|measured|m[ae]ss\w*)\b", said)
    wrong = OTHER.search(said) or TURNED.search(said)
    return Triple(family.pattern, (family.names[0], family.names[1], family.names[2])) if fits and not wrong else None


def _markers(columns: Columns, found: Sequence[Triple]) -> list[Entry]:
    """Numbered triples are markers: M1 X, M1 Y, ... M2 Z."""
    sets = families([triple.pattern for triple in found], 2)
    if not sets:
        return []
    pattern = sets[0].pattern
    names = tuple(name for triple in found if triple.pattern in sets[0].names for name in triple.names)
    unit, remark = length_unit(columns, names)
    first = next(triple for triple in found if triple.pattern == sets[0].names[0])
    letters = [name[pattern_at] for name, pattern_at in zip(first.names, [first.pattern.index("@")] * 3, strict=True)]
    return [
        Entry(f"m*{axis}_mm", pattern.replace("@", letter), unit, remark, names)
        for axis, letter in zip("xyz", letters, strict=True)
    ]


def _point_score(columns: Columns, triple: Triple) -> float:
    said = name_as_words(triple.pattern.replace("@", " "))
    score = 1.0 if columns.unit(triple.names[0]) in SIZES["length"] else 0.0
    return score + (2.0 if MEASURED.search(said) else 0.0) - (2.5 if COMMANDED.search(said) else 0.0)


def length_unit(columns: Columns, names: Sequence[str]) -> tuple[str, str]:
    """Return the unit of lengths, and what it rests on."""
    stated = columns.unit(names[0])
    if stated in SIZES["length"]:
        return str(stated), ""
    if said := columns.strange(names):
        return UNKNOWN, _strange(said, "length")
    size = columns.largest(names) or 0.0
    if 50.0 < size <= 30_000.0:
        return "mm", f"the file states no unit; values up to {size:.4g} are mm"
    if 0.1 < size <= 8.0:
        return "m", f"the file states no unit; values up to {size:.4g} look like metres: check"
    return UNKNOWN, f"the file states no unit, and values up to {size:.4g} do not decide between mm, m and inch"


TIME = re.compile(
    r"\b(?:time|timestamp|zeit\w*|uhrzeit|datum|date|elapsed|sec|seconds|clock)\b|^t(?: (?:s|ms|us|ns|min|h))?$"
)


def time(columns: Columns, taken: set[str]) -> Entry | None:
    """Return the line of the time."""
    for name in columns.names:
        if name in taken or not TIME.search(name_as_words(name)) or columns.strange([name]):
            continue
        numbers = columns.numbers(name)
        if numbers is None:
            texts = columns.texts(name)
            if texts and all(parse_stamp(text) is not None for text in texts):
                return Entry("t_s", name, TIMESTAMP, "", (name,))
        elif numbers and columns.unit(name) in (None, *SIZES["time"]) and _is_increasing_overall(numbers):
            stated = columns.unit(name)
            return Entry(
                "t_s", name, stated or _time_unit(numbers), "" if stated else "the file states no unit", (name,)
            )
    return None


def _is_increasing_overall(numbers: Sequence[float]) -> bool:
    return all(after >= before for before, after in itertools.pairwise(numbers)) and numbers[-1] > numbers[0]


def _time_unit(numbers: Sequence[float]) -> str:
    """Seconds, or what a count since 1970 shows by its size."""
    return next((unit for least, unit in ((1e17, "ns"), (1e14, "us"), (1e11, "ms")) if numbers[0] > least), "s")


def find_entry_by_words(
    columns: Columns, taken: set[str], words: str, make: Callable[[str], Entry | None]
) -> Entry | None:
    """Return the line of the first free column of numbers whose name has one of ``words``."""
    for name in columns.names:
        if name not in taken and columns.numbers(name) and re.search(rf"\b(?:{words})\b", name_as_words(name)):
            found = make(name)
            if found is not None:
                return found
    return None


DIGITS = re.compile(r"\d+")
AXIS = re.compile(
    r"(?<![A-Za-zÀ-ÿ])([xyzXYZ])(?![A-Za-zÀ-ÿ])|(?<=[a-zß-ÿ])([XYZ])(?![a-zß-ÿ])|(?<=^[tpTP])([xyzXYZ])(?![A-Za-z])"
)


@dataclass(frozen=True)
class Family:
    """Columns alike but for a number; ``pattern`` has a * in its place."""

    pattern: str
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class Triple:
    """Three columns alike but for x, y and z; ``pattern`` has a @ in its place."""

    pattern: str
    names: tuple[str, str, str]


def families(names: Iterable[str], fewest: int = 2) -> list[Family]:
    """Return families whose numbers begin with 0 or 1 and have no gap, the largest first."""
    found: dict[str, dict[int, str]] = {}
    for name in names:
        for match in DIGITS.finditer(name):
            if "*" not in name:
                found.setdefault(f"{name[: match.start()]}*{name[match.end() :]}", {})[int(match[0])] = name
    out = []
    for pattern, numbered in found.items():
        numbers = sorted(numbered)
        whole = numbers[0] in (0, 1) and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        if whole and len(numbers) >= fewest and pattern != "*":  # columns without a header are called by their index
            out.append(Family(pattern, tuple(numbered[k] for k in numbers)))
    return sorted(out, key=lambda family: -len(family))


def triples(names: Sequence[str]) -> list[Triple]:
    """Return the triples x, y, z in the order in which their x stands."""
    found: dict[str, dict[str, str]] = {}
    for name in names:
        for match in AXIS.finditer(name):
            letter = next(group for group in match.groups() if group)
            pattern = f"{name[: match.start()]}@{name[match.end() :]}"
            found.setdefault(pattern, {}).setdefault(letter.lower(), name)
    return [
        Triple(pattern, (axes["x"], axes["y"], axes["z"])) for pattern, axes in found.items() if set(axes) == set("xyz")
    ]


def name_as_words(name: str) -> str:
    """Return a name in small letters, words apart: ``TCPposX [mm]`` is ``tcppos x mm``."""
    apart = re.sub(r"(?<=[a-zß-ÿ])(?=[A-Z])", " ", name)
    return " ".join(re.findall(r"[^\W_]+|\*|@", apart.lower()))
