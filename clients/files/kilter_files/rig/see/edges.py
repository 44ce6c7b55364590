"""Where straight edges between dark and bright are, from the areas under profiles across them.

An area does not depend on the shape of the blur, and its noise follows from that of the pixels. Gradients alone would
pull the corner of a tag inwards and move that of a chessboard by up to a tenth of a pixel.

Corners between four squares: where two lines cross, each found on both sides of the corner.

Bright and dark change sides at the corner, so that ink that runs, or a camera whose grey levels are bent, rotates a line
and does not move the corner.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.rig.board_layout import opencv
from kilter_files.rig.see.pictures import Grey

MOST_REACH, LEAST_REACH = 5.0, 1.5  # px to either side of an edge
STEP = 0.5  # px along a profile
CLEAR = 2.5  # standard deviations of the blur, from the end of a profile to the next edge
LEAST_BLUR_PX, MOST_BLUR_PX = 0.6, 5.0  # a pixel and the way between pixels blur too
LEAST_CONTRAST = 10.0  # grey levels
ROUNDS, ENOUGH_PX = 5, 0.01

# from where corners, blur and bows were found before: corners, covariances, blur across each edge, and bows
Crossing = Callable[[Floats, float, Floats], tuple[Floats, Floats, Floats, Floats]]

ROUNDING = 12.0**-0.5  # standard deviation that whole grey levels have
KERNEL = np.array([1.0, -2.0, 1.0])  # its square blanks planes and bows, and leaves noise times 6
MOST_PIXELS = 120_000
LEAST_FLAT = 200  # pixels, below which all of the board are taken
STEEP = 4.0  # times the picture's usual slope: an edge


@dataclass(frozen=True)
class Pieces:
    """Pieces of edges: ``starts``, ``along`` and ``normals`` (n, 2) px, and ``t`` (n, m) px along each.

    ``bow`` (n, m) px is how far out an edge is thought to be: profiles that are centred see as much dark as bright.
    """

    starts: Floats
    along: Floats
    normals: Floats
    t: Floats
    bow: Floats


@dataclass(frozen=True)
class Offsets:
    """``out`` (n, m) px along the normal, its ``variances`` (n), ``rises`` (n): 1 towards bright, -1, or 0: no edge.

    ``blur_px`` (n) is the standard deviation of a normal distribution as wide as the edge.
    """

    out: Floats
    variances: Floats
    rises: Floats
    blur_px: Floats


def profile_reach(gap_px: float, blur_px: float, part: float, floor_px: float) -> tuple[float, float]:
    """How far profiles reach where the next edge is ``gap_px`` away, and what standard deviation its blur leaves, px.

    ``part`` of what the blur shifts an edge by shifts the corner too; ``floor_px`` is left without noise and blur.
    """
    reach = float(np.clip(gap_px - CLEAR * blur_px, LEAST_REACH, MOST_REACH))
    leak = math.erfc(max(gap_px - reach, 0.0) / blur_px / 2**0.5) / 2
    return reach, math.hypot(floor_px, part * leak * reach / 2)


def area(first: Floats, second: Floats) -> Floats:
    """Area (n) between vectors (n, 2)."""
    return np.asarray(np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]))


def usual_blur(blur_px: Floats) -> float:
    """The blur of most edges."""
    known = blur_px[np.isfinite(blur_px)]
    return float(np.clip(np.median(known), LEAST_BLUR_PX, MOST_BLUR_PX)) if len(known) else LEAST_BLUR_PX


def iterate_until_settled(start: Floats, bow: Floats, crossing: Crossing) -> tuple[Floats, Floats, Floats]:
    """Corners, covariances and blur by ``crossing``, again from what it found before until no corner moves."""
    at, blur = start, LEAST_BLUR_PX
    for _ in range(ROUNDS):
        before = at
        at, covariances, blurs, bow = crossing(before, blur, bow)
        blur = usual_blur(blurs)
        if not np.isfinite(at).any() or np.nanmax(np.abs(at - before)) < ENOUGH_PX:
            break
        at = np.where(np.isfinite(at), at, before)
    return at, covariances, blurs


def offsets(grey: Grey, pieces: Pieces, reach: float, noise: Noise) -> Offsets:
    """Find the edges' offsets from the pieces' lines."""
    steps = np.linspace(-reach, reach, 2 * round(reach / STEP) + 1)
    places = (pieces.starts[:, None] + pieces.t[..., None] * pieces.along[:, None])[:, :, None]
    out = (pieces.bow[..., None] + steps)[..., None]
    profiles = _sample_bilinear(grey, places + out * pieces.normals[:, None, None])
    width = max(1, len(steps) // 6)
    ends = [_straight(pieces.t, side.mean(axis=2)) for side in (profiles[..., :width], profiles[..., -width:])]
    difference = ends[1] - ends[0]
    usual = difference.mean(axis=1)
    rises = np.sign(usual) * (np.abs(difference).min(axis=1) >= LEAST_CONTRAST)
    safe = np.where(np.abs(difference) >= LEAST_CONTRAST / 4, difference, LEAST_CONTRAST)
    risen = np.clip((profiles - ends[0][..., None]) / safe[..., None], -0.5, 1.5)
    step = steps[1] - steps[0]
    weights = np.full(len(steps), step)
    weights[[0, -1]] = step / 2
    spacing = np.abs(np.diff(pieces.t, axis=1)).mean(axis=1)
    pixel = (noise.dark**2 + noise.bright**2) / 2
    variances = 2 * reach * pixel / np.maximum(usual**2, 1.0) / np.minimum(spacing, 1.0)
    slope = np.maximum(np.diff(risen.mean(axis=1), axis=1).max(axis=1) / step, 1e-3)
    return Offsets(pieces.bow + reach - risen @ weights, variances, rises, 1.0 / (slope * np.sqrt(2 * np.pi)))


def _sample_bilinear(grey: Grey, places: Floats) -> Floats:
    cv2 = opencv()
    x, y = (np.ascontiguousarray(places[..., k].reshape(len(places), -1), dtype=np.float32) for k in range(2))
    low = np.array([max(0.0, np.floor(part.min()) - 1) for part in (x, y)]).astype(int)
    high = [int(np.ceil(part.max())) + 2 for part in (x, y)]
    part = grey[low[1] : high[1], low[0] : high[0]]
    if not part.size:
        return np.zeros(places.shape[:-1])
    x, y = x - np.float32(low[0]), y - np.float32(low[1])
    found = cv2.remap(part.astype(np.float32), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, dtype=np.float64).reshape(places.shape[:-1])


def _straight(t: Floats, values: Floats) -> Floats:
    """Straight lines through values (n, m) along t."""
    off = t - t.mean(axis=1, keepdims=True)
    slope = (off * values).sum(axis=1) / (off**2).sum(axis=1)
    return np.asarray(values.mean(axis=1, keepdims=True) + slope[:, None] * off)


def fit_edge_curves(t: Floats, out: Floats, variances: Floats, degree: int) -> tuple[Floats, Floats]:
    """Curves (n, degree + 1) through offsets (n, m), lowest power first, and their covariances.

    What the curves leave counts where it is more than the noise.
    """
    powers = t[..., None] ** np.arange(degree + 1)
    inverse = np.linalg.inv(np.swapaxes(powers, 1, 2) @ powers)
    curves = np.einsum("nij,nmj,nm->ni", inverse, powers, out)
    left = out - np.einsum("nmi,ni->nm", powers, curves)
    found = (left**2).sum(axis=1) / max(1, t.shape[1] - degree - 1)
    return curves, inverse * np.maximum(variances, found)[:, None, None]


@dataclass(frozen=True)
class Noise:
    """Standard deviation of a pixel in grey levels at two grey levels; the variance is linear in between."""

    dark: float
    bright: float
    dark_level: float
    bright_level: float

    def variance(self, grey: Floats) -> Floats:
        """Variance of pixels of these grey levels."""
        span = max(self.bright_level - self.dark_level, 1.0)
        share = np.clip((grey - self.dark_level) / span, 0.0, 1.0)
        return np.asarray((1.0 - share) * self.dark**2 + share * self.bright**2)


def estimate_noise(grey: Grey, corners: Floats) -> Noise:
    """Noise around corners (n, 2) px: what is left of flat places when planes and bows are taken off."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    part_of = min(
        1.0, (MOST_PIXELS / max(1.0, float(np.prod(high - low)))) ** 0.5
    )  # the middle of a large board is enough
    middle, half = (low + high) / 2, (high - low) / 2 * part_of
    low = np.maximum(np.floor(middle - half).astype(int) - 8, 0)
    high = np.ceil(middle + half).astype(int) + 9
    part = grey[low[1] : high[1], low[0] : high[0]].astype(np.float64)
    if min(part.shape) < 8:
        return Noise(1.0, 1.0, 0.0, 255.0)
    left = _bent(_bent(part, 0), 1) / 6.0
    level, slope = _around(part)
    low_level, high_level = (float(v) for v in np.percentile(level, [10, 90]))
    between = (low_level + high_level) / 2
    sides = [_spread(left, slope, side) for side in (level < between, level >= between)]
    return Noise(sides[0], sides[1], low_level, high_level)


def _bent(part: Floats, axis: int) -> Floats:
    rows = np.moveaxis(part, axis, 0)
    return np.moveaxis(KERNEL[0] * rows[:-2] + KERNEL[1] * rows[1:-1] + KERNEL[2] * rows[2:], 0, axis)


def _around(part: Floats) -> tuple[Floats, Floats]:
    """Mean and range of the 3 x 3 pixels around each."""
    shifted = [part[i : part.shape[0] - 2 + i, k : part.shape[1] - 2 + k] for i in range(3) for k in range(3)]
    stack = np.stack(shifted)
    return np.asarray(stack.mean(axis=0)), np.asarray(np.ptp(stack, axis=0))


def _spread(left: Floats, slope: Floats, side: NDArray[np.bool_]) -> float:
    """Robust standard deviation where it is flat: the half with the smaller range, the range being of noise too."""
    if side.sum() < LEAST_FLAT:
        return ROUNDING
    flat = side & (slope <= STEEP / 2 * np.percentile(slope[side], 30))
    values = np.abs(left[flat if flat.sum() >= LEAST_FLAT else side])
    return max(ROUNDING, float(np.median(values)) / 0.6745)


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
