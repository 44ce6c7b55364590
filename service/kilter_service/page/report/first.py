"""The first page of a report: figure of merit, budget and decision about a tolerance, and what they rest on."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_core.errors import CoreError
from kilter_service.contract.acceptance import Acceptance, JudgedCampaign
from kilter_service.contract.budgets import Budget
from kilter_service.contract.versions import Version
from kilter_service.ground.db import Database
from kilter_service.page import words
from kilter_service.page.figures.plot import Plot, Table
from kilter_service.page.figures.scale import around
from kilter_service.page.report.figures import INK, STAGES, table
from kilter_service.versions.acceptance import service as acceptance
from kilter_service.versions.acceptance.routes import LARGEST_MM
from kilter_service.versions.acceptance.service import Wish

WIDE, TALL = 320.0, 240.0
MOST_CAMPAIGNS = 4  # named on the page, those that decide first
SHADES = ("#b8b8b8", "#777777", INK)
MEASURED = "measured"
MERIT, BUDGET = "Figure of merit", "Budget, standard uncertainties of a coordinate"
NOT_STATED = (
    "Nothing is decided, because no tolerance was stated: state one above the report on the page, or ask "
    "`kilter version accept {robot} --tolerance 0.3`."
)
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
    """What was decided, the figure of merit before and after, the budget of the campaign that decides, and its picture.

    ``found`` is None where no row is left that was not fitted: then errors and budget are those of the identification.
    ``decision`` is empty where no tolerance was stated.
    """

    title: str
    decision: str
    sentence: str
    found: Acceptance | None
    merits: Table
    budget: Table | None
    sums: Table | None
    missing: str
    views: list[Plot]

    @property
    def campaigns(self) -> list[JudgedCampaign]:
        """The campaigns that are named."""
        return [] if self.found is None else self.found.campaigns[:MOST_CAMPAIGNS]

    @property
    def more(self) -> int:
        """How many others were judged."""
        return 0 if self.found is None else len(self.found.campaigns) - len(self.campaigns)


def first_sheet(database: Database, robot: str, wish: Wish) -> First:
    """Return the first page where a tolerance is stated.

    Raises:
        CoreError: no row is left that was not fitted, or what else speaks against a decision.

    """
    found = acceptance.of_robot(database, robot, wish)
    return _of_rows(found, f"{robot}: {words.number(found.tolerance_mm)} mm", found.decision, found.sentence)


def first_sheet_undecided(database: Database, version: Version) -> First:
    """Return the first page without a tolerance: the same figures and budget, and how to have it decided."""
    robot = version.robot
    title, ask = f"{robot}: no tolerance stated", NOT_STATED.format(robot=robot)
    try:
        found = acceptance.of_robot(database, robot, Wish(LARGEST_MM, version.id))
    except CoreError as error:
        return _of_fit(version, title, f"{ask} {error.message}")
    said = words.mm(found.provable_mm)
    if found.lacking:
        return _of_rows(found, title, "", f"{ask} As it is, these rows prove none: {found.lacking[0].message}")
    return _of_rows(found, title, "", f"{ask} These {found.rows} held-out rows prove {said} and more.")


def _of_rows(found: Acceptance, title: str, decision: str, sentence: str) -> First:
    worst = found.campaigns[0]
    views = _views(found, worst, decided=bool(decision))
    return First(title, decision, sentence, found, _merits(found), *_budget_tables(worst.budget), views)


def _of_fit(version: Version, title: str, sentence: str) -> First:
    """The page of a version of which every row was fitted."""
    errors = version.metrics.validation or version.metrics.train
    held = "held-out" if version.metrics.validation is not None else "fitted"
    stages = [] if errors is None else [(label, getattr(errors, name)) for name, label in STAGES]
    merits = table(MERIT, [(f"{held} rows, {label}", one) for label, one in stages if one is not None])
    budget = None if errors is None else errors.budget
    return First(title, "", sentence, None, merits, *_budget_tables(budget), [])


def _budget_tables(budget: Budget | None) -> tuple[Table | None, Table | None, str]:
    """The contributions, their sums, and what they lack."""
    if budget is None:
        return None, None, "the whole budget: identify again from measured places of the tool"
    missing = ", ".join(SOURCES[one] for one in budget.not_assessed if one in SOURCES)
    return _budget(budget), _sums(budget), missing


def _merits(found: Acceptance) -> Table:
    return table(
        MERIT,
        [
            (f"{one.name} ({one.rows} rows), {label}", errors)
            for one in found.campaigns[:MOST_CAMPAIGNS]
            for label, errors in (("base and tool fitted only", one.before), ("calibrated", one.after))
        ],
    )


def _budget(budget: Budget) -> Table:
    unit, widths = words.in_columns([[one.half_width_mm, one.standard_mm] for one in budget.contributions])
    return [BUDGET, "Type", "Distribution", f"Half width, {unit}", f"u, {unit}", "Of a measured error"], [
        [SOURCES.get(one.source, one.source), one.type, one.distribution, *sizes, "yes" if one.of_measured else "no"]
        for one, sizes in zip(budget.contributions, widths, strict=True)
    ]


def _sums(budget: Budget) -> Table:
    k = words.number(budget.k, 2)
    sizes = [[budget.measured_standard_mm, budget.measured_expanded_mm], [budget.standard_mm, budget.expanded_mm]]
    labels = ("of a measured error", "of a prediction")
    unit, lengths = words.in_columns(sizes)
    rows = [[label, *row] for label, row in zip(labels, lengths, strict=True)]
    return ["Expanded uncertainty", f"u, {unit}", f"U (k = {k}), {unit}"], rows


def _views(found: Acceptance, worst: JudgedCampaign, decided: bool) -> list[Plot]:
    """Where the rows were measured, from above and from the side, told apart by what their errors come to."""
    safe = found.tolerance_mm - worst.budget.measured_expanded_mm
    sides = [WITHIN if e <= safe else BAND if e <= found.tolerance_mm else BEYOND for e in worst.error_at_mm]
    against = f", by their errors against {found.tolerance_mm:g} mm" if decided else ""
    if not decided:
        sides = len(sides) * [MEASURED]
    out = []
    for title, across, up in VIEWS:
        xs, ys = ([place[axis] for place in worst.at_mm] for axis in (across, up))
        plot = Plot(
            f"Measured places {title}",
            around(f"{'xyz'[across]}, mm", xs),
            around(f"{'xyz'[up]}, mm", ys),
            WIDE,
            TALL,
            f"Measured places {title}{against}",
        )
        for number, side in enumerate((WITHIN, BAND, BEYOND) if decided else (MEASURED,)):
            some = [k for k, one in enumerate(sides) if one == side]
            if some:
                names = [f"{worst.error_at_mm[k]:.3g} mm" for k in some]
                plot.points([xs[k] for k in some], [ys[k] for k in some], side, number, SHADES[number], names)
        out.append(plot)
    return out
