"""Findings of a search about itself: much is left, no load, no poses to propose, amplitudes at an end of their range."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kilter_core.errors import Finding
from kilter_core.gap.evidence.verdict import CONTRADICTED, Judged
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.in_space import fit_rms
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.prepare import Prepared
from kilter_core.identify.report import large_residual
from kilter_core.model import Calibration
from kilter_core.parameters import degrees, display_unit_and_scale

LARGE_DEG = 2.0  # left between two encoders of a joint: worth a warning


def size_warnings(found: SearchResult) -> Iterator[dict[str, Any]]:
    """Say when much is left after everything that was named: a fact about the model, no verdict about the rows."""
    problem, size = found.problem, fit_rms(found.problem)
    source = problem.settings.source
    if source.observes_tool:
        points = source.model.predict(source.batch, source.model_values(problem.values)).position
        yield from large_residual(size, points)
    elif degrees(size) > LARGE_DEG:
        yield {"code": "large_residual", "message": f"{degrees(size):.2f} deg are left between the encoders."}


def unloaded_findings(prepared: Prepared) -> Iterator[Finding]:
    """Say which effects were not looked for because nothing is known to load the joints."""
    loaded = list(dict.fromkeys(e.id for e in prepared.library.effects if "moments" in e.needs))
    if loaded and not np.any(prepared.problem.settings.source.batch.wrench):
        yield Finding("no_load", {"effects": loaded})


def unplanned_findings(problem: LinearizedProblem) -> Iterator[Finding]:
    """Say why no poses are proposed where contacts decide which poses the arm can take."""
    if not problem.settings.source.observes_places:
        yield Finding("no_next_poses", {})


def held_at_ends(calibration: Calibration) -> Iterator[Finding]:
    """Say it of every amplitude that is at an end of its range, other than nominal."""
    model = calibration.model
    start = model.n_geometric
    for p, value in zip(model.parameters[start:], calibration.values[start:], strict=True):
        end = next(
            (e for e in (p.lower, p.upper) if np.isfinite(e) and np.isclose(value, e, rtol=1e-9, atol=0.0)), None
        )
        if end is None or end == p.value:
            continue
        unit, scale = display_unit_and_scale(p.unit)
        yield Finding("at_end_of_range", {"parameter": p.name, "value": end * scale, "unit": unit})


def left_out_findings(effects: Sequence[Judged]) -> Iterator[Finding]:
    """Say which steps and drifts the version does without, and what would settle them."""
    out = [j for j in effects if not j.storable and j.verdict != CONTRADICTED]
    if out:
        names = list(dict.fromkeys(j.display_name for j in out))
        yield Finding("not_settled", {"effects": [j.evidence.candidate.label for j in out]}, {"names": names})
