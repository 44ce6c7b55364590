"""The frames of a KRL program: ``$BASE`` and ``$TOOL`` along its text, by literals, numbers and ``FDAT``."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator

from kilter_files.formats.programs.found import NUMBER, Program, blanked
from kilter_files.formats.programs.notations import KRL, Frame
from kilter_files.formats.programs.poses.in_force import InForce, calls_of_own
from kilter_files.formats.programs.poses.krl import NAME, key

NULL = Frame(KRL, (0.0,) * 6)
BRACES = r"\{([^{}\r\n]{0,500})\}"
FRAME = re.compile(
    rf"(\$(?:BASE|TOOL)|(?:BASE|TOOL)_DATA\[\d{{1,4}}\]|\bFRAME\s{{1,9}}{NAME})\s{{0,9}}=\s{{0,9}}{BRACES}", re.I
)
PART = re.compile(rf"\s{{0,9}}(?:(?:FRAME|(?:E6)?POS)\s{{0,9}}:\s{{0,9}})?([XYZABC])\s{{1,9}}({NUMBER})\s{{0,9}}", re.I)
SET = re.compile(
    rf"^[ \t]*(?:\$(BASE|TOOL)[ \t]*(?:=|(?=\.))[ \t]*([^\r\n]{{1,200}})|FDAT_ACT[ \t]*=[ \t]*({NAME})"
    r"|BAS[ \t]*\([ \t]*#(BASE|TOOL|\w{1,30})[ \t]*,[ \t]*(\w{1,30}))",
    re.I | re.M,
)
FDAT = re.compile(
    rf"\b({NAME})\s{{0,9}}=\s{{0,9}}\{{([^{{}}\r\n]{{0,500}}\b(?:TOOL|BASE)_NO\b[^{{}}\r\n]{{0,500}})\}}", re.I
)
CONTROL = re.compile(
    r"^[ \t]*(?:(IF|FOR|WHILE|REPEAT|LOOP|SWITCH)\b|(END(?:IF|FOR|WHILE|LOOP|SWITCH)|UNTIL)\b|(ELSE|CASE|DEFAULT)\b"
    r"|(GOTO\b|\w{1,64}[ \t]*:(?!=)))",
    re.I | re.M,
)
START = re.compile(r"^[ \t]*(?:GLOBAL[ \t]+)?DEF(?:FCT[ \t]+\w{1,64})?[ \t]+(\w{1,64})", re.I | re.M)
CHANGED = re.compile(r"^[ \t]*(BASE|TOOL)_DATA[ \t]*\[([^\]\r\n]{1,60})\][ \t]*(?:\.|=(?!=)(?![ \t]*\{))", re.I | re.M)
WITH = re.compile(
    r"[ \t,]\$(BASE|TOOL)[ \t]*=[ \t]*((?:\{[^{}\r\n]{0,500}\}|[^,(\r\n]|\([^()\r\n]{0,200}\)){1,300})", re.I
)
BLOCK = re.compile(r"^[ \t]*(?:((?:PTP_)?SPLINE)\b([^\r\n]{0,500})|ENDSPLINE\b)", re.I | re.M)
BY_DATA = re.compile(rf"S(?:BASE|TOOL2?)[ \t]*\([ \t]*({NAME})(?:\.(?:BASE|TOOL)_NO)?[ \t]*\)", re.I)
STANDING = re.compile(r"\$IPO_MODE\s{0,9}=\s{0,9}#TCP", re.I)
TOOL_STANDS = "its tool stands still (#TCP)"


class KrlFrames:
    """Base and tool at each place of a program, or why they are not known."""

    def __init__(self, program: Program, text: str) -> None:
        """Read the frames of a program and of the file beside it; ``text`` has its comments blanked."""
        self._stated = program.stated
        texts = [text, *([blanked(program.beside.text, ";")] if program.beside is not None else [])]
        self.literals = {match.start(2) - 1 for match in FRAME.finditer(text)}
        self._frames: dict[str, Frame | str] = {}
        self._data: dict[str, str] = {}
        for one in texts:
            self._read(one)
        self._changed = {(match[1].upper(), match[2].strip()) for one in texts for match in CHANGED.finditer(one)}
        self._text, self._blocks = text, list(BLOCK.finditer(text))
        self._stands = STANDING.search(text) is not None
        ways = (1, -1, 0, None)
        control = [(one.start(), next(w for k, w in enumerate(ways, 1) if one[k])) for one in CONTROL.finditer(text)]
        control = sorted([*control, *((at, 0) for at in calls_of_own(text, START))], key=lambda one: one[0])
        starts = [match.start() for match in START.finditer(text)]
        self.base, self.tool = InForce(control, starts), InForce(control, starts)
        for match in SET.finditer(text):
            self._set(match)

    def _read(self, text: str) -> None:
        for match in FRAME.finditer(text):
            name = re.sub(r"\s|FRAME\s", "", match[1], flags=re.I).upper()
            found = six_of(match[2])
            new = Frame(KRL, found) if found else f"{match[1]} is not X, Y, Z, A, B, C with numbers"
            if not name.startswith("$"):
                several = name in self._frames and self._frames[name] != new
                self._frames[name] = f"{match[1]} is set several times" if several else new
        for match in FDAT.finditer(text):
            self._data[key(match[1])] = match[2]

    def _set(self, match: re.Match[str]) -> None:
        at = match.start()
        if match[1]:
            (self.base if match[1].upper() == "BASE" else self.tool).set(at, self._value(match[1].upper(), match[2]))
        elif match[3]:
            for which, force in (("BASE", self.base), ("TOOL", self.tool)):
                force.set(at, self._by_data(which, match[3]))
        elif match[4].upper() in ("BASE", "TOOL"):
            (self.base if match[4].upper() == "BASE" else self.tool).set(at, self._numbered(match[4].upper(), match[5]))
        elif match[4].upper() in ("EX_BASE", "IPO_M"):
            self.base.set(at, "its base moves, or its tool stands still")

    def _value(self, which: str, said: str) -> Frame | str:
        said = said.strip()
        if said.startswith("."):
            return f"the program changes ${which}"
        literal = re.fullmatch(BRACES, said)
        if literal:
            found = six_of(literal[1])
            return Frame(KRL, found) if found else f"${which} is not X, Y, Z, A, B, C with numbers"
        number = re.fullmatch(rf"{which}_DATA\[(\d+)\]", said, re.I)
        if number:
            return self._numbered(which, number[1])
        data = BY_DATA.fullmatch(said)
        if data:
            return self._by_data(which, data[1])
        if said.upper() in ("$NULLFRAME", "$WORLD", "$ROBROOT"):
            return NULL
        return self._frames.get(said.upper(), f"${which}={said[:40]} is not known")

    def _by_data(self, which: str, name: str) -> Frame | str:
        """The frame that an ``FDAT`` names, as a spline motion takes it."""
        fields = self._fields(name)
        if fields.get("IPO_FRAME", "").upper() == "#TCP":
            return TOOL_STANDS
        number = fields.get(f"{which}_NO")
        return self._numbered(which, number) if number else f"{name} is not in this program, which says base and tool"

    def _fields(self, name: str) -> dict[str, str]:
        found = re.findall(r"(\w+)\s+([^,\s]+)", self._data.get(key(name), ""))
        return {field.upper(): value for field, value in found}

    def _numbered(self, which: str, number: str | None) -> Frame | str:
        if any(one == which and (said == number or not said.isdigit()) for one, said in self._changed):
            return f"the program changes {which}_DATA[{number}]"
        found = self._frames.get(f"{which}_DATA[{number}]")
        stated = (self._stated.bases if which == "BASE" else self._stated.tools).get(str(number))
        if found is None and stated is not None:
            return Frame(KRL, stated)
        if found is None and number == "0":
            return NULL
        option = which.lower()
        return found or f"{option} {number} is not in this program: state it, --{option} {number}=X,Y,Z,A,B,C"

    def at(self, place: int) -> tuple[tuple[Frame, ...] | str, Frame | str]:
        """Return base and tool of the motion at a place, or why they are not known."""
        own = self._with(place)
        base = own.get("BASE") or self._one("base", self.base, place)
        tool = TOOL_STANDS if self._stands else own.get("TOOL") or self._one("tool", self.tool, place)
        return base if isinstance(base, str) else (base,), tool

    def _with(self, place: int) -> dict[str, Frame | str]:
        """Frames that a spline motion sets for itself by WITH, or the block that it stands in."""
        k = bisect_right(self._blocks, place, key=re.Match.start) - 1
        block = self._blocks[k][2] if k >= 0 and self._blocks[k][1] else ""
        end = self._text.find("\n", place)
        own = self._text[place : end if end >= 0 else None]
        frames: dict[str, Frame | str] = {}
        for said in (block, own):
            _, _, with_ = f" {said.strip()}".upper().partition(" WITH ")
            frames |= {
                match[1].upper(): self._value(match[1].upper(), match[2]) for match in WITH.finditer(f" {with_}")
            }
        return frames

    def _one(self, which: str, force: InForce, place: int) -> Frame | str:
        known, value = force.at(place)
        if not known:
            return f"its {which} depends on the way that the program took"
        if isinstance(value, Frame | str):
            return value
        stated = (self._stated.bases if which == "base" else self._stated.tools).get("")
        return Frame(KRL, stated) if stated else f"its {which} is not set before it: state it, --{which} X,Y,Z,A,B,C"


def six_of(inside: str) -> tuple[float, ...] | None:
    """Return X, Y, Z, A, B, C of a list in braces; None where one is missing."""
    found = {match[1].upper(): float(match[2]) for match in _parts(inside)}
    return tuple(found[name] for name in KRL.names) if found.keys() == set(KRL.names) else None


def _parts(inside: str) -> Iterator[re.Match[str]]:
    for part in inside.split(","):
        match = PART.fullmatch(part)
        if match:
            yield match
