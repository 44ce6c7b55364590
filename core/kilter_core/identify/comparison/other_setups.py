"""Rows of another set-up: they agree with a calibration once base, or base and tool, are fitted to them, not before."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from kilter_core.errors import TooFewPosesError
from kilter_core.identify.comparison.model_comparison import Difference, PoseErrors, mean_mm
from kilter_core.identify.estimate import refit_frames
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration

ELSEWHERE = "set_up_elsewhere"
RIGID = 0.2  # of the error is left in new frames: no wear or drift of an arm is a rigid motion so nearly
BY_POSE = (
    "With {words} fitted to these rows {here:.3g} mm are left (mean by pose), {there:.3g} mm as the version has {them}"
)
EVALUATE = "Evaluate with refit {refit}."
CONFIRM = "Name them as the confirmation, where base and tool are fitted, or hold out poses of the same set-up."


def elsewhere(
    calibration: Calibration, measurement: Measurement, remedy: str = EVALUATE, refit: Sequence[str] = ()
) -> Iterator[dict[str, Any]]:
    """Warn where rows agree with a calibration in other frames only; say nothing of rows that are too few to tell.

    ``refit`` are the frames fitted to the rows already; ``remedy`` may name those to fit as ``{refit}``.
    """
    if not measurement.observes_places:
        return
    for anew in (("base",), ("base", "tool")):
        if set(anew) <= set(refit):
            continue
        try:
            stages = {
                "there": refit_frames(calibration, measurement, tuple(refit)),
                "here": refit_frames(calibration, measurement, anew),
            }
        except TooFewPosesError:
            return
        errors = PoseErrors.from_calibrations(stages, measurement).stages
        there, here = errors["there"], errors["here"]
        if np.mean(here) < RIGID * np.mean(there) and Difference.from_paired_errors(there, here).worse:
            yield _warning(anew, mean_mm(there), mean_mm(here), remedy)
            return


def _warning(anew: Sequence[str], there_mm: float, here_mm: float, remedy: str) -> dict[str, Any]:
    words, one = " and ".join(anew), len(anew) == 1
    numbers = BY_POSE.format(words=words, here=here_mm, there=there_mm, them="it" if one else "them")
    who = "the instrument, or the arm, stood elsewhere" if one else "instrument and tool were set up anew"
    refit = "[" + ", ".join(f'"{name}"' for name in anew) + "]"
    return {
        "code": ELSEWHERE,
        "refit": list(anew),
        "version_mm": there_mm,
        "refitted_mm": here_mm,
        "message": f"{numbers}: {who}. {remedy.format(refit=refit)}",
    }
