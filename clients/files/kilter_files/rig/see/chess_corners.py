"""Corners between four squares: where two lines cross, each found on both sides of the corner.

Bright and dark change sides at the corner, so that ink that runs, or a camera whose grey levels are bent, rotates a line
and does not move the corner.
"""

from __future__ import annotations

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.rig.board.opencv import opencv
from kilter_files.rig.see.edges import (
    Noise,
    Pieces,
    area,
    fit_edge_curves,
    iterate_until_settled,
    offsets,
    profile_reach,
)
from kilter_files.rig.see.pictures import Grey

BEGIN_PX = 2.5  # of an arm, from the corner: blur of the other edge
END = 0.6  # of a square
MOST_ARM_PX = 40.0
LEAST_CORNER_PROFILES, MOST_CORNER_PROFILES = 4, 30
FLOOR_PX = 0.007
LEFT = 0.2  # markers shift both arms of a line to opposite sides, and not by quite the same


def refine_corners(
    grey: Grey, start: Floats, board_mm: Floats, square_mm: float, marker_mm: float, noise: Noise
) -> tuple[Floats, Floats, Floats]:
    """Return corners (n, 2), covariances (n, 2, 2) px², NaN where there is none, and blur across both lines (n, 2).

    ``start`` is within 2 px; ``board_mm`` (n, 2) is where the corners are on the board.
    """
    sides = _sides(start, board_mm, square_mm)
    gap = (square_mm - marker_mm) / 2 / square_mm
    straight = np.zeros((2 * len(start), 2))
    return iterate_until_settled(
        start, straight, lambda at, blur, bow: _crossing(grey, at, sides, gap, noise, blur, bow)
    )


def _sides(start: Floats, board_mm: Floats, square_mm: float) -> Floats:
    """Sides of a square at each corner along the board's x and y (n, 2 axes, 2) px, by the board's homography."""
    cv2 = opencv()
    found, _ = cv2.findHomography(board_mm.astype(np.float64), start.astype(np.float64), 0)
    if found is None:
        return np.full((len(start), 2, 2), np.nan)
    h = np.asarray(found, dtype=np.float64)
    w = board_mm @ h[2, :2] + h[2, 2]
    at = (board_mm @ h[:2, :2].T + h[:2, 2]) / w[:, None]
    return np.stack([(h[:2, k] - at * h[2, k]) / w[:, None] for k in range(2)], axis=1) * square_mm


def _crossing(
    grey: Grey, at: Floats, sides: Floats, gap: float, noise: Noise, blur: float, bow: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    count = len(at)
    lengths = np.linalg.norm(sides, axis=2)
    along = sides / lengths[..., None]
    normals = np.stack([-along[..., 1], along[..., 0]], axis=-1)
    # the other side of the square seen across a line: what a profile can reach
    heights = area(sides[:, 0], sides[:, 1])[:, None] / lengths
    reach, left = profile_reach(gap * float(np.percentile(heights, 10)), blur, LEFT, FLOOR_PX)
    end = np.minimum(END * lengths, MOST_ARM_PX)
    profiles = int(np.clip(np.median(end) - BEGIN_PX, LEAST_CORNER_PROFILES, MOST_CORNER_PROFILES))
    t = BEGIN_PX + (np.maximum(end, BEGIN_PX + 2) - BEGIN_PX)[..., None] * np.linspace(0, 1, profiles)
    both = np.concatenate([-t[..., ::-1], t], axis=-1)  # (n, 2 lines, 2 profiles)
    flat = both.reshape(2 * count, -1)
    bowed = bow[:, :1] * flat + bow[:, 1:] * flat**2  # a line as it was found, through the corner
    arms = [
        Pieces(np.repeat(at, 2, 0), along.reshape(-1, 2), normals.reshape(-1, 2), flat[:, half], bowed[:, half])
        for half in (slice(profiles), slice(profiles, None))
    ]
    first, second = (offsets(grey, arm, reach, noise) for arm in arms)
    out = np.concatenate([first.out, second.out], axis=1)
    curves, covariances = fit_edge_curves(flat, out, (first.variances + second.variances) / 2, 2)
    lines = (first.rises * second.rises == -1).reshape(count, 2).all(axis=1)
    slopes = curves[:, 1].reshape(count, 2)
    tilted = normals - slopes[..., None] * along
    known = np.isfinite(tilted).all(axis=(1, 2)) & lines
    known[known] &= np.abs(np.linalg.det(tilted[known])) > 0.1
    places, spread = np.full((count, 2), np.nan), np.full((count, 2, 2), np.nan)
    inverse = np.linalg.inv(tilted[known])
    places[known] = at[known] + np.einsum("nij,nj->ni", inverse, curves[:, 0].reshape(count, 2)[known])
    across = covariances[:, 0, 0].reshape(count, 2)[known] + left**2
    spread[known] = np.einsum("nij,nj,nkj->nik", inverse, across, inverse)
    return places, spread, np.maximum(first.blur_px, second.blur_px).reshape(count, 2), curves[:, 1:]
