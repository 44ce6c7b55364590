"""What the server answers about budgets, made from the interface by `make contract`: change it there."""

from __future__ import annotations

from kilter_client.results.record import Record, Records


class Contribution(Record):
    """A source of uncertainty, as the root mean square over rows and coordinates."""

    distribution: str
    """Assumed distribution: `normal`, or `rectangular` within the half width."""
    half_width_mm: float | None
    """Half width of a rectangular distribution, mm."""
    of_measured: bool
    """Whether it counts for a measured error too, not only for a prediction."""
    share: float
    """Its share of the variance of a prediction."""
    source: str
    """`instrument`, `repeatability`, `registration` (base and tool), `temperature`, `model` (all other parameters) or `left_over` (what the fit left beyond the noise)."""
    standard_mm: float
    """Standard uncertainty of a coordinate, mm."""
    type: str
    """`A`: by the scatter of measurements; `B`: by other knowledge, as a certificate."""


class Correlation(Record):
    """Two sources that are not known independently."""

    between: tuple[str, ...]
    """The two sources."""
    coefficient: float
    """Their correlation before they were told apart; as contributions they do not correlate: the second has what the first does with it."""


class Budget(Record):
    """What is not known of a coordinate of the tool at some rows: standard uncertainties and, with `k`, expanded ones."""

    contributions: Records[Contribution]
    """What contributes."""
    correlations: Records[Correlation]
    """What is not known independently."""
    expanded_mm: float
    """The same, expanded, mm."""
    instrument: str | None
    """Name of the instrument; None: none was named."""
    k: float
    """Coverage factor: the expanded uncertainty is k times the standard one, about 95 %."""
    measured_expanded_mm: float
    """The same, expanded, mm."""
    measured_standard_mm: float
    """Standard uncertainty of a coordinate of a measured error, mm."""
    not_assessed: tuple[str, ...]
    """Sources that nothing tells of: no instrument named, no repeats, no temperature."""
    rows: int
    """Rows it is taken over, at most 2000, evenly chosen."""
    standard_mm: float
    """Standard uncertainty of a coordinate of a new measurement, as the version predicts it, mm."""
