"""The rows that a search let go, in the order in which they were given, with what the version leaves of each."""

from __future__ import annotations

from typing import Any

import numpy as np

from kilter_core.gap.report.next_poses import set_aside_again
from kilter_core.gap.search.prepare import Prepared
from kilter_core.identify.fit.tukey import points_mm, whitened_row_sizes
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import has_contacts
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Ints


def agreement_sentence(prepared: Prepared, held: Observations | None, spikes: Ints) -> str:
    """Say with how many visits a verdict goes, of those searched and held out; empty where none was set aside."""
    used = prepared.problem.settings.used
    visits = np.zeros(0, dtype=np.int64) if held is None else held.visits()
    seen = np.zeros(0, dtype=bool) if held is None else held.tool_seen
    aside = int(np.sum(~used)) + len(np.unique(visits[spikes]))
    total = len(used) + len(np.unique(visits[seen]))
    if not aside:
        return ""
    return (
        f" This is of {total - aside} of {total} visits: {aside} {'was' if aside == 1 else 'were'} set aside as wrong "
        "readings. Measure their poses again; what errs there again is the arm."
    )


def poses_again(prepared: Prepared, held: Observations | None, spikes: Ints) -> list[dict[str, Any]]:
    """The poses of what was set aside, of rows searched and held out, as documents: to be measured first."""
    source = prepared.problem.settings.source
    if not source.observes_places:
        return []
    parts = [prepared.given.select(prepared.outlying), *([] if held is None else [held.select(spikes)])]
    return [row for rows in parts if len(rows) for row in set_aside_again(rows, source.model.robot)]


def rows_aside(calibration: Calibration, rows: Observations, which: Ints, sigma: float) -> list[dict[str, Any]]:
    """Rows ``which (K,)`` of those given: ``row`` from 0, ``residual_mm`` and ``residual_sigma`` of its point.

    ``sigma`` is the standard deviation of a coordinate, m. Joint data and contacts have no point: both are None.
    """
    found: list[dict[str, Any]] = [
        {"row": int(row), "residual_mm": None, "residual_sigma": None, "weight": 0.0} for row in which
    ]
    if not found or (rows.position is None and rows.markers is None) or has_contacts(rows):
        return found
    measurement = Measurement.from_observations(rows.select(which), calibration.marker_points)
    left = measurement.residual(calibration.predict(measurement.observations))
    size = whitened_row_sizes(left.of_points(), sigma, np.nan) if sigma > 0.0 else np.full(len(which), np.nan)
    for one, length, sigmas in zip(found, points_mm(left), size, strict=True):
        one["residual_mm"] = length
        one["residual_sigma"] = float(sigmas) if np.isfinite(sigmas) else None
    return found
