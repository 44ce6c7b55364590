"""What every reader of robot programs gives back, and what they share."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

# every repeat is bounded: a damaged file must not make the search slow
NUMBER = r"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
LOOP = re.compile(r"^\s*(?:FOR|WHILE|GOTO)\b", re.I | re.M)
SHOWN = 5

Step = tuple[str, list[float], int]


@dataclass
class Targets:
    """Joints in deg (n rows), the line of each, and what was understood; ``poses`` are places given as poses, with lines."""

    dialect: str
    joints_deg: list[list[float]] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    poses: list[tuple[str, int]] = field(default_factory=list)

    def add(self, name: str, joints: list[float], line: int) -> None:
        """Take another target."""
        self.names.append(name)
        self.joints_deg.append(joints)
        self.lines.append(line)

    def poses_said(self) -> str:
        """Name the first poses with their lines."""
        more = f" and {len(self.poses) - SHOWN} more" if len(self.poses) > SHOWN else ""
        return ", ".join(f"{name} (line {line})" for name, line in self.poses[:SHOWN]) + more

    def in_order_of_moves(self, text: str, moves: Callable[[], Iterator[Step | None]]) -> None:
        """Take the targets as the program moves to them, when that can be known from its text."""
        order = list(moves())
        if not order:
            self.notes.append("in the order of their declarations: the program moves to none of them")
        elif None in order or LOOP.search(text):
            self.warnings.append("in the order of their declarations: the program's own order cannot be read from it")
        else:
            self.names, self.joints_deg, self.lines = [], [], []
            for step in order:
                assert step is not None
                self.add(*step)
            self.notes.append("in the order in which the program moves to them")


def without_comments(text: str, sign: str) -> str:
    """Blank the comments of a program: places stay."""
    return re.sub(rf"{sign}[^\n]*", lambda m: " " * len(m[0]), text)


def line_at(text: str, at: int) -> int:
    """Return the line of a place in a text."""
    return text.count("\n", 0, at) + 1
