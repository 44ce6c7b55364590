"""The report on a search, from what each of its steps found.

Numbers behind the pictures: residual against joint angle, direction and load, contributions, the gap bar.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from kilter_core.gap.evidence.held_out.held_out_errors import (
    HeldOut,
    HoldoutEvaluator,
    gap_document,
    noise_document,
    on_rows,
)
from kilter_core.gap.evidence.held_out.unseen_fit import UnseenFit
from kilter_core.gap.evidence.similarity.testability import alias_matrix, smallest_rows, untestable
from kilter_core.gap.evidence.verdict import sentence
from kilter_core.gap.outcome_warnings import Outcome, outcome_warnings
from kilter_core.gap.report.effect_curves import effect_curves
from kilter_core.gap.report.localization import remains
from kilter_core.gap.report.next_poses import set_aside_again
from kilter_core.gap.report.report import GapReport, Remains
from kilter_core.gap.search.forward_selection import SearchResult, rejected_candidates
from kilter_core.gap.search.linear.complete_form import incomplete_sentence
from kilter_core.gap.search.linear.linearized import (
    LinearizedProblem,
    cholesky_root,
    displacement_by_columns,
    ignore_step,
    weighted_displacement,
)
from kilter_core.gap.search.prepare import Prepared
from kilter_core.gap.search.scan import residual_given
from kilter_core.gap.search.sources.source import Source
from kilter_core.identify.fit.robust import points_mm, whitened_row_sizes
from kilter_core.identify.measured_rows import pooled_columns
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import has_contacts
from kilter_core.model import Calibration
from kilter_core.model.calibration import Doubt
from kilter_core.observations import Observations
from kilter_core.parameters import degrees, display_unit_and_scale, metres
from kilter_core.types import Bools, Floats, Ints

# Half of a box about a pose that was set aside, rad and m: a local error of a gear or an encoder is up to as wide, and the
# visit does not tell on which side of it it lies.
NEAR_RAD, NEAR_M = np.radians(10.0), 0.05
BY_NOISE = 0.001  # chance that noise leaves so much of an error beside the motion of the joint that made it
LEVER = 0.2  # of a joint's longest: with less it would have to err by far more than this to make the error
NEAR = "a pose near these was set aside as a wrong reading. Measure it again; what errs there again is the arm."
NOT_CLOSED = "its search leaves an error that no known effect explains."


def build_report(outcome: Outcome) -> GapReport:
    """Build the report; what it says of poses is of all that was named, what it says of the version of what is stored."""
    study, fit, effects, stored = outcome.study, outcome.fit, outcome.effects, outcome.version.stored
    search, held, unseen = fit.search, fit.version.held, fit.unseen
    found, prepared, options = search.found, search.prepared, study.options
    rows, library, problem = prepared.visits.observations, prepared.library, prepared.problem
    verdict, judging, spikes = fit.verdict(effects), held.report(), held.set_aside
    place = None if fit.adequacy.adequate else remains(found.problem, found.columns, rows, options.seed)
    rest, gap = Remains(fit.misfit, place), gap_document(prepared, found, judging)
    again = poses_again(prepared, study.validation, spikes) if options.next_poses else []
    searched, unchosen = study.numbers
    sigma = metres(gap["noise_mm"] or 0.0)
    return GapReport(
        stored=stored.with_doubts(version_doubts(held, verdict, unseen)),
        verdict=verdict,
        effects=effects,
        unseen=unseen,
        remains=rest,
        sentence=sentence(verdict, effects, fit.adequacy, fit.misfit, rest.words)
        + ("" if unseen is None else unseen.sentence())
        + incomplete_sentence(fit.lacking)
        + agreement_sentence(prepared, study.validation, spikes),
        where=outcome.where,
        gap=gap,
        measurements=by_kind(prepared, found, held, judging),
        adequacy=fit.adequacy,
        misfit=fit.misfit,
        predictive=judging.predictive,
        not_testable=(*untestable(library, search.judged, problem, rows), *(one.untestable() for one in search.unseen)),
        smallest_detectable=smallest_rows(library, search.judged),
        refused=rejected_candidates(found),
        next_poses=[*again, *outcome.next_poses],
        told_apart=outcome.told_apart,
        negative_control=outcome.control,
        alias_matrix=alias_matrix(problem, search.candidates, found.chosen),
        noise=noise_document(found.problem.settings),
        warnings=outcome_warnings(outcome),
        figures=figures(found, rows, gap, held),
        effect_curves=effect_curves(found, effects),
        library=library,
        set_aside=rows_aside(stored.calibration, prepared.given, prepared.outlying, searched, sigma),
        held_aside=rows_aside(stored.calibration, study.validation, spikes, unchosen, sigma),
        spikes=spikes,
    )


@dataclass(frozen=True)
class _Columns:
    """Which of a visit's numbers are of one kind."""

    name: str
    unit: str
    part: slice
    of_tool: bool


def by_kind(prepared: Prepared, search: SearchResult, held: HoldoutEvaluator, judging: HeldOut) -> list[dict[str, Any]]:
    """A document for each kind, in its unit: of the tool errors are rms lengths in space, of sensors rms of a reading."""
    problem = search.problem
    source, used = problem.settings.source, problem.settings.used
    fitted = [_errors(p)[used] for p in (prepared.problem, problem)]
    seen = np.isfinite(source.residual(problem.values))[used]
    others = [e @ judging.lower.T for e in (judging.before, judging.after)]
    there = seen if held.rows is None else held.valid_reading_mask
    return [_row(kind, prepared, problem, (fitted, seen), (others, there)) for kind in _kinds(source)]


def _kinds(source: Source) -> list[_Columns]:
    every = source.tool_measured(np.ones(len(source.batch), dtype=bool))
    if every is None:
        return [_Columns("link_encoders", source.unit, slice(0, source.tool_numbers), False)]
    sizes = [source.tool_numbers, *source.beside_numbers]
    ends = np.cumsum(sizes)
    return [
        _Columns(kind.name, kind.unit, slice(int(end) - size, int(end)), k == 0)
        for k, (kind, size, end) in enumerate(zip(every.kinds, sizes, ends, strict=True))
    ]


def _row(
    kind: _Columns,
    prepared: Prepared,
    problem: LinearizedProblem,
    fitted: tuple[list[Floats], Bools],
    held: tuple[list[Floats], Bools],
) -> dict[str, Any]:
    unit, scale = display_unit_and_scale(kind.unit)
    source, noise = problem.settings.source, problem.settings.noise
    lengths = slice(kind.part.start, noise.lengths) if kind.of_tool and noise.lengths else kind.part
    repeats = _repeats(kind, prepared, problem)
    out: dict[str, Any] = {
        "kind": kind.name,
        "unit": unit,
        "numbers": int(np.count_nonzero(fitted[1][:, kind.part])),
        "noise": float(np.sqrt(np.mean(np.diag(noise.row)[lengths]))) * scale,
        "repeats": None if repeats is None else repeats * scale,
    }
    for prefix, (errors, seen) in (("", fitted), ("validation_", held)):
        for name, each in zip(("before", "after"), errors, strict=True):
            size = _rms(kind, source, each, seen)
            out[prefix + name] = None if size is None else size * scale
    return out


def _rms(kind: _Columns, source: Source, errors: Floats, seen: Bools) -> float | None:
    """Of the tool the rms length in space, of a sensor that of the readings there were; None without any."""
    if not seen[:, kind.part].any():
        return None
    if kind.of_tool:
        return source.rms(errors[seen[:, kind.part].any(axis=1)])
    return float(np.sqrt(np.mean(errors[:, kind.part][seen[:, kind.part]] ** 2)))


def _repeats(kind: _Columns, prepared: Prepared, problem: LinearizedProblem) -> float | None:
    """Standard deviation between repeats of a pose; None where this kind was not repeated, or only without leaving it."""
    noise = problem.settings.noise
    if kind.of_tool or noise.kinds == ():
        return noise.between if noise.source == "repeats" else None
    condition = prepared.visits.condition[prepared.visits.visit]
    if prepared.moving or len(condition) == len(np.unique(condition)):
        return None
    residual = problem.settings.source.residual_of_rows(problem.values, prepared.rows, ignore_step)
    return pooled_columns(residual[:, kind.part], condition)


def _errors(problem: LinearizedProblem) -> Floats:
    """What a fit leaves (V, m), in m and rad."""
    return problem.settings.whitening.back(problem.raw)


class Aside(NamedTuple):
    """A visit that was set aside: its joints (n,), its error m, and joints that may have made it, each with its most m."""

    q: Floats
    error_m: float
    joints: dict[int, float]


def version_doubts(held: HoldoutEvaluator, verdict: str, unseen: UnseenFit | None) -> tuple[Doubt, ...]:
    """Return what a version doubts of itself: near each visit that was set aside, and everywhere if the run is unexplained."""
    source = held.search.problem.settings.source
    found = _doubts_near_set_aside(source, list(_aside(held))) if source.observes_tool and not held.moving else []
    if verdict == "unexplained":
        n, error = source.model.robot.n_joints, 0.0 if unseen is None or not unseen.refutes_model else unseen.beyond
        found.append(Doubt.everywhere(n, error, NOT_CLOSED))
    return tuple(found)


def _aside(held: HoldoutEvaluator) -> Iterator[Aside]:
    """Visits of the rows searched, then rows held out, that were set aside."""
    search = held.search
    settings, values = search.problem.settings, search.problem.values
    shared = settings.source.joint_columns(values)
    longest = [
        max(settings.source.rms(one[None]) for one in shared(j)) for j in range(settings.source.model.robot.n_joints)
    ]
    yield from _far_rows(settings.source, values, ~settings.used, settings.of_visit, longest)
    if held.rows is not None and not held.valid_row_mask.all():
        other, there = on_rows(settings.source, held.rows, search, values)
        yield from _far_rows(
            other,
            there,
            ~held.valid_row_mask,
            np.broadcast_to(settings.of_row, (len(held.rows), *settings.of_row.shape)),
            longest,
        )


def _far_rows(source: Source, values: Floats, which: Bools, noise: Floats, longest: list[float]) -> Iterator[Aside]:
    """Visits ``which (V,)`` of a source under their noise (V, m, m); ``longest (n,)`` m per rad of each joint's motion."""
    left, columns, rows = np.nan_to_num(source.residual(values)), source.joint_columns(values), np.flatnonzero(which)
    motions = [columns(j) for j in range(len(longest))]
    for row in rows:
        back, error = np.linalg.inv(cholesky_root(noise[row])), source.rms(left[[row]])
        joints = {}
        for j, motion in enumerate(motions):
            lever, size = source.rms(motion[[row]]), len(back)
            e, w = back @ left[row], back @ motion[row]
            beside = e - w * (w @ e) / max(float(w @ w), 1e-300)
            if size > 1 and lever > LEVER * longest[j] and beside @ beside < chi2.isf(BY_NOISE, size - 1):
                joints[j] = error * longest[j] / lever
        yield Aside(source.observations.q[row], error, joints)


def _doubts_near_set_aside(source: Source, aside: list[Aside]) -> list[Doubt]:
    """Boxes: along each joint that may have made an error, at any angle of the others; else about the pose in all joints."""
    robot = source.model.robot
    half = np.array([NEAR_M if joint.kind == "prismatic" else NEAR_RAD for joint in robot.joints])
    out = [Doubt(one.q - half, one.q + half, one.error_m, NEAR) for one in aside if not one.joints]
    for j in range(robot.n_joints):
        own = sorted((float(one.q[j]), one.joints[j]) for one in aside if j in one.joints)
        while own:
            low, error = own.pop(0)
            high = low
            while own and own[0][0] - high <= 2.0 * half[j]:
                high, error = own[0][0], max(error, own.pop(0)[1])
            box = Doubt.everywhere(robot.n_joints, error, NEAR)
            box.low[j], box.high[j] = low - half[j], high + half[j]
            out.append(box)
    return out


def agreement_sentence(prepared: Prepared, held: Observations | None, spikes: Ints) -> str:
    """Say with how many visits a verdict goes, of those searched and held out; empty where none was set aside."""
    used = prepared.problem.settings.used
    visits = np.zeros(0, dtype=np.int64) if held is None else held.visits()
    seen = np.zeros(0, dtype=bool) if held is None else held.tool_seen
    aside = int(np.sum(~used)) + len(np.unique(visits[spikes]))
    total = len(used) + len(np.unique(visits[seen]))
    if not aside:
        return ""
    return (
        f" This is of {total - aside} of {total} visits: {aside} {'was' if aside == 1 else 'were'} set aside as wrong "
        "readings. Measure their poses again; what errs there again is the arm."
    )


def poses_again(prepared: Prepared, held: Observations | None, spikes: Ints) -> list[dict[str, Any]]:
    """The poses of what was set aside, of rows searched and held out, as documents: to be measured first."""
    source = prepared.problem.settings.source
    if not source.observes_places:
        return []
    parts = [prepared.given.select(prepared.outlying), *([] if held is None else [held.select(spikes)])]
    return [row for rows in parts if len(rows) for row in set_aside_again(rows, source.model.robot)]


def rows_aside(
    calibration: Calibration, rows: Observations | None, which: Ints, numbers: Ints, sigma: float
) -> tuple[dict[str, Any], ...]:
    """Rows ``which (K,)`` of some: ``row`` as ``numbers (N,)`` say, ``residual_mm`` and ``residual_sigma`` of its point.

    ``sigma`` is the standard deviation of a coordinate, m. Joint data and contacts have no point: both are None.
    """
    found: list[dict[str, Any]] = [
        {"row": int(row), "residual_mm": None, "residual_sigma": None, "weight": 0.0} for row in numbers[which]
    ]
    if rows is None or not found or (rows.position is None and rows.markers is None) or has_contacts(rows):
        return tuple(found)
    measurement = Measurement.from_observations(rows.select(which), calibration.marker_points)
    left = measurement.residual(calibration.predict(measurement.observations))
    size = whitened_row_sizes(left.of_points(), sigma, np.nan) if sigma > 0.0 else np.full(len(which), np.nan)
    for one, length, sigmas in zip(found, points_mm(left), size, strict=True):
        one["residual_mm"] = length
        one["residual_sigma"] = float(sigmas) if np.isfinite(sigmas) else None
    return tuple(found)


MOST_POINTS = 1500


def figures(search: SearchResult, rows: Observations, gap: dict[str, Any], held: HoldoutEvaluator) -> dict[str, Any]:
    """Plain lists, ready to be plotted; lengths in mm (deg for joint data). ``held`` are the held-out rows, if any."""
    return {
        "residual_by_angle": [_by_angle(search, rows, j) for j in _joints(search, rows)],
        "residual_by_direction": _by_label(search, rows, "direction"),
        "residual_by_load": _by_label(search, rows, "payload_kg"),
        "contribution": contributions(search),
        "gap_bar": _gap_bar(search, gap, held),
    }


def contributions(search: SearchResult) -> list[dict[str, Any]]:
    """Displacement by each named effect: rms and largest, over the visits."""
    out = []
    for place in search.chosen:
        candidate = search.selector.scorer.candidates[place]
        moved = displacement_by_columns(search.problem, candidate.columns)[search.problem.settings.used]
        size = np.abs(moved).max(axis=1) if _joint_data(search) else np.linalg.norm(moved[:, :3], axis=1)
        out.append(
            {
                "label": candidate.label,
                **candidate.id_and_joints(),
                "rms": search.problem.settings.source.rms(moved) * _unit(search),
                "largest": float(size.max(initial=0.0)) * _unit(search),
            }
        )
    return out


def _residuals(problem: LinearizedProblem, columns: Sequence[int]) -> Floats:
    return problem.settings.whitening.back(residual_given(problem, columns))


def _unit(search: SearchResult) -> float:
    return display_unit_and_scale(search.problem.settings.source.unit)[1]


def _joint_data(search: SearchResult) -> bool:
    return not search.problem.settings.source.observes_tool


def _joints(search: SearchResult, rows: Observations) -> list[int]:
    named = {j for k in search.chosen for j in search.selector.scorer.candidates[k].joints or ()}
    return sorted(named) or list(range(rows.q.shape[1]))


def _by_angle(search: SearchResult, rows: Observations, j: int) -> dict[str, Any]:
    """Residual along what joint ``j`` moves, before and after, with the curve the named effects of the joint draw."""
    problem = search.problem
    along = _along(problem, j)
    own = [
        k
        for c in search.chosen
        if j in (search.selector.scorer.candidates[c].joints or ())
        for k in search.selector.scorer.candidates[c].columns
    ]
    order = np.argsort(rows.q[:, j], kind="stable")
    order = order[problem.settings.used[order]]
    order = order[:: -(-len(order) // MOST_POINTS) or 1]
    curve = weighted_displacement(problem, sorted(set(own))) if own else np.zeros((len(rows), along.shape[1]))

    def drawn(values: Floats) -> list[float]:
        return [round(float(v), 6) for v in (np.sum(values * along, axis=1) * _unit(search))[order]]

    rest = [k for k in search.columns if k not in own]
    return {
        "joint": j + 1,
        "q_deg": [round(float(v), 4) for v in degrees(rows.q[order, j])],
        "before": drawn(_residuals(problem, rest)),
        "after": drawn(_residuals(problem, search.columns)),
        "curve": drawn(curve),
    }


def _along(problem: LinearizedProblem, j: int) -> Floats:
    """Unit direction (V, m) in which joint ``j`` moves the point, or the encoder, that is measured."""
    source, size = problem.settings.source, problem.settings.whitener.shape[-1]
    D = np.zeros((len(problem.settings.used), size))
    if not source.observes_tool:
        own = source.residuals_by_joint(np.broadcast_to(np.arange(size), D.shape))[j]
        D[:, own[0].astype(np.int64)] = 1.0
        return D
    if source.observes_places:
        _, JQ = source.model.joint_jacobian(source.batch, problem.values)
        D[:, :3] = JQ[:, :3, j]
    else:
        D[:, : source.tool_numbers] = source.joint_columns(problem.values)(j)[:, : source.tool_numbers]
    return np.asarray(D / np.maximum(np.linalg.norm(D, axis=1, keepdims=True), 1e-9))


def _by_label(search: SearchResult, rows: Observations, name: str) -> list[dict[str, Any]]:
    """Mean and spread of the residual for every value of a label, before and after."""
    label = getattr(rows, name)
    if label is None:
        return []
    used = search.problem.settings.used
    before, after = _residuals(search.problem, []), _residuals(search.problem, search.columns)
    columns = range(label.shape[1]) if label.ndim == 2 else [None]
    out = []
    for j in columns:
        values = label if j is None else label[:, j]
        along = None if j is None else _along(search.problem, j)
        for v in np.unique(values)[:10]:
            own = (values == v) & used
            if not own.any():
                continue
            pair = [
                np.sum(r * along, axis=1)[own] if along is not None else np.linalg.norm(r[own, :3], axis=1)
                for r in (before, after)
            ]
            out.append(
                {
                    "joint": None if j is None else j + 1,
                    "value": float(v),
                    "n": int(own.sum()),
                    "before_mean": float(pair[0].mean()) * _unit(search),
                    "before_sd": float(pair[0].std()) * _unit(search),
                    "after_mean": float(pair[1].mean()) * _unit(search),
                    "after_sd": float(pair[1].std()) * _unit(search),
                }
            )
    return out


def _gap_bar(search: SearchResult, gap: dict[str, Any], held: HoldoutEvaluator) -> list[dict[str, Any]]:
    """The error before, after each effect in the order of what it takes off, and the noise; no label twice.

    ``held_out`` is the same on rows that took no part in the fit, None where there are none, and ``held_out_interval``
    its 95 % interval (of the noise: None).
    """
    unit = "deg" if "before_deg" in gap else "mm"
    bars = [{"label": "before", "value": gap[f"before_{unit}"]}]
    fitted: list[list[int]] = [[]]
    taken: list[int] = []
    seen: dict[str, int] = {}
    left = _residual_rms_function(search)
    while len(taken) < len(search.chosen):
        sizes = {k: left(search.selector.columns([*taken, k])) for k in search.chosen if k not in taken}
        best = min(sizes, key=lambda k: sizes[k])
        taken.append(best)
        fitted.append(search.selector.columns(taken))
        label = "+ " + search.selector.scorer.candidates[best].label
        seen[label] = seen.get(label, 0) + 1
        value = gap[f"after_{unit}"] if len(taken) == len(search.chosen) else sizes[best]
        bars.append({"label": label if seen[label] == 1 else f"{label} ({seen[label]})", "value": value})
    bars.append({"label": "noise", "value": gap[f"noise_rms_{unit}"]})
    if held.rows is None:
        return [{**bar, "held_out": None, "held_out_interval": None} for bar in bars]
    others = [*(held.rms(columns) * _unit(search) for columns in fitted), gap[f"validation_noise_rms_{unit}"]]
    ends = [*(held.rms_interval(columns) for columns in fitted), None]
    return [
        {**bar, "held_out": other, "held_out_interval": None if end is None else [v * _unit(search) for v in end]}
        for bar, other, end in zip(bars, others, ends, strict=True)
    ]


def _residual_rms_function(search: SearchResult) -> Callable[[Sequence[int]], float]:
    """What tells the rms error with some of the chosen columns, mm or deg; a basis of each set of them takes long."""
    problem, at = search.problem, {k: n for n, k in enumerate(search.columns)}
    W, settings = problem.projected_columns(search.columns), problem.settings

    def rms(columns: Sequence[int]) -> float:
        left = problem.y - W[:, [at[k] for k in columns]] @ problem.gram.solve(columns)
        return settings.source.rms(settings.whitening.back(left)[settings.used]) * _unit(search)

    return rms
