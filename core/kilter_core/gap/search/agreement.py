"""Position against orientation: what moves a joint moves both, so an effect fitted to both must fit each.

On a robot arm under a laser tracker with a probe, orientations showed what looked like backlash of the wrist; the positions,
which the same backlash must move, said the opposite. Such a name is an artefact of the instrument, not of the arm.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.scan import residual_given
from kilter_core.types import Floats

APART = 0.001  # chance of calling a true effect contradicted
POSE = 6  # scalars of a full pose: position, then orientation
SEEN = 1e-9


def has_conflicting_amplitudes(search: SearchResult, place: int) -> bool:
    """Whether position and orientation give a chosen effect different amplitudes, and it makes one of them worse."""
    problem = search.problem
    size = problem.settings.whitener.shape[-1]
    if size != POSE or problem.settings.source.tool_numbers != POSE or not problem.settings.source.observes_tool:
        return False
    selector = search.selector
    rest = selector.columns([k for k in search.chosen if k != place])
    basis = problem.basis(rest)
    W = problem.projected_columns(list(selector.scorer.candidates[place].columns))
    X = W - basis @ (basis.T @ W)
    r = residual_given(problem, rest)
    amount = np.asarray(np.linalg.lstsq(X, r, rcond=None)[0], dtype=np.float64)
    turned = np.arange(len(r)) % size >= 3
    worse = [_gain(X[part], r[part], amount) < 0.0 for part in (~turned, turned)]
    if not any(worse):
        return False
    # D r is the difference of the two estimates; the noise left of r is that off the basis.
    D = np.zeros((X.shape[1], len(r)))
    D[:, ~turned], D[:, turned] = np.linalg.pinv(X[~turned]), -np.linalg.pinv(X[turned])
    covariance = D @ D.T - (D @ basis) @ (D @ basis).T
    w, V = np.linalg.eigh(covariance * selector.variance(problem.gram, search.chosen))
    keep = w > SEEN * max(float(w[-1]), 1e-300)
    apart = float(np.sum((V[:, keep].T @ (D @ r)) ** 2 / w[keep]))
    return bool(chi2.sf(apart, int(keep.sum())) < APART)


def _gain(X: Floats, r: Floats, amount: Floats) -> float:
    moved = X @ amount
    return float(2.0 * moved @ r - moved @ moved)
