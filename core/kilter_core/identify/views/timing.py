"""Warnings that pictures were not taken when their joints were read, or line by line while the arm moved."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.measurement.camera.view_motion import Delay, timing
from kilter_core.types import QUANTILE

CHANCE = 1e-3
LITTLE_PX = 0.05  # rms of a corner, below which a delay is not worth a word


def bad_timing(fit: Fit) -> Iterator[dict[str, Any]]:
    """Warnings ``pictures_late`` and ``rolling_shutter``; nothing of views of an arm at rest."""
    views = fit.problem.measurement.pixels
    found = None if views is None else timing(views, fit.calibration())
    if found is None:
        return
    if _clear(found.pictures):
        late = found.pictures
        side = "after" if late.s > 0.0 else "before"
        yield _timing_warning(
            "pictures_late",
            late,
            found.views,
            f"Pictures were taken {_format_delay(late)} {side} their joints were read: corners are off along the motion by "
            f"{late.rms_px:.2g} px (rms). Let the arm rest at every pose, or move the times of the pictures by that much.",
        )
    if _clear(found.lines):
        lines = found.lines
        yield _timing_warning(
            "rolling_shutter",
            lines,
            found.views,
            f"The camera reads its picture line by line, over {_format_delay(lines)}, while the arm moves: corners are off by "
            f"{lines.rms_px:.2g} px (rms). Let the arm rest at every pose, or take a camera with a global shutter.",
        )


def _clear(one: Delay) -> bool:
    return one.chance < CHANCE and one.rms_px > LITTLE_PX


def _format_delay(one: Delay) -> str:
    return f"{abs(one.s):.3g} s (95 %: within {QUANTILE * one.sigma:.1g} s)"


def _timing_warning(code: str, one: Delay, views: int, message: str) -> dict[str, Any]:
    return {
        "code": code,
        "time_s": one.s,
        "u95_s": QUANTILE * one.sigma,
        "rms_px": one.rms_px,
        "views": views,
        "p_value": one.chance,
        "message": message,
    }
