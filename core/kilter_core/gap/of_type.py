"""A search that begins with what other arms of the type say: geometry that their spread holds hides no effect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from kilter_core.arm.robot import Robot
from kilter_core.errors import FindingDocument, OptionError
from kilter_core.gap.options import GapOptions
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fleet_prior import FleetPrior, FleetVersion, of_its_type
from kilter_core.identify.fleet_report import prior_document, prior_warnings
from kilter_core.identify.measured_rows import measurement_for
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.plausibility.belonging import refuse_mixed_up
from kilter_core.model import Calibration
from kilter_core.observations import Observations


@dataclass(frozen=True)
class KnownType:
    """Where a search begins whose geometry has the prior of the type, and the ``fit`` that this prior was judged by."""

    start: Calibration
    fleet: FleetPrior
    fit: Fit

    def to_document(self) -> dict[str, Any]:
        """The prior of the contract."""
        return prior_document(self.fleet, self.fit)

    def warnings(self) -> list[FindingDocument]:
        """What to know of the prior."""
        return list(prior_warnings(self.fleet, self.fit))


def known_type(
    robot: Robot, rows: Observations, options: GapOptions, start: Calibration | None, versions: Sequence[FleetVersion]
) -> KnownType:
    """The start of a search of these ``rows``, with the prior of ``versions`` of others, as far as the arm is one of them.

    The geometry is fitted without effects beside those of the start, so what is missing makes the arm look odd, and the prior
    wider: an effect is rather missed than named of a prior that does not hold.

    Raises:
        CoreError: ``fleet_too_few``, ``fleet_gauge``, ``fleet_conflict``: no prior from these versions.
        OptionError: nothing of the tool was measured.

    """
    begin = start or Calibration.nominal(robot)
    if rows.position is None and rows.markers is None:
        raise OptionError("Prior fleet needs rows that measure the tool: leave prior out.", option="prior")
    refuse_mixed_up(begin, rows)
    asked = IdentifyOptions(
        free=options.free,
        fix=options.fix,
        base=options.base,
        tool=options.tool,
        noise_mm=options.noise_mm,
        prior="fleet",
    )
    told, fleet = of_its_type(begin, rows, asked, versions)
    assert fleet is not None
    fit = fit_by_method(told, measurement_for(rows, asked, begin.marker_points), asked)
    model = replace(begin.model, of_type=fit.problem.model.of_type)
    return KnownType(replace(begin, model=model), fleet, fit)
