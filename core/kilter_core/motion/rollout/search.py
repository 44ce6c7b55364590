"""Which effects a joint shows between its commands and its readings: chosen on some episodes, judged on others.

An effect enters by what it gains on stretches left out, and is named by what it gains on whole episodes that no choice saw. A
second is one observation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.motion.kernels import joint as place
from kilter_core.motion.rollout.effects import BY_ID, ROLLOUT_EFFECTS, RolloutEffect
from kilter_core.motion.rollout.fit import BASE, EVALUATIONS, JointFit, Term, fit_base, fit_joint, fit_with, simulate
from kilter_core.motion.rollout.record import JointRecord
from kilter_core.types import QUANTILE, Bools, Floats

FOLDS = 4
MOST_TERMS = 3
TRIED = 4  # of the effects that leave least, tried on stretches left out
GAIN = 3.0  # standard errors of a gain, to enter and to be sure
RIVAL = 2.0  # standard errors within which another effect does as well
LEAST_SHARE = 0.03  # of the squares left, that an effect must explain
REFITS = 12  # evaluations of a fit that starts where another ended
PUSH, MOST_PUSHED = 30.0, 0.1  # times the usual square of a second; of all seconds
HELD_SHARE = 1.0 / 3.0
FEWEST_BLOCKS = 12
ONE_SCALE = 0.98  # correlation of armature and damping with the gain, from which they have one scale
LEAST_FREEDOM = 1e-6  # that a second keeps which alone says a number
SAME = 3.0  # standard errors within which the values of two logs agree
SAME_SHARE = 0.25  # of the value, within which they agree however sure they are


@dataclass(frozen=True)
class Split:
    """Rows (R,) that choose and rows that judge; ``whole`` where the latter are whole episodes."""

    train: Bools
    held: Bools
    whole: bool


@dataclass(frozen=True)
class JudgedEffect:
    """An effect that was found: its ``value`` in the unit of its number and its ``sigma``; the gain on rows that no choice saw
    in standard errors, its rivals, whether each log shows it, and the verdict. ``without`` is the fit that lacks it.
    """

    term: Term
    value: float
    sigma: float
    unseen: float
    rivals: tuple[RolloutEffect, ...]
    each_log: bool
    verdict: str
    without: JointFit


@dataclass(frozen=True)
class JointFindings:
    """What a joint shows: fits of the servo alone and with what was found, the judged effects, and seconds set aside.

    ``excluded`` are effects that were not found, with the most (95 %) that the log leaves room for.
    """

    record: JointRecord
    split: Split
    base: JointFit
    fit: JointFit
    judged: tuple[JudgedEffect, ...]
    excluded: tuple[tuple[RolloutEffect, float], ...]
    pushed_s: tuple[tuple[int, float], ...]

    @property
    def believed(self) -> JointFit:
        """The fit with what was found, or of the servo alone."""
        return self.fit if self.judged else self.base

    @cached_property
    def stated_left(self) -> Floats:
        """What the model as it is stated leaves of the readings (R,), rad."""
        return self.record.reading - simulate(self.record, self.record.stated)

    def rms(self, fit: JointFit, rows: Bools | None = None) -> float:
        """Root mean square (rad) of what a fit leaves on ``rows``, by default those that no choice saw."""
        rows = (self.split.held if rows is None else rows) & self.record.used
        return float(np.sqrt(np.mean(fit.left[rows] ** 2)))


def split_episodes(record: JointRecord, seed: int, apart: Bools | None = None) -> Split:
    """Hold out the episodes (E,) ``apart``; where there are none, a third of them, of a single one its last third.

    Raises:
        ObservationError: nothing is left to choose by.

    """
    count = len(record.episodes)
    if apart is not None and apart.any():
        if apart.all():
            raise ObservationError("All logs are held out: leave one to choose by.", code="nothing_to_choose_by")
        held = apart[record.episode]
        return Split(~held, held, True)
    if count > 1:
        held_ones = np.random.default_rng(seed).permutation(count)[: max(1, round(HELD_SHARE * count))]
        held = np.isin(record.episode, held_ones)
    else:
        held = np.arange(len(record.reading)) >= int((1.0 - HELD_SHARE) * len(record.reading))
    return Split(~held, held, count > 1)


def search_joint(record: JointRecord, split: Split, logs: Sequence[int]) -> JointFindings:
    """Find what a joint lacks; ``logs (E,)`` is the file that each episode comes from.

    What unseen rows contradict is still among it: they take no part in any choice until all are made.
    """
    base, fit, rivals, tried = _choose(record, split)
    pushed = _find_pushed_blocks(record, fit, split)
    if pushed.any():
        split = Split(split.train & ~pushed[record.block], split.held & ~pushed[record.block], split.whole)
        base, fit, rivals, tried = _choose(record, split)
    judged = [_judge(record, split, fit, term, rivals.get(term.effect.id, ()), logs) for term in fit.terms]
    found = {one.term.effect.id for one in judged}
    excluded = tuple(
        (one.terms[-1].effect, _upper_limit(record, one, split.train))
        for one in tried
        if one.terms[-1].effect.id not in found
    )
    rows = np.searchsorted(record.block, np.flatnonzero(pushed))
    times = np.concatenate([one.t for one in record.episodes])
    aside = tuple((int(record.episode[row]), float(times[row])) for row in rows)
    return JointFindings(record, split, base, fit, tuple(judged), excluded, aside)


def refit_joint(found: JointFindings, record: JointRecord) -> JointFindings:
    """Fit a joint anew, with what it lacks and without, in the arm as ``record`` has it corrected."""
    rows = found.split.train
    base = refit(record, found.base, (), rows, EVALUATIONS)
    fit = refit(record, found.fit, found.fit.terms, rows, EVALUATIONS) if found.fit.terms else base
    return replace(found, record=record, base=base, fit=fit)


def judge_anew(found: JointFindings, logs: Sequence[int]) -> JointFindings:
    """Judge what a joint lacks by its fit as it is now."""
    own = [
        _judge(found.record, found.split, found.fit, one.term, one.rivals, logs)
        for one in found.judged
        if _is_worth_a_name(found.fit, one.term)
    ]
    return drop_contradicted(found, own)


def judge_unseen(found: JointFindings, one: JudgedEffect, without: Floats, with_it: Floats) -> JudgedEffect:
    """Judge an effect by readings (R,) that were simulated without it and with it, on rows that no choice saw."""
    record, split = found.record, found.split
    unseen = gain_on(record, split.held, record.reading - without, record.reading - with_it)
    return replace(one, unseen=unseen, verdict=_verdict(split, unseen, one.term, one.rivals, one.each_log))


def drop_contradicted(found: JointFindings, judged: Sequence[JudgedEffect]) -> JointFindings:
    """Take out effects that unseen rows contradict, and fit the joint without them."""
    kept = [one for one in judged if one.verdict != "contradicted"]
    if len(kept) == len(found.fit.terms):
        return replace(found, judged=tuple(kept))
    fit = refit(found.record, found.fit, [one.term for one in kept], found.split.train, EVALUATIONS)
    return replace(found, fit=fit, judged=tuple(kept))


def gain_on(record: JointRecord, held: Bools, before: Floats, after: Floats) -> float:
    """What seconds gain, in standard errors, from residuals (R,) before and after."""
    rows = held & record.used
    blocks, count = np.unique(record.block[rows]), int(record.block.max()) + 1
    squares = [
        np.bincount(record.block[rows], one[rows] ** 2, count)[blocks].astype(np.float64) for one in (before, after)
    ]
    return _standard_errors(*squares)


def _choose(
    record: JointRecord, split: Split
) -> tuple[JointFit, JointFit, dict[str, tuple[RolloutEffect, ...]], list[JointFit]]:
    """Return the fit of the servo alone, that with the effects that enter, the rivals of each, and the last that were tried."""
    base = fit = fit_base(record, split.train)
    rivals: dict[str, tuple[RolloutEffect, ...]] = {}
    tried: list[JointFit] = []
    without = _fold_losses(record, fit, split.train)
    for _ in range(MOST_TERMS):
        tried = _fit_candidates(record, fit, split.train)
        losses = {one.terms[-1].effect.id: _fold_losses(record, one, split.train) for one in tried[:TRIED]}
        best = min(losses, key=lambda name: float(losses[name].sum()), default=None)
        if best is None or not _gains(without, losses[best]):
            break
        chosen = next(one for one in tried if one.terms[-1].effect.id == best)
        if not _is_worth_a_name(chosen, chosen.terms[-1]):
            break
        rivals[best] = tuple(
            BY_ID[name]
            for name, own in losses.items()
            if name != best and _standard_errors(own, losses[best]) < RIVAL and _gains(without, own)
        )
        fit, without = _drop_idle_terms(record, chosen, losses[best], split.train)
        fit, without = _choose_friction_anew(record, fit, without, split.train)
    return base, fit, rivals, tried


def _fit_candidates(record: JointRecord, fit: JointFit, train: Bools) -> list[JointFit]:
    """Fits with one effect more, each in its best variant, that which leaves least first."""
    sigma = _rms(record, fit, train)
    have = {term.effect.id for term in fit.terms}
    best: dict[str, JointFit] = {}
    for effect in ROLLOUT_EFFECTS:
        if effect.id in have:
            continue
        fits = [fit_with(record, fit, Term(effect, v), train, sigma) for v in range(len(effect.variants))]
        best[effect.id] = min(fits, key=lambda one: one.cost)
    return sorted(best.values(), key=lambda one: one.cost)


def _drop_idle_terms(record: JointRecord, fit: JointFit, losses: Floats, train: Bools) -> tuple[JointFit, Floats]:
    """Take out earlier terms that the last one has made needless; return the fit and what it leaves of each second."""
    for term in fit.terms[:-1]:
        fewer = refit(record, fit, [one for one in fit.terms if one is not term], train)
        without = _fold_losses(record, fewer, train)
        if not _gains(without, losses) or not _is_worth_a_name(fit, term):
            fit, losses = fewer, without
    return fit, losses


def _choose_friction_anew(record: JointRecord, fit: JointFit, losses: Floats, train: Bools) -> tuple[JointFit, Floats]:
    """Let friction creep where it held, or hold, if that is nearer now: without an effect, which was nearer says little."""
    begin = fit.p.copy()
    begin[place.RATE] = 0.0 if fit.creeps else record.stated[place.RATE]
    other = refit(record, replace(fit, p=begin), fit.terms, train)
    if other.cost >= fit.cost:
        return fit, losses
    return other, _fold_losses(record, other, train)


def refit(
    record: JointRecord, fit: JointFit, terms: Sequence[Term], rows: Bools, evaluations: int = 2 * REFITS
) -> JointFit:
    """Fit a joint with some of its ``terms``, from what it had."""
    begin = fit.p.copy()
    for term in fit.terms:
        if term not in terms:
            begin[term.effect.number.place] = record.stated[term.effect.number.place]
    return fit_joint(record, terms, rows, _rms(record, fit, rows), begin, evaluations)


def _fold_losses(record: JointRecord, fit: JointFit, train: Bools) -> Floats:
    """Squares (B,) that each second of ``train`` leaves, from fits to the other stretches."""
    blocks = np.unique(record.block[train & record.used])
    fold = np.full(int(record.block.max()) + 1, -1)
    fold[blocks] = np.arange(len(blocks)) * FOLDS // len(blocks)
    losses = np.zeros(int(record.block.max()) + 1)
    for k in range(FOLDS):
        inside = fold[record.block] == k
        own = refit(record, fit, fit.terms, train & ~inside, REFITS)
        rows = inside & train & record.used
        np.add.at(losses, record.block[rows], own.left[rows] ** 2)
    return losses[blocks]


def _gains(before: Floats, after: Floats) -> bool:
    enough = float((before - after).sum()) > LEAST_SHARE * float(before.sum())
    return enough and _standard_errors(before, after) > GAIN


def _standard_errors(before: Floats, after: Floats) -> float:
    """Gain of the squares of seconds (B,) in standard errors, of them or of their logarithms, which no single second rules."""
    floor = 0.1 * float(np.median(after)) + 1e-18
    gains = (before - after, np.log((before + floor) / (after + floor)))
    errors = [float(gain.sum()) / max(float(np.std(gain)) * np.sqrt(len(gain)), 1e-300) for gain in gains]
    return float(max(errors) if gains[0].sum() > 0.0 else min(errors))


def _is_worth_a_name(fit: JointFit, term: Term) -> bool:
    return bool(abs(fit.p[term.effect.number.place]) > term.effect.least)


def _rms(record: JointRecord, fit: JointFit, rows: Bools) -> float:
    return max(float(np.sqrt(np.mean(fit.left[rows & record.used] ** 2))), 1e-9)


def _find_pushed_blocks(record: JointRecord, fit: JointFit, split: Split) -> Bools:
    """Seconds (B,) in which something leant on the arm: far beyond what is left of all others."""
    count = int(record.block.max()) + 1
    rows = record.used
    squares = np.bincount(record.block[rows], fit.left[rows] ** 2, count)
    number = np.bincount(record.block[rows], minlength=count)
    mean = squares / np.maximum(number, 1)
    pushed = mean > PUSH * float(np.median(mean[number > 0]))
    return pushed if pushed.mean() <= MOST_PUSHED else np.zeros(count, dtype=bool)


def covariance(record: JointRecord, fit: JointFit, rows: Bools) -> Floats:
    """Covariance (k, k) of what was fitted, each second one observation, its residuals as a fit without it leaves them.

    Few seconds say how wide backlash is: a fit follows those, so what it leaves there is too small (CR3: Bell and McCaffrey
    2002).
    """
    rows = rows & record.used
    count = int(rows.sum())
    J, block = fit.jacobian, record.block[rows]
    left = fit.left[rows] / np.sqrt(count) / fit.sigma
    inverse = np.linalg.pinv(J.T @ J)
    spread = np.zeros_like(inverse)
    for one in np.unique(block):
        own = J[:count][block == one]
        leverage = own.T @ own @ inverse
        score = np.linalg.solve((1.0 + LEAST_FREEDOM) * np.eye(len(inverse)) - leverage, own.T @ left[block == one])
        spread += np.outer(score, score)
    return np.asarray(inverse @ spread @ inverse)


def servo_has_own_scale(found: JointFindings) -> bool:
    """Whether more than the inertia of the bodies says how large the numbers of the servo are: else only their ratios show."""
    spread = covariance(found.record, found.believed, found.split.train)
    sigmas = np.sqrt(np.diag(spread))
    with_gain = (spread / np.outer(sigmas, sigmas))[len(BASE) - 1, : len(BASE) - 1]
    return bool(np.min(np.delete(with_gain, 1)) < ONE_SCALE)  # friction may be small


def servo_sigmas(record: JointRecord, fit: JointFit, rows: Bools) -> dict[str, float]:
    """Standard errors of the numbers of the servo, by name."""
    spread = np.sqrt(np.maximum(np.diag(covariance(record, fit, rows)), 0.0)) * fit.scales
    return {number.name: float(s) for number, s in zip(BASE, spread, strict=False)}


def _sigma_of(record: JointRecord, fit: JointFit, term: Term, rows: Bools) -> float:
    at = [number.place for number in fit.fitted].index(term.effect.number.place)
    return float(np.sqrt(max(covariance(record, fit, rows)[at, at], 0.0)) * fit.scales[at])


def _upper_limit(record: JointRecord, fit: JointFit, rows: Bools) -> float:
    term = fit.terms[-1]
    value = float(fit.p[term.effect.number.place])
    return abs(value) + QUANTILE * _sigma_of(record, fit, term, rows)


def _judge(
    record: JointRecord,
    split: Split,
    fit: JointFit,
    term: Term,
    rivals: tuple[RolloutEffect, ...],
    logs: Sequence[int],
) -> JudgedEffect:
    every = split.train | split.held
    whole = refit(record, fit, fit.terms, every)
    fewer = refit(record, fit, [one for one in fit.terms if one is not term], split.train, 40)
    unseen = gain_on(record, split.held, fewer.left, fit.left)
    value = float(whole.p[term.effect.number.place])
    sigma = _sigma_of(record, whole, term, every)
    each = _shows_in_each_log(record, whole, term, every, logs)
    return JudgedEffect(term, value, sigma, unseen, rivals, each, _verdict(split, unseen, term, rivals, each), fewer)


def _verdict(split: Split, unseen: float, term: Term, rivals: tuple[RolloutEffect, ...], each: bool) -> str:
    if unseen < 0.0:
        return "contradicted"
    if unseen < GAIN or not split.whole:
        return "provisional"
    if any(rival.physical.id != term.effect.physical.id for rival in rivals):
        return "provisional"
    if rivals:
        return "class_confirmed"
    return "replicated" if each else "confirmed"


def _shows_in_each_log(record: JointRecord, whole: JointFit, term: Term, every: Bools, logs: Sequence[int]) -> bool:
    """Whether each of several logs, fitted by itself, has the effect with the same value."""
    kinds = np.asarray(logs)[record.episode]
    names = np.unique(kinds)
    if len(names) < 2:
        return False
    found = []
    for name in names:
        rows = every & (kinds == name)
        if len(np.unique(record.block[rows])) < FEWEST_BLOCKS:
            return False
        own = refit(record, whole, whole.terms, rows)
        found.append((float(own.p[term.effect.number.place]), _sigma_of(record, own, term, rows)))
    return all(
        abs(value) > GAIN * sigma
        and abs(value - found[0][0]) < max(SAME * float(np.hypot(sigma, found[0][1])), SAME_SHARE * abs(found[0][0]))
        for value, sigma in found
    )
