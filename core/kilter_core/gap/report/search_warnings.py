"""Warnings of a search about itself: much is left, no load, no poses to propose, amplitudes at an end of their range."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

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


def unloaded_warnings(prepared: Prepared) -> Iterator[dict[str, Any]]:
    """Say which effects were not looked for because nothing is known to load the joints."""
    loaded = list(dict.fromkeys(e.id for e in prepared.library.effects if "moments" in e.needs))
    if loaded and not np.any(prepared.problem.settings.source.batch.wrench):
        message = (
            f"{', '.join(loaded)} were not looked for: they follow load moments, and neither link masses nor a payload "
            "are known. Give the robot's links mass_kg and com_mm, or the rows payload_kg, and search again."
        )
        yield {"code": "no_load", "effects": loaded, "message": message}


def unplanned_warnings(problem: LinearizedProblem) -> Iterator[dict[str, Any]]:
    """Say why no poses are proposed where contacts decide which poses the arm can take."""
    if not problem.settings.source.observes_places:
        message = (
            "No poses are proposed: the contact decides which poses the arm can take. To make a name surer, hold the "
            "ball in more placements, with joint angles and orientations that differ from those measured."
        )
        yield {"code": "no_next_poses", "message": message}


def at_ends(calibration: Calibration) -> Iterator[dict[str, Any]]:
    """A warning for every amplitude that is at an end of its range, other than nominal."""
    model = calibration.model
    start = model.n_geometric
    for p, value in zip(model.parameters[start:], calibration.values[start:], strict=True):
        end = next(
            (e for e in (p.lower, p.upper) if np.isfinite(e) and np.isclose(value, e, rtol=1e-9, atol=0.0)), None
        )
        if end is None or end == p.value:
            continue
        unit, scale = display_unit_and_scale(p.unit)
        size = f"{end * scale:.3g} {unit}".removesuffix(" 1")
        yield {
            "code": "at_end_of_range", "parameter": p.name, "value": end * scale, "unit": unit,
            "message": f"{p.name} would come out beyond what is physical and is held at {size}: something else is in it. "
            "Check units, masses and payloads, and search again with `effects` that leave it out.",
        }  # fmt: skip


def left_out_warnings(effects: Sequence[Judged]) -> Iterator[dict[str, Any]]:
    """Say which steps and drifts the version does without, and what would settle them."""
    out = [j for j in effects if not j.storable and j.verdict != CONTRADICTED]
    names = ", ".join(dict.fromkeys(j.display_name for j in out))
    if out:
        yield {
            "code": "not_settled",
            "effects": [j.evidence.candidate.label for j in out],
            "message": f"The version leaves out what is not settled: {names}. To settle it, revisit poses at other times, or "
            "measure all in random order.",
        }
