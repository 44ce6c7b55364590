"""A drawn or swept circle and the tool's height, joined with the joint log into rows of contract columns."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kilter_files.formats.instrument_logs import TIME
from kilter_files.formats.marker_header import canonical_column_name
from kilter_files.formats.reader import Head
from kilter_files.formats.registry import binary_reader, open_source
from kilter_files.formats.tables.mat import read_mat
from kilter_files.formats.tables.tdms import Calibration, channels, read_channel
from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, did_you_mean, fault
from kilter_files.ground.text_blocks import blocks, count_rows, line_number_of_row
from kilter_files.ground.text_layout import sniff
from kilter_files.ground.units import SIZES, converter
from kilter_files.tables.source import Layout
from kilter_files.tables.table import JointLog, Table

REGISTERED_MM = 3.0
REACH_MM = 1.5  # a row this near to the circle and to its gap was at that gap
ASIDE_MM = 0.5
OTHER_LENGTH_MM = 0.2  # a ball bar is set up within this of the circle that is commanded
LEAST_SIGMA_MM = 0.005
ROWS_NEEDED = 8
SEEN_TO_FACE = 0.3  # cosine of its normal to the vertical from which a sheet faces up or down and not sideways
AXES = "xyz"


@dataclass(frozen=True)
class Circle:
    """Errors of a circle of ``radius_mm`` at ``turn`` rad: out of it, and along it where that was measured.

    ``is_bar`` where a ball bar measured it. ``along_mm`` is None for a bare line; values are NaN where nothing was measured.
    """

    path: Path
    radius_mm: float
    turn: Floats
    out_mm: Floats
    out_sigma_mm: Floats
    along_mm: Floats | None
    along_sigma_mm: Floats | None
    is_bar: bool = False


@dataclass(frozen=True)
class Frame:
    """The sheet in the robot's base: its axes are the columns of ``turned``; what the four points are left with."""

    turned: Floats
    centre_mm: Floats
    left_mm: Floats

    @staticmethod
    def sheet_frame() -> Frame:
        """The sheet's own frame."""
        return Frame(np.eye(3), np.zeros(3), np.zeros(4))


@dataclass(frozen=True)
class JoinOptions:
    """``window_s`` is averaged of the height; ``starts_s`` is the log's time when the height's file begins.

    ``taken_mm`` is the standard deviation of a coordinate that is taken from the command, None to refuse that.
    """

    window_s: float = 0.1
    starts_s: float = 0.0
    taken_mm: float | None = None


@dataclass
class Joined:
    """Rows ready for upload, and how well they fit together."""

    table: Table
    report: dict[str, Any] = field(default_factory=dict)


def read_points(path: Path) -> Floats:
    """Read the four quarter points (4, 3) in mm as the robot showed them, rows 1 to 4 with x_mm, y_mm, z_mm.

    Raises:
        FileError: other columns or another number of rows.

    """
    source = open_source(path, "csv", Layout())
    points = np.array([source.numbers(f"{axis}_mm") for axis in AXES]).T
    if points.shape != (4, 3) or np.isnan(points).any():
        what = f"has {len(points)} rows, or an empty cell"
        raise fault(path, what, "Give x_mm, y_mm, z_mm of quarter points 1, 2, 3, 4 in this order.")
    return points


def register(path: Path, points: Floats, radius_mm: float, faces_down: bool = False) -> Frame:
    """Lay the sheet through the four quarter points (4, 3); its face is up unless it ``faces_down``.

    Raises:
        FileError: they are not four quarters of such a circle, or run in the opposite direction.

    """
    turn = np.arange(4) * np.pi / 2
    sheet = radius_mm * np.stack([np.cos(turn), np.sin(turn), np.zeros(4)], axis=1)
    centre = points.mean(axis=0)
    U, _, V = np.linalg.svd(sheet.T @ (points - centre))
    turned = V.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(V.T @ U.T)) or 1.0]) @ U.T
    left = np.linalg.norm(points - centre - sheet @ turned.T, axis=1)
    if left.max() > REGISTERED_MM:
        found = np.linalg.norm(points - centre, axis=1)
        what = f"point {int(np.argmax(left)) + 1} is {left.max():.1f} mm off a circle of {radius_mm:g} mm"
        said = ", ".join(f"{value:.1f}" for value in found)
        raise fault(path, what, f"They lie {said} mm from their middle: check order, unit and sheet.")
    up = float(turned[2, 2])
    if abs(up) > SEEN_TO_FACE and (up < 0) != faces_down:
        way = "counterclockwise" if faces_down else "clockwise"
        what = f"the points run {way} seen from above, so the sheet would face {'up' if faces_down else 'down'}"
        other = "leave --faces-down out" if faces_down else "give --faces-down"
        raise fault(path, what, f"Give them in the order 1, 2, 3, 4 of the sheet; if it does lie like that, {other}.")
    return Frame(turned, centre, left)


def join(circle: Circle, log: JointLog, heights: Heights | None, frame: Frame, options: JoinOptions) -> Joined:
    """Join: one row for each place of the circle at which the log has the pencil.

    Raises:
        FileError: a log without commanded positions or time, that never follows the circle, or not within the heights.

    """
    along, taken = _along(circle, options)
    commanded = commanded_mm(log)
    at_sheet = (commanded - frame.centre_mm) @ frame.turned
    if circle.is_bar:
        in_plane = np.abs(at_sheet[:, 2]) < REGISTERED_MM
        if in_plane.any():
            refuse_other_length(circle.path, circle.radius_mm, float(np.median(np.hypot(*at_sheet[in_plane, :2].T))))
    rows, places = _match_rows_to_circle(circle, log, at_sheet, along)
    turn = circle.turn[places]
    r = circle.radius_mm + circle.out_mm[places]
    angle = turn + along[places] / r
    height, height_sigma, note = _height(circle, log, heights, options, rows, turn, at_sheet)
    on_sheet = np.stack([r * np.cos(angle), r * np.sin(angle), height], axis=1)
    sigma = np.stack(
        [
            np.maximum(circle.out_sigma_mm[places], LEAST_SIGMA_MM),
            np.full(len(rows), taken)
            if circle.along_sigma_mm is None
            else np.maximum(circle.along_sigma_mm[places], LEAST_SIGMA_MM),
            np.maximum(height_sigma, LEAST_SIGMA_MM),
        ],
        axis=1,
    )
    position = frame.centre_mm + on_sheet @ frame.turned.T
    table = _table(log, rows, position, _along_axes(sigma, turn, frame))
    table.notes.append(f"{len(rows)} of {len(circle.turn)} places of {circle.path.name} have a row of {log.path.name}")
    table.notes.append(note)
    if circle.along_mm is None:
        table.warnings.append(
            f"the line shows no error along itself: the command is used instead, with an uncertainty of {taken:g} mm. "
            "Identify joint offsets at most from such rows (--level 1)"
        )
    moved = at_sheet[rows] - on_sheet
    report = {
        "rows": len(rows),
        "frame": {"left_mm": [round(float(v), 4) for v in frame.left_mm]},
        "off_command_rms_mm": round(float(np.sqrt((moved**2).sum(axis=1).mean())), 4),
    }
    return Joined(table, report)


def refuse_other_length(path: Path, nominal_mm: float, commanded: float) -> None:
    """Refuse a ball bar's nominal length that is not the radius commanded: deviations would make another bar of it.

    Raises:
        FileError: they differ, with the option that mends it.

    """
    if abs(commanded - nominal_mm) > OTHER_LENGTH_MM:
        what = f"its nominal length is {nominal_mm:g} mm, but the circle commanded has a radius of {commanded:.3f} mm"
        said = f"{what} ({commanded / nominal_mm:.4g} times)"
        raise fault(path, said, f"If that is the bar's length, give --radius-mm {commanded:.6g}.")


def _along(circle: Circle, options: JoinOptions) -> tuple[Floats, float]:
    if circle.along_mm is not None:
        return circle.along_mm, 0.0
    if options.taken_mm is None:
        what = "shows no error along the circle: it has no strokes across the line"
        remedy = "Draw strokes, or use the command with the uncertainty of the robot: --take-command 1."
        raise fault(circle.path, what, remedy)
    return np.zeros(len(circle.turn)), options.taken_mm


def commanded_mm(log: JointLog) -> Floats:
    """Return the commanded tool positions (n, 3) of a log, mm.

    Raises:
        FileError: it has none.

    """
    for unit, factor in (("mm", 1.0), ("m", 1000.0)):
        if all(f"{axis}_{unit}" in log.columns for axis in AXES):
            return np.stack([log.columns[f"{axis}_{unit}"] for axis in AXES], axis=1) * factor
    what = "has no commanded tool positions"
    raise fault(log.path, what, "Add x_mm, y_mm, z_mm of the path that was commanded: they say where on the circle.")


def _match_rows_to_circle(
    circle: Circle, log: JointLog, at_sheet: Floats, along: Floats
) -> tuple[np.ndarray[Any, np.dtype[np.int64]], np.ndarray[Any, np.dtype[np.int64]]]:
    """Rows of the log and places of the circle that belong together, in the order of the places."""
    angle = np.arctan2(at_sheet[:, 1], at_sheet[:, 0])
    off = np.hypot(at_sheet[:, 0], at_sheet[:, 1]) - circle.radius_mm
    known = np.flatnonzero(~(np.isnan(circle.out_mm) | np.isnan(along)))
    turned = 0.0  # the sheet may be rotated a little against the command
    rows = np.zeros(0, dtype=np.int64)
    for _ in range(2):
        aside = _wrap_angle(angle[None, :] - circle.turn[known][:, None] - turned) * circle.radius_mm
        rows = np.argmin(np.hypot(aside, off[None, :]), axis=1)
        aside, height = aside[np.arange(len(known)), rows], np.abs(at_sheet[rows, 2])
        near = (np.abs(aside) < REACH_MM) & (np.abs(off[rows]) < REACH_MM) & (height < REGISTERED_MM)
        if np.count_nonzero(near) < ROWS_NEEDED:
            what = f"comes within {REACH_MM:g} mm of only {np.count_nonzero(near)} places of the circle"
            remedy = "Are its x_mm, y_mm, z_mm in the frame of the points (--points), and of this circle?"
            raise fault(log.path, what, remedy)
        turned += float(np.median(aside[near])) / circle.radius_mm
    aside = _wrap_angle(angle[rows] - circle.turn[known] - turned) * circle.radius_mm
    good = near & (np.abs(aside) < ASIDE_MM)
    return rows[good], known[good]


def _wrap_angle(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _height(
    circle: Circle,
    log: JointLog,
    heights: Heights | None,
    options: JoinOptions,
    rows: Any,
    turn: Floats,
    at_sheet: Floats,
) -> tuple[Floats, Floats, str]:
    """Heights over the plane through the four quarter points, their sigma, and what they are."""
    if heights is None:
        if options.taken_mm is None:
            what = "shows no height"
            raise fault(circle.path, what, "Give the potentiometer's file (--height), or --take-command.")
        return at_sheet[rows, 2], np.full(len(rows), options.taken_mm), "heights are those commanded"
    if log.t_s is None:
        raise fault(log.path, "has no time", "Add t_s: it joins the log with the heights.")
    mean, scatter = heights.around(log.t_s[rows] - options.starts_s, options.window_s)
    if np.isnan(mean).any():
        row = int(rows[int(np.argmax(np.isnan(mean)))])
        what = f"has no height {log.t_s[row] - options.starts_s:.3f} s after its start, row {row + 1} of {log.path}"
        raise fault(heights.path, what, "Give the log's time at which it begins (--height-starts-s).")
    quarters = [int(np.argmin(np.abs(_wrap_angle(turn - k * np.pi / 2)))) for k in range(4)]
    apart = [abs(float(_wrap_angle(turn[quarter] - k * np.pi / 2))) for k, quarter in enumerate(quarters)]
    if max(apart) > np.radians(20):
        what = f"no row near quarter point {int(np.argmax(apart)) + 1}"
        raise fault(log.path, what, "The heights count from the plane through all four: draw and log there too.")
    return mean - float(mean[quarters].mean()), scatter, heights.note + ", from the plane through the quarter points"


def _along_axes(sigma: Floats, turn: Floats, frame: Frame) -> Floats:
    """Standard deviations (n, 3) along the axes of the frame, of ones out of the circle, along it and upright."""
    c, s, zero, one = np.cos(turn), np.sin(turn), np.zeros(len(turn)), np.ones(len(turn))
    local = np.stack(
        [np.stack([c, s, zero], axis=1), np.stack([-s, c, zero], axis=1), np.stack([zero, zero, one], axis=1)], axis=2
    )
    ways = frame.turned @ local
    return np.asarray(np.sqrt(np.einsum("nij,nj->ni", ways**2, sigma**2)))


def _table(log: JointLog, rows: Any, position: Floats, sigma: Floats) -> Table:
    measured = {f"{axis}_{unit}" for axis in AXES for unit in ("mm", "m")}
    columns = {name: [float(v) for v in values[rows]] for name, values in log.columns.items() if name not in measured}
    for k, axis in enumerate(AXES):
        columns[f"{axis}_mm"] = [round(float(v), 6) for v in position[:, k]]
    for k, axis in enumerate(AXES):
        columns[f"s{axis}_mm"] = [round(float(v), 6) for v in sigma[:, k]]
    return Table(columns, list(range(1, len(rows) + 1)))


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
