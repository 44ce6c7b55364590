"""The result of a check of an arm as text."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

from kilter_client.cli.terminal.output import print_line
from kilter_client.cli.terminal.tables import number, show_list, show_rows

EXIT_CODES = {"ok": 0, "moved": 3, "cannot_tell": 4}
NEVER_SUMMED = (
    "No sums: with frames set up anew, or by a joint log alone, a check does not show every cause, and what creeps is not "
    "seen. Leave the instrument where it stands for some checks."
)
LISTED = 6  # causes of a table, the best first
HISTORY = 6  # newest checks and changes that are shown
FIRST = re.compile(r"; |(?<=[.]) ")  # the rest of a sentence of a check says what it rests on


def show_drift(result: Mapping[str, Any]) -> None:
    """Print the verdict, what to do, what was looked at, and what such rows can show."""
    print_line(result["sentence"])
    if result.get("remedy"):
        print_line(f"  {result['remedy']}")
    if result["verdict"] != "ok":
        _show_causes(result)
    show_smallest(result)
    for warning in result.get("warnings") or ():
        print_line(f"warning: {warning['message']}")


def show_smallest(result: Mapping[str, Any], most: int | None = None) -> None:
    """Print which changes rows show in 95 % of the checks, and which they do not; of the former ``most`` at most."""
    rows = [(one["words"], f"{number(one['value'], 2)} {one['unit']}") for one in result.get("smallest") or ()]
    if rows:
        show_rows(("such rows show", "from a change of"), rows[:most])
        if most is not None and len(rows) > most:
            print_line(f"and {len(rows) - most} more changes (--json)")
        print_line(
            f"in 95 % of the checks; an arm that has not moved alarms in {number(result['false_alarm'])} of them at most"
        )
    if result.get("unseen"):
        print_line(f"they do not show: {', '.join(result['unseen'])}")
    for sentence in result.get("faint") or ():
        print_line(sentence)


def show_history(found: Mapping[str, Any]) -> None:
    """Print how a robot stands, its checks with what was done between them, and the charts that say most."""
    print_line(f"{found['robot']}: {found['sentence']}")
    events = [(str(one["at"]), one["verdict"].replace("_", " "), one["sentence"]) for one in found["history"]]
    events += [(str(one["at"]), one["what"], _said_of_mark(one)) for one in found["marks"]]
    events.sort(key=itemgetter(0))
    if left := max(len(events) - HISTORY, 0):
        print_line(f"{left} older checks and changes: --json")
    show_rows(
        ("when", "", ""), [(at[:16].replace("T", " "), what, FIRST.split(said)[0]) for at, what, said in events[left:]]
    )
    charts = sorted(found["charts"], key=_height, reverse=True)[:LISTED]
    rows = [
        (
            one["words"],
            f"{number(_latest_value(one['values']), 3)} {one['unit']}",
            number(one["scatter"], 2),
            f"{number(_height(one), 2)} of {number(one['limit'], 2)}",
            str(one["since"] or "")[:10],
        )
        for one in charts
    ]
    if rows:
        show_rows(("chart", "last", "scatter", "sum", "since"), rows)
    elif found["checks"]:
        whole = any(one["whole"] for one in found["history"] if one["version_id"] == found["version_id"])
        print_line("The sums over many checks begin with the fourth that agrees." if whole else NEVER_SUMMED)


def _said_of_mark(one: Mapping[str, Any]) -> str:
    return f"{one['note']} ({one['repair_id']})" if one.get("repair_id") else str(one["version_id"])


def _latest_value(values: Sequence[float | None]) -> float:
    """The number of the last check that shows it."""
    return next((value for value in reversed(values) if value is not None), 0.0)


def _height(chart: Mapping[str, Any]) -> float:
    """The larger sum at the last check that has one."""
    return max(next((value for value in reversed(chart[way]) if value is not None), 0.0) for way in ("up", "down"))


def show_robots(found: Mapping[str, Any]) -> None:
    """Print how all robots stand, the worst first."""
    rows = [
        (
            one["robot"],
            one["state"].replace("_", " "),
            str(one["checks"]),
            "" if one["age_days"] is None else f"{one['age_days']} days ago",
            FIRST.split(one["sentence"], maxsplit=1)[0],
        )
        for one in found["robots"]
    ]
    show_list(("robot", "stands", "checks", "last", ""), rows)


def _show_causes(result: Mapping[str, Any]) -> None:
    rows = [
        (one["words"], _changes(one), number(one["gain"], 3), "refuted" if one["refuted"] else "may be")
        for one in result["looked_at"][:LISTED]
    ]
    show_rows(("cause", "change", "explains", ""), rows)


def _changes(cause: Mapping[str, Any]) -> str:
    seen = [one for one in cause["numbers"] if one["u95"] is not None]
    if len(cause["numbers"]) == 1:
        return "".join(f"{number(one['change'], 3)} ± {number(one['u95'], 2)} {one['unit']}" for one in seen)
    return ", ".join(
        f"{one['name']} {number(one['change'], 3)} ± {number(one['u95'], 2)} {one['unit']}" for one in seen
    )
