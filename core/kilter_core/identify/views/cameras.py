"""Cameras and boards in a fit: where they stand is fitted beside the arm, and is never part of its correction.

The places of a camera and a board take the part that base and tool have with a tracker: without one, base and tool stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from kilter_core.arm.robot import Robot
from kilter_core.effects import Batch, Effect, Local
from kilter_core.effects.physical import INSTRUMENT
from kilter_core.measurement import Measurement
from kilter_core.measurement.registration import register
from kilter_core.model import Calibration, RobotModel
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class Cameras(Effect):
    """Where the cameras and boards of ``rig`` stand, and their intrinsics and scales. It moves nothing of the arm."""

    id = "cameras"
    summary = "places of cameras and boards"
    source = "a camera that stands somewhere"
    physical = INSTRUMENT
    stage = "measurement"
    at_joints = False

    rig: PlacedRig | None = None

    @property
    def instrument(self) -> Any:
        """The cameras and boards."""
        return self.rig

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Increments of every place, and what is unknown of the cameras and boards themselves."""
        assert self.rig is not None
        return self.rig.parameters

    def local(self, batch: Batch, values: Floats) -> Local:
        """Nothing: cameras only look."""
        return Local()


def with_cameras(begin: Calibration, train: Observations, measurement: Measurement) -> Calibration:
    """The model to fit with the cameras that measured ``train``, from where they stood before or from nothing.

    Raises:
        ObservationError: what the views do not tell.

    """
    if measurement.pixels is None:
        return begin
    model, values = begin.model.absorb_frame_increments(begin.values)
    if measurement.observes_places:
        model = model.in_frames(*register(model, values, measurement.of_tool()))
    seen = train if train.camera is None else train.select(train.camera >= 0)
    seen = replace(seen, position=None, rotation=None, markers=None, sigma=None)  # views begin by themselves
    here = Calibration(model, values, begin.marker_points)
    views = Measurement.from_observations(seen, held=True).pixels
    assert views is not None
    known = None if measurement.observes_places else begin.rig
    rig = views.initial_rig(replace(here, rig=known).predict(seen)).with_folded_increments()
    effects = (*(e for e in begin.model.effects if not isinstance(e, Cameras)), Cameras(rig=rig))
    found = begin.with_effects(effects)
    start = found.values.copy()
    start[len(start) - len(rig.unknowns) :] = rig.values
    return replace(found, values=start)


def with_rig(calibration: Calibration, measurement: Measurement) -> Calibration:
    """The calibration with cameras and boards where they fit other rows best, all of the arm held."""
    views = measurement.pixels
    assert views is not None
    return replace(calibration, rig=views.fit_rig_to_rows(calibration.predict(measurement.observations)))


def unknown_rig(model: RobotModel) -> PlacedRig | None:
    """Cameras and boards whose unknowns are parameters of a model; None where no camera measured."""
    return next((e.rig for e in model.effects if isinstance(e, Cameras)), None)


def rig_from_calibration(calibration: Calibration) -> PlacedRig | None:
    """Cameras and boards as a calibration has them, the fitted ones where it has an effect of them."""
    fitted = rig_from_values(calibration.model, calibration.values)
    return calibration.rig if fitted is None else fitted.with_folded_increments()


def rig_from_values(model: RobotModel, values: Floats) -> PlacedRig | None:
    """Cameras and boards of an effect of a model, with the increments that ``values (P,)`` are; None where it has none."""
    for effect, at in model.effects_with_slices:
        if isinstance(effect, Cameras) and effect.rig is not None:
            return effect.rig.with_values(values[at])
    return None
