"""What a report says beside its verdict: what was not looked for, what the version leaves out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kilter_core.effects import Effect
from kilter_core.gap.evidence.verdict import CONTRADICTED, Judged
from kilter_core.gap.search.sources.source import Source


def left_out_warnings(effects: Sequence[Judged]) -> Iterator[dict[str, Any]]:
    """Say which steps and drifts the version does without, and what would settle them."""
    out = [j for j in effects if not j.storable and j.verdict != CONTRADICTED]
    if out:
        yield {
            "code": "not_settled", "effects": [j.evidence.candidate.label for j in out],
            "message": f"The version leaves out what is not settled: {', '.join(dict.fromkeys(j.called for j in out))}. To "
            "settle it, revisit poses at other times, or measure all in random order.",
        }  # fmt: skip


def unsearched(source: Source, effects: Sequence[Effect]) -> Iterator[dict[str, Any]]:
    """Say which effects were not looked for because nothing is known to load the joints."""
    loaded = list(dict.fromkeys(e.id for e in effects if "moments" in e.needs))
    if loaded and not np.any(source.batch.wrench):
        yield {
            "code": "no_load", "effects": loaded,
            "message": f"{', '.join(loaded)} were not looked for: they follow load moments, and neither link masses nor a "
            "payload are known. Give the robot's links mass_kg and com_mm, or the rows payload_kg, and search again.",
        }  # fmt: skip


def unplanned(source: Source) -> Iterator[dict[str, Any]]:
    """Say why no poses are proposed where contacts decide which poses the arm can take."""
    if not source.observes_places:
        yield {
            "code": "no_next_poses",
            "message": "No poses are proposed: the contact decides which poses the arm can take. To make a name surer, "
            "hold the ball in more placements, with joint angles and orientations that differ from those measured.",
        }
