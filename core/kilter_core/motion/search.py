"""Which effects a log shows: chosen by motions left out one after the other, judged by motions that no choice saw.

In-sample gain takes curves first and makes unseen motions worse; so a term enters by what it gains on motions left out, and is
named by what it gains on motions held out before anything was chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from kilter_core.motion.fit import Fit, Partial, Seen, covariance, fit_terms, partial_terms, score_terms
from kilter_core.motion.layout import Term
from kilter_core.motion.normal import Equations
from kilter_core.types import Bools, Floats, Ints

ALPHA = 0.01  # chance that any term enters where nothing is missing
MOST_TERMS = 20
TRIED = 8  # of the best by the score, tried on motions left out
DEVIATIONS = 2.0  # standard errors by which a gain, or one over a rival, must be above zero
LEAST_SHARE = 0.01  # of the squares left at its joint: a term that explains less is not worth a name
HELD_SHARE = 1.0 / 3.0
TIME_FOLDS = 5
ALIKE = 0.0027  # chance that two values of one effect count as different
SURE = 3.0  # standard errors by which a term is above zero on blocks that no choice saw
LEAST_UNSEEN = 0.5  # of its size there: below, it makes unseen motions worse or hardly better


@dataclass(frozen=True)
class Split:
    """Blocks (B,) that choose, blocks that judge, folds of the former, and whether the latter are whole motions."""

    train: Bools
    held: Bools
    folds: Ints
    whole: bool

    @property
    def every(self) -> Bools:
        """Blocks that take part at all."""
        return np.asarray(self.train | self.held)

    def without(self, blocks: Bools) -> Split:
        """Return the same without some blocks."""
        return replace(
            self, train=self.train & ~blocks, held=self.held & ~blocks, folds=np.where(blocks, -1, self.folds)
        )


@dataclass(frozen=True)
class Tests:
    """How many tests share a chance: ``orders`` of ripples, of which there are many, one half of it, and all ``others``."""

    orders: int
    others: int

    def count_for(self, term: Term) -> int:
        """Return by how much the chance of a term is multiplied."""
        return 2 * (self.orders if "order" in term.effect.needs else self.others)


@dataclass(frozen=True)
class Rival:
    """A term that does as well in place of one that was chosen: by how many standard errors it is behind."""

    term: Term
    behind: float


@dataclass(frozen=True)
class Judged:
    """A term that was found: ``value`` and ``sigma (k,)`` of all rows, how large it is on blocks that no choice saw,
    as a share of what was fitted, whether both halves agree, and its rivals.
    """

    term: Term
    value: Floats
    sigma: Floats
    unseen: float
    unseen_sigma: float
    halves_agree: bool
    sessions: tuple[bool, ...]
    rivals: tuple[Rival, ...]
    verdict: str

    def is_shown(self, tests: Tests) -> bool:
        """Whether any of its values is above zero by more than the largest of so many is by chance, and blocks that no choice
        saw say so too.
        """
        least = -float(ndtri(0.5 * ALPHA / tests.count_for(self.term)))
        return bool(np.any(np.abs(self.value) > least * self.sigma) and self.unseen > DEVIATIONS * self.unseen_sigma)


def split_motions(equations: Equations, seed: int, apart: Sequence[int] = ()) -> Split:
    """Hold out the sessions ``apart``; else a third of the motions, so that each session keeps one that is not held out;
    where none can be spared, the last third of each session.
    """
    held = np.isin(equations.session, apart)
    motions = np.random.default_rng(seed).permutation(np.unique(equations.motion))
    for motion in [] if len(apart) else motions.tolist():
        with_it = held | (equations.motion == motion)
        kept = all(np.any(~with_it[equations.session == s]) for s in np.unique(equations.session))
        if kept and len(np.unique(equations.motion[with_it])) <= max(1, round(HELD_SHARE * len(motions))):
            held = with_it
    whole = bool(held.any())
    if not whole:
        for session in np.unique(equations.session):
            own = np.flatnonzero(equations.session == session)
            held[own[int((1.0 - HELD_SHARE) * len(own)) :]] = True
    train = ~held
    kept_motions = np.unique(equations.motion[train])
    folds = np.full(len(held), -1)
    if len(kept_motions) >= TIME_FOLDS:
        folds[train] = np.searchsorted(kept_motions, equations.motion[train]) % TIME_FOLDS
    else:  # too few whole motions to leave one out: stretches of them
        places = np.flatnonzero(train)
        folds[places] = np.arange(len(places)) * TIME_FOLDS // len(places)
    return Split(train, held, folds, whole)


def gain_in_folds(partial: Partial, split: Split) -> tuple[Floats, tuple[float, float]]:
    """Return what a term gains (T,) in each block that chooses, by its values in the other folds; and its size there, as a
    share of those values, with its standard error.

    The model beside it is fitted to all of them: what the bodies are is not asked of four fifths of a short log.
    """
    along, torque = np.zeros(len(split.train)), np.zeros(len(split.train))
    for fold in range(TIME_FOLDS):
        inside = split.folds == fold
        along[inside], torque[inside] = partial.size(partial.value(split.train & ~inside), inside)
    return (2.0 * along - torque)[split.train], _size(along[split.train], torque[split.train])


def _size(along: Floats, torque: Floats) -> tuple[float, float]:
    """Size of a torque in blocks (B,), by its products with what is left and with itself; and its standard error."""
    whole = max(float(torque.sum()), 1e-12)
    size = float(along.sum()) / whole
    return size, float(np.sqrt(np.sum((along - size * torque) ** 2))) / whole


def _is_borne_out(size: float, sigma: float) -> bool:
    """Whether a size on blocks that did not choose it makes them better, and not by chance."""
    return size > max(LEAST_UNSEEN, DEVIATIONS * sigma)


def deviations(gain: Floats) -> float:
    """Mean of gains over its standard error."""
    if len(gain) < 2:
        return 0.0
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return float(gain.mean()) / spread if spread > 0.0 else 0.0


def search_terms(
    equations: Equations, split: Split, weights: Floats, tests: Tests, progress: Callable[[float], None]
) -> list[Term]:
    """Return the terms that enter the model, common ones first."""
    model = [term for term in equations.terms if term.effect.common]
    rest = [term for term in equations.terms if not term.effect.common and weights[term.joint] > 0.0]
    most = len(model) + MOST_TERMS
    while len(model) < most:
        progress(len(model) / most)
        fit = fit_terms(equations, model, split.train, weights)
        best = _best_entry(equations, fit, split, _list_significant_terms(equations, fit, split, rest, tests))
        if best is None:
            break
        model.append(best)
        rest.remove(best)
        model = _drop_idle_terms(equations, split, weights, model)
    return model


def _list_significant_terms(
    equations: Equations, fit: Fit, split: Split, rest: Sequence[Term], tests: Tests
) -> list[Seen]:
    seen = score_terms(equations, fit, split.train, rest)
    return [
        one
        for one in seen
        if one.p * tests.count_for(one.term) < ALPHA and one.share > LEAST_SHARE and is_plausible(one)
    ][:TRIED]


def is_plausible(seen: Seen) -> bool:
    """Whether physics allows the values of a term."""
    low, high = seen.term.effect.within
    return bool(np.all((seen.value > low) & (seen.value < high)))


def _best_entry(equations: Equations, fit: Fit, split: Split, seen: Sequence[Seen]) -> Term | None:
    """The term that gains most on blocks left out, of those that are borne out there."""
    best: tuple[float, Term | None] = (0.0, None)
    terms = [one.term for one in seen]
    for term, partial in zip(terms, partial_terms(equations, fit, split.train, terms), strict=True):
        gain, size = gain_in_folds(partial, split)
        if gain.sum() > best[0] and _is_borne_out(*size):
            best = float(gain.sum()), term
    return best[1]


def _drop_idle_terms(equations: Equations, split: Split, weights: Floats, model: list[Term]) -> list[Term]:
    """Leave out what the latest term has made superfluous."""
    for term in [term for term in model[:-1] if not term.effect.common]:
        without = [other for other in model if other is not term]
        fit = fit_terms(equations, without, split.train, weights)
        (partial,) = partial_terms(equations, fit, split.train, [term])
        if not _is_borne_out(*gain_in_folds(partial, split)[1]):
            model = without
    return model


def judge_terms(equations: Equations, split: Split, weights: Floats, model: Sequence[Term]) -> list[Judged]:
    """Judge each term that was found by blocks that no choice saw, by halves, by sessions, and against its rivals."""
    whole = fit_terms(equations, model, split.every, weights)
    spread = covariance(equations, whole, split.every)
    found = [term for term in model if not term.effect.common]
    return [_judge(equations, split, weights, model, term, whole, spread) for term in found]


def _judge(
    equations: Equations,
    split: Split,
    weights: Floats,
    model: Sequence[Term],
    term: Term,
    whole: Fit,
    spread: Floats,
) -> Judged:
    without = [other for other in model if other is not term]
    at = _find_places(whole, term)
    value, sigma = whole.theta[term.columns], np.sqrt(np.maximum(np.diag(spread)[at], 0.0))
    judged = Judged(
        term,
        value,
        sigma,
        *_unseen_size(equations, split, fit_terms(equations, without, split.every, weights), term),
        _halves_agree(equations, split, weights, model, term),
        _sessions_that_show(equations, split, weights, model, term, value, sigma),
        _find_rivals(equations, split, weights, model, term),
        "",
    )
    return replace(judged, verdict=_verdict(judged, split))


def _unseen_size(equations: Equations, split: Split, without: Fit, term: Term) -> tuple[float, float]:
    """How large a term is on blocks that no choice saw, as a share of what the others show, and its standard error.

    The model beside it is fitted to all blocks, as base and tool are to another campaign: asked is what the term does there.
    """
    (partial,) = partial_terms(equations, without, split.every, [term])
    return _size(*partial.size(partial.value(split.train), split.held))


def _find_places(fit: Fit, term: Term) -> Ints:
    return np.array([int(np.flatnonzero(fit.columns == c)[0]) for c in term.columns])


def _halves_agree(equations: Equations, split: Split, weights: Floats, model: Sequence[Term], term: Term) -> bool:
    """Whether both halves of the log, of each session by motions where it has several, show it alike."""
    first = np.zeros(len(equations.motion), dtype=bool)
    for session in np.unique(equations.session):
        own = np.flatnonzero(equations.session == session)
        motions, place = np.unique(equations.motion[own], return_inverse=True)
        order = place if len(motions) > 1 else np.arange(len(own))
        first[own[order < 0.5 * (order.max() + 1)]] = True
    (a, va), (b, vb) = (
        _value_in(equations, weights, model, term, part) for part in (first & split.every, ~first & split.every)
    )
    return _are_alike(a - b, va + vb)


def _are_alike(apart: Floats, variance: Floats) -> bool:
    """Whether none of some differences (k,) is larger than chance makes the largest of so many."""
    return bool(np.all(np.abs(apart) < -ndtri(0.5 * ALIKE / len(apart)) * np.sqrt(variance)))


def _value_in(
    equations: Equations, weights: Floats, model: Sequence[Term], term: Term, blocks: Bools
) -> tuple[Floats, Floats]:
    fit = fit_terms(equations, model, blocks, weights)
    spread = np.maximum(np.diag(covariance(equations, fit, blocks)), 0.0)
    return fit.theta[term.columns], spread[_find_places(fit, term)]


def _sessions_that_show(
    equations: Equations, split: Split, weights: Floats, model: Sequence[Term], term: Term, value: Floats, sigma: Floats
) -> tuple[bool, ...]:
    """Of each session, where there are several, whether it shows the same by itself."""
    sessions = np.unique(equations.session)
    if len(sessions) < 2 or term.session is not None:
        return ()
    shown = []
    for session in sessions:
        own, variance = _value_in(equations, weights, model, term, split.every & (equations.session == session))
        seen = bool(np.any(np.abs(own) > SURE * np.sqrt(variance)))
        shown.append(seen and _are_alike(own - value, variance + sigma**2))
    return tuple(shown)


def _find_rivals(
    equations: Equations, split: Split, weights: Floats, model: Sequence[Term], term: Term
) -> tuple[Rival, ...]:
    """Terms that do as well in its place, on blocks left out of the fit."""
    without = [other for other in model if other is not term]
    fit = fit_terms(equations, without, split.train, weights)
    others = [t for t in equations.terms if t not in model and weights[t.joint] > 0.0]
    seen = score_terms(equations, fit, split.train, [term, *others])
    own = next((one.gain for one in seen if one.term is term), 0.0)
    near = [one for one in seen if one.term is not term and one.gain > 0.5 * own and is_plausible(one)]
    own_gain, *gains = (
        gain_in_folds(partial, split)[0]
        for partial in partial_terms(equations, fit, split.train, [term, *(one.term for one in near)])
    )
    behind = [deviations(own_gain - gain) for gain in gains]
    rivals = [Rival(one.term, late) for one, late in zip(near, behind, strict=True) if late <= DEVIATIONS]
    return tuple(sorted(rivals, key=lambda rival: rival.behind))


def _verdict(judged: Judged, split: Split) -> str:
    """How sure a name is: replicated, confirmed, class_confirmed, provisional or contradicted."""
    if judged.unseen + DEVIATIONS * judged.unseen_sigma < 1.0 and judged.unseen < LEAST_UNSEEN:
        return "contradicted"
    seen = judged.unseen > max(LEAST_UNSEEN, SURE * judged.unseen_sigma)
    replicated = bool(judged.sessions) and all(judged.sessions)
    if not (seen and judged.halves_agree and (split.whole or replicated)):
        return "provisional"
    others = [rival.term for rival in judged.rivals]
    same = all(t.joint == judged.term.joint and t.effect.physical.id == judged.term.effect.physical.id for t in others)
    if others:
        return "class_confirmed" if same else "provisional"
    return "replicated" if replicated else "confirmed"
