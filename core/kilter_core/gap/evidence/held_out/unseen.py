"""Families cut down to the joints that show them: a version stores nothing of joints the rows have not seen.

A family is named by all of its joints together, so those that carry no load or hardly move get an amplitude too, which is
noise and nothing else: a compliance of 200 times the truth, or one below zero, at the last joint of an arm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.effects import Effect
from kilter_core.errors import Finding
from kilter_core.gap.evidence.fits.intervals import amplitude_significance, are_all_significant
from kilter_core.gap.search.candidates import FAMILY, JOINT, Candidate, Untestable
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import estimate_linear_parameters, refit

TAKEN_OVER = 0.2  # share of the variance of an amplitude that would vanish with a joint that it imitates


@dataclass(frozen=True)
class Unseen:
    """Joints (from 0) at which the rows do not show a family that was named for ``joints``."""

    candidate: Candidate
    joints: tuple[int, ...]

    def untestable(self) -> Untestable:
        """What is to be measured there."""
        c = self.candidate
        reason = "It is named at other joints; these rows do not show it here: it stays nominal, and nothing is stored."
        return Untestable(c.id, self.joints, reason, c.effects[0].remedy, "poses that show these joints")

    def finding(self) -> Finding:
        """The same as a finding of the search."""
        said = {"effect": self.candidate.id, "joints": [j + 1 for j in self.joints]}
        return Finding("unseen_stays_nominal", said, {"remedy": self.candidate.effects[0].remedy})


def seen_only(found: SearchResult) -> tuple[SearchResult, tuple[Unseen, ...]]:
    """The search with every family at the joints that show it, fitted again; and what was left out.

    Joints go one by one, the least certain first, as long as nothing that differs from zero goes with them: two joints that
    the poses hardly tell apart are each uncertain, and one of them is not. Where one would take over what the other does,
    both stay, each as uncertain as it is.
    """
    out = []
    for n, place in enumerate(found.chosen):
        candidate = found.selector.scorer.candidates[place]
        if candidate.level != FAMILY:
            continue
        left = _shown_members(found, candidate)
        gone = tuple(j for e, _ in _members(found, candidate) if e not in [m[0] for m in left] for j in e.joints or ())
        if gone:
            out.append(Unseen(candidate, gone))
            found = _with_members(found, n, left)
    return found, tuple(out)


Member = tuple[Effect, tuple[int, ...]]


def _members(found: SearchResult, candidate: Candidate) -> Iterator[Member]:
    """Effects of a family with their columns."""
    start, robot = 0, found.problem.settings.source.model.robot
    for effect in candidate.effects:
        end = start + len(effect.parameters(robot))
        yield effect, candidate.columns[start:end]
        start = end


def _shown_members(found: SearchResult, candidate: Candidate) -> list[Member]:
    left, gone = list(_members(found, candidate)), list[int]()
    others = [k for k in found.columns if k not in candidate.columns]
    members = len(left)
    while len(left) > 1:
        columns = sorted({*others, *_columns(left)})
        apart = [
            n for n, (_, own) in enumerate(left) if _nominal(found, own) or not _taken_over(found, columns, own, left)
        ]
        if not apart:
            break
        chances = {
            n: 1.0 if _nominal(found, left[n][1]) else amplitude_significance(found, columns, left[n][1])[0]
            for n in apart
        }
        worst = max(apart, key=chances.__getitem__)
        # Each at 95 % by itself, one family of seven in three kept a joint that has nothing.
        together = [amplitude_significance(found, found.columns, [*gone, *left[worst][1]])[0]]
        sure = are_all_significant(list(chances.values()), members) or are_all_significant(
            together, members - len(left) + 1
        )
        if chances[worst] < 1.0 and sure:
            break
        gone += left.pop(worst)[1]
    return left


def _taken_over(found: SearchResult, columns: Sequence[int], own: Sequence[int], members: Sequence[Member]) -> bool:
    """Whether members that stay would take over what one does: without it one of them would be told much too surely.

    Its amount would then be presumed to be zero, which no data say, and theirs would be wrong by what it is.
    """
    covariance = estimate_linear_parameters(found.problem, columns)[1]
    at = {k: n for n, k in enumerate(columns)}
    mine, theirs = [at[k] for k in own], [at[k] for k in _columns(members) if k not in own]
    shared = covariance[np.ix_(theirs, mine)]
    known = np.sum(shared @ np.linalg.pinv(covariance[np.ix_(mine, mine)], hermitian=True) * shared, axis=1)
    return bool(np.any(known > TAKEN_OVER * np.diag(covariance)[theirs]))


def _nominal(found: SearchResult, own: Sequence[int]) -> bool:
    """Whether a fit within the physical range leaves amplitudes at zero: a compliance that came out below it."""
    return not np.any(found.problem.settings.source.library(found.problem.values)[list(own)])


def _columns(members: Sequence[Member]) -> tuple[int, ...]:
    return tuple(k for _, own in members for k in own)


def _with_members(found: SearchResult, n: int, left: list[Member]) -> SearchResult:
    """The search whose ``n``-th name has these members only, fitted again."""
    scorer, place = found.selector.scorer, found.chosen[n]
    candidates, columns = list(scorer.candidates), _columns(left)
    own = candidates[place]
    alone = [
        k for k, c in enumerate(candidates) if c.level == JOINT and c.id == own.id and set(c.columns) == set(columns)
    ]
    if len(left) == 1 and alone:
        place = alone[0]
    else:
        joints = tuple(j for e, _ in left for j in e.joints or ())
        candidates[place] = replace(own, columns=columns, joints=joints, effects=tuple(e for e, _ in left), part=True)
    chosen = (*found.chosen[:n], place, *found.chosen[n + 1 :])
    selector = replace(found.selector, scorer=scorer.from_candidates(candidates, scorer.absolute, scorer.freedom))
    problem = refit(found.problem.settings, found.problem.values, selector.columns(chosen))
    cut = replace(found, selector=selector, chosen=chosen, problem=problem)
    return replace(cut, steps=cut.extended_steps(problem, chosen))
