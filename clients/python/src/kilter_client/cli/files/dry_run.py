"""``kilter upload --dry-run``: what a file holds and what would be refused, before anything is stored."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_client import Kilter
from kilter_client.cli.terminal.output import print_line
from kilter_client.cli.terminal.references import resolve_reference
from kilter_client.cli.terminal.tables import number, show_rows
from kilter_client.cli.terminal.wording import in_words, parameters_by_request_name
from kilter_client.errors import KilterError
from kilter_client.verbs.dry_run import checked_here, checked_rows
from kilter_files import Prepared

Document = dict[str, Any]

LOAD_UNITS = {"kg": "kg", "mm": "mm", "m": "m", "n": "N", "nm": "N m"}


def what_it_holds(
    robot: str, prepared: Prepared, wanted: Mapping[str, Any], campaign: str | None = None, as_json: bool = False
) -> Document:
    """Return ranges, poses, repeats, loads, directions, and what rules left out or would refuse.

    ``wanted`` is the campaign that an upload would make, or ``campaign`` the one that it would add to.
    """
    known = {"rows": prepared.rows, "sha256": prepared.sha256}
    try:
        kilter = Kilter()
    except KilterError as error:  # a dry run needs no server
        return known | checked_here(prepared, wanted["conditions"], error)
    with kilter:
        into = resolve_reference(kilter, "campaign", campaign, robot, as_json, "--campaign") if campaign else None
        return known | kilter.run(checked_rows(robot, prepared, wanted, into, _rephrase_for_upload))


def _rephrase_for_upload(detail: str) -> str:
    return in_words(detail, parameters_by_request_name(["upload"]))


def show_dry_run(document: Document) -> None:
    """Print it for people."""
    rows = [
        (c["name"], c["unit"], *("" if c[k] is None else f"{c[k]:.6g}" for k in ("low", "high")), str(c["empty"] or ""))
        for c in document.get("ranges", ())
    ]
    if rows:
        show_rows(("column", "unit", "lowest", "highest", "empty"), rows)
        print_line(f"rows: {document['rows']}")
        print_line(f"poses: {_poses(document['poses'])}")
        print_line(f"loads: {_loads(document['loads'])}")
        print_line(f"directions: {_directions(document['directions'])}")
    for text in document["left_out"]:
        print_line(f"left out: {text}")
    for text in document["refused"]:
        print_line(f"would be refused: {text}")
    if not document["refused"]:
        print_line("would be refused: nothing found")
    for text in document["odd"]:
        print_line(f"looks odd: {text}")
    if document["not_checked"]:
        print_line(f"not checked: {document['not_checked']}")
    print_line("Nothing was stored.")


def _poses(poses: Document | None) -> str:
    if poses is None:
        return "not known"
    visits, rows = (_span(poses[key]) for key in ("visits_per_pose", "rows_per_pose"))
    repeats = "none is repeated" if not poses["repeated"] else f"{poses['repeated']} of them repeated"
    counted = f"{visits} visit{'' if visits == '1' else 's'} per pose ({rows} row{'' if rows == '1' else 's'})"
    return f"{poses['count']} by {poses['by']}, {counted}, {repeats}"


def _span(pair: list[int]) -> str:
    return str(pair[0]) if pair[0] == pair[1] else f"{pair[0]} to {pair[1]}"


def _loads(loads: Document) -> str:
    said = []
    for name, values in loads.items():
        unit = LOAD_UNITS.get(name.rpartition("_")[2], "")
        if name.endswith("_distinct"):
            continue
        listed = values if isinstance(values, list) else [values]
        many = loads.get(f"{name}_distinct")
        text = (
            f"{number(listed[0])} to {number(listed[-1])}, {many} different" if many else ", ".join(map(number, listed))
        )
        of_all = name.removeprefix("campaign_")
        said.append(f"{of_all.rpartition('_')[0]} {text} {unit}" + (" (whole campaign)" if of_all != name else ""))
    return "; ".join(said) or "not given (payload_kg, or --payload-kg)"


def _directions(directions: Document) -> str:
    parts = [f"{name} {count['-1']} down, {count['0']} unknown, {count['1']} up" for name, count in directions.items()]
    return "; ".join(parts) or "not given (dir1 ...)"
