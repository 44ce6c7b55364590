"""Units of lab files and of contract columns, and the factor between them.

Euler angles of lab files to the contract's quaternion (w, x, y, z).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence

from kilter_files.ground.arrays import Floats
from kilter_files.ground.later import np

Convert = Callable[[float], float]

DEG = math.pi / 180

# dimension -> unit -> size in the dimension's base unit
SIZES: Mapping[str, Mapping[str, float]] = {
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "inch": 0.0254},
    "angle": {
        "rad": 1.0,
        "deg": DEG,
        "mrad": 1e-3,
        "arcmin": DEG / 60,
        "arcsec": DEG / 3600,
        "gon": 0.9 * DEG,
        "turn": 2 * math.pi,
    },
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "angle rate": {"rad/s": 1.0, "deg/s": DEG, "rpm": 2 * math.pi / 60},
    "length rate": {"m/s": 1.0, "mm/s": 1e-3},
    "angle acceleration": {"rad/s2": 1.0, "deg/s2": DEG},
    "length acceleration": {"m/s2": 1.0, "mm/s2": 1e-3},
    "torque": {"Nm": 1.0, "mNm": 1e-3, "kNm": 1e3},
    "force": {"N": 1.0, "kN": 1e3},
    "mass": {"kg": 1.0, "g": 1e-3},
    "pixels": {"px": 1.0},
}

KELVIN = 273.15
TIMESTAMP = "timestamp"  # the unit of a column of dates or clocks
UNKNOWN = "?"  # what a draft writes where it could not tell
JOINT = re.compile(r"q([1-9]\d?)_(deg|rad|mm|m)")
MARKER = re.compile(r"m([1-9]\d?)([xyz])_(mm|m)")
# What need not be seen in every row: markers, points of a probe, readings of inclinometers, corners of boards.
SELDOM = re.compile(rf"{MARKER.pattern}|tip[xyz]_(mm|m)|tilt\d+[xyz]_(deg|rad)|s?[uv]\d+_px")

NAMES = ("camera", "board")  # contract columns whose cells may be names
# contract name -> the unit its ending states, in the spelling of SIZES; "" is a plain number
CONTRACT: tuple[tuple[str, str], ...] = (
    (r"(?:q|link|cmd)\d+_(deg|rad|mm|m)", "{0}"),
    (r"(?:m\d+)?[xyz]_(mm|m)", "{0}"),
    (r"s[xyz]_(mm|m)", "{0}"),
    (r"(?:phi|theta|psi)_(deg|rad)", "{0}"),
    (r"qd\d+_(deg|rad|mm|m)_s", "{0}/s"),
    (r"qdd\d+_(deg|rad|mm|m)_s2", "{0}/s2"),
    (r"tau\d+_nm", "Nm"),
    (r"tau\d+_n", "N"),
    (r"t_s", "s"),
    (r"payload_kg", "kg"),
    (r"payload_com_[xyz]_(mm|m)", "{0}"),
    (r"load\d+_kg", "kg"),
    (r"load\d+_[xyz]_(mm|m)", "{0}"),
    (r"load\d+_f[xyz]_n", "N"),
    (r"load\d+_m[xyz]_nm", "Nm"),
    (r"temperature_c", "C"),
    (r"(?:base_tilt_[xy]|tilt\d+[xyz])_(deg|rad)", "{0}"),
    (r"s?[uv]\d+_px", "px"),
    (r"(?:tip[xyz]|bar)_(mm|m)", "{0}"),
    (r"f[xyz]_n", "N"),
    (r"m[xyz]_nm", "Nm"),
    (r"q[wxyz]|dir\d+|row|session|pose_id|socket_id|plane_id|bar_id|camera|board", ""),
)


def column_unit(column: str) -> str | None:
    """Return the unit a contract column's name states, ``""`` for a plain number, None for no contract column."""
    for pattern, unit in CONTRACT:
        match = re.fullmatch(pattern, column)
        if match:
            return unit.format(*match.groups())
    return None


def unit_dimension(unit: str) -> str | None:
    """Return the dimension of a unit, None for an unknown one."""
    if unit in ("C", "K"):
        return "temperature"
    return next((name for name, sizes in SIZES.items() if unit in sizes), None)


def converter(source: str, target: str) -> Convert | None:
    """Return the function from ``source`` to ``target`` unit, None when they measure different things."""
    if source == target:
        return float
    dimension = unit_dimension(source)
    if dimension is None or dimension != unit_dimension(target):
        return None
    if dimension == "temperature":
        shift = KELVIN if source == "C" else -KELVIN
        return lambda value: value + shift
    factor = SIZES[dimension][source] / SIZES[dimension][target]
    return lambda value: value * factor


def units_like(target: str) -> tuple[str, ...]:
    """Return the units a source of ``target`` may have, for error messages."""
    dimension = unit_dimension(target)
    return ("C", "K") if dimension == "temperature" else tuple(SIZES.get(dimension or "", {}))


Quaternion = tuple[float, float, float, float]

MATRICES = ("rows", "columns")
ORTHOGONAL = 2e-3  # by which squares and products of a matrix's rows may be off: of three written digits
SEQUENCE = re.compile(r"[xyz]{3}|[XYZ]{3}")


def is_sequence(name: str) -> bool:
    """Tell whether ``name`` is an Euler convention: capitals for the moving axes, small letters for the fixed."""
    return bool(SEQUENCE.fullmatch(name)) and name[0] != name[1] and name[1] != name[2]


def from_euler(angles: tuple[float, float, float], sequence: str) -> Quaternion:
    """Return the quaternion of three angles [rad]: ``"XYZ"`` intrinsic, ``"xyz"`` extrinsic, as scipy writes them."""
    turns = [_about(axis, angle) for axis, angle in zip(sequence.upper(), angles, strict=True)]
    if sequence.islower():
        turns.reverse()
    return upright(product(product(turns[0], turns[1]), turns[2]))


def from_matrix(parts: Sequence[float], order: str) -> Quaternion | None:
    """Return the quaternion of a rotation matrix (9), ``"rows"`` or ``"columns"`` one after the other; None if it is none."""
    a, b, c = parts[0:3], parts[3:6], parts[6:9]
    if order == "columns":
        a, b, c = tuple(zip(a, b, c, strict=True))
    if any(math.isnan(part) for part in parts):
        return (math.nan, math.nan, math.nan, math.nan)
    lengths = [_dot(x, x) - 1.0 for x in (a, b, c)]
    angles = [_dot(a, b), _dot(a, c), _dot(b, c)]
    third = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    if max(map(abs, lengths + angles)) > ORTHOGONAL or _dot(third, c) < 0.0:
        return None
    # The largest of the four parts is divided by, so that none is lost to rounding.
    squares = (a[0] + b[1] + c[2], a[0] - b[1] - c[2], b[1] - a[0] - c[2], c[2] - a[0] - b[1])
    rows = (
        (1.0 + squares[0], c[1] - b[2], a[2] - c[0], b[0] - a[1]),
        (c[1] - b[2], 1.0 + squares[1], b[0] + a[1], a[2] + c[0]),
        (a[2] - c[0], b[0] + a[1], 1.0 + squares[2], c[1] + b[2]),
        (b[0] - a[1], a[2] + c[0], c[1] + b[2], 1.0 + squares[3]),
    )
    return upright(rows[squares.index(max(squares))])


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the quaternion of the rotation ``b`` in the frame rotated by ``a``."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def upright(q: Quaternion) -> Quaternion:
    """Return ``q`` at unit length with w >= 0: one orientation, one quaternion."""
    size = math.sqrt(sum(part * part for part in q))
    size = -size if q[0] < 0 else size
    return (q[0] / size, q[1] / size, q[2] / size, q[3] / size)


def _about(axis: str, angle: float) -> Quaternion:
    c, s = math.cos(angle / 2), math.sin(angle / 2)
    return (c, s if axis == "X" else 0.0, s if axis == "Y" else 0.0, s if axis == "Z" else 0.0)


def matrices_from_quaternions(quaternions: Floats) -> Floats:
    """Return rotations (n, 3, 3) of unit quaternions (n, 4; w first)."""
    w, x, y, z = quaternions.T
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return np.stack(rows, axis=1).reshape(-1, 3, 3)


def quaternions_from_matrices(turned: Floats) -> Floats:
    """Return quaternions (n, 4; w first) of rotations, by the largest of their four squares: exact near any angle."""
    m = turned.reshape(-1, 9).T
    squares = np.stack([1 + m[0] + m[4] + m[8], 1 + m[0] - m[4] - m[8], 1 - m[0] + m[4] - m[8], 1 - m[0] - m[4] + m[8]])
    w, x, y, z = squares
    a, b, c = m[7] - m[5], m[2] - m[6], m[3] - m[1]
    d, e, f = m[1] + m[3], m[2] + m[6], m[5] + m[7]
    sets = np.stack([np.stack([w, a, b, c]), np.stack([a, x, d, e]), np.stack([b, d, y, f]), np.stack([c, e, f, z])])
    best = np.argmax(np.nan_to_num(squares), axis=0)
    q = sets[best, :, np.arange(len(turned))]
    q = q / np.linalg.norm(q, axis=1)[:, None]
    return np.asarray(np.where(q[:, :1] < 0, -q, q))
