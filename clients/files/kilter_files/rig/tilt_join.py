"""Inclinometer logs joined with the joint log: dwells are found and averaged as those of a tracker, and become readings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kilter_files.formats.logs.inclinometer import read_inclinometer, tilt_column_indices
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, fault
from kilter_files.ground.text_layout import sniff
from kilter_files.ground.units import SIZES
from kilter_files.match.dwells import RestOptions
from kilter_files.match.matching import match_dwells
from kilter_files.tables.joint_log import JointLog
from kilter_files.tables.recording import Block, Recording

ARM_MM = 1000.0  # the tip of a pointer so long stands for an angle: 1 mm/s is 0.06 deg/s
ROW = "log_row"
UNIT_TOLERANCE = 0.05
TURNED_DEG = 2.0  # of a joint, from which its motion tells the unit of the angles
STILL_DEG = 0.02


@dataclass(frozen=True)
class TiltOptions:
    """``joint`` is the number (from 1) the inclinometer sits behind, ``axis`` that of its frame; ``by`` order or time."""

    joint: int
    axis: str = "z"
    by: str = "time"
    channel: str = "x"
    unit: str | None = None
    rest: RestOptions = field(default_factory=RestOptions)


def pointer(path: Path, channel: str, unit: str | None) -> Recording:
    """Read an inclinometer log as a recording of one marker: the tip of a pointer that tilts.

    Raises:
        FileError: no such channel, or whatever ``read_inclinometer`` refuses.

    """
    found = read_inclinometer(path, unit)
    angle = found.columns.get(f"tilt_{channel}_deg")
    if angle is None:
        raise fault(path, f"has no inclination {channel}", "Choose the other with --channel.")
    t, a = found.columns["t_s"], np.radians(angle)
    steps = np.diff(t)
    if not (steps > 0).any():
        raise fault(path, "its time stands still", "Record more than one reading.")
    points = ARM_MM * np.stack([np.sin(a), np.cos(a), np.zeros(len(a))], axis=1)[:, None, :]

    def blocks() -> Iterator[Block]:
        yield Block(t.copy(), points.copy(), np.arange(1, len(t) + 1))

    rate = float(1.0 / np.median(steps[steps > 0]))
    return Recording(path, "inclinometer", ("pointer",), rate, len(t), blocks, found.notes, found.warnings)


def join_tilts(
    after: Path, before: Path | None, log: JointLog, joints: Sequence[str], options: TiltOptions
) -> tuple[dict[str, Floats], dict[str, Any]]:
    """Readings of one joint: configuration (``q1_deg`` ...) and ``reading_deg`` of every rest, and how they were found.

    ``joints`` are the robot's names of the joints. A reading is the inclination after the joint, minus that before it,
    minus the commanded rotation where the axis is the joint's own.

    Raises:
        FileError: rests that do not fit the log, angles in another unit than stated, an earlier joint that moves unseen.

    """
    marked = replace(log, columns=log.columns | {ROW: np.arange(len(log), dtype=np.float64)})
    rows, tilt, report = _rests(after, marked, options)
    if before is not None:
        others, level, more = _rests(before, marked, options)
        both, first, second = np.intersect1d(rows, others, return_indices=True)
        rows, tilt = both, tilt[first] - level[second]
        report["warnings"] += more["warnings"]
    q = log.q_even()[rows]
    if before is None:
        _refuse_unseen(after, q, options, joints)
    if options.axis == "z":
        tilt = _beyond_command(after, q[:, options.joint - 1], tilt, options)
    if len(rows) < 2:
        raise fault(
            after, f"has {len(rows)} dwells in common with the log", "Record all of them with both instruments."
        )
    columns = {_degrees(name): q[:, k] for k, name in enumerate(log.joints)}
    report |= {"readings": len(rows), "joint": joints[options.joint - 1], "axis": options.axis}
    return columns | {"reading_deg": tilt}, report


def _degrees(name: str) -> str:
    stem, _, unit = name.partition("_")
    return f"{stem}_deg" if unit in ("deg", "rad") else f"{stem}_mm"


def _rests(path: Path, log: JointLog, options: TiltOptions) -> tuple[Floats, Floats, dict[str, Any]]:
    """Rows of the log at rest, the mean inclination there in degrees, and the report of the matching."""
    recording = pointer(path, options.channel, options.unit)
    found = match_dwells(recording, log, options.by, options.rest)
    x, y = (found.columns[f"m1{axis}_mm"] for axis in "xy")
    tilt = np.degrees(np.unwrap(np.arctan2(x, y)))
    report = {"dwells": found.report["dwells"], "clock": found.report["clock"], "warnings": found.report["warnings"]}
    return found.columns[ROW].astype(np.int64), tilt, report


def _refuse_unseen(path: Path, q: Floats, options: TiltOptions, joints: Sequence[str]) -> None:
    moving = [joints[k] for k in range(options.joint - 1) if len(q) and np.ptp(q[:, k]) > STILL_DEG]
    if moving:
        what = f"{', '.join(moving)} before {joints[options.joint - 1]} moves too, and one inclinometer measures all of them"
        raise fault(path, what, "Give the log of the inclinometer on the link before the joint (--before).")


def _beyond_command(path: Path, q: Floats, tilt: Floats, options: TiltOptions) -> Floats:
    """Inclination minus the commanded rotation; its sign is that of the mounting."""
    if not len(q) or np.ptp(q) < TURNED_DEG:
        what = f"the joint rotates by {np.ptp(q) if len(q) else 0.0:.3g} deg between the dwells"
        raise fault(path, what, f"Rotate it by more than {TURNED_DEG:g} deg, so that sign and unit can be seen.")
    slope = float(np.polyfit(q, tilt, 1)[0])
    if abs(abs(slope) - 1.0) > UNIT_TOLERANCE:
        raise _other_unit(path, slope, options.unit or stated_unit(path))
    return np.asarray(np.sign(slope) * tilt - q)


def _other_unit(path: Path, slope: float, stated: str) -> FileError:
    """Say which unit would make the inclination follow the joint; angles were brought to degrees as ``stated``."""
    size = SIZES["angle"][stated] / max(abs(slope), 1e-9)
    likely = [unit for unit, own in SIZES["angle"].items() if abs(own / size - 1.0) < UNIT_TOLERANCE]
    what = f"the inclination changes {abs(slope):.4g} times as much as the joint rotates"
    if likely:
        what += f": the angles are {likely[0]} declared as {stated}"
        return fault(path, what, f"Give the unit: --unit {likely[0]}.")
    return fault(path, what, "Is it another joint, another axis (--axis), or is its axis steep?")


def stated_unit(path: Path) -> str:
    """Return the unit a log states for its inclinations, deg where it states none."""
    layout = sniff(path)
    return next((layout.units[i] or "deg" for i in tilt_column_indices(layout).values()), "deg")
