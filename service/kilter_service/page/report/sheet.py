"""Parts of a report: its first page, its plots, its effects, and the limits of the claim."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from kilter_core.errors import CoreError
from kilter_files.look import why_unusual
from kilter_service.contract.budgets import Budget
from kilter_service.contract.fits import Errors, Parameter, StageErrors, split_nominal_and_moved
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.contract.today import Acceptance, JudgedCampaign
from kilter_service.contract.versions import Version
from kilter_service.ground.core import core_effects
from kilter_service.ground.db import Database
from kilter_service.page import words
from kilter_service.page.figures.plot import Group, Plot, Table, places_from_two_sides
from kilter_service.page.shared import errors_drawn
from kilter_service.page.words import of_joints
from kilter_service.versions import acceptance
from kilter_service.versions.acceptance import Wish
from kilter_service.versions.routes import LARGEST_MM

INK, HEIGHT = "#141414", 230.0
SHADES_OF_BARS = ("#c8c8c8", "#828282", INK)
OF_MODELS = ("#dedede", "#adadad", "#6e6e6e", INK)
STAGES = (
    ("nominal", "nominal robot"),
    ("registration_only", "base and tool fitted only"),
    ("geometry_fitted", "geometry alone, without effects"),
    ("identified", "calibrated"),
)
PLACE = "nominal robot, mostly where instrument, base and tool are: not an error of the arm"
CURVES = {"before, nominal": STAGES[0][1], "registration only": STAGES[1][1], "identified": STAGES[-1][1]}
SIZES = (("mean_mm", "mean"), ("rms_mm", "rms"), ("p95_mm", "95 %"), ("max_mm", "largest"))


def before_and_after(errors: StageErrors, title: str) -> Plot | None:
    """Bars of the errors of each model on the same rows."""
    shown = STAGES if errors.place_mm is None else STAGES[1:]
    found = [(label, getattr(errors, name)) for name, label in shown if getattr(errors, name) is not None]
    if not found:
        return None
    shades = OF_MODELS[-len(found) :]
    series = [
        (one[0], shade, [getattr(one[1], size) for size, _ in SIZES]) for one, shade in zip(found, shades, strict=True)
    ]
    values = [value for _, _, row in series for value in row if value is not None]
    if not values or min(values) <= 0:
        return None
    return errors_drawn.grouped_bars(
        title,
        [label for _, label in SIZES],
        series,
        what="error on a logarithmic scale",
        size=(620.0, HEIGHT),
        log=True,
        description=title,
        table=table("Model", found),
    )


def table(what: str, judged: Sequence[tuple[str, Errors]]) -> Table:
    """Return the errors of each line below heads that name their unit, that of the largest of them."""
    unit, lengths = words.in_columns([[getattr(one, size) for size, _ in SIZES] for _, one in judged])
    rows = [[label, *sizes] for (label, _), sizes in zip(judged, lengths, strict=True)]
    return [what, *(f"{label}, {unit}" for _, label in SIZES)], rows


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
VIEWS = ("Measured places from above", "Measured places from the side")
SOURCES = {
    "instrument": "instrument, by its permissible error",
    "repeatability": "repeatability",
    "registration": "registration: base and tool",
    "temperature": "temperature",
    "model": "all other parameters of the model",
    "left_over": "what the fit left beyond the noise",
}


First = dict[str, Any]


def first_sheet(database: Database, robot: str, wish: Wish) -> First:
    """Return the first page where a tolerance is stated: decision, figures of merit, budget, and a picture of the rows.

    ``found`` is None where no row is left that was not fitted: then errors and budget are those of the identification.

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
    shown = {"campaigns": found.campaigns[:MOST_CAMPAIGNS], "more": len(found.campaigns[MOST_CAMPAIGNS:])}
    told = {"title": title, "decision": decision, "sentence": sentence, "found": found, "merits": _merits(found)}
    return {**told, **shown, **_budget_tables(worst.budget), "views": _views(found, worst, decided=bool(decision))}


def _of_fit(version: Version, title: str, sentence: str) -> First:
    """The page of a version of which every row was fitted."""
    errors = version.metrics.validation or version.metrics.train
    held = "held-out" if version.metrics.validation is not None else "fitted"
    stages = [] if errors is None else [(label, getattr(errors, name)) for name, label in STAGES]
    merits = table(MERIT, [(f"{held} rows, {label}", one) for label, one in stages if one is not None])
    told = {"title": title, "decision": "", "sentence": sentence, "found": None, "merits": merits}
    return {
        **told,
        "campaigns": [],
        "more": 0,
        **_budget_tables(None if errors is None else errors.budget),
        "views": [],
    }


def _budget_tables(budget: Budget | None) -> dict[str, Any]:
    """The contributions, their sums, and what they lack."""
    if budget is None:
        missing = "the whole budget: identify again from measured places of the tool"
        return {"budget": None, "sums": None, "missing": missing}
    missing = ", ".join(SOURCES[one] for one in budget.not_assessed if one in SOURCES)
    return {"budget": _budget(budget), "sums": _sums(budget), "missing": missing}


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
    groups: list[Group] = []
    for number, side in enumerate((WITHIN, BAND, BEYOND) if decided else (MEASURED,)):
        some = [k for k, one in enumerate(sides) if one == side]
        groups.append((side, number, SHADES[number], some, [f"{worst.error_at_mm[k]:.3g} mm" for k in some], ()))
    return places_from_two_sides(worst.at_mm, groups, against, size=(WIDE, TALL), titles=VIEWS)


def effect_contributions(database: Database, version: Version, search: GapResult | None) -> dict[str, Any]:
    """Say of each effect what it is and how far it moves the tool; uncertain masses move nothing by themselves."""
    own = [one for one in version.effects if one != words.MASSES]
    named = {one.id: one for one in (search.effects if search is not None else None) or []}
    moved = errors_drawn.moved_by_each(database, version.id)
    sizes = {one.effect: [one.rms_mm, one.largest_mm] for one in moved.effects}
    lengths = [[*sizes.get(one, [None, None]), named[one].moves_mm if one in named else None] for one in own]
    unit, columns = words.in_columns(lengths)
    shown = []
    for effect, (rms, largest, here) in zip(own, columns, strict=True):
        joints, kind = named[effect].joints if effect in named else None, core_effects.EFFECTS.get(effect)
        where, what = words.of_joints(joints) if joints else "", kind.summary if kind is not None else ""
        shown.append({"name": effect, "joints": where, "what": what, "rms": rms, "largest": largest, "searched": here})
    plot = moved.plot(SHADES[1:], 620.0) if moved.effects else None
    return {"poses": moved.poses, "unit": unit, "effects": shown, "plot": plot}


def closing(search: GapResult | None) -> tuple[Plot, str] | None:
    """How a search closed the gap, step by step: drawn, and in a sentence."""
    read = None if search is None else errors_drawn.steps_shown(search.figures, errors_drawn.error_unit(search.gap))
    return None if read is None else (errors_drawn.plot(read, SHADES_OF_BARS[:2]), errors_drawn.describe(read))


VERDICTS = {
    "replicated": "seen again in a measurement of another day or set-up, no narrower than its claim",
    "confirmed": "confirmed within this measurement; another day or set-up has not shown it again",
    "class_confirmed": "confirmed as one of a class that these rows cannot tell apart",
    "provisional": "provisional: not all tests were passed",
    "contradicted": "contradicted by rows that took no part in the search, and left out of the version",
}
EXTRAPOLATES = (
    "Outside the joint ranges, loads and temperatures that were measured the calibration extrapolates: the errors stated "
    "here do not hold there."
)


def limits(version: Version, search: GapResult | None) -> list[str]:
    """Return what the version does not claim, one sentence each."""
    return [*_errors(version), *_unknown(version), *_limits_of_search(search), EXTRAPOLATES]


def _errors(version: Version) -> Iterator[str]:
    if version.metrics.validation is None:
        yield "No pose was held out: the errors stated here are of poses that were fitted, and are smaller than elsewhere."
    yield from (one.message for one in version.objections)
    yield from (one.message for one in version.warnings)


def _unknown(version: Version) -> Iterator[str]:
    nominal, moved = split_nominal_and_moved(
        one for one in version.parameters if one.identifiable is False and not one.from_prior
    )
    if nominal:
        yield f"These poses cannot determine {_names(nominal)}: their values are those of the nominal robot."
    if moved:
        yield (
            f"These poses cannot determine {_names(moved)}: their values are not nominal, one guess of many that fit as "
            "well. Read them only together."
        )
    yield from (one.sentence for one in version.null_directions if one.sentence)
    odd = [one for one in version.parameters if one.plausible is False]
    for why in dict.fromkeys(why_unusual(one.name, one.value, one.sigma) for one in odd):
        alike = [one for one in odd if why_unusual(one.name, one.value, one.sigma) == why]
        yield f"Of {_names(alike)} these rows say: {why}. Check before you rely on them."


def _names(found: Sequence[Parameter]) -> str:
    return ", ".join(one.name for one in found)


def _limits_of_search(search: GapResult | None) -> Iterator[str]:
    for effect in (search.effects if search is not None else None) or []:
        verdict = VERDICTS.get(effect.verdict or "")
        where = f" of {of_joints(effect.joints)}" if effect.joints else ""
        if verdict:
            yield f"The effect {effect.id}{where} is {verdict}."
        if effect.claim is not None and effect.claim.said == "class" and effect.physical_class is not None:
            others = [*(effect.physical_class.members or []), *(effect.physical_class.outside or [])]
            yield f"What these rows show is no more than: {effect.claim.words}. It may be any of {', '.join(others)}."
        alike = [one.id for one in effect.alias_set or []]
        if alike:
            yield f"These rows cannot tell {effect.id}{where} from {', '.join(alike)}: either would explain them."
    for one in (search.not_testable if search is not None else None) or []:
        why = (one.reason or "these rows do not show it").rstrip(".")
        remedy = f" Remedy: {one.remedy.rstrip('.')}." if one.remedy else ""
        yield f"{one.id} could not be tested: {why}.{remedy}"
