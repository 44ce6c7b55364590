"""The model to fit with what its type says, where that was asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from kilter_core.identify.fleet.prior import FleetPrior, fleet_prior, left_one_out
from kilter_core.identify.fleet.versions import FRAMES, FleetVersion
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.rows.measurement_of_rows import measurement_for
from kilter_core.model import Calibration
from kilter_core.observations import Observations


def of_its_type(
    begin: Calibration, train: Observations, options: IdentifyOptions, versions: Sequence[FleetVersion] | None
) -> tuple[Calibration, FleetPrior | None]:
    """The calibration to fit from, whose model knows its type by ``versions`` of other robots; and that prior.

    Raises:
        CoreError: ``fleet_too_few``, ``fleet_gauge``: no prior from these versions.

    """
    if options.prior is None:
        return begin, None
    found = fleet_prior(begin.model, free_parameter_names(begin, train, options), versions or ())
    found = replace(found, left_one_out=left_one_out(begin.model, found.versions))
    return replace(begin, model=replace(begin.model, of_type=found.prior)), found


def free_parameter_names(begin: Calibration, train: Observations, options: IdentifyOptions) -> list[str]:
    """Names of what a fit of these rows frees; views place base and tool by cameras and boards, which is the same gauge."""
    measurement = measurement_for(train, options, begin.marker_points)
    rotation, base = measurement.observes_orientation, measurement.observes_base
    free = options.free_parameters(begin.model, observes_orientation=rotation, observes_base=base)
    names = [begin.names[k] for k in free]
    return [*names, *(f"{frame}x" for frame in FRAMES)] if measurement.tool.places_itself else names
