"""How a robot stands, in a word, and what to do next: of every surface in this one place.

Today in words. A number says of which rows it is, and from when.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

from kilter_service.contract.today import (
    UNUSED,
    DriftSummary,
    ErrorsToday,
    FirstStage,
    FirstStep,
    NextStep,
    RobotState,
    Standing,
    StepKind,
    Today,
)
from kilter_service.contract.wording import interval, said_of_error, widest
from kilter_service.ground.db.row import days_since
from kilter_service.ground.naming import plural
from kilter_service.versions.today.store import Measured

WORDS: dict[FirstStage, str] = {
    "describe": "Describe",
    "measure": "Measure",
    "check": "Check the file",
    "search": "Identify and search",
    "activate": "Activate",
    "correct": "Correct",
}
MISSING: dict[FirstStage, str] = {
    "describe": "",
    "measure": "Nothing was measured yet.",
    "check": "No campaign is meant for identification.",
    "search": "No version was made of the measurements yet.",
    "activate": "No version is active.",
    "correct": "No path and no stream was corrected yet.",
}


@dataclass(frozen=True)
class Reached:
    """What is stored of the first calibration of a robot; ``checked``: some rows are meant to be fitted."""

    measured: bool = False
    checked: bool = False
    searched: bool = False
    active: bool = False
    corrected: bool = False


def first_calibration(reached: Reached, steps: Mapping[FirstStage, Sequence[NextStep]]) -> list[FirstStep]:
    """Return the stages, of which the first that is not done has its ``steps``; none once all are done."""
    searched = reached.active or reached.searched
    done: dict[FirstStage, bool] = {
        "describe": True,
        "measure": searched or reached.measured,
        "check": searched or reached.checked,
        "search": searched,
        "activate": reached.active,
        "correct": reached.active and reached.corrected,
    }
    if all(done.values()):
        return []
    following = next(stage for stage in WORDS if not done[stage])
    return [
        FirstStep(
            stage=stage,
            words=words,
            done=done[stage],
            missing=MISSING[stage] if stage == following else "",
            steps=[*steps.get(stage, ())] if stage == following else [],
        )
        for stage, words in WORDS.items()
    ]


Look = Literal["good", "warn", "bad", "faint"]
FILE = "FILE"  # of the person's own
CAUSES = {
    "zero": "Re-zero",
    "sag": "Re-fit the sag of",
    "base": "Re-fit the base",
    "tool": "Re-fit the tool",
    "scale": "Re-fit the scale",
}


@dataclass(frozen=True)
class Known:
    """What is stored beside the errors of a robot: its goals, and what could be done next.

    ``rezeroed`` are versions made of the active one by the rows of a check (by campaign), ``causes`` what the last check
    names, ``newest`` the newest version if it never was active, ``fresh`` the newest campaign that is to be fitted,
    ``planned`` the job of poses that nobody has measured yet, and how many these are, ``proposed`` the same of the newest
    search, ``searching`` the job that identifies or searches now, ``reached`` how far its first calibration is.
    """

    tolerance_mm: float | None = None
    check_interval_days: int | None = None
    rezeroed: dict[str, tuple[str, str]] = field(default_factory=dict)
    causes: Sequence[str] = ()
    newest: tuple[str, str] | None = None
    fresh: Measured | None = None
    planned: tuple[str, int] | None = None
    proposed: tuple[str, int] | None = None
    searching: str | None = None
    reached: Reached = field(default_factory=Reached)


def assess(today: Today, drift: DriftSummary, known: Known) -> Standing:
    """Say how a robot stands; what is worst is said."""
    state, words, sentence, look = next(_states(today, drift, known))
    first = first_calibration(known.reached, _first_steps(today.robot, known))
    return Standing(
        state=state,
        words=words,
        sentence=sentence,
        look=look,
        tolerance_mm=known.tolerance_mm,
        check_interval_days=known.check_interval_days,
        without_mm=_without(today),
        steps=list({step.do: step for step in _steps(state, today, drift, known)}.values())[:3],
        first=first,
    )


def _states(today: Today, drift: DriftSummary, known: Known) -> Iterator[tuple[RobotState, str, str, Look]]:
    newest = today.newest
    if today.version_id is None:
        yield "uncalibrated", "Not calibrated", today.sentences[0], "faint"
        return
    moved = drift.state in ("moved", "cannot_tell")
    if _is_worse(today):
        assert newest is not None
        most = largest(newest, today.own)
        with_it, without = (said_of_error(one or 0.0, most) for one in (_mean(today), _without(today)))
        said = f"On the newest rows the version leaves {with_it}, the nominal arm alone {without}."
        yield "worse", "Worse than uncorrected", f"{said} {_reason(drift) if moved else ''}".strip(), "bad"
    if drift.state == "moved":
        yield "moved", "Has moved", _reason(drift), "bad"
    if drift.state == "cannot_tell":
        yield "cannot_tell", "Moved, cause unknown", _reason(drift), "bad"
    if today.changed:
        more = said_of_error(today.larger_by_mm or 0.0, largest(newest, today.own))
        yield "changed", "Has changed", f"Its error is {more} larger than at the fit, more than chance explains.", "bad"
    yield from _by_goals(today, drift, known)


def _by_goals(today: Today, drift: DriftSummary, known: Known) -> Iterator[tuple[RobotState, str, str, Look]]:
    newest, checked = today.newest, _checked(drift)
    if newest is None or newest.errors.identified is None:
        yield "not_known", "Not known", "The active version was made without measurements of the tool.", "warn"
        return
    mean = newest.errors.identified.mean_mm
    low, high = interval(newest.errors.identified, newest.errors.n) or (mean, mean)
    limit = known.tolerance_mm
    if limit is not None and low > limit:
        yield "outside", "Outside", f"{number(mean / limit)} times its tolerance of {limit:g} mm.", "bad"
    if known.check_interval_days is not None and (age := _age(today, drift)) > known.check_interval_days:
        said = f"It is to be checked every {plural(known.check_interval_days, 'day')}."
        yield "unchecked", f"Not checked for {plural(age, 'day')}", said, "warn"
    if drift.state == "creeping":
        yield "drifting", "Drifting", _reason(drift), "warn"
    if newest.source == "fitted":
        yield "not_known", "Not known", "Nothing was held out of the fit, so its error looks too good.", "warn"
    if limit is None:
        fit = today.own or newest
        since = max((one.measured_at for one in fit.campaigns), default=fit.at)
        look: Look = "good" if drift.last is not None else "faint"
        yield "as_calibrated", f"As calibrated on {since.day} {since:%B}", checked, look
        return
    if high > limit:
        yield "near", "Near", f"Its tolerance of {limit:g} mm is inside the interval of its error.", "warn"
    yield "within", f"Within {limit:g} mm", checked, "good"


def number(times: float) -> str:
    """Write how many times, with two digits."""
    return f"{times:.0f}" if times >= 10 else f"{times:.1f}".removesuffix(".0")


def _checked(drift: DriftSummary) -> str:
    if drift.last is None or drift.age_days is None:
        return "It was not checked since."
    return f"Its checks agree with the version, last on {drift.last.at:%Y-%m-%d}, {ago(drift.age_days)}."


def _age(today: Today, drift: DriftSummary) -> int:
    """Days since rows of the arm said how it is: of a check or an evaluation, else of its fit."""
    newest = today.newest
    ages = [] if newest is None else [one.age_days for one in newest.campaigns]
    ages += [] if drift.age_days is None else [drift.age_days]
    ages += [] if today.own is None else [days_since(today.own.at)] if not ages else []
    return min(ages, default=0)


def _reason(drift: DriftSummary) -> str:
    """The first sentence of a check, without the word of its verdict."""
    said = drift.sentence.partition(": ")[2] or drift.sentence
    first = said.partition(". ")[0].rstrip(".")
    return f"{first[:1].upper()}{first[1:]}."


def _mean(today: Today) -> float | None:
    errors = None if today.newest is None else today.newest.errors.identified
    return None if errors is None else errors.mean_mm


def _without(today: Today) -> float | None:
    without = None if today.newest is None else today.newest.errors.without_version
    return None if without is None else without.mean_mm


def _is_worse(today: Today) -> bool:
    """Whether the arm errs less without its version, by the interval of its error."""
    newest, without = today.newest, _without(today)
    if newest is None or without is None or newest.errors.identified is None or newest.source not in UNUSED:
        return False
    found = newest.errors.identified
    return (interval(found, newest.errors.n) or (found.mean_mm,))[0] > without


def _steps(state: RobotState, today: Today, drift: DriftSummary, known: Known) -> Iterator[NextStep]:
    robot, alarm = today.robot, drift.state in ("moved", "cannot_tell")
    if state == "uncalibrated":
        for found in _first_steps(robot, known).values():
            yield from found
        return
    if state in ("changed", "outside", "near") and known.newest is not None:
        yield _activation(*known.newest)
    if alarm and drift.last is not None:
        if drift.last.campaign_id in known.rezeroed:
            version, name = known.rezeroed[drift.last.campaign_id]
            yield _activation(version, f"re-zeroed {name}")
        elif drift.state == "moved" and len(known.causes) == 1:
            campaign = drift.last.campaign_id
            words = ("watch", "rezero", robot, "--campaign", campaign)
            yield _step("rezero", _rezero_words(known.causes[0]), *words, campaign_id=campaign, causes=[*known.causes])
    if known.fresh is not None:
        yield _search(robot, known.fresh)
    newest = today.not_evaluated[-1] if today.not_evaluated else None
    if not alarm and newest is not None and (known.fresh is None or known.fresh.id != newest.id):
        words = ("version", "evaluate", robot, "--campaign", newest.id)
        yield _step("evaluate", f"Evaluate on {newest.name}", *words, campaign_id=newest.id)
    poses = list(_poses(state, today, known))
    yield from poses if drift.state == "cannot_tell" else []
    if alarm:
        yield _step("record_repair", "It was repaired", "watch", "repair", robot, "WHAT")
    yield from poses


def _first_steps(robot: str, known: Known) -> dict[FirstStage, list[NextStep]]:
    """What each stage of a first calibration takes, the last stage first; empty where nothing is there for it."""
    upload = _step("upload", "Add measurements", "upload", robot, FILE)
    poses = [] if known.planned is None else [_measure(*known.planned)]
    if known.planned is None and not known.reached.measured:
        poses = [_step("plan", "Plan the poses", "plan", "poses", robot)]
    search = [] if known.fresh is None else [_search(robot, known.fresh)]
    if known.searching is not None:
        search = [
            _step("await_job", "See how far it is", "server", "jobs", "show", known.searching, job_id=known.searching)
        ]
    return {
        "correct": [_step("correct", "Correct a path", "correct", robot, "PATH")] if known.reached.active else [],
        "activate": [] if known.newest is None else [_activation(*known.newest)],
        "search": search,
        "measure": [*poses, upload] if known.planned else [upload, *poses],
        "check": [upload],
    }


def _poses(state: RobotState, today: Today, known: Known) -> Iterator[NextStep]:
    """Poses to measure: those that a job proposes, else a plan of some."""
    if known.planned is not None:
        yield _measure(*known.planned)
    elif state in ("not_known", "outside", "near") and known.proposed is not None:
        yield _measure(*known.proposed, "pose")
    yield _step("plan_check", "Plan a check", "plan", "check", today.robot)


def _measure(job: str, count: int, what: str = "planned pose") -> NextStep:
    return _step("measure", f"Measure {plural(count, what)}", "server", "jobs", "show", job, job_id=job)


def _rezero_words(cause: str) -> str:
    kind, _, joint = cause.partition("_")
    return f"{CAUSES[kind]} joint {joint}" if joint else CAUSES[kind]


def _activation(version: str, name: str) -> NextStep:
    return _step("activate", f"Activate {name}", "activate", version, version_id=version)


def _search(robot: str, fresh: Measured) -> NextStep:
    """What makes a version of a campaign; of pictures a fit with gears that yield, for a search in pixels takes hours."""
    words = (robot, "--campaign", fresh.id)
    if fresh.views:
        more = ("--validation", "0.25", "--effects", "axial_compliance")
        return _step("identify", "Identify", "identify", *words, *more, campaign_id=fresh.id)
    return _step("search", "Identify and search", "gap", *words, campaign_id=fresh.id)


def _step(
    do: StepKind,
    words: str,
    *command: str,
    version_id: str | None = None,
    campaign_id: str | None = None,
    job_id: str | None = None,
    causes: Sequence[str] = (),
) -> NextStep:
    return NextStep(
        do=do,
        words=words,
        command=f"kilter {shlex.join(command)}",
        version_id=version_id,
        campaign_id=campaign_id,
        job_id=job_id,
        causes=[*causes],
    )


SOURCES = {
    "evaluation": "on rows that no fit used",
    "check": "on the rows of a check, which no fit used",
    "held_out": "on rows that its own job held out",
    "fitted": "on the rows it was fitted to, which flatters",
}


def describe_today(today: Today) -> list[str]:
    """Say how good the robot is, whether that has changed, and what nobody has looked at."""
    return list(_sentences(today))


def _sentences(today: Today) -> Iterator[str]:
    if today.version_id is None:
        yield "No version is active: the arm is as good as its nominal description."
    elif today.newest is None:
        yield "How good the arm is, is not known: the active version was made without measurements of the tool."
    else:
        yield from _numbers(today, today.newest)
    if today.not_evaluated:
        named = "; ".join(f"{one.name}, {one.when}" for one in today.not_evaluated)
        yield (
            f"Measured since then and not evaluated: {named}. Evaluate it: `kilter version evaluate {today.robot} --campaign "
            f"{today.not_evaluated[-1].id}`."
        )
    if today.missing is not None:
        yield today.missing.sentence


def _numbers(today: Today, newest: ErrorsToday) -> Iterator[str]:
    assert newest.errors.identified is not None
    mean, aside = newest.errors.identified.mean_mm, left_out(newest.errors.left_out)
    most = largest(newest, today.own)
    ends = interval(newest.errors.identified, newest.errors.n)
    known = f" (95 % interval {said_of_error(ends[0], most)} to {said_of_error(ends[1], most)})" if ends else ""
    yield f"Mean error {said_of_error(mean, most)}{known} {newest.rows}{aside}: {describe_source_rows(newest)}."
    if today.compared:
        yield today.compared
    if newest.source == "fitted":
        yield "Nothing was held out: measure some poses that are only checked (kilter upload --role confirmation)."


def rows(source: str, refit: Sequence[str]) -> str:
    """Say which rows errors are of, and what was fitted to them."""
    return SOURCES[source] + (f", {' and '.join(refit)} fitted to them" if refit else "")


def largest(*errors: ErrorsToday | None) -> float:
    """Return the largest of the errors that stand beside each other, mm: the unit of all is that of this one."""
    known = [(one.errors.identified, one.errors.n) for one in errors if one is not None]
    return max((widest(found, n) for found, n in known if found is not None), default=0.0)


def describe_change(
    robot: str,
    newest: ErrorsToday | None,
    own: ErrorsToday | None,
    larger_by_mm: float | None,
    largest_mm: float | None = None,
) -> str:
    """Say whether the arm is worse than the version's own job said; empty where nothing else is known of it.

    ``largest_mm``: of other robots beside it, whose unit the numbers then have.
    """
    if newest is None or own is None or own.errors.identified is None or own.job_id == newest.job_id:
        return ""
    most = max(largest(newest, own), largest_mm or 0.0)
    mean, day = said_of_error(own.errors.identified.mean_mm, most), f"{own.at:%Y-%m-%d}"
    alarm = newest.alarm
    if larger_by_mm is None and alarm is not None:
        return f"Its own job said {mean} ({day}), not more than chance explains, but the check says {alarm.partition('. ')[0]}."
    if larger_by_mm is None:
        return f"Its own job said {mean} ({day}); the difference is not more than chance explains."
    command = f"`kilter version evaluate {robot} --campaign {newest.campaigns[0].id} --refit base`"
    anew = f" Where the instrument was set up anew, evaluate with `--refit base` first: {command}."
    if alarm is not None:
        command = f"`kilter check {robot} --campaign {newest.campaigns[0].id} --new-setup base`"
        anew = f" The check says so too. Where the instrument was set up anew: {command}."
    more = said_of_error(larger_by_mm, most)
    return (
        f"That is {more} more than the {mean} its own job said ({day}), more than chance explains: "
        "the arm, or what it was measured with, has changed." + ("" if newest.refit else anew)
    )


def left_out(rows: int | None) -> str:
    """Say how many rows a number leaves out, after a comma; nothing where it has all of them, or nobody knows."""
    return f", {plural(rows, 'row')} left out" if rows else ""


def describe_source_rows(found: ErrorsToday) -> str:
    """Say which rows, and from when."""
    named = "; ".join(f"campaign {one.name}, {one.when}" for one in found.campaigns) or "campaigns that are gone"
    return named


def ago(days: int) -> str:
    """Say how many days ago something was."""
    return "today" if days == 0 else f"{plural(days, 'day')} ago"


def describe_measurement_time(at: datetime, days: int, *, stated: bool) -> str:
    """Say when rows were measured, or that only their upload is known."""
    if stated:
        return f"measured on {at:%Y-%m-%d}, {ago(days)}"
    return f"sent on {at:%Y-%m-%d}, {ago(days)} (when it was measured is not stated)"
