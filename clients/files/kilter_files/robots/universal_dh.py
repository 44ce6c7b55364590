"""Factory calibrations of Universal Robots arms as DH tables: a controller's ``calibration.conf``, and lists ``dh_a`` ...

Axes 2, 3 and 4 are nearly parallel, so the common normals of a calibrated table lie metres away and point elsewhere.
What a joint does not feel, a displacement along its axis and a rotation about it, is handed on to the next link: frames
stay near the nominal ones, and so do their small errors.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError
from kilter_files.ground.later import need, np

LIST = re.compile(r"^[ \t]*((?:delta|dh)_(?:theta|a|d|alpha))[ \t]*[=:][ \t]*\[([^\]]*)\]", re.M | re.I)
ALPHAS = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
DELTA, WHOLE = "delta_", "dh_"
ROWS = ("theta", "a", "d", "alpha")
Origin = tuple[float, float, float, float, float, float]
Table = Mapping[str, tuple[float, ...]]


def holds_dh(text: str) -> bool:
    """Say whether a text is such a table."""
    found = {match[1].lower() for match in LIST.finditer(text)}
    return any({f"{stem}a", f"{stem}d", f"{stem}alpha"} <= found for stem in (DELTA, WHOLE))


def extract_lists_text(document: Any) -> str:
    """Return the lists of such a table in a YAML document, wherever they are, as text; empty: there are none."""
    if not isinstance(document, dict):
        return ""
    own = [f"{key} = {value}" for key, value in document.items() if isinstance(value, list)]
    return "\n".join([*own, *filter(None, map(extract_lists_text, document.values()))])


def read_dh(path: Path, text: str, nominal_mm: Sequence[float]) -> tuple[Table, bool]:
    """Return theta, a, d, alpha (rad, m) of six joints, and whether they were added to a nominal table.

    ``nominal_mm`` are d1, a2, a3, d4, d5, d6 of that table.

    Raises:
        FileError: a list is missing, is not of six numbers, or stands there twice.

    """
    found: dict[str, tuple[float, ...]] = {}
    for match in LIST.finditer(text):
        name = match[1].lower()
        if name in found:
            raise FileError(f"{path}: {name} stands there twice. Keep the one of this arm.", file=str(path), place=name)
        found[name] = _six(path, name, match[2])
    stem = DELTA if f"{DELTA}a" in found else WHOLE
    for row in ROWS:
        name = f"{stem}{row}"
        if name not in found and row != "theta":
            raise FileError(
                f"{path}: has no {name}. Copy the whole file from the controller.", file=str(path), place=name
            )
        found.setdefault(name, (0.0,) * 6)
    if stem == WHOLE:
        return {row: found[f"{stem}{row}"] for row in ROWS}, False
    d1, a2, a3, d4, d5, d6 = (value / 1e3 for value in nominal_mm)
    nominal = {"theta": (0.0,) * 6, "a": (0.0, a2, a3, 0.0, 0.0, 0.0), "d": (d1, 0.0, 0.0, d4, d5, d6), "alpha": ALPHAS}
    added = {row: tuple(a + b for a, b in zip(nominal[row], found[f"{stem}{row}"], strict=True)) for row in ROWS}
    return added, True


def joint_origins(table: Table, path: Path) -> tuple[list[Origin], Origin]:
    """Return the origin of each joint (x, y, z m, roll, pitch, yaw rad) seen from the link before it, and the flange's.

    Raises:
        MissingPackageError: numpy is not installed.

    """
    need(f"{path}: the calibration of a UR needs", "numpy")
    theta, a, d, alpha = (table[row] for row in ROWS)
    steps = [_along_x(a[k - 1], alpha[k - 1]) if k else np.eye(4) for k in range(6)]
    steps = [step @ _about_z(theta[k], d[k]) for k, step in enumerate(steps)]
    for k in (1, 2):  # nothing about or along an axis that the next one is parallel to
        turn = math.atan2(steps[k][1, 0], steps[k][0, 0]) if k == 2 else theta[1]
        rest = steps[k] @ _about_z(-turn, 0.0)
        way = float(rest[2, 3] / rest[2, 2]) if k == 2 else d[1]
        steps[k] = rest @ _about_z(0.0, -way)
        steps[k + 1] = _about_z(turn, way) @ steps[k + 1]
    return [_origin(step) for step in steps], _origin(_along_x(a[5], alpha[5]))


def _six(path: Path, name: str, said: str) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in said.replace("\n", " ").split(","))
    except ValueError:
        values = ()
    if len(values) != 6 or not all(map(math.isfinite, values)):
        raise FileError(f"{path}: {name} is not six numbers. Copy the file again.", file=str(path), place=name)
    return values


def _about_z(angle: float, way: float) -> Any:
    T = np.eye(4)
    c, s = math.cos(angle), math.sin(angle)
    T[:2, :2], T[2, 3] = [[c, -s], [s, c]], way
    return T


def _along_x(way: float, angle: float) -> Any:
    T = np.eye(4)
    c, s = math.cos(angle), math.sin(angle)
    T[1:3, 1:3], T[0, 3] = [[c, -s], [s, c]], way
    return T


def _origin(T: Any) -> Origin:
    roll, pitch = math.atan2(T[2, 1], T[2, 2]), math.atan2(-T[2, 0], math.hypot(T[2, 1], T[2, 2]))
    yaw = math.atan2(T[1, 0], T[0, 0])
    x, y, z = (float(value) for value in T[:3, 3])
    return x, y, z, roll, pitch, yaw
