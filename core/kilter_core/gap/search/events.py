"""When something happened once: every place between two rows is tried, and the best one kept, for each effect that jumps.

An effect that jumps is linear in how far, not in when. For each of them all its columns, one per place between two visits,
are scored at once by sums along the order of measurement: given geometry and what is chosen, what it takes off chi-square
there. The candidate is the best place; that it is the best of so many counts against it (:attr:`Candidate.places`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.effects import Effect
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.linear.gram import VISIBLE
from kilter_core.gap.search.linear.linearized import LinearizedProblem, linearise_problem, with_columns_of
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.sources.source import Source
from kilter_core.observations import Observations
from kilter_core.observations.clock import read_clock
from kilter_core.types import Bools, Floats, Ints

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
