"""Joint targets in robot programs: ABB RAPID, KUKA KRL, FANUC LS and Universal Robots' script."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from kilter_client.files.faults import fault, head_of
from kilter_client.files.text_layout import encoding_of

MOST_BYTES = 16 << 20
LOOKED_AT = 1 << 18
UNUSED_AXIS = 8e9  # RAPID writes 9E9 for an external axis that is not there

# every repeat is bounded: a damaged file must not make the search slow
NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
SIX = r"\[\s*" + r"\s*,\s*".join([f"({NUMBER})"] * 6) + r"\s*\]"
PAIR = re.compile(rf"\[\s*{SIX}\s*,\s*{SIX}\s*\]")
RAPID = re.compile(r"\bjointtarget\s+(\w+)\s*(?:\{[\d,\s]*\})?\s*:=([^;]{0,200000});", re.I)
RAPID_MOVE = re.compile(r"\bMoveAbsJ\s+(?:(\w+)(?:\s*\{\s*(\d+)\s*\})?\s*[\\,]|(\[[^;]{0,2000});)", re.I)
KRL = re.compile(r"(?:\b(\w{1,64})\s?=\s?)?\{\s?(?:E6AXIS\s?:|AXIS\s?:)?\s?(A1\s[^}]{0,500})\}", re.I)
KRL_AXIS = re.compile(rf"\bA(\d)\s+({NUMBER})")
LS = re.compile(r"P\[\s?(\d+)\s?(?::[^\]]{0,80})?\]\s?\{([^}]{0,2000})\}\s?;")
LS_AXIS = re.compile(rf"\bJ(\d)\s?=\s{{0,9}}({NUMBER})\s{{0,9}}(deg|mm)")
LS_MOVE = re.compile(r"^\s*\d+\s*:\s*[JLC]\s+P\[\s*(\d+)", re.M)
URSCRIPT = re.compile(r"\bmovej\s?\(\s?\[([^\]]{0,500})\]")
LOOP = re.compile(r"^\s*(?:FOR|WHILE|GOTO)\b", re.I | re.M)


@dataclass
class Targets:
    """Joints in deg (n rows), the line of each, and what was understood."""

    dialect: str
    joints_deg: list[list[float]] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def add(self, name: str, joints: list[float], line: int) -> None:
        """Take another target."""
        self.names.append(name)
        self.joints_deg.append(joints)
        self.lines.append(line)


def dialect_of(path: Path) -> str | None:
    """Return whose program a text is by its content, None when it holds no joint targets."""
    head = head_of(path, LOOKED_AT)
    if b"\0" in head and not head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return None
    text = head.decode(encoding_of(path, head), "replace")
    signs = {
        "RAPID": r"\bjointtarget\b|\bMoveAbsJ\b", "FANUC LS": r"^\s*/(?:PROG|POS)\b", "KRL": r"\{[^{}]{0,40}\bA1\s+[-+\d.]",
        "URScript": r"\bmovej\s*\(",
    }  # fmt: skip
    return next((name for name, sign in signs.items() if re.search(sign, text, re.M | re.I)), None)


def read_targets(path: Path) -> Targets:
    """Read the joint targets of a program, in the order in which it moves to them, else as they are declared.

    Raises:
        FileError: no targets, one with other than six numbers, or one given as a pose.

    """
    dialect = dialect_of(path)
    if dialect is None:
        raise fault(path, "holds no joint targets", "RAPID, KRL, FANUC LS and URScript are understood.")
    content = head_of(path, MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise fault(path, f"is larger than {MOST_BYTES >> 20} MB", "Is it a program?")
    text = content.decode(encoding_of(path, content), "replace").removeprefix("\ufeff")
    read = {"RAPID": _rapid, "KRL": _krl, "FANUC LS": _ls, "URScript": _script}[dialect]
    found = Targets(dialect)
    read(path, text, found)
    if not found.joints_deg:
        raise fault(path, f"holds no joint targets of {dialect}", "Give joint targets, not poses.")
    odd = next((i for i, q in enumerate(found.joints_deg) if len(q) != len(found.joints_deg[0])), None)
    if odd is not None:
        what = f"{found.names[odd]} has {len(found.joints_deg[odd])} joints, the first {len(found.joints_deg[0])}"
        raise fault(path, what, "Give the targets of one arm.", line=found.lines[odd])
    found.notes.insert(0, f"{dialect}: {len(found.joints_deg)} joint targets, in degrees")
    return found


def _without_comments(text: str, sign: str) -> str:
    return re.sub(rf"{sign}[^\n]*", lambda m: " " * len(m[0]), text)


def _line(text: str, at: int) -> int:
    return text.count("\n", 0, at) + 1


def _rapid(path: Path, text: str, found: Targets) -> None:
    text = _without_comments(text, "!")
    known: dict[str, list[tuple[list[float], int]]] = {}
    external = False
    for match in RAPID.finditer(text):
        pairs = list(PAIR.finditer(match[2]))
        if not pairs or PAIR.sub("", match[2]).strip(" \t\r\n[],"):
            what = f"{match[1]} is not made of six joints and six external axes, [[...],[...]]"
            raise fault(path, what, "Correct the target.", line=_line(text, match.start()))
        rows = [[float(v) for v in pair.groups()] for pair in pairs]
        external |= any(abs(v) < UNUSED_AXIS and v != 0 for row in rows for v in row[6:])
        known[match[1].lower()] = [
            (row[:6], _line(text, match.start(2) + pair.start())) for row, pair in zip(rows, pairs, strict=True)
        ]
        for k, (q, line) in enumerate(known[match[1].lower()], 1):
            found.add(match[1] if len(rows) == 1 else f"{match[1]}{{{k}}}", q, line)
    if external:
        found.warnings.append("external axes are left out: what they move belongs to the base or the tool")
    _in_order_of_moves(found, text, lambda: _rapid_moves(text, known))


def _rapid_moves(
    text: str, known: dict[str, list[tuple[list[float], int]]]
) -> Iterator[tuple[str, list[float], int] | None]:
    for move in RAPID_MOVE.finditer(text):
        line = _line(text, move.start())
        if move[3]:
            pair = PAIR.match(move[3])
            yield ("MoveAbsJ", [float(v) for v in pair.groups()[:6]], line) if pair else None
            continue
        rows, index = known.get(move[1].lower(), []), int(move[2] or 1) - 1
        yield (move[1], rows[index][0], rows[index][1]) if 0 <= index < len(rows) else None


def _in_order_of_moves(
    found: Targets, text: str, moves: Callable[[], Iterator[tuple[str, list[float], int] | None]]
) -> None:
    """Take the targets as the program moves to them, when that can be known from its text."""
    order = list(moves())
    if not order:
        found.notes.append("in the order of their declarations: the program moves to none of them")
    elif None in order or LOOP.search(text):
        found.warnings.append("in the order of their declarations: the program's own order cannot be read from it")
    else:
        found.names, found.joints_deg, found.lines = [], [], []
        for step in order:
            assert step is not None
            found.add(*step)
        found.notes.append("in the order in which the program moves to them")


def _krl(path: Path, text: str, found: Targets) -> None:
    text = _without_comments(text, ";")
    for match in KRL.finditer(text):
        axes = {int(number): float(value) for number, value in KRL_AXIS.findall(match[2])}
        line, name = _line(text, match.start()), match[1] or "axis target"
        if sorted(axes) != list(range(1, len(axes) + 1)) or len(axes) < 4:
            raise fault(path, f"{name} lacks axes: it has {sorted(axes)}", "Correct the target.", line=line)
        found.add(name, [axes[k] for k in sorted(axes)], line)
    found.notes.append("in the order in which they are written")


def _ls(path: Path, text: str, found: Targets) -> None:
    known: dict[str, tuple[str, list[float], int]] = {}
    for match in LS.finditer(text):
        axes = {int(number): float(value) for number, value, unit in LS_AXIS.findall(match[2]) if unit == "deg"}
        line = _line(text, match.start())
        if not axes or sorted(axes) != list(range(1, len(axes) + 1)):
            what = f"P[{match[1]}] is given as a pose" if not axes else f"P[{match[1]}] has joints {sorted(axes)}"
            raise fault(path, what, "Show it as joints on the pendant (REPRE) and export again.", line=line)
        known[match[1]] = (f"P[{match[1]}]", [axes[k] for k in sorted(axes)], line)
    for target in known.values():
        found.add(*target)
    found.notes.append("FANUC reads J3 against the horizontal: the robot needs --follows J3=J2")
    _in_order_of_moves(found, text, lambda: (known.get(move) for move in LS_MOVE.findall(text)))


def _script(path: Path, text: str, found: Targets) -> None:
    text = _without_comments(text, "#")
    for match in URSCRIPT.finditer(text):
        line, cells = _line(text, match.start()), match[1].split(",")
        try:
            radians = [float(cell) for cell in cells]
        except ValueError as error:
            raise fault(path, f"movej goes to {match[1][:40]!r}, no numbers", "Give numbers.", line=line) from error
        if any(not abs(v) <= 4.2 * math.pi for v in radians):
            raise fault(path, "movej goes more than two turns: are these degrees", "Give radians.", line=line)
        found.add("movej", [math.degrees(v) for v in radians], line)
    found.notes.append("in the order in which the program moves to them")
