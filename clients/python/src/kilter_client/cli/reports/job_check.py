"""What a job would do, as text: what it uses, what the data determine, what is missing, how long it takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import typer

from kilter_client.cli.terminal.output import emit, print_line
from kilter_client.cli.terminal.tables import number, show_rows

FEW_REASONS = 2  # of one remedy, from which they stand in the JSON alone
MOST_TERMS = 4  # of a sum that anybody would read; longer ones stand in the JSON
HOW = {
    "campaigns": "the campaigns named",
    "fraction": "as asked",
    "folds": "every pose once, in folds",
    "unasked": "a quarter, unasked",
}


def finish_check(told: dict[str, Any], as_json: bool) -> None:
    """Print a check.

    Raises:
        typer.Exit: the job would fail.

    """
    emit(told, as_json, show_check)
    if not told["would_run"]:
        raise typer.Exit(1)


def show_check(told: Mapping[str, Any]) -> None:
    """Print a check: what a job would use and find out, and what it would fail of."""
    print_line(
        f"{told['kind']} of {told['robot']}: {'would run' if told['would_run'] else 'would fail'}; nothing was queued"
    )
    for problem in told["problems"]:
        print_line(f"  {problem['code']}: {problem['message']}")
    rows = [(c["id"], c["name"], c["use"], str(c["rows"]), number(c["poses"])) for c in told["campaigns"]]
    if rows:
        show_rows(("campaign", "name", "use", "rows", "poses"), rows)
    held = told["held_out"]
    if held["how"] != "none":
        print_line(f"held out: {held['poses']} poses, {held['rows']} rows ({HOW[held['how']]})")
    _show_identifiability(told.get("identifiability"))
    testability = told.get("testability")
    if testability:
        print_line(f"{len(testability['testable'])} parameters of effects can be tested")
    _show_missing(told["missing"])
    for limit in told["limited"]:
        print_line(f"note: {limit}")
    last = told["duration_s"]
    print_line(
        f"it would take some {number(last['expected'])} s ({number(last['low'])} to {number(last['high'])} s): {last['basis']}"
    )


def _show_identifiability(told: Mapping[str, Any] | None) -> None:
    if told:
        print_line(
            f"{told['parameters']} parameters, {len(told['identifiable'])} identifiable, rank {told['rank']}; judged with "
            f"{number(told['noise_mm'])} mm of noise ({told['noise_from']})"
        )
        for one in (one for direction in told["null_directions"] for one in direction.get("sums") or ()):
            if len(one["parameters"]) <= MOST_TERMS:
                print_line(f"  {one['sentence']}")


def _show_missing(missing: Sequence[Mapping[str, Any]]) -> None:
    """What the data do not tell, under the remedy that would: the same for dozens of parameters is said once."""
    by_remedy: dict[str, dict[str, list[str]]] = {}
    for one in missing:
        by_remedy.setdefault(one["remedy"], {}).setdefault(one["reason"], []).append(one["what"])
    if by_remedy:
        print_line("not determined by these data:")
    for remedy, reasons in by_remedy.items():
        names = [name for own in reasons.values() for name in own]
        if len(reasons) <= FEW_REASONS:
            for reason, own in reasons.items():
                print_line(f"  {', '.join(own)}: {reason}")
        else:
            print_line(f"  {', '.join(names)} ({len(names)} in all)")
        print_line(f"    {remedy}")
