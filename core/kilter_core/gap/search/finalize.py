"""After the search: no name that chance could have given, no shape without a cause where a cause does as well.

The search judged each entry before the last re-fit. Here everything is judged again at the final fit, with the null
distribution the report quotes; and an empirical term that a physical one could replace at the same price is replaced.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import chi2

from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.in_space import fit_rms
from kilter_core.gap.search.linear.linearized import LinearizedProblem, refit
from kilter_core.gap.search.scan import residual_given
from kilter_core.gap.search.select import MARGIN, SMALLEST_GAIN
from kilter_core.types import Floats

# Position against orientation: what moves a joint moves both, so an effect fitted to both must fit each.
#
# On a robot arm under a laser tracker with a probe, orientations showed what looked like backlash of the wrist; the
# positions, which the same backlash must move, said the opposite. Such a name is an artefact of the instrument, not
# of the arm.

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


def finalize(found: SearchResult, alpha: float) -> SearchResult:
    """Drop and replace until every member is significant at the final fit; each change is followed by a re-fit."""
    seen = {frozenset(found.chosen)}
    while found.chosen:
        wrong = [k for k in found.chosen if has_conflicting_amplitudes(found, k)][:1]
        after = tuple(k for k in found.chosen if k not in wrong) if wrong else _without_chance(found, alpha)
        if after == found.chosen:
            after = _with_better_names(found, seen)
        if after == found.chosen:
            return found
        seen.add(frozenset(after))
        found.problem.resting()
        problem = refit(found.problem.settings, found.problem.values, found.selector.columns(after))
        found = replace(found, problem=problem, chosen=after, steps=found.extended_steps(problem, after))
    return found


def or_geometry_alone(found: SearchResult, geometry: LinearizedProblem) -> SearchResult:
    """The search if what it found leaves a smaller error than the ``geometry`` alone; else nothing is named."""
    better = found.problem.chi2 <= geometry.chi2 and fit_rms(found.problem) <= fit_rms(geometry)
    if found.chosen and better:
        return found
    steps = (found.steps[0],) if not found.chosen else found.extended_steps(geometry, ())
    return replace(found, problem=geometry, chosen=(), steps=steps)


def chance(found: SearchResult, place: int, alpha: float) -> float:
    """Family-wise p-value of a chosen candidate given the others, at the final fit.

    Where the linear statistic does not reach ``alpha``, a re-fit without the candidate decides: what it leaves more is
    the likelihood ratio. An amplitude times an uncertain load is not linear, and an effect far from zero whose
    uncertainty is that of the loads was called chance although nothing else explained the rows.
    """
    scorer = found.selector.scorer
    rest = found.selector.columns([k for k in found.chosen if k != place])
    gram = found.problem.gram
    scores = scorer.scores(gram.condition_on_columns(rest))
    tests = len(scorer.candidates)
    p = found.null.family_wise(float(scores.p[place]), tests)
    if p <= alpha:
        return p
    without = refit(found.problem.settings, found.problem.values, rest)
    ratio = scorer.tail_of_ratio(
        place, int(scores.d[place]), without.chi2, found.problem.chi2, gram.nu - gram.rank(rest)
    )
    return min(p, found.null.family_wise(ratio, tests))


def rejected_candidates(found: SearchResult) -> list[dict[str, Any]]:
    """Rows {id, joints, explains, p_value} of the candidates that were not named, the least likely by chance first.

    ``explains`` is the share of the squared residuals of the final fit that the candidate would take away with geometry
    fitted beside it (reduction S of the score test); ``p_value`` is family-wise, as that of a name. Candidates that the
    named ones or geometry imitate whole are left out: they have no score.
    """
    scorer, gram = found.selector.scorer, found.problem.gram.condition_on_columns(found.columns)
    scores = scorer.scores(gram)
    rows = [
        {
            **candidate.id_and_joints(),
            "explains": min(1.0, float(scores.S[k]) / gram.yy) if gram.yy > 0.0 else 0.0,
            "p_value": found.null.family_wise(float(scores.p[k]), len(scorer.candidates)),
        }
        for k, candidate in enumerate(scorer.candidates)
        if k not in found.chosen and scores.d[k] > 0
    ]
    return sorted(rows, key=lambda row: (row["p_value"], -row["explains"]))


def _without_chance(found: SearchResult, alpha: float) -> tuple[int, ...]:
    p = {k: chance(found, k, alpha) for k in found.chosen}
    worst = max(p, key=lambda k: p[k])
    return found.chosen if p[worst] <= alpha else tuple(k for k in found.chosen if k != worst)


def _with_better_names(found: SearchResult, seen: set[frozenset[int]]) -> tuple[int, ...]:
    """The set with one empirical member replaced by the best physical one within the margin, where there is one, or a
    physical member by another of its class at the same joints, where that does better at the final fit.
    """
    selector, gram = found.selector, found.problem.gram
    candidates = selector.scorer.candidates
    for place in found.chosen:
        allowed = MARGIN if candidates[place].empirical else -SMALLEST_GAIN
        rest = tuple(k for k in found.chosen if k != place)
        taken = set(selector.columns(rest))
        scores = selector.scorer.scores(gram.condition_on_columns(selector.columns(rest)))
        value = scores.S / selector.variance(gram, found.chosen) - scores.d * np.log(selector.rows)
        value -= selector.scorer.paid
        for k in np.argsort(-value, kind="stable"):
            rival = candidates[int(k)]
            if value[place] - value[k] > allowed:
                break
            after = (*rest, int(k))
            fits = not rival.empirical and not taken & set(rival.columns)
            fits = fits and (candidates[place].empirical or _are_of_a_class(candidates[place], rival))
            if fits and scores.d[k] and frozenset(after) not in seen and selector.plausible(gram, after, int(k)):
                return after
    return found.chosen


def _are_of_a_class(one: Candidate, other: Candidate) -> bool:
    return one.joints == other.joints and one.effects[0].physical.id == other.effects[0].physical.id
