"""How well a calibration predicts measurements it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from core.errors import OptionError
from core.identify.estimate import estimate
from core.identify.options import IdentifyOptions
from core.measurement import Measurement
from core.metrics import Errors
from core.model import Calibration
from core.observations import Observations


def evaluate(calibration: Calibration, observations: Observations, refit: Sequence[str] = ()) -> dict[str, Any]:
    """Metrics of a calibration on observations beside those of the nominal robot and of registration alone.

    ``refit`` names the frames fitted anew to these observations: [], ["base"] or ["base", "tool"] (the tracker was set
    up anew). ``registration_only`` fits both frames of the nominal robot, whatever ``refit`` says.

    Raises:
        OptionError: another refit. TooFewPosesError: too few poses for it. ObservationError: nothing measured.

    """
    if list(refit) not in ([], ["base"], ["base", "tool"]):
        raise OptionError(f'refit is {list(refit)}: give [], ["base"] or ["base", "tool"].', option="refit")
    measurement = Measurement.of(observations, calibration.marker_points)
    nominal = Calibration.nominal(calibration.robot)
    stages = {
        "nominal": nominal,
        "registration_only": _refitted(nominal, measurement, ("base", "tool")),
        "identified": _refitted(calibration, measurement, tuple(refit)),
    }
    errors = {name: Errors.of(stage, measurement) for name, stage in stages.items()}
    return {"n": len(errors["nominal"].points), **{name: e.to_document() for name, e in errors.items()}}


def _refitted(calibration: Calibration, measurement: Measurement, frames: tuple[str, ...]) -> Calibration:
    if not frames:
        return calibration
    model, values = calibration.model.folded(calibration.values)
    held = model.names[6 : model.n_geometric - 6] + model.names[model.n_geometric :]
    options = IdentifyOptions(fix=held, tool="free" if "tool" in frames else "fixed")
    fit = estimate(Calibration(model, values), measurement, options)
    return Calibration(*fit.problem.model.folded(fit.values), measurement.marker_points)
