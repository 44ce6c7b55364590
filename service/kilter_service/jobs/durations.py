"""How long a job would compute: by what the same job took here before, by its own beginning, or by other jobs and a rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from kilter_service.contract.jobs.check import Duration
from kilter_service.contract.jobs.registry import KINDS
from kilter_service.jobs.records import JobRequest

START_ROWS = 100  # overhead of a job, in rows
BEGUN = 2.0  # factor by which the beginning of a job may mislead
WIDEST = 3.0  # factor by which a single earlier job may mislead
RULE_ROWS = 300
SHORTEST_S = 0.01


@dataclass(frozen=True)
class PastRun:
    """How long an earlier job computed, on how many rows, and what was asked."""

    seconds: float
    rows: int
    request: JobRequest


def duration(
    kind: str, rows: int, request: JobRequest, past: Sequence[PastRun], begun: float | None = None
) -> Duration:
    """Estimate how long a job would compute, from earlier jobs with the same options, else from all of the kind.

    ``begun`` is what the beginning of the job says, in seconds, where it was made: it knows these rows and this machine.
    """
    same = [run for run in past if _duration_relevant_options(run.request) == _duration_relevant_options(request)]
    if begun is not None and not same:
        return _cap_by_budget(
            _duration(begun, begun / BEGUN, begun * BEGUN, "the beginning of this job, made and timed here"), request
        )
    chosen = same or list(past)
    if not chosen:
        return _cap_by_budget(_by_rule(kind, rows, request), request)
    took = [run.seconds * _work(rows, request) / _work(run.rows, run.request) for run in chosen]
    wide = 1.0 + (WIDEST - 1.0) / len(took) ** 0.5
    wide *= 1.0 if same else WIDEST
    which = "with the same options" if same else "with other options"
    jobs = f"{len(took)} earlier {kind} {'job' if len(took) == 1 else 'jobs'} {which}, by the number of rows"
    return _cap_by_budget(_duration(median(took), min(took) / wide, max(took) * wide, jobs), request)


def _cap_by_budget(found: Duration, request: JobRequest) -> Duration:
    """The same under a budget that was asked for: what is cut short ends soon after it."""
    budget = request.options.get("budget_s")
    if budget is None or found.high <= budget:
        return found
    expected, low, high = (min(value, float(budget)) for value in (found.expected, found.low, found.high))
    return _duration(
        expected, low, high, f"{found.basis}; no longer than the budget of {budget:g} s, but for what is begun by then"
    )


def _by_rule(kind: str, rows: int, request: JobRequest) -> Duration:
    expected, low, high = KINDS[kind].seconds
    more = max(1.0, _work(rows, request) / _work(RULE_ROWS, JobRequest.from_document({"robot": ""})))
    basis = f"a rule for {kind} jobs of this size: no earlier one of this server tells it"
    return _duration(expected * more, low, high * more, basis)


def _duration(expected: float, low: float, high: float, basis: str) -> Duration:
    values = [round(max(value, SHORTEST_S), 2) for value in (expected, low, high)]
    return Duration(expected=values[0], low=min(values), high=max(values), basis=basis)


def _work(rows: int, request: JobRequest) -> float:
    return float(rows + START_ROWS) * (1 + (request.folds or 0))


def _duration_relevant_options(request: JobRequest) -> tuple[Any, ...]:
    """What of the options makes a job long."""
    options = request.options
    effects = options.get("effects")
    return (
        options.get("method"),
        options.get("intervals"),
        options.get("purpose"),
        options.get("level"),
        len(effects) if isinstance(effects, list) else 0,
        bool(options.get("propose")),
    )
