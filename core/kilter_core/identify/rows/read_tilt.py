"""A tilt that was measured is either to be explained or taken as it was read: whichever effects a model has decides."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from kilter_core.effects import Effect
from kilter_core.model import Calibration
from kilter_core.observations import Observations


def as_inputs(named: Sequence[Effect | type[Effect]], start: Calibration | None, *given: Any) -> tuple[Any, ...]:
    """What was given, its rows with the tilt of the base as a condition where an effect takes it so.

    The effects are those ``named`` and those of the ``start``.
    """
    effects = (*named, *(() if start is None else start.model.effects))
    if not any("base_tilt_x" in effect.needs for effect in effects):
        return given
    return tuple(one.with_tilt_as_condition() if isinstance(one, Observations) else one for one in given)
