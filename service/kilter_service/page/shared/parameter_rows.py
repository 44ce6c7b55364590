"""The parameters of a version as rows: a dot with its interval over what was known before, the clearest change first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from kilter_service.contract.fits import Parameter
from kilter_service.page.figures import strip
from kilter_service.page.words import parameter_sigma

TWO = 1.96  # standard deviations of an end of a 95 % interval


@dataclass(frozen=True)
class ParameterRow:
    """A parameter and its drawing, which is empty where nothing says how sure it is, or what was known before."""

    parameter: Parameter
    drawn: Markup | str


def parameter_rows(parameters: Sequence[Parameter], priors: Mapping[str, float]) -> list[ParameterRow]:
    """Return the rows, sorted by change over standard deviation."""
    ordered = sorted(parameters, key=lambda one: -_clearness(one))
    return [ParameterRow(one, _draw(one, priors.get(one.name))) for one in ordered]


def _clearness(one: Parameter) -> float:
    sigma = parameter_sigma(one)
    return 0.0 if one.change is None else abs(one.change) / sigma if sigma else math.inf


def _draw(one: Parameter, prior: float | None) -> Markup | str:
    sigma = parameter_sigma(one)
    if one.change is None or one.value is None or not sigma or not prior:
        return ""
    nominal = one.value - one.change
    low = one.change - TWO * sigma if one.lower is None else one.lower - nominal
    high = one.change + TWO * sigma if one.upper is None else one.upper - nominal
    title = f"{one.name}: {_clearness(one):.1f} standard deviations from nominal; the band is what was known before"
    return strip.against_prior(one.change, low, high, prior, title)
