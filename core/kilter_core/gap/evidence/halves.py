"""Does a name last where something else is left: the two halves of a campaign, one after the other, against each other.

On real arms something is always left (trap 17). There an effect must rise on its own evidence: each half names it, both
show the same amplitude, and each predicts the other half better with it than without it. It is claimed as its class then,
so it need not stand beside every smooth shape that what is left may have: a sag at three loads stood beside none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.stats import chi2, norm

from kilter_core.gap.evidence.fits.intervals import are_all_significant
from kilter_core.gap.evidence.guarded import Guarded
from kilter_core.gap.evidence.stability import SMALLEST, reweight_problem
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.gram import Gram
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.select import Selector
from kilter_core.parameters import mm
from kilter_core.types import Bools, Floats

AGREE = 3.0  # combined standard deviations within which the amplitudes of both halves are one
AGAIN = 0.01  # chance below which an effect is there beside all that a half names
POSES_PER_HALF = 12  # poses of a half: fewer hold no geometry
RANK = 1e-8  # share of the largest singular value below which a direction of a half is not seen


@dataclass(frozen=True)
class Halves:
    """What the halves say of one effect.

    ``named`` of either half, amplitudes ``apart`` in combined standard deviations, mean errors of the other half's
    poses ``predicted`` with and without it (None for joint data).
    ``joints`` (from 0) are those of it at which both halves name it, or its class, and show it; None where it acts at none.
    """

    named: tuple[bool, bool]
    apart: float
    predicted: Guarded
    length: bool  # whether the errors are lengths
    joints: tuple[int, ...] | None = None

    @property
    def lasts(self) -> bool:
        """Whether name, amplitude and prediction are the same in both halves, at a joint that both name."""
        return all(self.named) and self.joints != () and self.apart <= AGREE and self.predicted.better

    def to_document(self) -> dict[str, Any]:
        """Plain numbers, mm."""
        told = self.predicted
        return {
            "lasts": self.lasts,
            "named": list(self.named),
            "apart_sigma": self.apart,
            "with_mm": mm(told.with_it) if self.length else None,
            "without_mm": mm(told.without) if self.length else None,
            "better": told.better,
            "joints": None if self.joints is None else [j + 1 for j in self.joints],
        }


@dataclass(frozen=True)
class Sides:
    """The halves of the poses, one after the other, and what either names: asked once for all effects."""

    search: SearchResult
    most: int

    @cached_property
    def visits(self) -> tuple[Bools, Bools]:
        """Visits (V,) of each."""
        first = _first_half(self.search)
        return first, ~first

    @cached_property
    def able(self) -> bool:
        """Whether both have poses enough to hold the geometry."""
        settings = self.search.problem.settings
        return min(len(np.unique(settings.group[side & settings.used])) for side in self.visits) >= POSES_PER_HALF

    @cached_property
    def half_searches(self) -> tuple[_Searched, _Searched]:
        """What the selection on each half alone names."""
        first, second = (self._search_half(side) for side in self.visits)
        return first, second

    def _search_half(self, side: Bools) -> _Searched:
        gram, rows = restrict_to_visits(self.search.problem, side)
        selector = replace(self.search.selector, rows=rows)
        return _Searched(gram, selector, tuple(selector.select_candidates(gram, self.search.critical, self.most)))


@dataclass(frozen=True)
class _Searched:
    """A half, and the places of what it names."""

    gram: Gram
    selector: Selector
    chosen: tuple[int, ...]

    def matching_candidates(self, place: int, rivals: Sequence[int]) -> list[Candidate]:
        """What the half names of an effect or its rivals; or the effect, if it is there beside all that the half names.

        A half rarely has poses enough to name everything as the best of a whole library. What is asked of it is whether the
        effect came again.
        """
        candidates = self.selector.scorer.candidates
        own = [candidates[k] for k in (place, *rivals)]
        named = [candidates[k] for k in self.chosen if any(_share_class_and_joint(candidates[k], one) for one in own)]
        if named:
            return named
        there = self.selector.scorer.tail_probability(self.gram, place, self.selector.columns(self.chosen)) < AGAIN
        return [candidates[place]] if there else []


def restrict_to_visits(problem: LinearizedProblem, side: Bools) -> tuple[Gram, int]:
    """The linearised problem on some visits (V,) alone, with the freedom that these leave, and their numbers.

    With the freedom of all rows, what a half leaves would pass for noise of half its variance and less: one name too many
    makes that smaller still, and a search on seven axes ended in eleven shapes that explained everything.
    """
    weight = side[problem.row_visit].astype(np.float64)
    settings, U = problem.settings, problem.U[side[problem.row_visit]]
    share = float((side & settings.used).sum()) / float(settings.used.sum())
    numbers = share * settings.numbers / settings.inflation
    along = np.linalg.eigvalsh(U.T @ U)
    nu = numbers - float(np.sum(along / (along + SMALLEST)))
    return replace(reweight_problem(problem, weight), nu=max(nu, 1.0)), max(2, int(numbers))


def halves(sides: Sides, place: int, rivals: Sequence[int]) -> Halves | None:
    """Ask both halves of the poses; ``rivals`` are the places that count as the same name. None with too few poses."""
    if not sides.able:
        return None
    search = sides.search
    fits = [_fit_half(search, place, side) for side in sides.visits]
    (a, A), (b, B) = (fit.amounts for fit in fits)
    away = float((a - b) @ np.linalg.pinv(A + B, hermitian=True) @ (a - b))
    apart = float(norm.isf(max(float(chi2.sf(away, len(a))), 1e-300) / 2.0))
    errors = [fit.errors(search, other) for fit, other in zip(fits, reversed(sides.visits), strict=True)]
    with_it, without = (np.concatenate([e[k] for e in errors]) for k in (0, 1))
    again = [half.matching_candidates(place, rivals) for half in sides.half_searches]
    told, length = Guarded.from_errors(with_it, without), search.problem.settings.source.observes_tool
    joints = _joints_of_both(search, place, again, fits)
    return Halves((bool(again[0]), bool(again[1])), apart, told, length, joints)


def _joints_of_both(
    search: SearchResult, place: int, again: Sequence[Sequence[Candidate]], fits: Sequence[_Fit]
) -> tuple[int, ...] | None:
    """Joints of a name at which both halves name it or its class, and show it: a family may come again at others."""
    candidate = search.selector.scorer.candidates[place]
    if candidate.joints is None:
        return None
    named = [{j for c in own for j in c.joints or candidate.joints} for own in again]
    shown = [_joints_shown(search, candidate, *fit.amounts) for fit in fits]
    return tuple(j for j in candidate.joints if all(j in own for own in (*named, *shown)))


def _joints_shown(search: SearchResult, candidate: Candidate, amounts: Floats, covariance: Floats) -> set[int]:
    """Joints whose amounts differ from zero in a half: 5 % over all of them, by Holm's steps."""
    robot, start, chances = search.problem.settings.source.model.robot, 0, dict[int, float]()
    for effect in candidate.effects:
        own = slice(start, start + len(effect.parameters(robot)))
        start, a = own.stop, amounts[own]
        size = float(a @ np.linalg.pinv(covariance[own, own], hermitian=True) @ a)
        chances |= dict.fromkeys(effect.joints or (), float(chi2.sf(size, len(a))))
    first = sorted(chances, key=chances.__getitem__)
    last = next(
        (n for n, j in enumerate(first) if not are_all_significant([chances[k] for k in first[: n + 1]], len(first))),
        None,
    )
    return set(first[:last])


def _first_half(search: SearchResult) -> Bools:
    """Visits (V,) of the poses that came first."""
    settings = search.problem.settings
    clock = settings.source.observations.t
    order = np.arange(len(settings.group), dtype=np.float64) if clock is None else np.asarray(clock, dtype=np.float64)
    poses = int(settings.group.max()) + 1
    count = np.maximum(np.bincount(settings.group, minlength=poses), 1)
    when = np.bincount(settings.group, order, poses) / count
    rank = np.argsort(np.argsort(when, kind="stable"), kind="stable")
    return np.asarray(rank[settings.group] < poses / 2)


@dataclass(frozen=True)
class _Fit:
    """One half fitted: coefficients with the effect and without it, its amplitudes with their covariance."""

    with_it: Floats
    without: Floats
    columns: Floats  # geometry and all that was chosen (R, p + d), the effect's own last
    amounts: tuple[Floats, Floats]

    def errors(self, search: SearchResult, side: Bools) -> tuple[Floats, Floats]:
        """Errors (G,) of the poses of a half, with the effect and without it."""
        problem = search.problem
        seen = side & problem.settings.used
        group = np.unique(problem.settings.group[seen], return_inverse=True)[1]
        order = np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1])
        out = []
        for beta in (self.with_it, self.without):
            left = problem.y - self.columns[:, : len(beta)] @ beta
            back = problem.settings.whitening.back(left)[seen]
            out.append(np.array([problem.settings.source.rms(back[own]) for own in order]))
        return out[0], out[1]


def _fit_half(search: SearchResult, place: int, side: Bools) -> _Fit:
    problem, selector = search.problem, search.selector
    own = list(selector.scorer.candidates[place].columns)
    rest = [k for k in search.columns if k not in own]
    columns = np.hstack([problem.U, problem.projected_columns([*rest, *own])])
    rows = (side & problem.settings.used)[problem.row_visit]
    X, y = columns[rows], problem.y[rows]
    inverse = np.linalg.pinv(X.T @ X, rcond=RANK, hermitian=True)
    beta = inverse @ (X.T @ y)
    nu = max(float(len(y)) / problem.settings.inflation - X.shape[1], 1.0)
    grown = max(1.0, float(np.sum((y - X @ beta) ** 2)) / nu)
    d = len(own)
    plain = X[:, :-d]
    without = np.linalg.pinv(plain.T @ plain, rcond=RANK, hermitian=True) @ (plain.T @ y)
    return _Fit(beta, without, columns, (beta[-d:], grown * inverse[-d:, -d:]))


def _share_class_and_joint(one: Candidate, other: Candidate) -> bool:
    """Whether both are of one class at a joint of both."""
    if one.id != other.id and one.effects[0].physical.id != other.effects[0].physical.id:
        return False
    joints, others = set(one.joints or ()), set(other.joints or ())
    return not joints or not others or bool(joints & others)
