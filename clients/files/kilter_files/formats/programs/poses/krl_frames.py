"""The frames of a KRL program: ``$BASE`` and ``$TOOL`` along its text, by literals, numbers and ``FDAT``."""

from __future__ import annotations

import re
from collections.abc import Iterator

from kilter_files.formats.programs.found import NUMBER, Program, blanked
from kilter_files.formats.programs.poses.in_force import InForce
from kilter_files.formats.programs.poses.notations import KRL, Frame

NULL = Frame(KRL, (0.0,) * 6)
NAME = r"\w{1,64}(?:\[\d{1,4}\])?"
BRACES = r"\{([^{}\r\n]{0,500})\}"
FRAME = re.compile(
    rf"(\$(?:BASE|TOOL)|(?:BASE|TOOL)_DATA\[\d{{1,4}}\]|\bFRAME\s{{1,9}}{NAME})\s{{0,9}}=\s{{0,9}}{BRACES}", re.I
)
PART = re.compile(rf"\s{{0,9}}(?:(?:FRAME|(?:E6)?POS)\s{{0,9}}:\s{{0,9}})?([XYZABC])\s{{1,9}}({NUMBER})\s{{0,9}}", re.I)
SET = re.compile(
    rf"^[ \t]*(?:\$(BASE|TOOL)[ \t]*=[ \t]*([^\r\n]{{1,200}})|FDAT_ACT[ \t]*=[ \t]*({NAME})"
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
START = re.compile(r"^[ \t]*(?:GLOBAL[ \t]+)?DEF(?:FCT)?\b", re.I | re.M)
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
        self._stands = STANDING.search(text) is not None
        ways = (1, -1, 0, None)
        control = [(one.start(), next(w for k, w in enumerate(ways, 1) if one[k])) for one in CONTROL.finditer(text)]
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
            self._data[match[1].upper()] = match[2]

    def _set(self, match: re.Match[str]) -> None:
        at = match.start()
        if match[1]:
            (self.base if match[1].upper() == "BASE" else self.tool).set(at, self._value(match[1].upper(), match[2]))
        elif match[3]:
            fields = dict(re.findall(r"(\w+)\s+([^,\s]+)", self._data.get(match[3].upper(), "")))
            fields = {name.upper(): value for name, value in fields.items()}
            stands = fields.get("IPO_FRAME", "").upper() == "#TCP"
            for which, force in (("BASE", self.base), ("TOOL", self.tool)):
                number = fields.get(f"{which}_NO")
                value = TOOL_STANDS if stands else self._numbered(which, number)
                force.set(at, value if number else f"{match[3]} is not in this program, which says base and tool")
        elif match[4].upper() in ("BASE", "TOOL"):
            (self.base if match[4].upper() == "BASE" else self.tool).set(at, self._numbered(match[4].upper(), match[5]))
        elif match[4].upper() in ("EX_BASE", "IPO_M"):
            self.base.set(at, "its base moves, or its tool stands still")

    def _value(self, which: str, said: str) -> Frame | str:
        said = said.strip()
        literal = re.match(BRACES, said)
        if literal:
            found = six_of(literal[1])
            return Frame(KRL, found) if found else f"${which} is not X, Y, Z, A, B, C with numbers"
        number = re.fullmatch(rf"{which}_DATA\[(\d+)\]", said, re.I)
        if number:
            return self._numbered(which, number[1])
        if said.upper() in ("$NULLFRAME", "$WORLD", "$ROBROOT"):
            return NULL
        return self._frames.get(said.upper(), f"${which}={said[:40]} is not known")

    def _numbered(self, which: str, number: str | None) -> Frame | str:
        found = self._frames.get(f"{which}_DATA[{number}]")
        stated = (self._stated.bases if which == "BASE" else self._stated.tools).get(str(number))
        if found is None and stated is not None:
            return Frame(KRL, stated)
        if found is None and number == "0":
            return NULL
        option = which.lower()
        return found or f"{option} {number} is not in this program: state it, --{option} {number}=X,Y,Z,A,B,C"

    def at(self, place: int) -> tuple[tuple[Frame, ...] | str, Frame | str]:
        """Return base and tool at a place, or why they are not known."""
        base = self._one("base", self.base, place)
        return base if isinstance(base, str) else (base,), TOOL_STANDS if self._stands else self._one(
            "tool", self.tool, place
        )

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
