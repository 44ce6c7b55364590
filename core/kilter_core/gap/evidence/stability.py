"""Would other poses of the same kind give the same names: the whole selection repeated on resampled poses.

Every pose gets a random weight (Bayesian bootstrap), and geometry and candidates are projected and scored again with
it. Signs of residuals around the fit would leave the poses as they are: a name that rests on two of them would always return.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.gram import Gram
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.scan import FEWEST_FLIPS, grouping, residual_given
from kilter_core.types import Floats

INCLUDED = 0.8  # share of resamples in which a name must return
DECIDED = 2.5  # standard errors from that share at which more resamples would change nothing
LOOK = 20  # resamples between two looks
FEW = 5  # resamples where no verdict waits for them
MANY = 2500  # scalars above which the candidates of a resample are those of the data to a few per cent
SMALLEST = 1e-9


def inclusion(
    search: SearchResult,
    classes: dict[int, tuple[int, ...]],
    rising: Collection[int],
    draws: int,
    seed: int,
    progress: Callable[[float], None],
    over: Callable[[], bool] = lambda: False,
) -> dict[int, tuple[float, float]]:
    """Share of resamples in which each chosen candidate, and any of its class, is selected again.

    ``classes`` gives the places that count as the same name; ``rising`` are those whose verdict waits for this: where there
    are none, a few resamples tell enough. Empty where time is ``over`` before enough of them were drawn to say anything.
    """
    # Pairs cost most of a search under unknown noise; what entered one by one is looked for one by one again.
    selector = replace(search.selector, pairs=search.selector.scorer.absolute or search.has_paired_entry)
    if not search.chosen:
        return {}
    rng = np.random.default_rng(seed)
    own = dict.fromkeys(search.chosen, 0)
    any_ = dict.fromkeys(search.chosen, 0)
    resampled = _make_resampler(search, rng)
    most = selector.names(search.chosen) + 2
    done = draws
    for b in range(draws):
        look = b and b % LOOK == 0 if rising else b == FEW
        if look and _are_shares_decided([any_[k] / b for k in rising], b):
            done = b
            break
        if over():
            if b < (LOOK if rising else FEW):
                return {}
            done = b
            break
        if b % 5 == 0:
            progress(b / draws)
        again = selector.select_candidates(resampled(), search.critical, most)
        names = {(selector.scorer.candidates[k].id, selector.scorer.candidates[k].joints) for k in again}
        columns = set(selector.columns(again))
        for k in search.chosen:
            found = _was_selected(search, k, names, columns)
            own[k] += found
            any_[k] += found or any(_was_selected(search, m, names, columns) for m in classes.get(k, ()))
    return {k: (own[k] / done, any_[k] / done) for k in search.chosen}


def _are_shares_decided(shares: list[float], draws: int) -> bool:
    """Whether so many draws leave no doubt on which side of the gate every share lies."""
    error = np.sqrt(INCLUDED * (1.0 - INCLUDED) / draws)
    return all(abs(share - INCLUDED) > DECIDED * error for share in shares)


def _was_selected(
    search: SearchResult, place: int, names: set[tuple[str, tuple[int, ...] | None]], columns: set[int]
) -> bool:
    """Whether a candidate was selected: by name, or most of its columns within a family or as members of one."""
    candidate = search.selector.scorer.candidates[place]
    if (candidate.id, candidate.joints) in names:
        return True
    same = {name for name, _ in names}
    return candidate.id in same and len(columns & set(candidate.columns)) >= 0.5 * len(candidate.columns)


def _make_resampler(search: SearchResult, rng: np.random.Generator) -> Callable[[], Gram]:
    """What draws a resample: poses weighted again, on thousands of scalars in the data alone; noise where poses are few."""
    poses = int(search.problem.settings.group.max()) + 1
    if poses < FEWEST_FLIPS:
        return lambda: _noisy(search, rng)
    if search.problem.rows > MANY:
        scores = _scores(search, poses)
        return lambda: _reweight_data_only(search, *scores, _weights(poses, rng) - 1.0)
    group = search.problem.settings.group[search.problem.row_visit]
    return lambda: reweight_problem(search.problem, _weights(poses, rng)[group])


def _weights(poses: int, rng: np.random.Generator) -> Floats:
    """Weights of the poses with mean 1, as of a bootstrap that draws none of them twice and leaves none out."""
    drawn = rng.exponential(size=poses)
    return np.asarray(drawn / drawn.mean())


def reweight_problem(problem: LinearizedProblem, weight: Floats) -> Gram:
    """The linearised problem with rows weighted (R,): geometry, candidates and data projected again."""
    X = np.sqrt(weight)[:, None] * np.column_stack([problem.U, problem.W, problem.y])
    p, H = problem.U.shape[1], X.T @ X
    K = np.linalg.solve(H[:p, :p] + SMALLEST * np.eye(p), H[:p, p:])
    left = H[p:, p:] - H[p:, :p] @ K
    return Gram(0.5 * (left + left.T)[:-1, :-1], left[:-1, -1], max(float(left[-1, -1]), 0.0), problem.nu)


def _scores(search: SearchResult, poses: int) -> tuple[Floats, Floats]:
    """What each pose adds to the candidates' data (G, Q) and to chi-square (G,), by its residual."""
    problem = search.problem
    r = residual_given(problem, search.columns)
    group = problem.settings.group[problem.row_visit]
    return problem.projection.under(grouping(group, poses, r)), np.bincount(group, r**2, poses).astype(np.float64)


def _reweight_data_only(search: SearchResult, scores: Floats, sizes: Floats, weight: Floats) -> Gram:
    """The data of poses weighted by one more than ``weight``; among so many the candidates stay as they are."""
    gram = search.problem.gram
    step = weight @ scores
    beta = gram.solve(search.columns)
    yy = gram.yy + float(weight @ sizes) + 2.0 * float(step[search.columns] @ beta)
    return gram.with_data(gram.c + step, max(yy, 0.0))


def _noisy(search: SearchResult, rng: np.random.Generator) -> Gram:
    """The fitted effects and Gaussian noise."""
    problem, columns = search.problem, search.columns
    beta = problem.gram.solve(columns)
    w, V = np.linalg.eigh(problem.A)
    noise = V @ (rng.standard_normal(len(w)) * np.sqrt(np.maximum(w, 0.0)))
    power = float(beta @ problem.A[np.ix_(columns, columns)] @ beta)
    chi2 = float(rng.chisquare(max(problem.nu, 1.0)))
    yy = power + 2.0 * float(noise[columns] @ beta) + chi2
    return problem.gram.with_data(problem.A[:, columns] @ beta + noise, max(yy, 0.0))
