"""A read sheet as a CSV table and as a figure."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np

from kilter_files.rig.sheet.reading import SheetReading

COLUMNS = ("angle_deg", "out_mm", "out_sigma_mm", "along_mm", "along_sigma_mm")


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
