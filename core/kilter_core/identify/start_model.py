"""What a fit begins with: the model with the effects asked for, and rows that have what these read."""

from __future__ import annotations

from dataclasses import replace

from kilter_core.arm.robot import Robot
from kilter_core.errors import ObservationError
from kilter_core.identify.carried_masses import with_masses
from kilter_core.identify.options import IdentifyOptions
from kilter_core.model import Calibration
from kilter_core.observations import Observations


def build_start_model(
    robot: Robot, train: Observations, options: IdentifyOptions, start: Calibration | None
) -> Calibration:
    """The model to fit at its starting values: the effects asked for, or with none asked those of the start."""
    effects = tuple(effect.configure_for_robot(robot, train) for effect in options.make_effects())
    if start is None:
        return Calibration.nominal(robot, with_masses(effects, robot, train, options))
    begin = replace(start, doubts=())  # of the fit before
    return begin.with_effects(with_masses(effects or start.model.effects, robot, train, options))


def refuse_missing_columns(begin: Calibration, train: Observations) -> None:
    """Raise :class:`ObservationError` where an effect of the model needs a column that the rows do not have."""
    available = frozenset({"moments"} | set(train._present()))
    for effect in begin.model.effects:
        missing = effect.missing(available)
        if missing:
            raise ObservationError(
                f"Effect {effect.id} needs {', '.join(sorted(missing))}, which these observations do not have: "
                "upload the columns, or leave the effect out.",
                effect=effect.id,
                missing=sorted(missing),
            )
