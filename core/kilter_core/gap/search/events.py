"""When something happened once, and what is noise after every new name.

An effect that jumps is linear in how far, not in when. For each of them all its columns, one per place between two visits,
are scored at once by sums along the order of measurement: given geometry and what is chosen, what it takes off chi-square
there. The candidate is the best place; that it is the best of so many counts against it (:attr:`Candidate.places`).

Without repeats the noise is the scatter of the fit. Frozen at the first fit it holds the gap itself: wrong readings do not
show above it, and the next effect hides under the first (an arm of 0.02 mm was said to have 0.08). With repeats a name
that follows the clock or the temperature takes its share out of what they differ by, and what is left of them is the noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg

from kilter_core.effects import Effect
from kilter_core.gap.noise.from_repeats import FIT, Noise, add_approach_noise, noise_again, re_estimate_fit_noise
from kilter_core.gap.noise.visits import isolate_unused_visits
from kilter_core.gap.options import PREPARING, Budget, OutOfTimeError
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.linear.gram import VISIBLE
from kilter_core.gap.search.linear.linearized import (
    LinearizedProblem,
    Tick,
    ignore_step,
    linearise_problem,
    refit,
    with_columns_of,
)
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.outliers import LARGE, outliers, stands_out
from kilter_core.gap.search.sources.source import Source
from kilter_core.observations import Observations
from kilter_core.observations.clock import read_clock
from kilter_core.observations.groups import subtract_group_means
from kilter_core.types import Bools, Floats, Ints, Progress

VISITS_PER_SIDE = 4  # visits on either side: fewer are readings that went wrong, and set aside as such
EQUAL = 1e-6  # of chi-square: rounding
SURE = 0.95  # of the interval of rows in which it happened


@dataclass(frozen=True)
class Course:
    """Rows in the order in which they were measured, and what separates them: their time, or their number.

    ``order (N,)``; ``key (N,)`` in that order, s where ``timed``.
    """

    order: Ints
    key: Floats
    timed: bool

    @staticmethod
    def from_observations(rows: Observations) -> Course | None:
        """By a clock that never falls back, else by the numbers of the rows; None where neither is known."""
        clock = read_clock(rows)
        if rows.t is not None and clock.trusted and np.all(np.diff(rows.t[clock.order]) >= 0.0):
            return Course(clock.order, np.asarray(rows.t[clock.order], dtype=np.float64), True)
        if rows.row is None:
            return None
        order = np.argsort(rows.row, kind="stable").astype(np.int64)
        return Course(order, np.asarray(rows.row[order], dtype=np.float64), False)

    def mark(self, place: int) -> dict[str, Any]:
        """Options of an effect that happened before ``order[place]`` and after the one before it."""
        if self.timed:
            return {"at_s": 0.5 * float(self.key[place - 1] + self.key[place]), "at_row": None}
        return {"at_s": None, "at_row": int(self.key[place])}

    def place(self, effect: Effect) -> int:
        """First place in the order that is after an effect."""
        at_s, at_row = getattr(effect, "at_s", None), getattr(effect, "at_row", None)
        mark = at_s if self.timed else at_row
        return 0 if mark is None else int(np.searchsorted(self.key, mark))

    @property
    def able(self) -> Bools:
        """Places (N,) at which something can have happened."""
        out = np.zeros(len(self.key), dtype=bool)
        out[VISITS_PER_SIDE : len(out) - VISITS_PER_SIDE + 1] = True
        out[1:] &= np.diff(self.key) > 0.0
        return out


@dataclass(frozen=True)
class Profile:
    """What one candidate takes off chi-square at each place (N,), -inf where it cannot have happened, and its degrees (N,)."""

    course: Course
    taken: Floats
    degrees: Ints

    def value(self, rows: int) -> Floats:
        """What it takes, less the price of its parameters (N,)."""
        return np.asarray(self.taken - self.degrees * np.log(rows))


def with_row_numbers(rows: Observations) -> Observations:
    """Rows with their numbers in the order of measurement, from 1, where they state none."""
    if rows.row is not None:
        return rows
    number = np.empty(len(rows), dtype=np.int64)
    number[read_clock(rows).order] = np.arange(1, len(rows) + 1)
    return replace(rows, row=number)


def profiles(
    problem: LinearizedProblem, candidates: Sequence[Candidate], chosen: Sequence[int], wanted: Sequence[int]
) -> dict[int, Profile]:
    """Profiles of the ``wanted`` events (places among the candidates), each given geometry and the other ``chosen``."""
    source = problem.settings.source
    course = Course.from_observations(source.observations)
    if course is None or not wanted or not course.able.any():
        return {}
    columns = [k for c in wanted for k in candidates[c].columns]
    B = _always(problem.settings, problem.values, course, columns)
    out, start = {}, 0
    for c in wanted:
        others = sorted({k for m in chosen if m != c for k in candidates[m].columns})
        width = len(candidates[c].columns)
        out[c] = _profile(problem, course, B[:, start : start + width], others)
        start += width
    return out


def _always(settings: ProblemSettings, values: Floats, course: Course, columns: Sequence[int]) -> Floats:
    """Whitened columns (R, K) of effects that happen after all rows."""
    never: dict[str, Any] = {"at_s": float(course.key[-1]) + 1.0, "at_row": None}
    if not course.timed:
        never = {"at_s": None, "at_row": int(course.key[-1]) + 1}
    source = replace_events(
        settings.source, {event_key(e): replace(e, **never) for e in event_effects(settings.source)}
    )
    return settings.whitening.columns(source.without_geometry().linear(values, None, columns).W)


def _profile(problem: LinearizedProblem, course: Course, B: Floats, others: Sequence[int]) -> Profile:
    """Sums over all rows before each place: columns with themselves, with what is taken out, and with the data."""
    size = problem.settings.whitener.shape[-1]
    basis, soft = problem.basis(others), problem.soft
    r = soft(problem.y - basis @ (basis.T @ problem.y))
    out = np.hstack([soft(basis), soft.Q * np.sqrt(1.0 - (1.0 + soft.shrink) ** 2)])
    blocks = B.reshape(-1, size, B.shape[1])[course.order]
    along = out.reshape(-1, size, out.shape[1])[course.order]
    H = _exclusive_cumulative_sum(np.matmul(blocks.transpose(0, 2, 1), blocks))
    Z = _exclusive_cumulative_sum(np.matmul(along.transpose(0, 2, 1), blocks))
    c = _exclusive_cumulative_sum(np.einsum("vik,vi->vk", blocks, r.reshape(-1, size)[course.order]))
    norm = np.sqrt(np.maximum(np.diagonal(H, axis1=1, axis2=2), 1e-300))
    A = (H - np.matmul(Z.transpose(0, 2, 1), Z)) / (norm[:, :, None] * norm[:, None, :])
    w, V = np.linalg.eigh(A)
    seen = w > VISIBLE
    z = np.einsum("vkj,vk->vj", V, c / norm) * seen / np.sqrt(np.where(seen, w, 1.0))
    return Profile(course, np.where(course.able, np.sum(z**2, axis=1), -np.inf), seen.sum(axis=1))


def _exclusive_cumulative_sum(each: Floats) -> Floats:
    """Sums over all before each place."""
    out = np.cumsum(each, axis=0)
    return np.asarray(np.subtract(out, each, out=out))


def event_effects(source: Source) -> tuple[Effect, ...]:
    """Effects of the library that happen once."""
    return tuple(e for e in source.model.effects if e.event)


def replace_events(source: Source, effects: dict[str, Effect]) -> Source:
    """The source with these effects, by their ids, in place of the same elsewhere in time."""
    if not effects:
        return source
    model = replace(source.model, effects=tuple(_with_event_time(e, effects) for e in source.model.effects))
    return replace(source, model=model)  # type: ignore[type-var]


def _with_event_time(effect: Effect, effects: dict[str, Effect]) -> Effect:
    """An effect at the time that ``effects`` say of its kind and joint."""
    found = effects.get(event_key(effect))
    if found is None or not effect.event:
        return effect
    return replace(effect, at_s=getattr(found, "at_s", None), at_row=getattr(found, "at_row", None))  # type: ignore[call-arg]


def event_key(effect: Effect) -> str:
    """Name of a kind of event at its joint."""
    return effect.id if effect.joints is None else f"{effect.id}@{','.join(map(str, effect.joints))}"


def place_events(
    problem: LinearizedProblem, candidates: Sequence[Candidate], chosen: Sequence[int] = ()
) -> tuple[LinearizedProblem, tuple[Candidate, ...]]:
    """The problem with every event where it takes most, given the chosen, and the candidates at these places."""
    wanted = [k for k, c in enumerate(candidates) if c.effects[0].event]
    found = profiles(problem, candidates, chosen, wanted)
    if not found:
        return problem, tuple(candidates)
    at: dict[str, Effect] = {}
    made = list(candidates)
    for k, profile in found.items():
        effect = candidates[k].effects[0]
        best = _best(profile, profile.course.place(effect), problem.rows)
        at[event_key(effect)] = replace(effect, **profile.course.mark(best))
        made[k] = replace(candidates[k], effects=(at[event_key(effect)],), places=int(profile.course.able.sum()))
    source = replace_events(problem.settings.source, at)
    if source.model.effects == problem.settings.source.model.effects:
        return problem, tuple(made)
    settings = replace(problem.settings, source=source)
    others = [column for k, c in enumerate(made) if c != candidates[k] for column in c.columns]
    if np.any(source.library(problem.values)[others]):
        problem.resting()
        return linearise_problem(settings, problem.values), tuple(made)
    return with_columns_of(problem, settings, others), tuple(made)


def _best(profile: Profile, now: int, rows: int) -> int:
    """Best place; of equal ones the end that is not ``now``.

    Places are equal where all visits between them were set aside, which those are that an event on their wrong side moved:
    on the other side they are judged anew.
    """
    value = profile.value(rows)
    equal = np.flatnonzero(value >= np.max(value) - EQUAL)
    return int(equal[-1] if now == equal[0] else equal[0])


def likely(profile: Profile, variance: float) -> tuple[int, int, int]:
    """Most likely place of an event, and the first and last of the fewest places that hold it with 95 %.

    Every place is as likely beforehand; its likelihood given the data follows from what the event takes there.
    """
    taken = np.where(profile.course.able, profile.taken / variance, -np.inf)
    chance = np.exp(0.5 * (taken - np.max(taken)))
    chance /= chance.sum()
    order = np.argsort(-chance, kind="stable")
    inside = order[: int(np.searchsorted(np.cumsum(chance[order]), SURE)) + 1]
    return int(order[0]), int(inside.min()), int(inside.max())


WRONG = "wrong readings beyond those set aside"
CHANGED = 0.02  # of the noise, from which a fit is made again
FREER = 0.1  # of its freedom, from which the same
MANY = 500  # visits above which names do not have them judged again, until the search ends or the noise changes
FITS = 3  # of the geometry without wrong readings
SEEN = 1e-12  # of the largest: smaller eigenvalues are directions that geometry imitates
ROUNDS = 3  # more of noise read from repeats and amounts fitted under it


def refit_with_updated_noise(
    problem: LinearizedProblem, columns: Sequence[int], tick: Tick = ignore_step, at_last: bool = True
) -> LinearizedProblem:
    """The problem re-fitted with noise and outliers as the fit with these columns shows them; itself if unchanged.

    Every visit is judged, also those set aside before: one may come back. A drift in a noise that came from repeats keeps
    the amount of the name that explains it near its prior: the noise that is left of them lets it go, in some rounds.
    Visits are judged by all of the library, named or not: among many they are ``at_last``, and under another noise.
    ``tick`` is called at every step, and may raise: then nothing was judged again.
    """
    before, problem = problem, _update_noise_once(problem, columns, tick, at_last)
    for _ in range(ROUNDS if problem is not before and problem.settings.noise.repeats is not None else 0):
        after = _with_noise(problem.settings, problem, columns, problem.settings.used)
        if _is_noise_unchanged(problem.settings.noise, after.noise):
            break
        problem.resting()
        problem = refit(after, problem.values, columns, tick)
    return problem


def without_wrong(problem: LinearizedProblem, budget: Budget, progress: Progress) -> LinearizedProblem:
    """The geometry fitted without wrong readings, which each fit judges for the next until none changes, or time is over."""
    tick = budget.tick(PREPARING, WRONG)
    for _ in range(FITS):
        try:
            after = refit_with_updated_noise(problem, (), tick)
        except OutOfTimeError:
            break
        if after is problem:
            break
        progress(0.7, "fitting without outliers")
        problem = after
    return problem


def _update_noise_once(
    problem: LinearizedProblem, columns: Sequence[int], tick: Tick, at_last: bool
) -> LinearizedProblem:
    settings = problem.settings
    if settings.inflation > 1.0:  # rows correlated in time: a disturbance looks like what they share
        return problem
    every = replace(settings, used=np.ones(len(settings.used), dtype=bool))
    every = _with_noise(every, problem, columns, settings.used)
    known = not at_last and len(settings.used) > MANY and _is_noise_unchanged(settings.noise, every.noise)
    if known or (len(settings.used) > LARGE and settings.used.all() and not stands_out(every, problem.values)):
        used = settings.used
    else:
        problem.resting()
        used = ~outliers(linearise_problem(every, problem.values), columns, tick)
    after = _with_noise(replace(every, used=used), problem, columns, used)
    if np.array_equal(used, settings.used) and _is_noise_unchanged(settings.noise, after.noise):
        return problem
    problem.resting()
    return refit(after, problem.values, columns, tick)


def under(settings: ProblemSettings, problem: LinearizedProblem, columns: Sequence[int] = ()) -> LinearizedProblem:
    """A problem re-fitted under the noise and outliers of another, so that the two can be compared."""
    if settings is problem.settings:
        return problem
    problem.resting()
    return refit(settings, problem.values, columns)


def _is_noise_unchanged(before: Noise, after: Noise) -> bool:
    """Whether nothing changed that a verdict could rest on."""
    if before is after:
        return True
    ratio = after.coordinate / max(before.coordinate, 1e-300)
    freedom = after.freedom / before.freedom if before.freedom > 0.0 else 1.0
    if before.kinds and not np.allclose(np.diag(before.row), np.diag(after.row), rtol=2.0 * CHANGED, atol=0.0):
        return False
    was, now = (np.diagonal(noise.visit, axis1=1, axis2=2) for noise in (before, after))
    if before.readings is not None and not np.allclose(was, now, rtol=2.0 * CHANGED, atol=0.0):
        return False
    return abs(ratio - 1.0) < CHANGED and abs(freedom - 1.0) < FREER and before.most == after.most


def _with_noise(
    settings: ProblemSettings, problem: LinearizedProblem, columns: Sequence[int], used: Bools
) -> ProblemSettings:
    """The noise of the fit where it comes from there, that of repeats without what the fit explains; others stay.

    Where too few repeats are left before anything is named, it is that of the fit: what was read from them all is that of
    the wrong readings (of 15 repeated poses four were approached alike, two of these once wrongly, and a noise of
    0.024 mm was 0.14).
    """
    by_fit = settings.noise.source == FIT
    if settings.noise.repeats is not None:
        noise = _of_repeats(settings, problem, columns, used)
        if noise is not None or columns:
            return settings if noise is None else replace(settings, noise=noise)
        settings, by_fit = replace(settings, trusted=False), True
    if settings.trusted or (not by_fit and settings.noise.readings is None):
        return settings
    residual = unheld(problem, columns, settings.source.residual(problem.values))
    free = problem.U.shape[1] + len(columns)
    lost = min(0.9, free / max(used.sum() * residual.shape[1], 1))
    if not by_fit:
        return replace(settings, noise=add_approach_noise(settings.noise, residual, used, lost))
    return replace(settings, noise=settings.source.even(re_estimate_fit_noise(settings.noise, residual, used, lost)))


def unheld(problem: LinearizedProblem, columns: Sequence[int], residual: Floats) -> Floats:
    """Residuals (V, m) as the library ``columns`` would leave them without their priors; ``residual`` where no visit counts.

    Noise that holds an effect is so large that the effect's prior holds its amount near nothing, which leaves the effect
    in the noise: of 0.027 deg/K 0.0018 were found, with an interval that proved it.
    """
    if not len(columns):
        return residual
    settings, source = problem.settings, problem.settings.source
    G = source.prior.columns(problem.G)
    X = np.hstack([G, problem.W_raw[:, list(columns)]])
    H, b = X.T @ X, X.T @ problem.raw
    own = slice(0, G.shape[1])
    H[own, own] += np.eye(G.shape[1])
    b[own] -= source.prior.whiten_deviation(source.prior.standardized_deviation(source.geometry(problem.values)))
    left = settings.whitening.back(problem.raw - X @ scipy.linalg.lstsq(H, b, cond=SEEN)[0])
    counts = settings.used[:, None] & ~np.isnan(residual)
    return np.where(counts, left, residual)


def _of_repeats(
    settings: ProblemSettings, problem: LinearizedProblem, columns: Sequence[int], used: Bools
) -> Noise | None:
    """The noise of the repeats at this fit, with equal weights where it had them; None where too few are left."""
    noise = settings.noise
    assert noise.repeats is not None
    pairs = noise.repeats.pairs
    beside = columns if pairs is None else [k for k in columns if k not in pairs.columns]  # it fits those by itself
    taken = fitted_away(problem, beside, noise.repeats.visits.condition)
    left = unheld(problem, columns, settings.source.residual(problem.values))
    again = noise_again(noise, left, taken, used)
    if again is None or again is noise or not np.allclose(noise.visit, noise.even().visit, rtol=1e-9, atol=0.0):
        return again
    return again.even()


def fitted_away(problem: LinearizedProblem, columns: Sequence[int], condition: Ints) -> float:
    """How many scalars of the differences between visits of one ``condition (V,)`` the library columns fit.

    The noise in them is gone from the residual. Geometry fits none: it is the same for all visits of a condition.
    """
    used = problem.settings.used
    basis = problem.basis(columns)[:, problem.U.shape[1] :]
    if not basis.shape[1]:
        return 0.0
    rows = basis.reshape(len(used), -1)
    return float(np.sum(subtract_group_means(rows, isolate_unused_visits(condition, used)) ** 2))
