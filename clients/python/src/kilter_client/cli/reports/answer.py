"""An answer on one screen: the headline, warnings with their remedies, one table, and what is next; the rest by --details.

What to do after an answer: the command to type next, of every command in this one place.
"""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from typing import Any

from kilter_client import Kilter
from kilter_client.cli.reports.gap_report import TORQUE_HEAD, list_torques
from kilter_client.cli.terminal.output import name_ids, number, print_line, screen_columns, table, wrap_line
from kilter_client.results.shown_jobs import MODELS, nominal_words

LINES = 20  # of an answer, but for a table that is longer
MOST_ROWS = 8  # of its table
DETAILS, IN_JSON = "(--details)", "(all: --json)"
CAUSE = 70  # characters that are kept of what is the matter
IN_HEADLINE = {"poses_will_not_tell"}  # warnings that the headline says
ROWS = {"train": "fitted", "validation": "unseen"}
ERRORS = (("mean_mm", "mean mm"), ("rms_mm", "rms mm"), ("p95_mm", "p95 mm"), ("max_mm", "max mm"))


def show_answer(result: Mapping[str, Any], stored: Sequence[str]) -> None:
    """Print the answer of a job or of a version; ``stored`` says where it is stored and what is next."""
    for line in format_answer(result, stored, screen_columns()):
        print_line(line)


def format_answer(result: Mapping[str, Any], stored: Sequence[str], columns: int) -> list[str]:
    """Return the lines of an answer, of at most so many ``columns``."""
    head = [line for one in str(result.get("headline") or "").splitlines() for line in wrap_line(one, columns)]
    foot = [line for one in stored for line in wrap_line(one, columns)]
    middle = _format_table(result, columns)
    warnings = [one for one in result.get("warnings") or () if one.get("code") not in IN_HEADLINE]
    room = max(LINES - len(head) - len(middle) - len(foot), 2)
    return [*head, *fit_messages([f"Warning: {one['message']}" for one in warnings], columns, room), *middle, *foot]


def fit_messages(messages: Sequence[str], columns: int, room: int, rest: str = DETAILS) -> list[str]:
    """Return messages as at most ``room`` lines: whole, or each with its remedy, or the first ones; ``rest`` has all."""
    whole = [wrap_line(one, columns) for one in messages]
    if sum(map(len, whole)) <= room:
        return [line for lines in whole for line in lines]
    short = [wrap_line(_shorten(one, 2 * columns - 6, rest), columns) for one in messages]
    kept: list[str] = []
    for k, lines in enumerate(short):
        left = len(short) - k
        if kept and len(kept) + len(lines) > room - (left > 1):
            return [*kept, f"and {left} more {rest}"]
        kept += lines
    return kept


def _shorten(message: str, characters: int, rest: str) -> str:
    """Return a message of at most so many characters, cut in its middle: its end, where the remedy stands, is kept, and begins
    with a sentence where there is one.
    """
    if len(message) <= characters:
        return message
    head = textwrap.shorten(message, CAUSE, placeholder=" ...")
    tail = textwrap.wrap(message[::-1], characters - len(head) - len(rest) - 2)[0][::-1]  # of whole words
    return f"{head} {tail.partition('. ')[2] or tail} {rest}"


def _format_table(result: Mapping[str, Any], columns: int) -> list[str]:
    """The one table of an answer: what was found, causes of a change, or errors."""
    head: tuple[str, ...]
    rows: list[tuple[str, ...]]
    if result.get("motion") and not result.get("found"):
        head, rows = TORQUE_HEAD, list_torques(result["motion"])
    elif result.get("found") is not None:
        head, rows = (
            ("effect", "joints", "size", "moves tool by", "sure"),
            [_effect_row(one) for one in result["found"]],
        )
    elif result.get("looked_at"):
        head = ("what may have moved", "change")
        alike = [one for one in result["looked_at"] if not one.get("refuted")]
        rows = [_cause(one) for one in alike] if len(alike) > 1 and result.get("verdict") != "ok" else []
    else:
        head, rows = ("rows", "model", *(words for _, words in ERRORS)), list(_errors(result.get("metrics") or {}))
    if not rows:
        return []
    filled = [k for k in range(len(head)) if any(row[k] for row in rows)]
    head, rows = tuple(head[k] for k in filled), [tuple(row[k] for k in filled) for row in rows]
    lines = table(head, rows[:MOST_ROWS], columns).splitlines()
    more = len(rows) - MOST_ROWS
    return [*lines, *([f" and {more} more {DETAILS}"] if more > 0 else []), ""]


def _effect_row(one: Mapping[str, Any]) -> tuple[str, ...]:
    moves = "" if one.get("moves_mm") is None else f"{number(one['moves_mm'], 2)} mm"
    return one["effect"], format_joints(one.get("joints") or ()), one.get("size") or "", moves, one["sure"]


def _cause(one: Mapping[str, Any]) -> tuple[str, ...]:
    seen = [n for n in one.get("numbers") or () if n.get("u95") is not None]
    changes = ", ".join(f"{number(n['change'], 2)} {n['unit']}" for n in seen)
    return one["words"], changes


def _errors(metrics: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Errors by rows and model: of an evaluation those of each campaign; of a fit unseen rows come first."""
    for name in sorted(metrics, key=lambda one: one == "train"):
        block = metrics[name] or {}
        for stage, words in MODELS.items():
            if isinstance(block.get(stage), Mapping):
                means = ((block.get(one) or {}).get("mean_mm") for one in ("nominal", "registration_only"))
                label = nominal_words(*means) if stage == "nominal" else words
                rows = f"{block.get('name') or ROWS.get(name, name)} ({block.get('n', '?')})"
                yield rows, label, *(number(block[stage].get(key), 3) for key, _ in ERRORS)


def format_joints(joints: Sequence[int]) -> str:
    """Write joints shortly: 2-5, 7."""
    runs: list[list[int]] = []
    for joint in sorted(joints):
        if runs and joint == runs[-1][-1] + 1:
            runs[-1].append(joint)
        else:
            runs.append([joint])
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)


Document = Mapping[str, Any]
PLACEHOLDER = "FILE"  # of the person's own


def format_next(*words: str, when: str = "") -> list[str]:
    """Return the line that names a command, its words quoted as a shell needs them, and ``when`` it is next."""
    return [f"Next{when}: kilter {name_ids(shlex.join(words))}"]


def suggest_after_job(kilter: Kilter, job: Document) -> list[str]:
    """Return what to do after a job: with the version that it made or looked at, or about an arm that has moved."""
    result: Document = job.get("result") or {}
    if job["kind"] == "drift" and result:
        if result["verdict"] == "ok":
            return format_next("today", job["robot"])
        return suggest_after_today(kilter.robots.today(job["robot"]))
    if job["kind"] == "plan" and result:
        return format_next("check" if result["purpose"] == "check" else "upload", job["robot"], PLACEHOLDER)
    if job["kind"] == "payload" and result.get("centre_mm"):
        centre = ",".join(f"{value:.0f}" for value in result["centre_mm"])
        load = ["--payload-kg", f"{result['mass_kg']:.3g}", f"--payload-com-mm={centre}"]
        return format_next("upload", job["robot"], PLACEHOLDER, *load, when=", with rows that carry it")
    if result.get("motion") and not result.get("version_id"):  # a log makes a version where it names a start
        weak = any(one["sure"] != "certain" for one in result.get("found") or ())
        when = ", to decide" if weak else ", to see the same in a second log"
        return format_next("plan", "motion", job["robot"], "-o", "motions.csv", when=when)
    return suggest_for_version(kilter.versions.get(result["version_id"])) if result.get("version_id") else []


def suggest_for_version(version: Document) -> list[str]:
    """Return what to do with a version: see how good it is today, look for what it lacks, or activate it.

    What speaks against one says itself what to do.
    """
    if version["active"]:
        return format_next("today", version["robot"])
    if version.get("something_missing"):
        used = [
            _repeat(option, [one["id"] for one in version["campaigns"] if one["use"] == use])
            for option, use in (("--campaign", "train"), ("--validation", "validation"))
        ]
        return format_next("gap", version["robot"], *used[0], *used[1])
    return [] if version.get("objections") else format_next("activate", version["id"])


def suggest_after_upload(kilter: Kilter, robot: str, campaign: str) -> list[str]:
    """Return what to do with a campaign: search in it, on what is held out, or compare the active version with it."""
    others = sorted(kilter.campaigns.list(robot), key=itemgetter("rows"), reverse=True)  # checks have few
    role = next((one["role"] for one in others if one["id"] == campaign), None)
    fitted, held = ([one["id"] for one in others if one["role"] == use] for use in ("train", "validation"))
    if role == "train":
        return format_next("gap", robot, "--campaign", campaign, *_repeat("--validation", held[:1]))
    if kilter.robots.get(robot).get("active_version"):
        return format_next("version", "evaluate", robot, "--campaign", campaign)
    if role == "validation" and fitted:
        return format_next("gap", robot, "--campaign", fitted[0], "--validation", campaign)
    return format_next("upload", robot, PLACEHOLDER)


def suggest_after_today(today: Document) -> list[str]:
    """Return what to do about an arm as it is today: what the server's answer says first, as its page does."""
    steps = today["standing"]["steps"]
    return [f"Next: {name_ids(steps[0]['command'])}"] if steps else []


def _repeat(option: str, values: Sequence[str]) -> list[str]:
    return [word for value in values for word in (option, value)]
