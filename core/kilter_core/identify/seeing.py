"""What rows are to an identification: points and poses in a frame, distances between poses, or contacts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import OptionError
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import Contacts
from kilter_core.measurement.distances import Distances
from kilter_core.observations import Observations

Floats = NDArray[np.float64]


def seen(
    observations: Observations,
    options: IdentifyOptions,
    points: Floats | None = None,
    anchor: Measurement | None = None,
) -> Measurement:
    """Measurement of rows as the options want them.

    ``points (m, 3)`` is the markers' known shape; ``anchor`` are the rows that say where contacts stand.

    Raises:
        ObservationError: nothing measured. OptionError: a method that does not go with these rows.

    """
    if Contacts.held(observations):
        _refuse(options, "Rows held by sockets, planes and bars")
        known = {tuple(map(int, pair.split("-"))): mm * 1e-3 for pair, mm in options.socket_distances_mm.items()}
        places = anchor if isinstance(anchor, Contacts) else None
        return Contacts.among(observations, {(a, b): m for (a, b), m in known.items()}, places)
    if options.base == "removed":
        _refuse(options, "Distances between poses (base removed)")
        return Distances.of(observations, points)
    return Measurement.of(observations, points)


def _refuse(options: IdentifyOptions, what: str) -> None:
    if options.method != "least_squares":
        raise OptionError(f"{what} are identified by method least_squares only.", option="method")
    if options.loss == "tukey":
        raise OptionError(f'{what} have no rows to let go one by one: take loss "huber".', option="loss")
    if options.intervals == "bootstrap":
        raise OptionError(f"{what} have no poses to resample one by one: take intervals profile.", option="intervals")
    if any(effect.id == "unknown_residual" for effect in options.make_effects()):
        raise OptionError(f"{what} cannot gate a learned effect: leave unknown_residual out.", option="effects")
