"""Numbers behind the pictures: residual against joint angle, direction and load, contributions, the gap bar."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from kilter_core.gap.evidence.held_out.held_out_errors import HoldoutEvaluator
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.in_space import displacement_by_columns, weighted_displacement
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.scan import residual_given
from kilter_core.observations import Observations
from kilter_core.parameters import degrees, display_unit_and_scale
from kilter_core.types import Floats

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
