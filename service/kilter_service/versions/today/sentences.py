"""Today in words. A number says of which rows it is, and from when."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime

from kilter_service.contract.today import ErrorsToday, Today
from kilter_service.contract.words import interval, said_of_error, widest
from kilter_service.ground.texts import plural

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
