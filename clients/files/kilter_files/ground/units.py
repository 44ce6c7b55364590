"""Units of lab files and of contract columns, and the factor between them."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

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
