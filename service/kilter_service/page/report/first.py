"""The first page of a report that states a tolerance: the decision, and all that it rests on, on one page."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_service.contract.acceptance import Acceptance, JudgedCampaign
from kilter_service.contract.budgets import Budget
from kilter_service.ground.db import Database
from kilter_service.page import words
from kilter_service.page.figures.plot import Plot
from kilter_service.page.figures.scale import around
from kilter_service.page.report.figures import INK, SIZES
from kilter_service.versions.acceptance import service as acceptance
from kilter_service.versions.acceptance.service import Wish

WIDE, TALL = 320.0, 240.0
MOST_CAMPAIGNS = 4  # named on the page, those that decide first
SHADES = ("#b8b8b8", "#777777", INK)
WITHIN, BAND, BEYOND = "within by the guard band", "within it or its band", "beyond"
VIEWS = (("from above", 0, 1), ("from the side", 0, 2))
SOURCES = {
    "instrument": "instrument, by its permissible error",
    "repeatability": "repeatability",
    "registration": "registration: base and tool",
    "temperature": "temperature",
    "model": "all other parameters of the model",
    "left_over": "what the fit left beyond the noise",
}


@dataclass(frozen=True)
class First:
    """The decision, the figure of merit before and after, the budget of the campaign that decides, and its picture."""

    found: Acceptance
    merits: list[list[str]]
    budget: list[list[str]]
    sums: list[list[str]]
    missing: str
    views: list[Plot]

    @property
    def campaigns(self) -> list[JudgedCampaign]:
        """The campaigns that are named."""
        return self.found.campaigns[:MOST_CAMPAIGNS]

    @property
    def more(self) -> int:
        """How many others were judged."""
        return len(self.found.campaigns) - len(self.campaigns)


def first_sheet(database: Database, robot: str, wish: Wish) -> First:
    """Return the first page.

    Raises:
        CoreError: no row is left that was not fitted, or what else speaks against a decision.

    """
    found = acceptance.of_robot(database, robot, wish)
    worst = found.campaigns[0]
    return First(
        found, _merits(found), _budget(worst.budget), _sums(worst.budget),
        ", ".join(SOURCES[one] for one in worst.budget.not_assessed if one in SOURCES), _views(found, worst),
    )  # fmt: skip


def _merits(found: Acceptance) -> list[list[str]]:
    judged = [
        (f"{one.name} ({one.rows} rows), {label}", errors)
        for one in found.campaigns[:MOST_CAMPAIGNS]
        for label, errors in (("base and tool fitted only", one.before), ("calibrated", one.after))
    ]
    lengths = words.in_one_unit([[getattr(errors, size) for size, _ in SIZES] for _, errors in judged])
    return [[label, *sizes] for (label, _), sizes in zip(judged, lengths, strict=True)]


def _budget(budget: Budget) -> list[list[str]]:
    widths = words.in_one_unit([[one.half_width_mm, one.standard_mm] for one in budget.contributions])
    return [
        [SOURCES.get(one.source, one.source), one.type, one.distribution, *sizes, "yes" if one.of_measured else "no"]
        for one, sizes in zip(budget.contributions, widths, strict=True)
    ]


def _sums(budget: Budget) -> list[list[str]]:
    k = words.number(budget.k, 2)
    sizes = [[budget.measured_standard_mm, budget.measured_expanded_mm], [budget.standard_mm, budget.expanded_mm]]
    labels = ("of a measured error", "of a prediction")
    found = zip(labels, words.in_one_unit(sizes), strict=True)
    return [[label, standard, f"{expanded} (k = {k})"] for label, (standard, expanded) in found]


def _views(found: Acceptance, worst: JudgedCampaign) -> list[Plot]:
    """Where the rows were measured, from above and from the side, told apart by what their errors come to."""
    safe = found.tolerance_mm - worst.budget.measured_expanded_mm
    sides = [WITHIN if e <= safe else BAND if e <= found.tolerance_mm else BEYOND for e in worst.error_at_mm]
    out = []
    for title, across, up in VIEWS:
        xs, ys = ([place[axis] for place in worst.at_mm] for axis in (across, up))
        plot = Plot(
            f"Measured places {title}", around(f"{'xyz'[across]}, mm", xs), around(f"{'xyz'[up]}, mm", ys), WIDE, TALL,
            f"Measured places {title}, by their errors against {found.tolerance_mm:g} mm",
        )  # fmt: skip
        for number, side in enumerate((WITHIN, BAND, BEYOND)):
            some = [k for k, one in enumerate(sides) if one == side]
            if some:
                names = [f"{worst.error_at_mm[k]:.3g} mm" for k in some]
                plot.points([xs[k] for k in some], [ys[k] for k in some], side, number, SHADES[number], names)
        out.append(plot)
    return out
