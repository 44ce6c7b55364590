"""What rows are to an identification: points and poses in a frame, distances between poses, or contacts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.effects import Effect
from kilter_core.errors import OptionError
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Floats


def measurement_for(
    observations: Observations,
    options: IdentifyOptions,
    points: Floats | None = None,
    anchor: Measurement | None = None,
) -> Measurement:
    """Measurement of rows as the options want them.

    ``points (m, 3)`` is the markers' known shape; ``anchor`` are the rows that say where contacts stand, and what encoders
    and inclinometers read at zero.

    Raises:
        ObservationError: nothing measured. OptionError: a method that does not go with these rows.

    """
    made = Measurement.from_observations(
        observations,
        points,
        relative=options.base == "removed",
        held=True,
        socket_distances=options.socket_distances,
        anchor=anchor,
    )
    for kind in made.kinds:
        if kind.plain_fits_only:
            _refuse(options, kind.summary[0].upper() + kind.summary[1:])
    return made


def between_rows(options: IdentifyOptions, rows: Observations) -> IdentifyOptions:
    """The options for some of the rows: distances to sockets that are held out are not there to be fitted."""
    known = set() if rows.socket is None else set(np.unique(rows.socket).tolist())
    kept = {p: mm for p, mm in options.socket_distances_mm.items() if {int(n) for n in p.split("-")} <= known}
    return options if len(kept) == len(options.socket_distances_mm) else replace(options, socket_distances_mm=kept)


def _refuse(options: IdentifyOptions, what: str) -> None:
    if options.method != "least_squares":
        raise OptionError(f"{what} are identified by method least_squares only.", option="method")
    if options.loss == "tukey":
        raise OptionError(f'{what} have no rows to let go one by one: take loss "huber".', option="loss")
    if options.intervals == "bootstrap":
        raise OptionError(f"{what} have no poses to resample one by one: take intervals profile.", option="intervals")
    if any(effect.id == "unknown_residual" for effect in options.make_effects()):
        raise OptionError(f"{what} cannot gate a learned effect: leave unknown_residual out.", option="effects")


def as_inputs(named: Sequence[Effect | type[Effect]], start: Calibration | None, *given: Any) -> tuple[Any, ...]:
    """What was given, its rows with the tilt of the base as a condition where an effect takes it so.

    The effects are those ``named`` and those of the ``start``.
    """
    effects = (*named, *(() if start is None else start.model.effects))
    if not any("base_tilt_x" in effect.needs for effect in effects):
        return given
    return tuple(one.with_tilt_as_condition() if isinstance(one, Observations) else one for one in given)
