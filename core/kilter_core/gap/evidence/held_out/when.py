"""When a named event happened: the row, as people count the rows of their file, how sure it is, and how far it went."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.effects import Effect
from kilter_core.errors import Finding, FindingDocument
from kilter_core.gap.evidence.fits.final_fit import final_effect_amounts
from kilter_core.gap.evidence.held_out.held_out_errors import on_rows
from kilter_core.gap.evidence.held_out.practical_size import moves_u95_mm
from kilter_core.gap.search.events import Course, event_key, likely, profiles, replace_events
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.observations import Observations
from kilter_core.parameters import degrees
from kilter_core.types import QUANTILE, Floats


@dataclass(frozen=True)
class When:
    """Rows of the file, from 1: the last ``before`` an event and the first ``after`` it; first and last that may be its first.

    ``moved_mm`` is the rms displacement of the tool by it, ``u95_mm`` half of its 95 % interval; ``rotated`` how far the
    frame that moved rotated.
    """

    place: int
    before: int
    after: int
    low: int
    high: int
    moved_mm: float
    u95_mm: float
    rotated: Rotated | None


@dataclass(frozen=True)
class Rotated:
    """How far a frame rotated, with half of its 95 % interval; None where the rows show no rotation of it."""

    rotated_deg: float | None = None
    u95_deg: float | None = None

    @staticmethod
    def from_search(found: SearchResult, k: int) -> Rotated | None:
        """What the amounts of a chosen candidate say; None of one that moves no frame."""
        candidate, source = found.selector.scorer.candidates[k], found.problem.settings.source
        if candidate.joints is not None:
            return None
        library = source.model.parameters[len(source.model.parameters) - source.n_library :]
        places = [found.columns.index(column) for column in candidate.columns if library[column].unit == "rad"]
        amounts = final_effect_amounts(found)
        size = float(np.linalg.norm(amounts.values[places]))
        if size == 0.0:
            return Rotated()
        slope = amounts.values[places] / size
        half = QUANTILE * float(np.sqrt(slope @ amounts.covariance[np.ix_(places, places)] @ slope))
        return Rotated(float(degrees(size)), float(degrees(half)))


def events(found: SearchResult, every: Observations, moves_mm: dict[int, float]) -> tuple[When, ...]:
    """When each chosen event happened, in rows of ``every``: those searched and those held out, in the file's order."""
    candidates = found.selector.scorer.candidates
    chosen = [k for k in found.chosen if candidates[k].effects[0].event]
    course = Course.from_observations(every)
    if course is None or not chosen:
        return ()
    variance = found.selector.variance(found.problem.gram, found.chosen)
    out = []
    for k, profile in profiles(found.problem, candidates, found.chosen, chosen).items():
        _, low, high = likely(profile, variance)
        place = max(1, min(course.place(candidates[k].effects[0]), len(every) - 1))
        own = profile.course.key
        first = max(1, int(np.searchsorted(course.key, own[low - 1], side="right")))
        last = min(len(every) - 1, int(np.searchsorted(course.key, own[high], side="left")))
        row, share = course.order + 1, float(profile.course.place(candidates[k].effects[0])) / len(own)
        less = 1.0 / np.sqrt(max(share, 1.0 / len(own)))  # only rows before it are moved by it
        far, half = moves_mm[k] * less, moves_u95_mm(found, k) * less
        rotated = Rotated.from_search(found, k)
        out.append(When(k, int(row[place - 1]), int(row[place]), int(row[first]), int(row[last]), far, half, rotated))
    return tuple(out)


def refine_event_positions(found: SearchResult, held_out: Observations | None) -> SearchResult:
    """The search with its events between the right rows among those held out, which the rows searched leave open.

    Nothing else follows from it: an event stays between the same two visits that were searched.
    """
    candidates = found.selector.scorer.candidates
    chosen = [k for k in found.chosen if candidates[k].effects[0].event]
    if held_out is None or not len(held_out) or not chosen:
        return found
    source = found.problem.settings.source
    searched, unseen = Course.from_observations(source.observations), Course.from_observations(held_out)
    if searched is None or unseen is None or searched.timed != unseen.timed:
        return found
    for k in chosen:
        found = _settled_one(found, k, held_out, searched, unseen)
    return found


def _settled_one(found: SearchResult, k: int, rows: Observations, searched: Course, unseen: Course) -> SearchResult:
    candidate = found.selector.scorer.candidates[k]
    effect = candidate.effects[0]
    place = searched.place(effect)
    low, high = searched.key[place - 1], searched.key[place]
    inside = np.flatnonzero((unseen.key > low) & (unseen.key < high))
    if not len(inside):
        return found
    keys = np.concatenate([[low], unseen.key[inside], [high]])
    few = rows.select(unseen.order[inside])
    sizes = [_size(_place_event(found, k, searched, keys, n), few) for n in range(1, len(keys))]
    return _place_event(found, k, searched, keys, 1 + int(np.argmin(sizes)))


def _place_event(found: SearchResult, k: int, course: Course, keys: Floats, place: int) -> SearchResult:
    """The search with an event just before one of the ``keys``."""
    candidate = found.selector.scorer.candidates[k]
    mark = replace(course, order=np.arange(len(keys)), key=keys).mark(place)
    effect: Effect = replace(candidate.effects[0], **mark)
    settings = found.problem.settings
    source = replace_events(settings.source, {event_key(effect): effect})
    candidates = list(found.selector.scorer.candidates)
    candidates[k] = replace(candidate, effects=(effect,))
    scorer = replace(found.selector.scorer, candidates=tuple(candidates))
    return replace(
        found,
        problem=replace(found.problem, settings=replace(settings, source=source)),
        selector=replace(found.selector, scorer=scorer),
    )


def _size(found: SearchResult, rows: Observations) -> float:
    """Sum of squares of what the model leaves in some rows."""
    source, values = on_rows(found.problem.settings.source, rows, found, found.problem.values)
    return float(np.nansum(source.residual(values)[:, : source.tool_numbers or None] ** 2))


def event_findings(
    found: SearchResult,
    whens: tuple[When, ...],
    likely_only: Collection[int],
    by_views: bool,
    of_fit: Sequence[FindingDocument],
) -> Iterator[Finding]:
    """Say when what happened, and what to do about it; those that are ``likely_only`` may have.

    A camera or board that moved half-way was found in a fit that knows one place of it (``camera_moved`` ``of_fit``). Where
    the search names the same move, its version has both places: the finding takes the name of what moved from the fit.
    """
    for when in whens:
        candidate = found.selector.scorer.candidates[when.place]
        rotated = when.rotated
        step = {
            "row": when.after,
            "rows_95": [when.low, when.high],
            "moved_mm": when.moved_mm,
            "u95_mm": when.u95_mm,
            "rotated_deg": rotated and rotated.rotated_deg,
            "u95_deg": rotated and rotated.u95_deg,
        }
        yield Finding(
            "moved_once",
            step | describe_moved_part(step, of_fit),
            {
                "effect": candidate.id,
                "joint": (candidate.joints or (0,))[0] + 1,
                "before": when.before,
                "likely": when.place in likely_only,
                "by_views": by_views,
                "moves_frame": rotated is not None,
            },
        )


def describe_moved_part(step: Mapping[str, Any], of_fit: Sequence[FindingDocument]) -> dict[str, Any]:
    """Return the camera or board whose move a step of base or tool, which rotates as a frame does, may be; else nothing."""
    if step["rotated_deg"] is None:
        return {}
    low, high = step["rows_95"]
    for one in of_fit:
        if one["code"] == "camera_moved" and low <= one["rows_95"][1] and one["rows_95"][0] <= high:
            return {"part": one["part"], "name": one["name"]}
    return {}


def not_said_by(findings: Sequence[Mapping[str, Any]], of_fit: Sequence[FindingDocument]) -> Iterator[FindingDocument]:
    """Remarks of a fit without those on a camera or board whose move the search names."""
    named = {(one["part"], one["name"]) for one in findings if one["code"] == "moved_once" and "part" in one}
    for one in of_fit:
        if one["code"] != "camera_moved" or (one["part"], one["name"]) not in named:
            yield one
