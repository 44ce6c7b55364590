"""Inclinometer logs: time and one or two inclinations, as any text table, in degrees and seconds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kilter_client.files.faults import fault
from kilter_client.files.recording import Floats
from kilter_client.files.text_blocks import blocks, count_rows, line_of
from kilter_client.files.text_layout import TextLayout, sniff
from kilter_client.files.tracker_header import plain
from kilter_client.files.units import SIZES, converter

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


def tilts_of(layout: TextLayout) -> dict[str, int]:
    """Return which column is the inclination x and y; empty when it is no inclinometer's file."""
    found: dict[str, int] = {}
    for i, name in enumerate(layout.names):
        match = TILT.match(plain(name))
        if match:
            found.setdefault(AXES[match[1]], i)
    return found


def read_inclinometer(path: Path, unit: str | None = None) -> Inclinations:
    """Read an inclinometer log; ``unit`` is that of its angles where the file does not say.

    Raises:
        FileError: no inclination or time among the columns, no unit, an angle that cannot be, time that goes back.

    """
    layout = sniff(path)
    tilts = tilts_of(layout)
    time = next((i for i, name in enumerate(layout.names) if plain(name) in TIME), None)
    if not tilts or time is None:
        said = ", ".join(layout.names[:12])
        raise fault(path, f"no time and inclination among {said}", "Name the columns so.", line=layout.first_line)
    wanted = sorted({time, *tilts.values()})
    rows, cut = count_rows(path, layout)
    raw = np.concatenate(list(blocks(path, layout, wanted, rows)))
    t = raw[:, wanted.index(time)] * SIZES["time"].get(layout.units[time] or "s", 1.0)
    _refuse(path, layout, np.isnan(raw).any(axis=1), "a cell is empty", None)
    _refuse(path, layout, np.diff(t, prepend=-np.inf) < 0, "time goes back: two logs glued together", time)
    columns: dict[str, Floats] = {"t_s": t - t[0]}
    notes = []
    for axis, column in sorted(tilts.items()):
        stated = layout.units[column] or unit
        convert = converter(stated, "deg") if stated else None
        if convert is None:
            what = f"its angles are in {stated or 'no stated unit'}"
            raise fault(path, what, "Give the unit: deg, rad, mrad (mm/m), arcmin.", column=layout.names[column])
        angle = raw[:, wanted.index(column)] * convert(1.0)
        wild = np.abs(angle) > STEEPEST_DEG
        _refuse(path, layout, wild, f"more than half a turn, declared as {stated}: are these degrees", column)
        columns[f"tilt_{axis}_deg"] = angle
        notes.append(f"tilt_{axis}_deg from {layout.names[column]!r} [{stated}]")
    return Inclinations(columns, tuple(notes), () if cut is None else (cut,))


def _refuse(
    path: Path,
    layout: TextLayout,
    wrong: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    what: str,
    column: int | None,
) -> None:
    if wrong.any():
        line = line_of(path, layout, int(np.argmax(wrong)))
        place = {} if column is None else {"column": layout.names[column]}
        raise fault(path, what, "Correct the row, or export again.", line=line, **place)
