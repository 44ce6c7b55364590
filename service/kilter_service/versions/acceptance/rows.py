"""What a version leaves of rows that it was not fitted to, and with which uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import CoreError
from kilter_core.observations import Observations, evenly
from kilter_core.types import Floats, Ints
from kilter_service.contract.instruments import Instrument
from kilter_service.ground.core import core_evaluate, core_identify, core_measurement, core_model, core_watch
from kilter_service.robots.instruments.validity import permissible

if TYPE_CHECKING:
    from kilter_core.evaluate import Conformity
    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration


MOST_SHOWN = 500


@dataclass(frozen=True)
class Judged:
    """Rows of a campaign: the conformity of the worst, errors in mm, the budget, and places with errors (N,) m.

    ``before`` are those of the nominal robot with both frames fitted.
    """

    conformity: Conformity
    before: dict[str, float]
    after: dict[str, float]
    budget: dict[str, Any]
    places: Floats
    sizes: Floats
    rows: Ints


def judge_rows(
    calibration: Calibration,
    known: Predictive,
    rows: Observations,
    numbers: Ints,
    instrument: Instrument | None,
    refit: Sequence[str],
    tolerance_m: float,
) -> Judged | None:
    """Judge rows, whose ``numbers`` in their campaign are from 0; None where no place of the tool was measured.

    Raises:
        CoreError: too few rows for the frames to fit.

    """
    if rows.position is None and rows.markers is None:
        return None
    measurement = core_measurement.Measurement.from_observations(rows, calibration.marker_points, held=True)
    fitted = core_identify.refit_frames(calibration, measurement, tuple(refit))
    budget = core_evaluate.Budget.from_measurement(fitted, known, measurement, permissible(instrument), refit)
    if budget is None:
        return None
    error = core_evaluate.errors_by_row(fitted, measurement).error
    seen = ~np.isnan(error).any(axis=1)
    if not seen.any():
        return None
    sizes = np.linalg.norm(error[seen], axis=1)
    conformity = core_evaluate.judge(sizes, core_evaluate.K * budget.along(np.nan_to_num(error))[seen], tolerance_m)
    nominal = core_identify.refit_frames(
        core_model.Calibration.nominal(calibration.robot), measurement, ("base", "tool")
    )
    before, after = (
        core_measurement.Errors.from_calibration(one, measurement).to_document() for one in (nominal, fitted)
    )
    document = {"instrument": instrument and instrument.name, **budget.to_document()}
    return Judged(conformity, before, after, document, _places(rows)[seen], sizes, numbers[seen])


def of_another_arm(calibration: Calibration, known: Predictive, rows: Observations, found: Judged) -> bool:
    """Whether a check of these rows would refuse them as another arm's: they are far off, and no one cause explains it."""
    misfit = float(np.sqrt(np.mean(found.sizes**2)))
    if not core_watch.far_off(calibration, misfit):
        return False
    try:
        core_watch.check(calibration, rows, known)
    except CoreError as error:
        return error.code == core_watch.ANOTHER_ARM
    return False


def sample_places_and_errors(found: Judged) -> tuple[Floats, Floats]:
    """Places (n, 3) m and errors (n,) m of some rows, evenly chosen, the worst among them."""
    some = np.union1d(evenly(len(found.sizes), MOST_SHOWN), found.sizes.argmax())
    return found.places[some], found.sizes[some]


def span(found: Sequence[Judged]) -> tuple[Floats, Floats]:
    """Lowest and highest places (3,) m."""
    places = np.concatenate([one.places for one in found])
    return places.min(axis=0), places.max(axis=0)


def _places(rows: Observations) -> Floats:
    if rows.position is not None:
        return rows.position
    assert rows.markers is not None
    seen = ~np.isnan(rows.markers)
    return np.asarray(np.where(seen, rows.markers, 0.0).sum(axis=1) / np.maximum(seen.sum(axis=1), 1))
