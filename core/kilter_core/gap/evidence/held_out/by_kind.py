"""What a search says of each kind of measurement: its noise, and its errors before and after, fitted and held out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.gap.evidence.held_out.held_out_errors import HeldOut, HoldoutEvaluator
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import LinearizedProblem, ignore_step
from kilter_core.gap.search.prepare import Prepared
from kilter_core.gap.search.sources.source import Source
from kilter_core.identify.rows.noise import pooled_columns
from kilter_core.parameters import display_unit_and_scale
from kilter_core.types import Bools, Floats


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
