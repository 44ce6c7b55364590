"""The result of an identification: how much better the robot is, what was found, and what the data cannot tell."""

from __future__ import annotations

import math
from typing import Any

from kilter_service.campaigns.suspicious import service as suspicious
from kilter_service.contract.fits import CorrelatedGroup, Covariance, Influence, StageErrors
from kilter_service.contract.jobs.identify import IdentifyJob, IdentifyResult
from kilter_service.ground.db import Database
from kilter_service.page.figures.heat_map import HeatMap
from kilter_service.page.figures.plot import Plot
from kilter_service.page.figures.scale import category_axis, lengths
from kilter_service.page.jobs import stages
from kilter_service.page.shared.cumulative import cumulative
from kilter_service.page.shared.masses import of_a_mass
from kilter_service.page.shared.parameter_rows import parameter_rows
from kilter_service.page.words import in_columns, number
from kilter_service.versions import service as versions
from kilter_service.versions.predictions import places

MOST_NAMES = 20  # of a correlation map, and of an influence chart


def result_context(database: Database, job: IdentifyJob) -> dict[str, Any]:
    """Return what ``jobs/identify.html`` shows."""
    result = job.result or IdentifyResult()
    held = result.metrics.validation if result.metrics else None
    judged = held or (result.metrics.train if result.metrics else None)
    where = "held-out rows" if held else "the rows that were fitted"
    figures = result.figures
    covariance = versions.get(database, result.version_id).covariance if result.version_id else None
    groups = result.correlated_groups or []
    return {
        "result": result,
        "suspicious": suspicious.of_campaigns(database, [*job.campaigns, *held_out(job)]),
        "version": result.version_id,
        "held": held is not None,
        "where": where,
        "points": judged.n if judged else None,
        "left_out": judged.left_out if judged else None,
        "judged": {name: getattr(judged, name, None) for name, _ in stages.STAGES},
        "stages": stages.compared_models(judged),
        "meaning": stages.MEANING,
        "bars": stages.bars(judged, where),
        "curve": cumulative(
            (figures.held_out_errors or figures.fitted_errors) if figures else None, where, stages.CURVES
        ),
        "effects": gain_of_effects(judged),
        "seen": parameter_rows(
            [row for row in result.parameters or [] if row.identifiable is not False or row.from_prior],
            places.prior_sigmas(database, result.version_id) if result.version_id else {},
        ),
        "unseen": [
            row
            for row in result.parameters or []
            if row.identifiable is False and not row.from_prior and not of_a_mass(row.name)
        ],
        "groups": groups,
        "map": correlation_map(groups, covariance),
        "influence": influence_chart(result.influence or []),
    }


def held_out(job: IdentifyJob) -> list[str]:
    """Return the campaigns that a job held out by name."""
    return job.validation if isinstance(job.validation, list) else []


def gain_of_effects(errors: StageErrors | None) -> float | None:
    """Return what the effects take off the mean error beyond the geometry, mm; None: there are none."""
    if errors is None or errors.best_rigid is None or errors.identified is None:
        return None
    return errors.best_rigid.mean_mm - errors.identified.mean_mm


def correlation_map(groups: list[CorrelatedGroup], known: Covariance | None) -> HeatMap | None:
    """Draw how the parameters that go together correlate; None: none do, or nothing is known of them."""
    wanted = list(dict.fromkeys(name for group in groups for name in group.parameters))[:MOST_NAMES]
    names, matrix = (known.names or [], known.matrix or []) if known is not None else ([], [])
    places = {name: place for place, name in enumerate(names)}
    wanted = [name for name in wanted if name in places and matrix[places[name]][places[name]] > 0]
    if len(wanted) < 2:
        return None
    values = [[_correlation(matrix, places[a], places[b]) for b in wanted] for a in wanted]
    return HeatMap(
        "Correlation of parameters that go together",
        wanted,
        wanted,
        values,
        low=-1.0,
        high=1.0,
        diverging=True,
        cell=34.0,
        description="Near 1 or -1 the data tell only a combination of the two.",
    )


def _correlation(matrix: list[list[float]], a: int, b: int) -> float:
    return matrix[a][b] / math.sqrt(matrix[a][a] * matrix[b][b])


def influence_chart(found: list[Influence]) -> Plot | None:
    """Draw how far each parameter moves the tool: mean, with least and largest over the poses."""
    rows = sorted((one for one in found if one.mean_mm is not None), key=lambda one: -(one.mean_mm or 0.0))[:MOST_NAMES]
    if not rows:
        return None
    means = [one.mean_mm or 0.0 for one in rows]
    ends = [(one.min_mm or 0.0, one.max_mm or 0.0) for one in rows]
    unit, moved = in_columns([[one.mean_mm, one.min_mm, one.max_mm] for one in rows])
    plot = Plot(
        "Influence of the parameters on the tool",
        category_axis("parameter", [one.name for one in rows]),
        lengths("movement of the tool", [*means, *(high for _, high in ends)], zero=True),
        width=760.0,
        table=(
            ["Parameter", "Change", "Its unit", f"Mean, {unit}", f"Least, {unit}", f"Largest, {unit}"],
            [[one.name, number(one.step), one.unit or "", *sizes] for one, sizes in zip(rows, moved, strict=True)],
        ),
    )
    return plot.bars([k + 0.5 for k in range(len(rows))], means, 0.6, "mean over the poses", errors=ends)
