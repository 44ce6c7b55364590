"""Who else could it be (E6): every candidate that does as well in the place of a chosen one, and how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from core.gap.candidates import FAMILY, Candidate
from core.gap.hunt import Hunt
from core.gap.select import MARGIN
from core.gap.world import VISIBLE

Floats = NDArray[np.float64]

SAME = 0.9999  # canonical correlation beyond which two signatures are one


@dataclass(frozen=True)
class Alias:
    """A rival: points behind the chosen, canonical correlation given geometry and the rest, P(the chosen is wrong)."""

    place: int
    candidate: Candidate
    behind: float
    correlation: float
    wrong: float


def aliases_of(hunt: Hunt, place: int) -> tuple[Alias, ...]:
    """Rivals of a chosen candidate within the margin when swapped in, best first; empirical ones included."""
    selector, gram = hunt.selector, hunt.world.gram
    rest = tuple(k for k in hunt.chosen if k != place)
    given = gram.given(selector.columns(rest))
    variance = selector.variance(gram, hunt.chosen)
    scores = selector.scorer.scores(given)
    lenient = scores.S / variance - 2.0 * scores.d
    chosen = selector.scorer.candidates[place]
    value = scores.S / variance - scores.d * np.log(selector.rows)
    strength = max(float(scores.S[place]) / variance - float(scores.d[place]), 0.0)
    found = []
    for k in np.argsort(-value, kind="stable"):
        rival = selector.scorer.candidates[int(k)]
        behind = float(value[place] - value[k])
        if not rival.empirical:
            # A richer rival is not ruled out by its price alone: two points a parameter is what noise gives it.
            behind = min(behind, max(float(lenient[place] - lenient[k]), 0.0))
        if behind > MARGIN:
            continue
        own = int(k) in hunt.chosen or _nested(chosen, rival) or scores.d[k] == 0
        if own or not selector.plausible(gram, (*rest, int(k)), int(k)):
            continue
        rho = correlation(given.A, chosen.columns, rival.columns)
        wrong = float(norm.cdf(-np.sqrt(strength * max(1.0 - rho, 0.0) / 2.0)))
        found.append(Alias(int(k), rival, behind, rho, wrong))
    singles = {(a.candidate.id, k) for a in found if a.candidate.level != FAMILY for k in a.candidate.columns}
    return tuple(a for a in found if a.candidate.level != FAMILY or chosen.level == FAMILY or not _listed(a, singles))


def _listed(alias: Alias, singles: set[tuple[str, int]]) -> bool:
    """Whether a family only repeats one of its joints that is in the list already."""
    return any((alias.candidate.id, k) in singles for k in alias.candidate.columns)


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


def _half(A: Floats, columns: tuple[int, ...]) -> Floats:
    w, V = np.linalg.eigh(A[np.ix_(columns, columns)])
    keep = w > VISIBLE
    return np.asarray(V[:, keep] / np.sqrt(w[keep]))


def _nested(one: Candidate, other: Candidate) -> bool:
    """Whether both are the same effect with joints of one among those of the other."""
    a, b = set(one.columns), set(other.columns)
    return one.id == other.id and (a <= b or b <= a)
