"""Campaigns that a model fits one by one and not together: the tool, or the base, was another one in each.

Beside the model's own parameters, linear about the fit of all campaigns together, every campaign after the first gets a
tool, a base, or both. What these take from what is left says whether the arm, or how it was set up, differed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from kilter_core.errors import CoreError
from kilter_core.identify.fit.problem import linearised_residual
from kilter_core.measurement import Measurement
from kilter_core.measurement.kind import POINTS
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.groups import evenly
from kilter_core.types import Floats, Ints

CLEARLY = 2.5  # times less that must be left with a set-up for each campaign: loads and drift of an arm take less
ALIKE = 1.2  # times what base and tool together leave, up to which one of them explains it
CHANCE = 1e-9  # of as much from campaigns of one set-up
MOST_ROWS = 4000  # of all campaigns together that are looked at
MOST_PARTS = 20  # campaigns or sessions: of more the frames would be as many as the rows
FEWEST_ROWS = 6  # of a campaign, or it says nothing
SMALL = 1e-8  # singular values below that share of the largest move nothing
SETTLES = ("tool",), ("base",), ("base", "tool")


@dataclass(frozen=True)
class SetUpChange:
    """Frames ``which`` that each campaign has of its own, m that they lie apart, and m left with one for all and with each."""

    which: tuple[str, ...]
    moved: float
    together: float
    apart: float


def set_up_change(calibration: Calibration, parts: Sequence[Observations]) -> SetUpChange | None:
    """Return the frames that differ between the ``parts`` that a calibration was fitted to; None where one does for all."""
    seen = [part.select(part.tool_seen) for part in parts if part.position is not None or part.markers is not None]
    rows = [part for part in seen if len(part) >= FEWEST_ROWS]
    if not 2 <= len(rows) <= MOST_PARTS:
        return None
    rows = [part.select(evenly(len(part), MOST_ROWS // len(rows))) for part in rows]
    try:
        joined = Observations.concatenate([replace(part, pose_id=None) for part in rows])
        return _find_set_up_change(calibration, joined, np.repeat(np.arange(len(rows)), list(map(len, rows))))
    except (CoreError, np.linalg.LinAlgError):  # rows that differ in what was measured, or lack what an effect reads
        return None


def _find_set_up_change(calibration: Calibration, rows: Observations, part: Ints) -> SetUpChange | None:
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    measurement = Measurement.from_observations(rows, calibration.marker_points, held=True).of_tool()
    free = np.arange(len(model.names))
    residual = linearised_residual(model, measurement, model.batch(measurement.observations), values, free)
    block = next((one for one in residual.blocks if one.group == POINTS), None)
    if block is None or block.J is None:
        return None
    r, J = block.r, block.J * np.array([p.prior_sigma for p in model.parameters])
    code = np.broadcast_to(part[:, None, None], r.shape)
    seen = ~np.isnan(r)
    r, J, code = r[seen], J[seen], code[seen]
    n = model.n_geometric
    frames = {"base": np.arange(6), "tool": np.arange(n - 6, n if rows.markers is not None else n - 3)}
    sigma = {name: np.array([model.parameters[k].prior_sigma for k in index]) for name, index in frames.items()}
    Q = _basis(J)
    plain = r - Q @ (Q.T @ r)
    before, codes = float(plain @ plain), range(1, int(part.max()) + 1)
    fits = {}
    for which in SETTLES:
        columns = np.hstack([J[:, frames[name]] * (code == c)[:, None] for c in codes for name in which])
        free_of = columns - Q @ (Q.T @ columns)
        found = np.linalg.lstsq(free_of, plain, rcond=SMALL)[0]
        left = plain - free_of @ found
        fits[which] = float(left @ left), found, int(np.linalg.matrix_rank(free_of, tol=SMALL * np.sqrt(len(r))))
    both = fits["base", "tool"][0]
    which = next(one for one in SETTLES if fits[one][0] <= ALIKE**2 * both)
    after, found, extra = fits[which]
    freedom = len(r) - Q.shape[1] - extra
    if freedom <= extra or before < CLEARLY**2 * after:
        return None
    if fdtrc(extra, freedom, (before - after) / extra / (after / freedom)) > CHANCE:
        return None
    twists = found * np.tile(np.concatenate([sigma[name] for name in which]), len(codes))
    moved = _largest_shift(twists, which, [len(frames[name]) for name in which], len(codes))
    points = len(r) / 3.0
    return SetUpChange(which, moved, float(np.sqrt(before / points)), float(np.sqrt(after / points)))


def _basis(J: Floats) -> Floats:
    """Orthonormal columns (R, k) of what the model's parameters move."""
    U, s, _ = np.linalg.svd(J, full_matrices=False)
    return np.asarray(U[:, s > SMALL * s[0]])


def _largest_shift(twists: Floats, which: tuple[str, ...], sizes: list[int], campaigns: int) -> float:
    """Longest shift (m) of a frame of any campaign."""
    lengths = []
    for one in np.split(twists, campaigns):
        start = 0
        for size, _ in zip(sizes, which, strict=True):
            lengths.append(float(np.linalg.norm(one[start : start + 3])))
            start += size
    return max(lengths)
