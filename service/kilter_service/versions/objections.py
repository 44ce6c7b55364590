"""What a version's own identification says against activating it; needs nothing but the stored document."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from kilter_service.contract.versions import CorrectionLimits, Objection
from kilter_service.ground.core import core_identify

if TYPE_CHECKING:
    from kilter_core.model import Calibration

# Warnings that speak against a version: of held-out poses, of the arm itself, of its camera, of a confirmation, of its
# correction.
CODES = (
    "heldout_worse_than_registration",
    "worse_than_geometry",
    "another_arm",
    "board_scale_differs",
    "camera_moved",
    "confirmation_worse",
    "cannot_correct",
)
HELD_OUT_CODES = CODES[:2]
ERRORS_OF_DOUBT, SHARE_OF_DOUBT = (
    2.0,
    0.01,
)  # as in kilter_core.identify.comparison: standard errors, and of the simpler model's error
SIMPLER = {
    "registration_only": "base and tool alone",
    "geometry_fitted": "the geometry alone",
    "geometry_only": "the geometry alone",  # as earlier releases stored it
    "nominal": "the nominal robot",
}
OF_REACH = 0.005  # what real arms leave, at most, before anything is identified
SHARE = 0.5  # of what base and tool alone leave: rows of which a fit explains less belong to something else
ROWS = {"validation": "its own held-out rows", "train": "the rows it was fitted to"}


def objections_from_report(report: Mapping[str, Any], limits: CorrectionLimits) -> list[Objection]:
    """Return what speaks against a version with this report, nothing when its job found it good."""
    warnings = [w for w in report.get("warnings") or () if w.get("code") in CODES and w.get("beyond_chance", True)]
    named = [Objection(code=w["code"], message=w["message"]) for w in warnings]
    metrics = report.get("metrics") or {}
    return [*named, *_worse_held_out(metrics.get("validation") or {}, named), *_too_large(report, limits)]


def of_calibration(calibration: Calibration, said: Sequence[Objection]) -> list[Objection]:
    """Return what the arm of a version says against it, where its report has not: earlier releases did not look."""
    codes = {one.code for one in said}
    found = [Objection(code=w["code"], message=w["message"]) for w in core_identify.another_arm(calibration)]
    return [one for one in found if one.code not in codes]


def _worse_held_out(held: Mapping[str, Any], named: list[Objection]) -> list[Objection]:
    """The simpler model that its own held-out rows prefer, unless a warning of held-out poses has said so."""
    named = [one for one in named if one.code in HELD_OUT_CODES]
    found = held.get("identified") or {}
    for stage, what in SIMPLER.items():
        simpler = held.get(stage) or {}
        if named or not found or not simpler or not _clearly_larger(found, simpler, int(held.get("n") or 1)):
            continue
        message = (
            f"On its own held-out rows it leaves {found['mean_mm']:.4g} mm, {what} {simpler['mean_mm']:.4g} mm: "
            "more than chance explains."
        )
        return [Objection(code="heldout_worse", message=message)]
    return []


def _clearly_larger(found: Mapping[str, Any], simpler: Mapping[str, Any], n: int) -> bool:
    """Whether a mean is larger than another beyond chance; the rows' own differences are not stored, so as if unpaired."""
    doubt = ERRORS_OF_DOUBT * math.sqrt((variance(found) + variance(simpler)) / n)
    return float(found["mean_mm"] - simpler["mean_mm"]) > max(doubt, SHARE_OF_DOUBT * float(simpler["mean_mm"]))


def variance(block: Mapping[str, Any]) -> float:
    """Variance of the errors of rows, mm^2, of a stored block of metrics."""
    return max(float(block.get("rms_mm", block["mean_mm"])) ** 2 - float(block["mean_mm"]) ** 2, 0.0)


def _too_large(report: Mapping[str, Any], limits: CorrectionLimits) -> list[Objection]:
    """An error left that is larger than any correction, for an arm of this reach: held-out rows say it first.

    Another robot is suspected only where the fit explained next to nothing: 7 mm of 208 are the right arm's.
    """
    metrics = report.get("metrics") or {}
    reach = (report.get("workspace") or {}).get("reach_mm") or 0.0
    for block, rows in ROWS.items():
        stages = metrics.get(block) or {}
        left, before = _mean(stages, "identified"), _mean(stages, "registration_only")
        if left is None or left <= max(limits.max_position_mm, OF_REACH * reach):
            continue
        was = "" if before is None else f" of {before:.4g} mm"
        message = (
            f"It leaves {left:.4g} mm{was} on {rows}, too large to correct with: it may move the tool by "
            f"{limits.max_position_mm:g} mm at most. {_astray(report) or _remedy(left, before)}"
        )
        return [Objection(code="error_beyond_limit", message=message)]
    return []


def _astray(report: Mapping[str, Any]) -> str:
    """What is said of rows that no arm explains: with them in the errors nothing can be said of the arm."""
    said = [str(one["message"]) for one in report.get("warnings") or () if one.get("code") == "rows_astray"]
    return f"It is not the arm. {' '.join(said)}" if said else ""


def _remedy(left: float, before: float | None) -> str:
    if before is not None and left <= SHARE * before:
        return (
            "Most of the error is explained: enter the zero offsets that it found in the controller and measure again, or "
            "look for what the model lacks (kilter gap) and for wrong rows."
        )
    return "Joints, columns or units may be mixed up, or it is another robot."


def _mean(block: Mapping[str, Any], stage: str) -> float | None:
    value = (block.get(stage) or {}).get("mean_mm")
    return None if value is None else float(value)
