"""How similar two candidates are after geometry and the rest, and a rival with what is known of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.linear.gram import VISIBLE
from kilter_core.types import Floats

SAME = 0.9999  # canonical correlation beyond which two signatures are one
HELD = 0.999  # canonical correlation from which a rival holds a signature, whatever else it could imitate


@dataclass(frozen=True)
class Alias:
    """A rival: points behind the chosen, canonical correlation given geometry and the rest, P(the chosen is wrong).

    ``member`` names the class where the rival is one of a class that the chosen cannot be distinguished from.
    """

    place: int
    candidate: Candidate
    behind: float
    correlation: float
    wrong: float
    member: str = ""


def correlation(A: Floats, one: tuple[int, ...], other: tuple[int, ...]) -> float:
    """Smallest canonical correlation that matters: largest share of one's space that the other's can copy, as a cosine.

    For single columns the plain correlation; for spaces, the mean square of the smaller one's directions, rooted.
    """
    first, second = (_half(A, c) for c in ((one, other) if len(one) <= len(other) else (other, one)))
    if not first.shape[1] or not second.shape[1]:
        return 0.0
    a, b = (one, other) if len(one) <= len(other) else (other, one)
    cross = first.T @ A[np.ix_(a, b)] @ second
    return float(min(1.0, np.sqrt(np.sum(cross**2) / first.shape[1])))


def correlations(A: Floats, spaces: Sequence[tuple[int, ...]]) -> Floats:
    """:func:`correlation` of every two spaces (K, K): each one's root is taken once, not once for each pair."""
    halves = [_half(A, columns) for columns in spaces]
    ranks = np.array([half.shape[1] for half in halves], dtype=np.int64)
    roots = np.zeros((len(A), int(ranks.sum())))
    starts = np.cumsum(ranks) - ranks
    for start, half, columns in zip(starts, halves, spaces, strict=True):
        roots[list(columns), start : start + half.shape[1]] = half
    space = np.repeat(np.arange(len(spaces)), ranks)
    member = (space == np.arange(len(spaces))[:, None]) * 1.0
    shared = member @ (roots.T @ A @ roots) ** 2 @ member.T
    sizes = np.array([len(columns) for columns in spaces])
    smaller = np.where(sizes[:, None] <= sizes, ranks[:, None], ranks)
    known = (ranks[:, None] > 0) & (ranks > 0)
    return np.asarray(np.where(known, np.minimum(1.0, np.sqrt(shared / np.maximum(smaller, 1))), 0.0))


def _half(A: Floats, columns: tuple[int, ...]) -> Floats:
    w, V = np.linalg.eigh(A[np.ix_(columns, columns)])
    keep = w > VISIBLE
    return np.asarray(V[:, keep] / np.sqrt(w[keep]))
