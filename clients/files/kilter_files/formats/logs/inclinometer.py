"""Inclinometer logs: time and one or two inclinations, as any text table, in degrees and seconds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from kilter_files.formats.tracker_header import canonical_column_name
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, fault
from kilter_files.ground.later import np
from kilter_files.ground.text_blocks import blocks, count_rows, line_number_of_row
from kilter_files.ground.text_layout import TextLayout, sniff
from kilter_files.ground.units import SIZES, converter

TILT = re.compile(r"^(?:incl|inclination|inclinometer|tilt|angle|slope|neigung|level)[a-z]*?([xy12]?)$")
TIME = ("t", "time", "timestamp", "zeit", "elapsedtime")
AXES = {"": "x", "x": "x", "1": "x", "y": "y", "2": "y"}
STEEPEST_DEG = 181.0


@dataclass(frozen=True)
class Inclinations:
    """``columns``: t_s, tilt_x_deg, and tilt_y_deg where there is one."""

    columns: Mapping[str, Floats]
    notes: tuple[str, ...]
    warnings: tuple[str, ...] = ()


def tilt_column_indices(layout: TextLayout) -> dict[str, int]:
    """Return which column is the inclination x and y; empty when it is not an inclinometer's file."""
    found: dict[str, int] = {}
    for i, name in enumerate(layout.names):
        match = TILT.match(canonical_column_name(name))
        if match:
            found.setdefault(AXES[match[1]], i)
    return found


def read_inclinometer(path: Path, unit: str | None = None) -> Inclinations:
    """Read an inclinometer log; ``unit`` overrides what the file says of its angles.

    Raises:
        FileError: no inclination or time among the columns, no unit, an angle that cannot be, time that goes back.

    """
    layout = sniff(path)
    tilts = tilt_column_indices(layout)
    time = next((i for i, name in enumerate(layout.names) if canonical_column_name(name) in TIME), None)
    if not tilts or time is None:
        said = ", ".join(layout.names[:12])
        raise fault(path, f"no time and inclination among {said}", "Name the columns so.", line=layout.first_line)
    wanted = sorted({time, *tilts.values()})
    rows, cut = count_rows(path, layout)
    raw = np.concatenate(list(blocks(path, layout, wanted, rows)))
    t = raw[:, wanted.index(time)] * SIZES["time"].get(layout.units[time] or "s", 1.0)
    _refuse(path, layout, np.isnan(raw).any(axis=1), "a cell is empty", None)
    _refuse(path, layout, np.diff(t, prepend=-np.inf) < 0, "time goes back: two logs concatenated", time)
    columns: dict[str, Floats] = {"t_s": t - t[0]}
    notes, warnings = [], [] if cut is None else [cut]
    for axis, column in sorted(tilts.items()):
        told = layout.units[column]
        stated = unit or told
        convert = converter(stated, "deg") if stated else None
        if convert is None:
            what = f"its angles are in {stated or 'no stated unit'}"
            raise fault(path, what, "Give the unit: deg, rad, mrad (mm/m), arcmin.", column=layout.names[column])
        angle = raw[:, wanted.index(column)] * convert(1.0)
        wild = np.abs(angle) > STEEPEST_DEG
        if wild.any():
            raise _too_steep(path, layout, int(np.argmax(wild)), column, str(stated))
        if told is not None and unit is not None and told != unit:
            warnings.append(f"{layout.names[column]!r} taken as {unit}, as you say; the file says {told}")
        columns[f"tilt_{axis}_deg"] = angle
        notes.append(f"tilt_{axis}_deg from {layout.names[column]!r} [{stated}]")
    return Inclinations(columns, tuple(notes), tuple(warnings))


def _too_steep(path: Path, layout: TextLayout, row: int, column: int, stated: str) -> FileError:
    """Say which smaller unit the angles may be in."""
    smaller = [unit for unit in ("deg", "mrad", "arcmin", "arcsec") if SIZES["angle"][unit] < SIZES["angle"][stated]]
    factors = [f"{unit} ({SIZES['angle'][unit] / SIZES['angle'][stated]:.4g} of it)" for unit in smaller]
    what = f"more than 180 degrees, declared as {stated}: are these {' or '.join(factors) or 'no angles'}"
    remedy = f"Give the unit (--unit {smaller[0]}), or correct the row." if smaller else "Correct the row."
    return fault(path, what, remedy, line=line_number_of_row(path, layout, row), column=layout.names[column])


def _refuse(
    path: Path,
    layout: TextLayout,
    wrong: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    what: str,
    column: int | None,
) -> None:
    if wrong.any():
        line = line_number_of_row(path, layout, int(np.argmax(wrong)))
        place = {} if column is None else {"column": layout.names[column]}
        raise fault(path, what, "Correct the row, or export again.", line=line, **place)
