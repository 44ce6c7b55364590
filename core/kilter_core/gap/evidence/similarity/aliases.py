"""Who else could it be (E6): every candidate that does as well as a chosen one, and how sure that is."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from kilter_core.effects.unknown import UnknownSmoothCurve
from kilter_core.gap.evidence.similarity.similarity import HELD, SAME, Alias, correlation
from kilter_core.gap.evidence.similarity.smooth import EVEN, is_curve, own_curve, smooth_members
from kilter_core.gap.search.candidates import FAMILY, Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.select import MARGIN
from kilter_core.types import Floats

SEVERAL = 2.0  # times the whole gap, after geometry, that each of two effects must move the arm


def cancelling_members(search: SearchResult, place: int) -> tuple[Alias, ...]:
    """The chosen effects that a chosen one cancels against, under the name of their sum; none where it does not cancel.

    Compared after geometry: an effect that geometry undoes in part is no larger than what is left of it.
    """
    problem, selector = search.problem, search.selector
    columns = search.columns
    fitted = dict(zip(columns, problem.gram.solve(columns), strict=True))
    candidates = selector.scorer.candidates

    def contribution_norm(*places: int) -> float:
        own = selector.columns(places)
        beta = np.array([fitted[k] for k in own])
        return float(np.sqrt(max(beta @ problem.A[np.ix_(own, own)] @ beta, 0.0)))

    gap = contribution_norm(*search.chosen)
    if contribution_norm(place) < SEVERAL * gap:
        return ()
    against = [
        k
        for k in search.chosen
        if k != place
        and contribution_norm(k) > SEVERAL * gap
        and contribution_norm(place, k) < max(contribution_norm(place), contribution_norm(k)) / SEVERAL
    ]
    if not against:
        return ()
    own = candidates[place].columns
    names = " and ".join(candidates[k].label for k in sorted((place, *against)))
    name = f"sum of {names}"
    return tuple(
        Alias(k, candidates[k], 0.0, correlation(problem.A, own, candidates[k].columns), EVEN, name) for k in against
    )


__all__ = ["SAME", "Alias", "correlation", "find_aliases"]


def find_aliases(search: SearchResult, place: int) -> tuple[Alias, ...]:
    """Rivals of a chosen candidate within the margin when swapped in, best first; empirical ones included.

    The others of a class that the name cannot be distinguished from come last, with the class's name.
    """
    selector, gram = search.selector, search.problem.gram
    rest = tuple(k for k in search.chosen if k != place)
    given = gram.condition_on_columns(selector.columns(rest))
    variance = selector.variance(gram, search.chosen)
    scores = selector.scorer.scores(given)
    lenient = scores.S / variance - 2.0 * scores.d
    chosen = selector.scorer.candidates[place]
    value = scores.S / variance - scores.d * np.log(selector.rows) - selector.scorer.paid
    strength = max(float(scores.S[place]) / variance - float(scores.d[place]), 0.0)
    found = []
    for k in np.argsort(-value, kind="stable"):
        rival = selector.scorer.candidates[int(k)]
        behind = float(value[place] - value[k])
        if not rival.empirical:
            # A richer rival is not ruled out by its price alone: two points a parameter is what noise gives it.
            behind = min(behind, max(float(lenient[place] - lenient[k]), 0.0))
        if behind > MARGIN and not (scores.S[k] > HELD**2 * scores.S[place] and _holds(given.A, rival, chosen)):
            continue
        own = (
            int(k) in search.chosen
            or _is_nested_effect(chosen, rival)
            or _another_pace(chosen, rival)
            or scores.d[k] == 0
        )
        if own or not selector.plausible(gram, (*rest, int(k)), int(k)):
            continue
        rho = correlation(given.A, chosen.columns, rival.columns)
        wrong = float(norm.cdf(-np.sqrt(strength * max(1.0 - rho, 0.0) / 2.0)))
        found.append(Alias(int(k), rival, behind, rho, wrong))
    singles = {(a.candidate.id, k) for a in found if a.candidate.level != FAMILY for k in a.candidate.columns}
    found = [
        a
        for a in found
        if a.candidate.level != FAMILY or chosen.level == FAMILY or not _repeats_listed_joint(a, singles)
    ]
    if is_curve(chosen):  # whether a smooth curve takes the name away is decided there, joint by joint
        found = [
            a for a in found if a.candidate.id != UnknownSmoothCurve.id or not _is_joint_subset(a.candidate, chosen)
        ]
    members = smooth_members(search, place) or cancelling_members(search, place)
    return tuple(found) if not members else _with_members(found, members)


def _is_joint_subset(one: Candidate, other: Candidate) -> bool:
    """Whether the joints of one are among those of the other."""
    return set(one.joints or ()) <= set(other.joints or ())


def _with_members(found: list[Alias], members: tuple[Alias, ...]) -> tuple[Alias, ...]:
    """Rivals and members of the class, each once. Of a smooth error no other curve of the joint says more."""
    known = {a.place for a in members}
    joints = {j for a in members for j in a.candidate.joints or ()}
    smooth = any(a.candidate.empirical for a in members)
    rest = [a for a in found if a.place not in known and not (smooth and own_curve(a.candidate, joints))]
    return (*rest, *members)


def _holds(A: Floats, rival: Candidate, chosen: Candidate) -> bool:
    """Whether a cause holds the chosen signature: the base rotates like a first joint whose zero drifts.

    No price counts then, because no data of this kind can distinguish the two. A cause that imitates anything is none.
    """
    cause = not rival.empirical and rival.level != FAMILY and not rival.effects[0].supple
    return cause and correlation(A, chosen.columns, rival.columns) > HELD


def _repeats_listed_joint(alias: Alias, singles: set[tuple[str, int]]) -> bool:
    """Whether a family only repeats one of its joints that is in the list already."""
    return any((alias.candidate.id, k) in singles for k in alias.candidate.columns)


def _another_pace(one: Candidate, other: Candidate) -> bool:
    """Whether both are the same law, tried at another pace or in other pieces at the same place: the same name."""
    if one.id != other.id or not one.effects[0].clock:
        return False
    return _is_joint_subset(one, other) or _is_joint_subset(other, one)


def _is_nested_effect(one: Candidate, other: Candidate) -> bool:
    """Whether both are the same effect with joints of one among those of the other."""
    a, b = set(one.columns), set(other.columns)
    return one.id == other.id and (a <= b or b <= a)
