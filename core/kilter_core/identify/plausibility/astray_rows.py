"""Rows whose tool is nowhere near where their joints put it, among rows that all agree: empty readings, stale positions.

One such row of forty takes a fit, its errors and every verdict with it: the arm is called another one, or its geometry
wrong. Errors of an arm differ from pose to pose by a factor of a few, never by ``BEYOND``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from kilter_core.identify.plausibility.placed import Sample, place_nearer, seen_tool
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import Floats, Ints

ASTRAY = "rows_astray"
FEWEST = 12  # poses below which base and tool can imitate too much
USUAL = 0.75  # quantile of the distances that stands for the usual row
BEYOND = 20.0  # times that
LEAST_M = 5e-3  # what is nearer a robust loss sets aside
MOST = 0.2  # share of the rows: more of them are not exceptions
NEAR_M = 1e-3  # rms distance of rows among which none hides: they need no second look
SHOWN = 5


def astray_warnings(begin: Calibration, rows: Observations) -> Iterator[dict[str, Any]]:
    """Name rows (from 1, of those given) that no arm explains; every set-up of the instrument is placed by itself."""
    found: list[tuple[int, float, float]] = []
    for part in _set_ups(rows):
        index, off = _distances(begin, rows, part)
        usual = float(np.quantile(off, USUAL)) if len(off) else 0.0
        far = np.flatnonzero(off > max(BEYOND * usual, LEAST_M))
        if len(far) <= MOST * len(off):
            found += [(int(index[k]) + 1, float(off[k]), usual) for k in far]
    if found:
        others_mm = mm(max(usual for _, _, usual in found))
        yield _astray_warning([(row, mm(off)) for row, off, _ in sorted(found)], others_mm)


def renumber_warnings(warnings: Iterable[dict[str, Any]], index: Ints) -> Iterator[dict[str, Any]]:
    """The same warnings of rows that are ``index`` (from 0) of more."""
    for one in warnings:
        if one["code"] == ASTRAY:
            found = [(int(index[row - 1]) + 1, off) for row, off in zip(one["rows"], one["off_mm"], strict=True)]
            yield _astray_warning(found, one["others_mm"])
        else:
            yield one


def of_held_out(warnings: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """What is said of rows of a validation: those astray, which are in the errors on held-out rows."""
    for one in warnings:
        if one["code"] == ASTRAY:
            yield {**one, "message": f"Of the validation's rows: {one['message'][0].lower()}{one['message'][1:]}"}


def unless_astray(warnings: Iterable[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """The warnings without that of a large residual where rows astray explain it, which no arm has to."""
    said = list(warnings)
    astray = any(one["code"] == ASTRAY for one in said)
    yield from (one for one in said if not (astray and one["code"] == "large_residual"))


def _astray_warning(found: list[tuple[int, float]], others_mm: float) -> dict[str, Any]:
    shown = ", ".join(f"row {row} by {off:.3g} mm" for row, off in found[:SHOWN])
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return {
        "code": ASTRAY,
        "rows": [row for row, _ in found],
        "off_mm": [off for _, off in found],
        "others_mm": others_mm,
        "message": f"The tool is not where the joints put it in {shown}{more}, where the others are within {others_mm:.2g} mm. "
        "No arm does that: a reading that was not taken (zeros), the position of another pose, or joints of another. Leave "
        "these rows out of the file and upload it again.",
    }


def _set_ups(rows: Observations) -> Iterator[Ints]:
    keys = [key for key in (rows.session, rows.setup) if key is not None]
    if not keys:
        yield np.arange(len(rows))
        return
    codes = np.unique(np.stack(keys, axis=1), axis=0, return_inverse=True)[1].reshape(-1)
    yield from (np.flatnonzero(codes == code) for code in np.unique(codes))


def _distances(begin: Calibration, rows: Observations, part: Ints) -> tuple[Ints, Floats]:
    """Rows of a set-up whose tool can be told, and how far (m) each is from the arm placed by base and tool alone."""
    whole = Measurement.from_observations(rows.select(part), begin.marker_points, held=True)
    index, tool = part[whole.tool.measured_row_mask()], whole.of_tool()
    sample = Sample.from_measurement(begin, tool) if len(index) >= FEWEST else None
    if sample is None or len(sample) < FEWEST:
        return index[:0], np.zeros(0)
    points, _, use = seen_tool(tool, tool.observations)
    placed = (
        sample.fitted_placement
        if sample.fitted_placement.size <= NEAR_M
        else place_nearer(sample.flange, sample.points, sample.fitted_placement)
    )
    flange = sample.predict_flange(tool.observations.q[use])
    return index[use], np.linalg.norm(points[use] - placed.predict_points(flange), axis=1)
