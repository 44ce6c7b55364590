"""Katana arms from the configuration files of the Katana Native Interface (KNI), ``katana6M180.cfg`` and its kin."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

from kilter_files.ground.errors import FileError
from kilter_files.robots.text import read_text

JOINTS = 5  # the sixth motor is the gripper
SEGMENTS = 4
MOTOR = re.compile(r"\[MOT\[(\d+)\]\]")
HEADING = re.compile(r"\[([A-Za-z]\w*)\]")
ENTRY = re.compile(r'([\w\[\]]+)\s*=\s*"([^"]*)"\s*;')
SEGMENT = re.compile(r"segment\[?(\d)\]?", re.IGNORECASE)


def read_katana(path: Path, name: str) -> dict[str, Any]:
    """Return a chain document whose joints are read as KNI reads them: angles between angleOffset and its range.

    Raises:
        FileError: a motor or a segment is missing, or a value is not a number.

    """
    motors, segments = _entries(path)
    lengths = [segments.get(k) for k in range(1, SEGMENTS + 1)]
    if any(length is None for length in lengths):
        missing = [f"segment{k}" for k in range(1, SEGMENTS + 1) if k not in segments]
        raise FileError(f"{path}: {', '.join(missing)} is missing: is this a KNI configuration?", file=str(path))
    return {
        "name": name,
        "convention": "chain",
        "source": f"KNI configuration {path.name}; joints as KNI counts them",
        "joints": [{"name": f"j{k + 1}", "limits_deg": _limits(path, motors, k)} for k in range(JOINTS)],
        "elements": _elements([float(length or 0.0) for length in lengths]),
    }


def _elements(lengths: list[float]) -> list[dict[str, Any]]:
    """KNI's direct kinematics (6M180): upright at 90, 180, 180 deg, the wrist counting backwards.

    Between the parallel axes 2, 3 and 4 stand small tilts about x and z, which a calibration needs.
    """
    upper, fore, wrist, end = lengths
    return [
        {"joint": "j1", "axis": "Rz"},
        {"axis": "Rx", "name": "alpha_2", "value": 0.0},
        {"joint": "j2", "axis": "Ry", "value": -90.0},
        {"axis": "Tz", "name": "segment_1", "value": upper},
        {"axis": "Rx", "name": "alpha_3", "value": 0.0},
        {"axis": "Rz", "name": "beta_3", "value": 0.0},
        {"joint": "j3", "axis": "Ry", "value": -180.0},
        {"axis": "Tz", "name": "segment_2", "value": fore},
        {"axis": "Rx", "name": "alpha_4", "value": 0.0},
        {"axis": "Rz", "name": "beta_4", "value": 0.0},
        {"joint": "j4", "axis": "Ry", "ratio": -1.0, "value": 180.0},
        {"axis": "Tz", "name": "segment_3", "value": wrist},
        {"axis": "Rx", "name": "alpha_5", "value": 0.0},
        {"joint": "j5", "axis": "Rz", "ratio": -1.0, "value": 90.0},
        {"axis": "Tz", "name": "segment_4", "value": end},
    ]


def _entries(path: Path) -> tuple[dict[int, dict[str, str]], dict[int, float]]:
    """Return the entries of each motor, and the segments (mm)."""
    motors: dict[int, dict[str, str]] = {}
    segments: dict[int, float] = {}
    motor: int | None = None
    for number, line in enumerate(read_text(path).splitlines(), 1):
        text = line.partition("#")[0].strip()
        if match := MOTOR.search(text):
            motor = int(match[1])
        elif (heading := HEADING.fullmatch(text)) and heading[1].upper().startswith(("END", "EFF", "KATANA")):
            motor = None
        elif match := ENTRY.search(text):
            if motor is not None:
                motors.setdefault(motor, {})[match[1]] = match[2]
            elif segment := SEGMENT.fullmatch(match[1]):
                # KNI counts from 1 in segment1 and from 0 in segment[0].
                segments[int(segment[1]) + ("[" in match[1])] = _number(path, number, match[1], match[2])
    if not motors:
        raise FileError(f"{path}: has no [MOT[0]]: is this a KNI configuration?", file=str(path))
    return motors, segments


def _limits(path: Path, motors: dict[int, dict[str, str]], k: int) -> list[float]:
    entries = motors.get(k, {})
    missing = [key for key in ("angleOffset", "angleRange") if key not in entries]
    if missing:
        raise FileError(
            f"{path}: motor {k} ([MOT[{k}]]) lacks {', '.join(missing)}.", file=str(path), place=f"MOT[{k}]"
        )
    start, span = (_number(path, 0, f"MOT[{k}] {key}", entries[key]) for key in ("angleOffset", "angleRange"))
    return sorted((start, start + span))


def _number(path: Path, line: int, key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        where = f", line {line}" if line else ""
        raise FileError(f"{path}{where}: {key} is {text!r}, not a number.", file=str(path), place=key)
    return value
