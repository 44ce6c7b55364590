"""KRL: axis targets in braces, of ``.src`` and ``.dat``; external axes stay, poses are named."""

from __future__ import annotations

import re

from kilter_files.formats.programs.found import Program, blanked
from kilter_files.formats.programs.target_list import NUMBER

AXES = re.compile(
    r"(?:\b(\w{1,64}(?:\[\d{1,4}\])?)\s{0,9}=\s{0,9})?\{\s{0,9}(?:(?:E6)?AXIS\s{0,9}:)?\s{0,9}(A\d\s[^{}]{0,500})(\}|\Z|\{)",
    re.I,
)
AXIS = re.compile(rf"\s{{0,9}}([AE])(\d)\s{{1,9}}({NUMBER})\s{{0,9}}", re.I)
POSE = re.compile(r"\{\s{0,9}(?:(?:E6)?POS\s{0,9}:)?\s{0,9}[XYZ]\s[^{}\n]{0,500}\}", re.I)
MOVE = re.compile(r"^[ \t]*(S?(?:PTP|LIN|CIRC)(?:_REL)?)[ \t]+([^\r\n]+)", re.I | re.M)


def find(program: Program) -> None:
    """Find the axis targets.

    Raises:
        FileError: one that lacks axes, has other than numbers, or is cut.

    """
    text = blanked(program.text, ";")
    if re.search(r"^\s*DEFDAT\b", text, re.I | re.M) and not re.search(r"^\s*ENDDAT\b", text, re.I | re.M):
        raise program.refuse(len(text), "ends without ENDDAT", "Copy or export it again.")
    known = set()
    relative = [match.span() for match in MOVE.finditer(text) if match[1].upper().endswith("_REL")]
    for match in AXES.finditer(text):
        if any(start <= match.start() < end for start, end in relative):
            continue
        _take(program, match)
        known.add((match[1] or "").upper())
    for match in POSE.finditer(text):
        program.leave(match.start(), "a pose")
    for match in MOVE.finditer(text):
        goal = match[2].split()[0].rstrip(",").upper()
        if match[1].upper().endswith("_REL") or (goal[0] != "{" and goal not in known):
            program.leave(match.start(), f"{match[1]} {match[2].strip()[:40]}: not an axis target of this file")


def _take(program: Program, match: re.Match[str]) -> None:
    parts = [AXIS.fullmatch(match[2], at.start(), at.end()) for at in re.finditer(r"[^,]+", match[2])]
    arm = [part for part in parts if part is not None and part[1].upper() == "A"]
    name = match[1] or "axis target"
    if match[3] != "}" or None in parts or [part[2] for part in arm] != [str(k + 1) for k in range(len(arm))]:
        raise program.refuse(
            match.start(), f"{name} is not A1, A2, ... with numbers", "Correct it, or export it again."
        )
    at = match.start(2)
    program.add(name, [(part[3], (at + part.start(3), at + part.end(3))) for part in arm])
