"""Budgets of uncertainty for the results of jobs.

How the curve of an effect over its own quantity is called: on the page, in reports and in files of figures alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.observations import evenly
from kilter_service.contract.figures import EffectCurve
from kilter_service.contract.gap_details import AtJoints
from kilter_service.ground.core import core_evaluate, core_measurement
from kilter_service.robots.store import permissible

if TYPE_CHECKING:
    from kilter_core.identify import Identification, Predictive
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations
    from kilter_service.contract.devices import Instrument


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


SIDES = {1.0: "after motion +", -1.0: "after motion −", 0.0: "not moved"}


def title(curve: EffectCurve) -> str:
    """Return what is drawn over what."""
    said = f"{_format_effect_at_joints(curve.id, [curve.joint])} over {quantity(curve)}"
    return said[0].upper() + said[1:]


def format_effect_name(effect: AtJoints) -> str:
    """Return what an effect is called, with its joints."""
    return _format_effect_at_joints(effect.id, effect.joints or [])


def across(curve: EffectCurve) -> str:
    """Return the title of the axis along x."""
    return f"{quantity(curve)}, {unit_of_x(curve)}"


def upwards(curve: EffectCurve) -> str:
    """Return the title of the axis along y."""
    return f"what joint {curve.joint} {'rotates' if curve.unit == 'deg' else 'moves'} by, {curve.unit}"


def quantity(curve: EffectCurve) -> str:
    """Return the quantity that the effect follows."""
    rotary = curve.unit == "deg"
    return {
        "q": f"{'angle' if rotary else 'position'} of joint {curve.joint}",
        "axial": f"load {'moment about' if rotary else 'force along'} joint {curve.joint}",
        "t": "time since the first visit",
        "temperature_c": "temperature",
    }.get(curve.follows, curve.follows)


def unit_of_x(curve: EffectCurve) -> str:
    """Return the unit of that quantity as people write it."""
    return "°C" if curve.x_unit == "degC" else curve.x_unit


def model(direction: float | None) -> str:
    """Return what a curve of the model is called in a legend."""
    return f"model{_direction_suffix(direction)}, 95 % band"


def visit(direction: float | None) -> str:
    """Return what the visits of a direction are called in a legend."""
    return f"visit{_direction_suffix(direction)}, 95 % interval"


def _format_effect_at_joints(effect: str, joints: Sequence[int]) -> str:
    *others, last = [str(joint) for joint in joints] or [""]
    where = f" of joints {', '.join(others)} and {last}" if others else f" of joint {last}" if last else ""
    return f"{effect.replace('_', ' ')}{where}"


def _direction_suffix(direction: float | None) -> str:
    return "" if direction is None else f", {SIDES[direction]}"
