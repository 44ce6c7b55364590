"""What a version's own identification says against activating it; needs nothing but the stored document."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from service.versions.schemas import CorrectionLimits, Objection

CODES = ("heldout_worse_than_registration", "worse_than_geometry")  # warnings that say what this module looks for
SHARE_OF_DOUBT = 0.01  # as in core.compare: a smaller difference is no harm
SIMPLER = {"registration_only": "base and tool alone", "geometry_only": "the geometry alone", "nominal": "the drawing"}


def objections_of(report: Mapping[str, Any], limits: CorrectionLimits) -> list[Objection]:
    """Return what speaks against a version with this report, nothing when its job found it good."""
    warnings = [w for w in report.get("warnings") or () if w.get("code") in CODES]
    named = [Objection(code=w["code"], message=w["message"]) for w in warnings]
    metrics = report.get("metrics") or {}
    return [*named, *_worse_held_out(metrics.get("validation") or {}, named), *_too_large(metrics, limits)]


def _worse_held_out(held: Mapping[str, Any], named: list[Objection]) -> list[Objection]:
    """The simpler model that its own held-out rows prefer, unless a warning has said so."""
    found = _mean(held, "identified")
    for stage, what in SIMPLER.items():
        simpler = _mean(held, stage)
        if found is None or simpler is None or named or found <= simpler * (1 + SHARE_OF_DOUBT):
            continue
        message = f"On its own held-out rows it leaves {found:.4g} mm, {what} {simpler:.4g} mm."
        return [Objection(code="heldout_worse", message=message)]
    return []


def _too_large(metrics: Mapping[str, Any], limits: CorrectionLimits) -> list[Objection]:
    """A version that explains its own rows worse than the largest correction it may make describes another arm."""
    left = _mean(metrics.get("train") or {}, "identified")
    if left is None or left <= limits.max_position_mm:
        return []
    message = (
        f"It leaves {left:.4g} mm on the rows it was fitted to, more than the {limits.max_position_mm:g} mm it may ever "
        "correct: joints, columns or units are mixed up, or the robot is another."
    )
    return [Objection(code="error_beyond_limit", message=message)]


def _mean(block: Mapping[str, Any], stage: str) -> float | None:
    value = (block.get(stage) or {}).get("mean_mm")
    return None if value is None else float(value)
