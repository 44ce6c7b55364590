"""The fit of a study: frames registered first, then all free parameters, and the stages that are compared."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.learned import Learned, select_learned_effects
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.reference import is_continued, place_nominal, wanted_frames
from kilter_core.identify.rows.measurement_of_rows import measurement_for
from kilter_core.identify.scale_gauge import with_likeliest_scale
from kilter_core.identify.setup_frames import without_frames
from kilter_core.identify.steps.start import Study
from kilter_core.identify.uncertainty.tool_error import beside_tool_error
from kilter_core.identify.views import with_cameras
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.types import Progress


@dataclass(frozen=True)
class Fitted:
    """The fit of the rows of a study.

    ``begin`` has the cameras and the learned effects that were fitted; the ``stages`` are "nominal", "registration_only"
    and "identified"; ``arm`` is the last of them without the frames of set-ups, cameras and boards.
    """

    begin: Calibration
    measurement: Measurement
    fit: Fit
    learned: Learned | None
    stages: dict[str, Calibration]
    arm: Calibration


def fit_study(study: Study, progress: Progress) -> Fitted:
    """Register the frames of the nominal robot, then fit what the options leave free."""
    options, prior = study.options, study.prior
    measurement = measurement_for(study.train, options, study.points)
    begin = with_cameras(study.begin, study.train, measurement)
    tool = measurement.of_tool()
    registered = place_nominal(begin, tool, options, prior)
    wanted = wanted_frames(begin, registered, tool, options, is_continued(options, prior))
    begin, learned = select_learned_effects(begin, study.train, options, prior)
    found = fit_by_method(begin, measurement, options, progress, prior)
    fit = with_likeliest_scale(beside_tool_error(found))
    stages = name_stages(study, measurement, registered, fit.calibration(*wanted))
    return Fitted(begin, measurement, fit, learned, stages, without_frames(stages["identified"]))


def name_stages(
    study: Study, measurement: Measurement, registered: Calibration, identified: Calibration
) -> dict[str, Calibration]:
    """The calibrations to compare, by name; seen by cameras alone the nominal robot has no place but the registered one."""
    nominal = registered if measurement.tool.places_itself else Calibration.nominal(study.robot)
    return {"nominal": nominal, "registration_only": registered, "identified": identified}
