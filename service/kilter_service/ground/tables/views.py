"""What cameras saw, from stored columns: pixels of corners, and the cameras and boards that the campaign describes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from kilter_core.observations import Board, Camera, Rig
from kilter_core.types import Floats
from kilter_service.ground.wire import to_metres

PERCENT = 1e-2


def rig_from_conditions(conditions: Mapping[str, Any]) -> Rig | None:
    """The cameras and boards of a campaign, SI; None where it names none.

    Raises:
        ObservationError: ``camera_invalid`` or ``board_invalid``.

    """
    if not conditions.get("cameras") or not conditions.get("boards"):
        return None
    return Rig(tuple(map(_camera, conditions["cameras"])), tuple(map(_board, conditions["boards"])))


def _camera(one: Mapping[str, Any]) -> Camera:
    sigmas = one.get("sigmas_px")
    return Camera(
        one["name"],
        one["mount"],
        (one["width_px"], one["height_px"]),
        (one["fx_px"], one["fy_px"]),
        (one["cx_px"], one["cy_px"]),
        one.get("distortion_model", "none"),
        tuple(one.get("distortion") or ()),
        one.get("intrinsics") or ("fixed" if sigmas is None else "prior"),
        None if sigmas is None else tuple(sigmas),
    )


def _board(one: Mapping[str, Any]) -> Board:
    corners = tuple((to_metres(x), to_metres(y), to_metres(z)) for x, y, z in one["corners_mm"])
    return Board(one["name"], one["mount"], corners, PERCENT * (one.get("scale_sigma_percent") or 0.0))


def views(si: Mapping[tuple[str, int | None], Floats], conditions: Mapping[str, Any], rows: int) -> dict[str, Any]:
    """Fields of the observations; none without pixels, or where nobody describes the cameras."""
    rig = rig_from_conditions(conditions)
    if rig is None or not any(quantity == "pixel_u" for quantity, _ in si):
        return {}
    pixels = _corners(si, rig.most_corners, "", rows)
    out = {"pixels": pixels, "rig": rig}
    seen = ~np.isnan(pixels).all(axis=(1, 2))
    for name in ("camera", "board"):
        number = si.get((name, None), np.ones(rows))
        out[name] = np.where(seen, np.nan_to_num(number, nan=1.0).astype(np.int64) - 1, -1)
    if any(quantity == "pixel_su" for quantity, _ in si):
        out["pixel_sigma"] = _corners(si, rig.most_corners, "s", rows)
    return out


def _corners(si: Mapping[tuple[str, int | None], Floats], corners: int, prefix: str, rows: int) -> Floats:
    out = np.full((rows, corners, 2), np.nan)
    for k in range(corners):
        for axis, letter in enumerate("uv"):
            column = si.get((f"pixel_{prefix}{letter}", k))
            if column is not None:
                out[:, k, axis] = column
    return out
