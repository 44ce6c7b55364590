"""Parameter versions: list, show, activate, roll back, compare, export."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.reports.results import MASSES, show_activations, show_active, show_today, show_version
from kilter_client.cli.stored import keeping
from kilter_client.cli.terminal.arguments import Details, Json, Retired, Robot, VersionId
from kilter_client.cli.terminal.output import emit, note, number, print_line, show_list, show_rows
from kilter_client.cli.terminal.references import OfRobot, resolve_reference
from kilter_client.errors import UsageError
from kilter_client.files import files_robots
from kilter_client.requests.calls.versions import NOMINAL
from kilter_client.results.record import decimals, estimate
from kilter_client.results.rows import write_file

STATES = {
    "known": "known",
    "uncertain": "not told apart from 0",
    "held": "not told: shared with base or tool, or not identified",
    "unstated": "nobody says how well it is known",
    "shared": "goes with the table's other numbers: not to be entered alone",
}


def _format_value(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def show(document: dict[str, Any], details: bool) -> None:
    """Print the zero offsets as a table, with ``details`` every number of the export beside its nominal one."""
    if "numbers" not in document:
        return
    if details:
        rows = [
            (one["where"], one["name"], *(_format_value(one[key]) for key in ("nominal", "exported", "difference")))
            for one in document["numbers"]
        ]
        show_rows(("joint or frame", "number", "nominal", "exported", "difference"), rows)
    offsets = []
    for one in document["zero_offsets"]:
        unit = "deg" if "offset_deg" in one else "mm"
        half = one[f"half_width_{unit}"]
        within = "–" if half is None or one["state"] in ("held", "shared") else f"± {half:.2g} {unit}"
        offsets.append((one["joint"], f"{one[f'offset_{unit}']:+.6g} {unit}", within, STATES[one["state"]]))
    show_rows(("joint", "zero offset", "95 %", "how well it is known"), offsets)
    print_line(document["zero_offsets_sign"])


MOST_CHANGES = 12  # of a comparison on a screen
CARRIED = ("link_mass_", "link_moment_", "load_payload_")  # parameters that nobody asked for

group = typer.Typer(
    help="List, name, retire and purge versions; without a command, list those of a robot.",
    rich_markup_mode=None,
    no_args_is_help=True,
    cls=keeping.ListsByDefault,
)


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    keeping.register(group, "version")
    app.add_typer(group, name="versions")
    app.command(epilog="Example: kilter version show ur10 v2")(version)
    app.command(epilog="Example: kilter activate ur10 v2")(activate)
    app.command(epilog="Example: kilter version rollback ur10")(rollback)
    app.command(epilog="Example: kilter today ur10")(today)
    app.command(epilog="Example: kilter version activations ur10")(activations)
    app.command(epilog="Example: kilter version diff ur10 v1 ur10 v2")(diff)
    app.command(epilog="Example: kilter version export ur10 v2 --format json -o ur10.json")(export)


@group.command("list", epilog="Example: kilter version list ur10")
def list_(robot: Robot, retired: Retired = False, as_json: Json = False) -> None:
    """List the versions of a robot."""
    with Kilter() as kilter:
        document = {"versions": kilter.versions.list(robot, retired)}
    emit(document, as_json, _show_list)


def version(version: VersionId, robot: OfRobot = None, details: Details = False, as_json: Json = False) -> None:
    """Show a version: where it comes from, and its parameters."""
    with Kilter() as kilter:
        version = resolve_reference(kilter, "version", version, robot, as_json)
        emit(kilter.versions.get(version), as_json, partial(show_version, details=details))


def activate(
    version: VersionId,
    force: Annotated[bool, typer.Option("--force", help="Even if it predicts worse; the log records it.")] = False,
    reason: Annotated[str, typer.Option("--reason", help="Why, for the log.")] = "",
    robot: OfRobot = None,
    as_json: Json = False,
) -> None:
    """Make a version the one that corrects, unless it predicts worse than the active one."""
    with Kilter() as kilter:
        version = resolve_reference(kilter, "version", version, robot, as_json)
        document = kilter.versions.activate(version, force=force, reason=reason)
        emit(document, as_json, partial(show_active, kilter.url, "active"))


def rollback(robot: Robot, as_json: Json = False) -> None:
    """Return to the version that was active before."""
    with Kilter() as kilter:
        emit(kilter.versions.rollback(robot), as_json, partial(show_active, kilter.url, "active again"))


def today(robot: Robot, as_json: Json = False) -> None:
    """Show how good a robot is today, on rows that no fit used, and what is missing."""
    with Kilter() as kilter:
        emit(kilter.robots.today(robot), as_json, show_today)


def activations(robot: Robot, as_json: Json = False) -> None:
    """List who activated which version, when and why."""
    with Kilter() as kilter:
        document = {"activations": kilter.versions.activations(robot)}
    emit(document, as_json, show_activations)


def diff(
    first: Annotated[
        str,
        typer.Argument(help="A version: id, name, `latest`, `nominal`, or the id of a search.", show_default=False),
    ],
    second: Annotated[str, typer.Argument(help="Another; `nominal` is the nominal robot.", show_default=False)],
    robot: OfRobot = None,
    as_json: Json = False,
) -> None:
    """Compare the parameters of two versions, or of a version and the nominal robot."""
    with Kilter() as kilter:
        both = [_of_diff(kilter, one, robot, as_json) for one in (first, second)]
        document = kilter.versions.diff(*both)
    emit(document, as_json, _show_diff)


def export(
    version: VersionId,
    form: Annotated[str, typer.Option("--format", help="json, urdf, mjcf, usd, dh-csv, ...")] = "json",
    output: Annotated[Path | None, typer.Option("--output", "-o", help="File to write; default is stdout.")] = None,
    ranges: Annotated[
        float | None,
        typer.Option(
            metavar="PERCENT",
            help="Write how far the arm may be from the version, to train with: ranges that cover so much (95), and draws.",
        ),
    ] = None,
    robot: OfRobot = None,
    details: Details = False,
    as_json: Json = False,
) -> None:
    """Write a version as a file for other programs."""
    if ranges is not None:
        if form not in ("json", "ranges"):
            raise UsageError(f"--ranges writes a file of its own: leave --format {form} out, and export that apart.")
        form = "ranges"
    if as_json and output is None:
        raise UsageError("--json reports what was written: name the file with -o.")
    with Kilter() as kilter:
        version = resolve_reference(kilter, "version", version, robot, as_json)
        content = kilter.versions.export(version, form, ranges_percent=ranges)
    for said in content.notes:
        note(f"Note: {said}", as_json)
    if output is None:
        typer.get_binary_stream("stdout").write(content)
        return
    write(output, content)
    document = {"version_id": version, "format": form, "output": str(output), "bytes": len(content)}
    document["notes"] = list(content.notes)
    emit(document | files_robots.lists_of_export(content), as_json, partial(_show_written, details=details))


def _show_written(document: dict[str, Any], details: bool) -> None:
    show(document, details)
    print_line(f"{document['output']}: {document['bytes']} bytes")


def write(output: Path, content: bytes) -> None:
    """Write a file of the person's choice.

    Raises:
        FileError: it cannot be written.

    """
    write_file(content, output)


def _show_list(document: dict[str, Any]) -> None:
    rows = [
        (
            "*" if v["active"] else "",
            v["id"],
            v["name"] + (" (retired)" if v["retired_at"] else ""),
            _effects(v["effects"]) + ("; torques" if v.get("torques") else ""),
            _held_out(v["metrics"]),
            v["parent_id"] or "",
            str(v["created_at"])[:16].replace("T", " "),
        )
        for v in document["versions"]
    ]
    show_list(("", "version", "name", "effects", "mean mm", "parent", "made"), rows)


def _effects(ids: list[str]) -> str:
    own = ", ".join(name for name in ids if name != MASSES) or "geometry"
    return f"{own}; masses uncertain" if MASSES in ids else own


def _held_out(metrics: dict[str, Any]) -> str:
    """The mean error of the identified model, on held-out rows where there were some."""
    for name, words in (("validation", "unseen"), ("train", "fitted")):
        stage = (metrics.get(name) or {}).get("identified")
        if stage:
            return f"{number(stage.get('mean_mm'), 2)} {words}"
    return ""


def _of_diff(kilter: Kilter, one: str, robot: str | None, as_json: bool) -> str:
    """The id of what is compared: a version, the job that made one, or the nominal robot."""
    if one == NOMINAL:
        return one
    return resolve_reference(kilter, "job" if one.startswith("job_") else "version", one, robot, as_json)


def _show_diff(document: dict[str, Any]) -> None:
    print_line((document.get("paired") or {}).get("sentence") or document.get("not_paired") or "")
    for word in ("added", "removed"):
        if document[f"effects_{word}"]:
            print_line(f"effects {word}: {', '.join(document[f'effects_{word}'])}")
    sides = [NOMINAL if document[key] == NOMINAL else word for key, word in (("a", "first"), ("b", "second"))]
    moved = sorted(
        (p for p in document["parameters"] if p.get("moved", True)), key=lambda p: p["name"].startswith(CARRIED)
    )
    if moved:
        show_rows(("parameter", *sides, "change", "unit"), [_comparison_row(p) for p in moved[:MOST_CHANGES]])
    rest, hidden = len(document["parameters"]) - len(moved), len(moved) - MOST_CHANGES
    said = [f"{hidden} more differ"] if hidden > 0 else []
    said += [f"{rest} differ by less than their uncertainty or not at all"] if rest else []
    if said:
        print_line(f"{', and '.join(said)}; --json has them.")


def _comparison_row(p: dict[str, Any]) -> tuple[str, ...]:
    """A row of a comparison; the change has the digits that the less certain of both allows."""
    values = [
        number(p[key], 7) if p.get(f"sigma_{key}") is None else estimate(p[key], decimals(p[f"sigma_{key}"]))
        for key in ("a", "b")
    ]
    known = [sigma for sigma in (p.get("sigma_a"), p.get("sigma_b")) if sigma is not None]
    return p["name"], *values, estimate(p["change"], decimals(max(known)) if known else None), p["unit"]
