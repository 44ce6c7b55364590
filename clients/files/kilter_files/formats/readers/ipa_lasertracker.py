"""Fraunhofer IPA's campaigns with a laser tracker."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime
from pathlib import Path

from kilter_files.formats.reader import DEVICE, NO_HINTS, Document, Head, Hints, Reader
from kilter_files.formats.tables.text import read_text
from kilter_files.formats.unknown.understood import describe_table
from kilter_files.ground.errors import FileError
from kilter_files.ground.units import from_euler
from kilter_files.tables.source import Layout, TextSource
from kilter_files.tables.table import Table

# Fraunhofer IPA robot accuracy data: UR10 and Leica laser tracker with T-Mac, one CSV per series.
#
# Semicolons with decimal commas; joints in rad, position in mm, orientation in deg as intrinsic XYZ Euler angles.

LAYOUT = Layout(delimiter=";", decimal=",")
JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
AXES = ("x", "y", "z")
STAMP = re.compile(r"\d{14}")
NEEDED = (*JOINTS, *(f"measurement_{axis}" for axis in AXES), *(f"measurement_r{axis}" for axis in AXES))


def read_ipa_lasertracker(path: Path) -> Table:
    """Read one series.

    Raises:
        FileError: another file (the hand-eye calibration has no joints), or a damaged cell.

    """
    source = read_text(path, LAYOUT)
    absent = [name for name in NEEDED if not source.has(name)]
    if absent:
        raise FileError(
            f"{path}: is not a series of the IPA data, {', '.join(absent)} missing. Upload a measurements_*.csv; "
            "the hand-eye calibration holds no joint readings.",
            file=str(path),
            column=absent[0],
        )
    table = Table({}, source.lines)
    _joints_and_pose(source, table)
    _spread(source, table)
    if source.has("measurement_temperature"):
        table.columns["temperature_c"] = source.numbers("measurement_temperature")
        table.notes.append("temperature_c from measurement_temperature [C]")
    _time(source, table)
    _goals(source, table)
    _complete(path, table)
    return table


def _joints_and_pose(source: TextSource, table: Table) -> None:
    for i, name in enumerate(JOINTS, start=1):
        table.columns[f"q{i}_rad"] = source.numbers(name)
    for axis in AXES:
        table.columns[f"{axis}_mm"] = source.numbers(f"measurement_{axis}")
    angles = zip(*(source.numbers(f"measurement_r{axis}") for axis in AXES), strict=True)
    turned = [from_euler((math.radians(a), math.radians(b), math.radians(c)), "XYZ") for a, b, c in angles]
    for i, name in enumerate(("qw", "qx", "qy", "qz")):
        table.columns[name] = [quaternion[i] for quaternion in turned]
    table.notes += [
        "q1_rad to q6_rad from the six joints [rad]",
        "x_mm, y_mm, z_mm from measurement_x, y, z [mm]",
        "qw, qx, qy, qz from measurement_rx, ry, rz [deg], Euler angles about the moving axes x, y, z",
    ]


def _spread(source: TextSource, table: Table) -> None:
    names = [f"measurement_std_{axis}" for axis in AXES]
    if not all(source.has(name) for name in names):
        return
    for axis, name in zip(AXES, names, strict=True):
        table.columns[f"s{axis}_mm"] = source.numbers(name)
    table.notes.append("sx_mm, sy_mm, sz_mm from measurement_std_x, y, z [mm]")
    if source.has("measurement_std_rx"):
        table.warnings.append("measurement_std_rx, ry, rz left out: the contract has no spread of orientation")


def _time(source: TextSource, table: Table) -> None:
    if not source.has("Timestamp"):
        return
    stamps = source.texts("Timestamp")
    damaged = [(text, line) for text, line in zip(stamps, source.lines, strict=True) if not STAMP.fullmatch(text)]
    if damaged:
        text, line = damaged[0]
        table.warnings.append(
            f"Timestamp left out: {len(damaged)} of {len(stamps)} are damaged (line {line}: {text!r}, rounded by a "
            "spreadsheet). The order of the rows is the order in time"
        )
        return
    table.columns["t_s"] = [datetime.strptime(text, "%Y%m%d%H%M%S").replace(tzinfo=UTC).timestamp() for text in stamps]
    table.notes.append("t_s from Timestamp, seconds since 1970")


def _goals(source: TextSource, table: Table) -> None:
    ignored = [name for name in source.names if name.startswith("Goal ")]
    if ignored:
        table.notes.append(f"{len(ignored)} Goal columns ignored: commanded, not measured")


def _complete(path: Path, table: Table) -> None:
    """Leave out rows in which the tracker or the robot gave nothing."""
    bad = {i for values in table.columns.values() for i, value in enumerate(values) if math.isnan(value)}
    if bad:
        lines = ", ".join(str(table.lines[i]) for i in sorted(bad)[:5])
        table.warnings.append(f"{len(bad)} rows left out because a cell is empty (line {lines})")
        table.keep([i for i in range(len(table)) if i not in bad])
    if not len(table):
        raise FileError(f"{path}: no complete row. Export the series again.", file=str(path))


class IpaLasertracker(Reader[Table]):
    """One series."""

    name = "ipa-lasertracker"
    title = "A campaign of Fraunhofer IPA's laser tracker data set"
    use = DEVICE

    def recognises(self, head: Head) -> bool:
        """All columns of a series."""
        return not head.hints.say_points and head.layout is not None and set(NEEDED) <= set(head.layout.names)

    def describe(self, head: Head) -> Document:
        """Columns as they stand in the file, and how it is sent."""
        found = describe_table(head)
        return found | {
            "kind": self.name,
            "device": self.name,
            "ready": True,
            "notes": [f"ready for kilter upload --device {self.name}", *found["notes"]],
        }

    def read(self, path: Path, hints: Hints = NO_HINTS) -> Table:
        """Read the series."""
        return read_ipa_lasertracker(path)


READER = IpaLasertracker()
