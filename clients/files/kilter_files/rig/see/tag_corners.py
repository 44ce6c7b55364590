"""Corners of tags: where the edges of the black border meet."""

from __future__ import annotations

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.rig.see.edges import Pieces, area, fit_edge_curves, iterate_until_settled, offsets, profile_reach
from kilter_files.rig.see.noise import Noise
from kilter_files.rig.see.pictures import Grey

ENDS = 0.12  # of an edge at either end, left out: blur of the corner
LEAST_PROFILES, MOST_PROFILES = 5, 60
BOWED_FROM = 16  # profiles, from which an edge may be bowed by a lens
FLOOR_PX = 0.015


def refine_corners(grey: Grey, quads: Floats, cells: int, white: float, noise: Noise) -> tuple[Floats, Floats, Floats]:
    """Return corners (n, 4, 2), clockwise, covariances (n, 4, 2, 2) px², and blur (n, 4) across each edge.

    ``quads`` are within 2 px; ``white`` is how wide the white around a tag is, in parts of its side.
    """
    gap, straight = min(1.0 / cells, white), np.zeros(4 * len(quads))
    return iterate_until_settled(quads, straight, lambda at, blur, bow: _meeting(grey, at, gap, noise, blur, bow))


def _meeting(
    grey: Grey, quads: Floats, gap: float, noise: Noise, blur: float, bow: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    count = len(quads)
    chords = np.roll(quads, -1, axis=1) - quads
    lengths = np.linalg.norm(chords, axis=2)
    along = chords / lengths[..., None]
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)  # outwards
    whole = area(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]) / 2
    reach, left = profile_reach(gap * float(np.percentile(whole[:, None] / lengths, 10)), blur, 1.0, FLOOR_PX)
    profiles = int(np.clip((1 - 2 * ENDS) * np.median(lengths), LEAST_PROFILES, MOST_PROFILES))
    t = lengths[..., None] * np.linspace(ENDS, 1 - ENDS, profiles)
    starts, ways, outwards, flat = (part.reshape(4 * count, -1) for part in (quads, along, normals, t))
    bowed = bow[:, None] * flat * (flat - lengths.reshape(-1, 1))  # nothing at the corners
    seen = offsets(grey, Pieces(starts, ways, outwards, flat, bowed), reach, noise)
    degree = 2 if profiles >= BOWED_FROM else 1
    curves, covariances = fit_edge_curves(flat, seen.out, seen.variances, degree)
    ends = [_evaluate_curves(curves, covariances, where) for where in (np.zeros(4 * count), lengths.ravel())]
    (begin, begin_slope, begin_variance), (end, end_slope, end_variance) = (
        tuple(part.reshape(count, 4) for part in one) for one in ends
    )
    # corner k is where edge k - 1 ends and edge k begins
    off = np.stack([np.roll(end, 1, axis=1), begin], axis=-1)
    variance = np.stack([np.roll(end_variance, 1, axis=1), begin_variance], axis=-1) + left**2
    tilted = np.stack(
        [np.roll(normals - end_slope[..., None] * along, 1, axis=1), normals - begin_slope[..., None] * along], axis=2
    )
    bright = (seen.rises == 1).reshape(count, 4)
    known = bright & np.roll(bright, 1, axis=1) & (np.abs(np.linalg.det(tilted)) > 0.1)
    inverse = np.linalg.inv(tilted[known])
    places, spread = np.full(quads.shape, np.nan), np.full((*quads.shape, 2), np.nan)
    places[known] = quads[known] + np.einsum("nij,nj->ni", inverse, off[known])
    spread[known] = np.einsum("nij,nj,nkj->nik", inverse, variance[known], inverse)
    return places, spread, seen.blur_px.reshape(count, 4), curves[:, 2] if degree == 2 else bow


def _evaluate_curves(curves: Floats, covariances: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Offset, slope and variance of curves at one place each."""
    powers = t[:, None] ** np.arange(curves.shape[1])
    degrees = np.arange(1, curves.shape[1])
    slopes = (curves[:, 1:] * degrees * powers[:, :-1]).sum(axis=1)
    return (curves * powers).sum(axis=1), slopes, np.einsum("ni,nij,nj->n", powers, covariances, powers)
