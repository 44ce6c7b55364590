"""Columns that belong together by their names: numbered ones, and those that differ in the letter of an axis."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

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
