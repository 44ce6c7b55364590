"""The tool's height over the sheet: a potentiometer's or LVDT's channel in a TDMS, text or MATLAB file, in s and mm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kilter_files.formats.logs.inclinometer import TIME
from kilter_files.formats.reader import Head
from kilter_files.formats.registry import binary_reader
from kilter_files.formats.tables.mat import read_mat
from kilter_files.formats.tables.tdms import Calibration, channels, read_channel
from kilter_files.formats.tracker_header import canonical_column_name
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, fault
from kilter_files.ground.names import did_you_mean
from kilter_files.ground.text_blocks import blocks, count_rows, line_number_of_row
from kilter_files.ground.text_layout import sniff
from kilter_files.ground.units import SIZES, converter

MOST_CALIBRATION_POINTS = 1000


@dataclass(frozen=True)
class Heights:
    """``mm`` (n) at ``t_s`` (n), larger when the tool is farther from the paper."""

    path: Path
    t_s: Floats
    mm: Floats
    note: str

    def around(self, t_s: Floats, window_s: float) -> tuple[Floats, Floats]:
        """Return mean height and its scatter within half a window of each time; NaN where the file has none."""
        low = np.searchsorted(self.t_s, t_s - window_s / 2)
        high = np.maximum(np.searchsorted(self.t_s, t_s + window_s / 2, side="right"), low)
        count = high - low
        shifted = self.mm - self.mm.mean()
        sums = [np.concatenate([[0.0], np.cumsum(shifted**power)]) for power in (1, 2)]
        with np.errstate(invalid="ignore", divide="ignore"):
            mean, square = ((total[high] - total[low]) / count for total in sums)
        scatter = np.sqrt(np.maximum(square - mean**2, 0.0))
        return np.where(count > 0, mean + self.mm.mean(), np.nan), np.where(count > 0, scatter, np.nan)


def read_calibration(text: str) -> Calibration:
    """Understand ``V:mm,V:mm``: volts and the heights a gauge block gave them.

    Raises:
        FileError: fewer than two points, a volt twice, or heights that go up and down.

    """
    try:
        pairs = [tuple(float(part) for part in point.split(":")) for point in text.split(",")]
    except ValueError:
        pairs = []
    points = sorted((pair[0], pair[1]) for pair in pairs if len(pair) == 2 and np.isfinite(pair).all())
    if len(points) < 2 or len(points) != len(pairs) or len(points) > MOST_CALIBRATION_POINTS:
        raise FileError(f"calibration {text[:80]!r}: give two or more V:mm, for example 0:-10,5:35.")
    steps = np.diff(np.array(points), axis=0)
    if not (np.all(steps[:, 0] > 0) and (np.all(steps[:, 1] > 0) or np.all(steps[:, 1] < 0))):
        raise FileError(f"calibration {text[:80]!r}: each volt has one height, and heights only rise or only fall.")
    return Calibration(tuple(points))


def read_heights(
    path: Path, channel: str | None = None, calibration: Calibration | None = None, time: str | None = None
) -> Heights:
    """Read a channel; ``time`` names its time where the file does not say, ``calibration`` makes mm of volts.

    Raises:
        FileError: no such channel, no time, volts without or outside the calibration, an empty cell, time that goes back.

    """
    reader, cut = binary_reader(Head(path)), None
    if reader is None:
        t, values, unit, name, cut = _text(path, channel, time)
    elif reader.name == "tdms":
        t, values, unit, name = _tdms(path, channel)
    elif reader.name == "mat":
        t, values, unit, name = _mat(path, channel, time)
    else:
        raise fault(path, f"is {reader.is_a}, not a log of heights", "Give TDMS, CSV or .mat.")
    if len(values) < 2:
        raise fault(path, f"has {len(values)} values", "Record the whole drawing.", column=name)
    if not (np.isfinite(values).all() and np.isfinite(t).all()):
        row = int(np.argmax(~(np.isfinite(values) & np.isfinite(t))))
        raise fault(path, f"value {row + 1} is missing", "Fill it or leave it out.", column=name)
    if np.any(np.diff(t) <= 0):
        row = int(np.argmax(np.diff(t) <= 0)) + 2
        raise fault(path, f"time goes back or stops at value {row}", "Split the file there.", column=name)
    note = f"height from {name!r} of {path.name}" + ("" if cut is None else f" ({cut})")
    return Heights(path, t, _in_mm(path, name, values, unit, calibration), note)


def _in_mm(path: Path, name: str, values: Floats, unit: str | None, calibration: Calibration | None) -> Floats:
    if calibration is not None:
        mm = calibration.to_mm(values)
        if np.isnan(mm).any():
            row = int(np.argmax(np.isnan(mm)))
            what = f"value {row + 1}, {values[row]:.6g} V, is far outside the calibration"
            raise fault(path, what, "Calibrate over the whole range, or choose another channel.", column=name)
        return mm
    convert = converter(unit, "mm") if unit else None
    if convert is None:
        what = f"is in {unit or 'no stated unit'}, not in mm"
        raise fault(path, what, "Give the calibration of volts to mm (--calibration 0:-10,5:35).", column=name)
    return values * convert(1.0)


def _tdms(path: Path, channel: str | None) -> tuple[Floats, Floats, str | None, str]:
    found = channels(path)
    name = _chosen(path, channel, [c.name for c in found])
    step = next(c.step_s for c in found if c.name == name)
    if step is None:
        what = "states no time between its samples (wf_increment)"
        raise fault(path, what, "Record it as a waveform, or export it with a time column.", column=name)
    t, values = read_channel(path, name)
    unit = next(c.unit for c in found if c.name == name)
    return t, values, unit or None, name


def _text(path: Path, channel: str | None, time: str | None) -> tuple[Floats, Floats, str | None, str, str | None]:
    layout = sniff(path)
    names = list(layout.names)
    at = (
        names.index(time)
        if time in names
        else next((i for i, n in enumerate(names) if canonical_column_name(n) in TIME), None)
    )
    if at is None or (time is not None and time not in names):
        raise fault(path, f"no time among {', '.join(names[:12])}", "Name its column t_s, or give --height-time.")
    name = _chosen(path, channel, [n for n in names if n != names[at]])
    column = names.index(name)
    rows, cut = count_rows(path, layout)
    raw = np.concatenate(list(blocks(path, layout, [at, column], rows)))
    if np.isnan(raw).any():
        row = int(np.argmax(np.isnan(raw).any(axis=1)))
        raise fault(
            path, "a cell is empty", "Fill it or leave the row out.", line=line_number_of_row(path, layout, row)
        )
    return raw[:, 0] * SIZES["time"].get(layout.units[at] or "s", 1.0), raw[:, 1], layout.units[column], name, cut


def _mat(path: Path, channel: str | None, time: str | None) -> tuple[Floats, Floats, str | None, str]:
    if channel is None or time is None:
        what = "its variables say neither height nor time"
        raise fault(path, what, "Give --channel and --height-time, for example u(:,1) and t.")
    source = read_mat(path)
    t, values = np.array(source.numbers(time)), np.array(source.numbers(channel))
    if len(t) != len(values):
        raise fault(
            path, f"{len(values)} heights and {len(t)} times", "Name two columns of one length.", column=channel
        )
    return t, values, None, channel


def _chosen(path: Path, channel: str | None, names: list[str]) -> str:
    if channel is not None and channel not in names:
        what = f"no channel {channel!r}{did_you_mean(channel, names)}"
        raise fault(path, what, f"It has {', '.join(names[:20])}.", column=channel)
    if channel is None and len(names) != 1:
        raise fault(path, f"has {len(names)} channels", f"Choose with --channel: {', '.join(names[:20])}.")
    return channel if channel is not None else names[0]
