"""Budgets of uncertainty for the results of jobs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.observations import evenly
from kilter_service.ground.core import core_evaluate, core_measurement
from kilter_service.robots.instruments.store import permissible

if TYPE_CHECKING:
    from kilter_core.identify import Identification, Predictive
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations
    from kilter_service.contract.instruments import Instrument

MOST_ROWS = 2000  # of which a budget is taken, evenly chosen
Instruments = Mapping[str, "Instrument"]


def uncertainty_budget(
    calibration: Calibration,
    known: Predictive | None,
    rows: Observations,
    instrument: Instrument | None,
    refit: Sequence[str] = (),
) -> dict[str, Any] | None:
    """Return the budget of rows as a document; None where a version knows nothing of itself, or no place is measured."""
    if known is None or (rows.position is None and rows.markers is None):
        return None
    if len(rows) > MOST_ROWS and not refit:  # frames are known by all rows that they were fitted to
        rows = rows.select(evenly(len(rows), MOST_ROWS))
    measurement = core_measurement.Measurement.from_observations(rows, calibration.marker_points, held=True)
    found = core_evaluate.Budget.from_measurement(calibration, known, measurement, permissible(instrument), refit)
    return None if found is None else {"instrument": instrument and instrument.name, **found.to_document()}


def coarsest(instruments: Instruments, campaigns: Iterable[str]) -> Instrument | None:
    """Return the instrument of campaigns that may be the most wrong at a metre; None where one of them names none."""
    used = [instruments.get(campaign) for campaign in campaigns]
    known = [one for one in used if one is not None]
    if len(known) < len(used):
        return None
    return max(known, key=lambda one: one.mpe_um + one.mpe_um_per_m, default=None)


def add_to_metrics(
    metrics: Mapping[str, Any],
    found: Identification,
    train: Observations,
    held: Observations | None,
    instruments: Instruments,
    campaigns: Sequence[str],
    held_campaigns: Sequence[str],
) -> None:
    """Put the budgets of the rows that were fitted and of those that were held out beside their errors."""
    inside = np.arange(len(train)) if found.inside is None else found.inside
    outside = np.setdiff1d(np.arange(len(train)), inside)
    if held is None:  # of a fraction the rest; of folds every row was held out once
        held, held_campaigns = train.select(outside if len(outside) else inside), campaigns
    blocks = (("train", train.select(inside), campaigns), ("validation", held, held_campaigns))
    for name, rows, of in blocks:
        if metrics.get(name):
            used = coarsest(instruments, of)
            metrics[name]["budget"] = uncertainty_budget(found.calibration, found.predictive, rows, used)
