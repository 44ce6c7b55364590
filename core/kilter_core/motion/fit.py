"""Weighted least squares on the products of a log, and how sure its values are when a second is one observation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc

from kilter_core.motion.layout import Term
from kilter_core.motion.normal import Equations
from kilter_core.types import Bools, Floats, Ints

PRIOR_SHARE = 3.0  # of the torque of a joint: no base parameter is believed to make more than so many times it
ITERATIONS = 3
OWN_SHARE = 0.002  # of a column, that the model must leave of it
HIDDEN_SHARE = 0.02  # of a column, below which only a very large effect would be seen
HIDDEN_BLOCKS = 3.0  # over the number of blocks: the same in a short log
ALIKE_COLUMNS = 1e-10  # of the largest eigenvalue, below which columns of one term count as the same
JUDGED = 20  # of the terms that gain most


@dataclass(frozen=True)
class Fit:
    """Values ``theta (width,)``, zero outside the model's ``columns``; ``inverse (k, k)`` of their normal matrix."""

    columns: Ints
    theta: Floats
    inverse: Floats
    weights: Floats


def fit_terms(equations: Equations, terms: Sequence[Term], blocks: Bools, weights: Floats) -> Fit:
    """Fit base parameters and terms to some blocks; what they do not show stays near zero."""
    columns = equations.columns_of(terms)
    A, b = equations.sum_blocks(blocks, weights)
    A, b = A[np.ix_(columns, columns)], b[columns]
    inverse = np.asarray(np.linalg.inv(A + np.diag(_ridge(equations, A, weights, blocks))), dtype=np.float64)
    theta = np.zeros(equations.layout.width)
    theta[columns] = inverse @ b
    return Fit(columns, theta, inverse, weights)


def _ridge(equations: Equations, A: Floats, weights: Floats, blocks: Bools) -> Floats:
    """Precision (k,) of zero for every value: that its column alone makes a few times the torques that were measured."""
    total = float(weights @ equations.torque_squares(blocks))
    own = np.diag(A)
    return np.where(own > 0.0, own / max(PRIOR_SHARE**2 * total, 1e-12), 1.0)


def joint_weights(equations: Equations, terms: Sequence[Term], blocks: Bools) -> Floats:
    """Return one over the variance (n,) of what is left at each joint, so that all joints count alike; 0 for unused ones."""
    rows = equations.rows[blocks].sum(axis=0)
    squares = equations.torque_squares(blocks)
    used = (rows > 0) & (squares > 0.0)
    weights = np.where(used, rows / np.where(used, squares, 1.0), 0.0)
    for _ in range(ITERATIONS):
        fit = fit_terms(equations, terms, blocks, weights)
        left = equations.losses(fit.theta, np.ones_like(weights), blocks).sum(axis=0)
        least = 1e-12 * squares
        weights = np.where(used, rows / np.maximum(np.where(used, left, 1.0), np.where(used, least, 1.0)), 0.0)
    return weights


def covariance(equations: Equations, fit: Fit, blocks: Bools) -> Floats:
    """Covariance (k, k) of the values of a fit, each block one observation (Liang and Zeger 1986)."""
    scores = equations.scores(fit.theta, fit.weights)[blocks][:, fit.columns]
    count = len(scores)
    middle = scores.T @ scores * (count / max(count - 1, 1))
    return np.asarray(fit.inverse @ middle @ fit.inverse)


@dataclass(frozen=True)
class Seen:
    """What a term would add: ``value (k,)``, its p-value, and the share of what is left at its joint that it explains."""

    term: Term
    value: Floats
    p: float
    gain: float
    share: float


def score_terms(equations: Equations, fit: Fit, blocks: Bools, terms: Sequence[Term]) -> list[Seen]:
    """Return what each of some terms would gain beside a fit, the most first, and how sure the best of them are.

    A term that the model imitates has nothing of its own left and is passed over.
    """
    A, b = equations.sum_blocks(blocks, fit.weights)
    left = equations.losses(fit.theta, fit.weights, blocks).sum(axis=0)
    found = []
    for term in terms:
        c = term.columns
        across = A[np.ix_(fit.columns, c)]
        beta, own = fit.inverse @ across, A[np.ix_(c, c)]
        M = own - across.T @ beta
        if not np.trace(M) > OWN_SHARE * np.trace(own):
            continue
        s = b[c] - A[np.ix_(c, fit.columns)] @ fit.theta[fit.columns]
        value = np.asarray(np.linalg.pinv(M, rcond=ALIKE_COLUMNS, hermitian=True) @ s)
        gain = float(s @ value)
        found.append(Seen(term, value, 1.0, gain, gain / max(float(left[term.joint]), 1e-12)))
    found.sort(key=lambda one: -one.gain)
    best, rest = found[:JUDGED], found[JUDGED:]
    left_out = values_without_blocks(equations, fit, blocks, [one.term for one in best])
    return [*(replace(one, p=_p_value(one.value, *of)) for one, of in zip(best, left_out, strict=True)), *rest]


def values_without_blocks(
    equations: Equations, fit: Fit, blocks: Bools, terms: Sequence[Term]
) -> list[tuple[Floats, Floats]]:
    """Return the values (b, k) of each of some terms beside the model when each of the blocks is left out of the fit, and
    which share (b,) of the term's own torque the block holds.
    """
    columns, m = np.concatenate([fit.columns, *(term.columns for term in terms)]), len(fit.columns)
    A, b = equations.block_sums(columns, blocks, fit.weights)
    ridge = _ridge(equations, A.sum(axis=0), fit.weights, blocks)
    A, b = A.sum(axis=0) + np.diag(ridge) - A, b.sum(axis=0) - b
    solved = np.linalg.solve(A[:, :m, :m], np.concatenate([A[:, :m, m:], b[:, :m, None]], axis=2))
    own = A[:, m:, m:] - A[:, m:, :m] @ solved[:, :, :-1]
    along = b[:, m:] - (A[:, m:, :m] @ solved[:, :, -1:])[:, :, 0]
    out, at = [], 0
    for term in terms:
        c = slice(at, at + len(term.columns))
        inverse = np.linalg.pinv(own[:, c, c], rcond=ALIKE_COLUMNS, hermitian=True)
        kept = np.trace(own[:, c, c], axis1=1, axis2=2)
        out.append((np.einsum("bij,bj->bi", inverse, along[:, c]), 1.0 - kept / kept.max()))
        at += len(term.columns)
    return out


def _p_value(value: Floats, left_out: Floats, shown: Floats) -> float:
    """Wald's test of values (k,) by how they change when each block (b,) is left out: the jackknife, which knows how much
    the model has taken of what is left. Where few blocks hold most of a term (``shown``), they are its degrees of freedom
    (Bell and McCaffrey 2002).
    """
    count, k = left_out.shape
    freedom = min(float(shown.sum()) ** 2 / max(float(shown @ shown), 1e-12), float(count)) - k
    if freedom <= 1.0:
        return 1.0
    apart = left_out - left_out.mean(axis=0)
    spread = np.linalg.pinv(apart.T @ apart * ((count - 1) / count))
    return float(fdtrc(k, freedom, float(value @ spread @ value) / k))


@dataclass(frozen=True)
class Partial:
    """A term in what a model leaves, block by block: products with that ``along (B, k)`` and with itself ``squares (B, k, k)``,
    each without what the model could imitate of it.
    """

    along: Floats
    squares: Floats

    def value(self, blocks: Bools) -> Floats:
        """Return the values (k,) that some blocks show."""
        return np.asarray(
            np.linalg.pinv(self.squares[blocks].sum(axis=0), rcond=ALIKE_COLUMNS, hermitian=True)
            @ self.along[blocks].sum(axis=0)
        )

    def size(self, value: Floats, blocks: Bools) -> tuple[Floats, Floats]:
        """Return products (b,) of the torque of some values with what is left in some blocks, and with itself."""
        return self.along[blocks] @ value, self.squares[blocks] @ value @ value


def partial_terms(equations: Equations, fit: Fit, blocks: Bools, terms: Sequence[Term]) -> list[Partial]:
    """Return each of some terms beside a fit to some blocks (Frisch, Waugh and Lovell)."""
    A, _ = equations.sum_blocks(blocks, fit.weights)
    scores = equations.scores(fit.theta, fit.weights)
    found = []
    for term in terms:
        own = np.zeros((equations.layout.width, len(term.columns)))
        own[term.columns] = np.eye(len(term.columns))
        own[fit.columns] -= fit.inverse @ A[np.ix_(fit.columns, term.columns)]
        found.append(Partial(scores @ own, equations.squares(own, fit.weights)))
    return found


def find_hidden_terms(equations: Equations, fit: Fit, blocks: Bools, terms: Sequence[Term]) -> list[Term]:
    """Return terms that the fit imitates in these blocks, so that nothing can be said of them."""
    A, _ = equations.sum_blocks(blocks, fit.weights)
    least = max(HIDDEN_SHARE, HIDDEN_BLOCKS / max(int(np.count_nonzero(blocks)), 1))
    hidden = []
    for term in terms:
        own, across = A[np.ix_(term.columns, term.columns)], A[np.ix_(fit.columns, term.columns)]
        if np.trace(own - across.T @ fit.inverse @ across) <= least * np.trace(own):
            hidden.append(term)
    return hidden
