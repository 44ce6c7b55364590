"""Budgets of uncertainty: what contributes to it, by which kind of knowledge, and the expanded uncertainty."""

from __future__ import annotations

from pydantic import Field

from kilter_service.contract.units import Mm, Stored


class Contribution(Stored):
    """A source of uncertainty, as the root mean square over rows and coordinates."""

    source: str = Field(
        description="`instrument`, `repeatability`, `registration` (base and tool), `temperature`, `model` (all other "
        "parameters) or `left_over` (what the fit left beyond the noise)."
    )
    type: str = Field(description="`A`: by the scatter of measurements; `B`: by other knowledge, as a certificate.")
    distribution: str = Field(description="Assumed distribution: `normal`, or `rectangular` within the half width.")
    half_width_mm: Mm | None = Field(None, description="Half width of a rectangular distribution, mm.")
    standard_mm: Mm = Field(description="Standard uncertainty of a coordinate, mm.")
    share: float = Field(description="Its share of the variance of a prediction.")
    of_measured: bool = Field(description="Whether it counts for a measured error too, not only for a prediction.")


class Correlation(Stored):
    """Two sources that are not known independently."""

    between: list[str] = Field(description="The two sources.")
    coefficient: float = Field(
        description="Their correlation before they were told apart; as contributions they do not correlate: the second has "
        "what the first does with it."
    )


class Budget(Stored):
    """What is not known of a coordinate of the tool at some rows: standard uncertainties and, with `k`, expanded ones."""

    rows: int = Field(description="Rows it is taken over, at most 2000, evenly chosen.")
    instrument: str | None = Field(None, description="Name of the instrument; null: none was named.")
    k: float = Field(description="Coverage factor: the expanded uncertainty is k times the standard one, about 95 %.")
    standard_mm: Mm = Field(
        description="Standard uncertainty of a coordinate of a new measurement, as the version predicts it, mm."
    )
    expanded_mm: Mm = Field(description="The same, expanded, mm.")
    measured_standard_mm: Mm = Field(description="Standard uncertainty of a coordinate of a measured error, mm.")
    measured_expanded_mm: Mm = Field(description="The same, expanded, mm.")
    contributions: list[Contribution] = Field(description="What contributes.")
    correlations: list[Correlation] = Field(description="What is not known independently.")
    not_assessed: list[str] = Field(
        description="Sources that nothing tells of: no instrument named, no repeats, no temperature."
    )
