"""A drawn sheet read: which sheet, how well it was placed, and how far the pencil was from the circle at every gap."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.rig.sheet.camera import INCH_MM, Camera, Picture, fit_camera, read_picture
from kilter_files.rig.sheet.fiducials import Marks, find_marks, place_sheet
from kilter_files.rig.sheet.layout import Sheet
from kilter_files.rig.sheet.trace import REACH_MM, Line, Ring, Strokes, printed_circle, strokes, trace, unroll

LEAST_DPI = 120.0
GOOD_DPI = 250.0
LONGEST_MISSING = 2  # gaps without a line that are passed over
SECOND_IN = 0.25
MOST_LENS_SIGMAS = 4.0
RIM_MARKS = 8
STROKES_NEEDED = 4
SCALE_OFF = 0.005
BLUNT_MM = 1.05

COLUMNS = ("angle_deg", "out_mm", "out_sigma_mm", "along_mm", "along_sigma_mm")


@dataclass(frozen=True)
class Options:
    """What the person says of a sheet: ``bars_mm`` are the two scale bars as measured on paper, across and upright."""

    radius_mm: float | None = None
    page: int = 1
    bars_mm: tuple[float, float] | None = None
    allow_gaps: bool = False


@dataclass(frozen=True)
class SheetReading:
    """``angle_deg`` of the gaps, counterclockwise from quarter point 1; errors out of the circle and along it, in mm.

    NaN where nothing was drawn. ``along_mm`` is None on a sheet without strokes.
    """

    path: Path
    sheet: Sheet
    angle_deg: Floats
    out_mm: Floats
    out_sigma_mm: Floats
    along_mm: Floats | None
    along_sigma_mm: Floats | None
    width_mm: float
    placing: dict[str, Any]
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def to_document(self) -> dict[str, Any]:
        """Return the reading as the command prints it."""
        known = self.out_mm[~np.isnan(self.out_mm)]
        rows = []
        for k, angle in enumerate(self.angle_deg):
            row = {"angle_deg": round(float(angle), 4)} | _pair("out", self.out_mm[k], self.out_sigma_mm[k])
            if self.along_mm is not None and self.along_sigma_mm is not None:
                row |= _pair("along", self.along_mm[k], self.along_sigma_mm[k])
            rows.append(row)
        return {
            "file": str(self.path),
            "radius_mm": self.sheet.radius_mm,
            "line": {
                "gaps": len(self.angle_deg),
                "seen": len(known),
                "width_mm": round(self.width_mm, 3),
                "mean_abs_mm": round(float(np.abs(known).mean()), 4),
                "rms_mm": round(float(np.sqrt((known**2).mean())), 4),
                "max_abs_mm": round(float(np.abs(known).max()), 4),
                "radius_mm": round(self.sheet.radius_mm + float(known.mean()), 4),
            },
            "placing": self.placing,
            "rows": rows,
            "notes": self.notes,
            "warnings": self.warnings,
        }


def _pair(name: str, value: float, sigma: float) -> dict[str, float | None]:
    empty = bool(np.isnan(value))
    return {
        f"{name}_mm": None if empty else round(float(value), 4),
        f"{name}_sigma_mm": None if empty else round(float(sigma), 4),
    }


def read_sheet(path: Path, options: Options = Options()) -> SheetReading:
    """Read a scan or photo of a drawn sheet.

    Raises:
        FileError: no picture, no sheet, too few pixels, no line or more than one, a part of it missing.
        MissingPackageError: a package of the extra ``sheet`` is not installed.

    """
    picture = read_picture(path, options.page)
    marks = find_marks(picture, options.radius_mm)
    camera, marks, warnings = place_sheet(picture, marks)
    dpi = _check_density(picture, camera, marks.sheet, warnings)
    ring = unroll(picture.rgb, camera, marks.sheet)
    line = trace(ring)
    camera, rim = _with_rim(picture, camera, marks, ring, line)
    ring = unroll(picture.rgb, camera, marks.sheet)
    line = trace(ring)
    _check_line(path, line, options.allow_gaps, warnings)
    return _reading(picture, camera, marks, line, strokes(ring, line), rim, dpi, options, warnings)


def _check_density(picture: Picture, camera: Camera, sheet: Sheet, warnings: list[str]) -> float:
    turn = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    rim = sheet.radius_mm * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    pixels = camera.to_pixels(rim)
    height, width = picture.rgb.shape[:2]
    if not np.all((pixels > 2) & (pixels < [width - 3, height - 3])):
        outside = float(np.degrees(turn[np.argmin(np.all((pixels > 2) & (pixels < [width - 3, height - 3]), axis=1))]))
        raise fault(picture.path, f"the circle leaves the picture at {outside:.0f} deg", "Take the whole sheet.")
    dpi = float(camera.px_per_mm(rim).min()) * INCH_MM
    if dpi < LEAST_DPI:
        what = f"has {dpi:.0f} dpi on the sheet where it is least"
        raise fault(picture.path, what, f"At least {LEAST_DPI:.0f} are needed, 300 are good: scan finer, go nearer.")
    if dpi < GOOD_DPI:
        warnings.append(f"only {dpi:.0f} dpi on the sheet, 300 are good")
    return dpi


def _with_rim(picture: Picture, camera: Camera, marks: Marks, ring: Ring, line: Line) -> tuple[Camera, dict[str, Any]]:
    """Place the sheet again with its printed circle, which also shows a lens that bends."""
    size = (picture.rgb.shape[1], picture.rgb.shape[0])
    which, out = printed_circle(ring, line)
    radius = marks.sheet.radius_mm
    good = np.abs(out - np.median(out)) < 0.35 if len(out) else np.zeros(0, dtype=bool)
    which, out = which[good], out[good]
    seen = {"dashes_seen": len(which), "circle_rms_mm": round(float(np.sqrt((out**2).mean())), 4) if len(out) else None}
    turn = (2 * which + 1) * np.pi / ring.periods
    at = (radius + out)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    rim = (radius, camera.to_pixels(at)) if len(which) >= RIM_MARKS else None
    if len(marks.mm) < 6:
        return (camera if rim is None else fit_camera(size, marks.mm, marks.pixels, rim)[0]), seen
    bent, _ = fit_camera(size, marks.mm, marks.pixels, rim, with_lens=True)
    if abs(bent.lens) > MOST_LENS_SIGMAS * bent.lens_sigma:
        return bent, seen
    return fit_camera(size, marks.mm, marks.pixels, rim)[0], seen


def _check_line(path: Path, line: Line, allow_gaps: bool, warnings: list[str]) -> None:
    there = ~np.isnan(line.out_mm)
    step = 360.0 / len(there)
    if np.count_nonzero(there) < 0.2 * len(there):
        what = f"no drawn line within {REACH_MM:g} mm of the circle ({np.count_nonzero(there)} of {len(there)} gaps)"
        raise fault(path, what, "Draw with a soft, sharp pencil along the circle; scan with more contrast.")
    second = np.flatnonzero(line.second)
    if len(second) > SECOND_IN * np.count_nonzero(there):
        what = f"two lines run beside each other, first at {second[0] * step:.0f} deg"
        raise fault(path, what, "Draw only one run on each sheet.")
    start, longest = _longest_run(~there)
    if longest > LONGEST_MISSING and not allow_gaps:
        first, last = start * step, (start + longest - 1) * step
        what = f"the line is missing from {first:.0f} to {last % 360:.0f} deg"
        raise fault(path, what, "Draw the whole circle, or take what there is with allow_gaps (--allow-gaps).")
    if not there.all():
        warnings.append(f"no line in {np.count_nonzero(~there)} of {len(there)} gaps")
    if np.nanmax(np.abs(line.out_mm)) > REACH_MM - 0.9:
        at = int(np.nanargmax(np.abs(line.out_mm))) * step
        what = f"the line is more than {REACH_MM - 0.9:.1f} mm from the circle at {at:.0f} deg"
        raise fault(path, what, "Register the robot to the four quarter points first, then draw again.")
    if float(np.nanmedian(line.width_mm)) > BLUNT_MM:
        warnings.append(f"the line is {np.nanmedian(line.width_mm):.1f} mm wide: a blunt pencil, or two runs")


def _longest_run(missing: Any) -> tuple[int, int]:
    """Start and length of the longest run of True around the ring."""
    best, count = (0, 0), len(missing)
    if missing.all():
        return 0, count
    first = int(np.argmin(missing))
    length = 0
    for k in range(first, first + count + 1):
        if missing[k % count]:
            length += 1
        else:
            best = max(best, ((k - length) % count, length), key=lambda b: b[1])
            length = 0
    return best


def _reading(
    picture: Picture,
    camera: Camera,
    marks: Marks,
    line: Line,
    crossing: Strokes,
    rim: dict[str, Any],
    dpi: float,
    options: Options,
    warnings: list[str],
) -> SheetReading:
    sheet, count = marks.sheet, len(line.out_mm)
    turn = 2 * np.pi * np.arange(count) / count
    radial = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    tangent = np.stack([-np.sin(turn), np.cos(turn)], axis=1)
    placed = [camera.sigma_along(sheet.radius_mm * radial, way) for way in (radial, tangent)]
    drawn = np.count_nonzero(~np.isnan(crossing.along_mm)) >= STROKES_NEEDED
    out, along = line.out_mm, crossing.along_mm if drawn else np.full(count, np.nan)
    scaled, stretch = _on_paper(picture, camera, sheet, options, warnings)
    if scaled is not None:
        point = (sheet.radius_mm + out)[:, None] * radial + np.where(np.isnan(along), 0, along)[:, None] * tangent
        moved = point * scaled
        out = np.sum(moved * radial, axis=1) - sheet.radius_mm
        along = np.where(np.isnan(along), np.nan, np.sum(moved * tangent, axis=1))
    off = np.linalg.norm(camera.to_mm(marks.pixels) - marks.mm, axis=1)
    placing = {
        "by": marks.way,
        "marks": len(marks.mm),
        "marks_rms_mm": round(float(np.sqrt((off**2).mean())), 4),
        "sigma_mm": round(float(placed[0].mean()), 4),
        "dpi": round(dpi, 1),
        "lens": round(camera.lens, 5),
        "scale": stretch,
    } | rim
    notes = [f"placed by {len(marks.mm)} marks ({marks.way}), lens {camera.lens:+.4f}"]
    notes.append(
        "strokes across the line show errors along it" if drawn else "no strokes: errors along it are unobservable"
    )
    return SheetReading(
        picture.path,
        sheet,
        np.degrees(turn),
        out,
        np.hypot(line.sigma_mm, placed[0]),
        along if drawn else None,
        np.hypot(crossing.sigma_mm, placed[1]) if drawn else None,
        float(np.nanmedian(line.width_mm)),
        placing,
        notes,
        warnings,
    )


def _on_paper(
    picture: Picture, camera: Camera, sheet: Sheet, options: Options, warnings: list[str]
) -> tuple[Floats | None, dict[str, Any]]:
    """Scale of the print, by bars measured on paper; else what the scanner's own resolution says of it."""
    if options.bars_mm is not None:
        scale = np.array(options.bars_mm) / sheet.bar_mm
        if np.any(np.abs(scale - 1) > 0.1):
            what = (
                f"bars of {options.bars_mm[0]:g} and {options.bars_mm[1]:g} mm are not the sheet's {sheet.bar_mm:g} mm"
            )
            raise fault(picture.path, what, "Measure both bars from end to end, in mm.")
        return scale, {"x": round(float(scale[0]), 5), "y": round(float(scale[1]), 5), "from": "bars"}
    if picture.px_per_mm is None:
        return None, {"x": 1.0, "y": 1.0, "from": "print"}
    step = np.array([[sheet.radius_mm, 0], [-sheet.radius_mm, 0], [0, sheet.radius_mm], [0, -sheet.radius_mm]])
    p = camera.to_pixels(step)
    sizes = [float(np.linalg.norm(p[k] - p[k + 1])) / (2 * sheet.radius_mm * picture.px_per_mm) for k in (0, 2)]
    if max(abs(size - 1) for size in sizes) > SCALE_OFF:
        said = " x ".join(f"{100 * size:.1f} %" for size in sizes)
        warnings.append(f"by the scanner's resolution it was printed at {said}: measure the bars and give --bars-mm")
    return None, {"x": 1.0, "y": 1.0, "from": "print", "by_scanner": [round(size, 5) for size in sizes]}


def to_csv(reading: SheetReading) -> bytes:
    """Return one row per gap; empty cells where nothing was drawn."""
    out = io.StringIO(newline="")
    writer = csv.writer(out, lineterminator="\n")
    rows = reading.to_document()["rows"]
    names = [name for name in COLUMNS if name in rows[0]]
    writer.writerow(names)
    writer.writerows(["" if row[name] is None else row[name] for name in names] for row in rows)
    return out.getvalue().encode()


def figure(reading: SheetReading) -> dict[str, Any]:
    """Return the errors over the angle as a Plotly document, their two-sigma bounds as small points."""
    traces = [*_traces(reading, "out of the circle", reading.out_mm, reading.out_sigma_mm, "#1f5fa8")]
    if reading.along_mm is not None and reading.along_sigma_mm is not None:
        traces += _traces(reading, "along it", reading.along_mm, reading.along_sigma_mm, "#d2691e")
    return {
        "data": traces,
        "layout": {
            "title": {"text": f"Drawn line against the circle of {reading.sheet.radius_mm:g} mm"},
            "xaxis": {"title": {"text": "angle from quarter point 1, deg"}},
            "yaxis": {"title": {"text": "error, mm (small: two sigma)"}},
        },
    }


def _traces(reading: SheetReading, name: str, value: Any, sigma: Any, colour: str) -> list[dict[str, Any]]:
    known = ~np.isnan(value)
    x = reading.angle_deg[known]
    bounds = np.concatenate([value[known] - 2 * sigma[known], value[known] + 2 * sigma[known]])
    return [
        _scatter(name, x, value[known], 6, colour),
        _scatter(None, np.concatenate([x, x]), bounds, 2, colour),
    ]


def _scatter(name: str | None, x: Any, y: Any, size: float, colour: str) -> dict[str, Any]:
    points = {"x": [round(float(v), 4) for v in x], "y": [round(float(v), 4) for v in y]}
    return {"type": "scatter", "mode": "markers", "name": name, "marker": {"size": size, "color": colour}} | points
