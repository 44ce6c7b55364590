"""The warning that a printed board is not flat, with its size and what to do."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.measurement.camera.board_shape import board_shapes
from kilter_core.parameters import mm
from kilter_core.types import QUANTILE

CHANCE = 1e-3  # of saying it of a flat board, all boards together
LITTLE_M = 2e-5  # from the highest to the lowest corner: no printed sheet is flatter


def bent_boards(fit: Fit) -> Iterator[dict[str, Any]]:
    """Warnings ``board_not_flat``; nothing where no camera measured, or too little."""
    views = fit.problem.measurement.pixels
    if views is None:
        return
    prediction = fit.calibration().predict(views.observations)
    found = list(board_shapes(views, prediction, views.resolve_rig(prediction)))
    for one in found:
        if one.chance * len(found) > CHANCE or one.size - QUANTILE * one.sigma < LITTLE_M:
            continue
        (x, y), twist = (mm(v) for v in one.bows), mm(one.twist)
        size, half = mm(one.size), mm(QUANTILE * one.sigma)
        yield {
            "code": "board_not_flat",
            "board": one.board,
            "size_mm": size,
            "u95_mm": half,
            "bow_x_mm": x,
            "bow_y_mm": y,
            "twist_mm": twist,
            "rms_px": one.rms_px,
            "p_value": one.chance,
            "message": f"Board {one.board} is not flat: from its highest to its lowest corner {size:.2g} mm (95 %: within "
            f"{half:.1g} mm), a bow of {x:.2g} mm along x and {y:.2g} mm along y and a twist of {twist:.2g} mm in z of its "
            f"frame. It moves corners by {one.rms_px:.2g} px (rms). Glue it to a stiff plate and measure anew, or add this to "
            "the heights in its `corners_mm`; if another board says the same, the lens needs another model.",
        }
