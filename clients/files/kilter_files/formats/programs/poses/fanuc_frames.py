"""FANUC's UFRAME and UTOOL as a program sets them: by position registers that it fills with plain numbers."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from kilter_files.formats.programs.found import NUMBER

LINE = re.compile(r"^[ \t]*+\d{0,9}+[ \t]*+:\s*+(?!!|//|--)([^;\n]*)", re.M)
ELEMENT = re.compile(
    rf"PR\[\s?(\d+)\s?(?::[^\]\n]{{0,80}})?,\s?([1-6])\s?(?::[^\]\n]{{0,80}})?\]\s*+=\s*+\(?\s*+({NUMBER})\s*+\)?\s*+"
)
REGISTER = re.compile(r"PR\[\s?(\d{1,3})?")  # another statement that may change one
SET = re.compile(
    r"(?:\b|\$MN|\.\$)U(FRAME|TOOL)\s?(?:\[((?:[^\[\]\n]|\[[^\[\]\n]{0,20}\]){1,40})\]|(?<=\$UFRAME)|(?<=\$UTOOL))[.$\w]{0,20}\s?=\s?([^;\n]*)",
    re.I,
)
FROM_REGISTER = re.compile(r"PR\[\s?(\d+)\s?(?::[^\]\n]{0,80})?\]\s*+")
NUMBERED = re.compile(r"\s?(\d+)\s?(?::[^\]\n]*)?")
WAY = re.compile(r"\s*+(?:LBL|JMP|IF|ELSE|ENDIF|SELECT|FOR|ENDFOR|CALL|RUN|[JLCAS]\s+P)", re.I)
BRANCHES = re.compile(r"\b(?:JMP|CALL)\b", re.I)


@dataclass(frozen=True)
class Setting:
    """What sets UFRAME or UTOOL (``name``): of which ``number`` (empty: of any), to which ``numbers`` where these are known.

    ``first`` says that the program surely sets it before it moves, branches or calls.
    """

    name: str
    number: str
    numbers: tuple[float, ...] | None
    first: bool


@lru_cache(maxsize=4)
def parse_frame_settings(text: str) -> tuple[Setting, ...]:
    """Return what a program sets, in its order."""
    registers: dict[str, dict[int, float]] = {}
    found: list[Setting] = []
    first = True
    for line in LINE.finditer(text):
        said = line[1]
        first = first and WAY.match(said) is None and BRANCHES.search(said) is None
        element, setting = ELEMENT.fullmatch(said), SET.search(said)
        if element is not None:
            registers.setdefault(str(int(element[1])), {})[int(element[2])] = float(element[3])
        elif setting is not None:
            source = FROM_REGISTER.fullmatch(setting[3])
            values = registers.get(str(int(source[1])), {}) if source is not None and first else {}
            numbers = tuple(values[k] for k in sorted(values)) if len(values) == 6 else None
            plain = None if "$" in setting[0] else NUMBERED.fullmatch(setting[2] or "")
            number = "" if plain is None else str(int(plain[1]))
            found.append(Setting(f"U{setting[1].upper()}", number, numbers, first))
        elif (changed := REGISTER.match(said)) is not None:
            registers = {} if changed[1] is None else {k: v for k, v in registers.items() if k != str(int(changed[1]))}
    return tuple(found)
