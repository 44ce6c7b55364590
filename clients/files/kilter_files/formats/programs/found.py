"""Joint targets at their places in the text of a program, and new numbers at these places."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from kilter_files.formats.programs.target_list import NUMBER, line_at
from kilter_files.ground.faults import fault

SAME_DEG = 5e-10  # a joint that moves less keeps its characters
Span = tuple[int, int]


@dataclass(frozen=True)
class JointTarget:
    """A target: its joints in deg, and the places of their numbers; ``radians`` says how these are written."""

    name: str
    line: int
    joints_deg: tuple[float, ...]
    spans: tuple[Span, ...]
    radians: bool = False


@dataclass
class Program:
    """The text of a program, byte for byte as Latin-1, its joint targets, and the lines of targets that are left."""

    path: Path
    text: str
    dialect: str
    least_decimals: int = 6
    targets: list[JointTarget] = field(default_factory=list)
    left: list[tuple[int, str]] = field(default_factory=list)

    def add(self, name: str, numbers: Sequence[tuple[str, Span]], *, radians: bool = False) -> None:
        """Take a target by its numbers and their places."""
        values = [float(text) for text, _ in numbers]
        degrees = tuple(math.degrees(v) if radians else v for v in values)
        spans = tuple(span for _, span in numbers)
        self.targets.append(JointTarget(name, line_at(self.text, spans[0][0]), degrees, spans, radians))

    def leave(self, at: int, what: str) -> None:
        """Name a target that stays as it is."""
        self.left.append((line_at(self.text, at), what))

    def refuse(self, at: int, what: str, remedy: str) -> Exception:
        """Build the error of a place."""
        return fault(self.path, what, remedy, line=line_at(self.text, at))

    def rewritten(self, joints_deg: Sequence[Sequence[float]]) -> str:
        """Return the text with these joints (n rows, deg) in place of the targets' own; all else stays."""
        new = {
            span: _number(self.text[slice(*span)], value, target.radians, self.least_decimals)
            for target, row in zip(self.targets, joints_deg, strict=True)
            for span, old, value in zip(target.spans, target.joints_deg, row, strict=True)
            if abs(value - old) > SAME_DEG
        }
        parts, at = [], 0
        for (start, end), number in sorted(new.items()):
            parts += [self.text[at:start], number]
            at = end
        return "".join([*parts, self.text[at:]])


def _number(old: str, value_deg: float, radians: bool, least: int) -> str:
    mantissa, _, exponent = old.lower().partition("e")
    written = len(mantissa.partition(".")[2]) - int(exponent or 0)
    decimals = min(max(written, least + 2 * radians), 15)
    return f"{math.radians(value_deg) if radians else value_deg:{'+' if old[0] == '+' else ''}.{decimals}f}"


def blanked(text: str, comment: str) -> str:
    """Blank strings and comments: places stay."""
    return re.sub(rf'"[^"\n]*"|{comment}[^\r\n]*', lambda match: " " * len(match[0]), text)


def numbers_in(text: str, start: int, end: int) -> list[tuple[str, Span]]:
    """Return the numbers between commas with their places; an empty list when something else is among them."""
    found, at = [], start
    for cell in text[start:end].split(","):
        bare = cell.strip()
        if not re.fullmatch(NUMBER, bare):
            return []
        first = at + cell.index(bare)
        found.append((bare, (first, first + len(bare))))
        at += len(cell) + 1
    return found
