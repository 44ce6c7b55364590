"""``kilter version residuals``: the residuals of every row, as a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.reports.answer import format_next
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal.arguments import CampaignIds, Json, VersionId, split_names
from kilter_client.cli.terminal.output import emit, print_line, print_lines
from kilter_client.cli.terminal.references import OfRobot, resolve_reference, resolved_all
from kilter_client.errors import UsageError


def register(app: typer.Typer) -> None:
    """Add the command to the ``kilter`` command."""
    app.command(epilog="Example: kilter version residuals ur10 v2 --campaign cmp_1f -o left.csv")(residuals)


def residuals(
    version: VersionId,
    campaign: CampaignIds = None,
    output: Annotated[
        Path | None, typer.Option("--output", "--out", "-o", help="File to write; default is stdout.")
    ] = None,
    form: Annotated[
        Literal["csv", "parquet"] | None, typer.Option("--format", help="By default what the name of the file says.")
    ] = None,
    robot: OfRobot = None,
    as_json: Json = False,
) -> None:
    """Write what a version leaves of every row: errors in mm and in sigma, set aside or not, held out or not."""
    if as_json and output is None:
        raise UsageError("--json reports what was written: name the file with -o.")
    suffix = "parquet" if output is not None and output.suffix == ".parquet" else "csv"
    with Kilter() as kilter:
        version = resolve_reference(kilter, "version", version, robot, as_json)
        used = resolved_all(kilter, "campaign", split_names(campaign), robot, as_json)
        content = kilter.versions.residuals(version, used, form or suffix)
        of = kilter.versions.get(version)
        looked_at = ((used or [one["id"] for one in of["campaigns"]])[0], "--robot", of["robot"])
    if output is None:
        typer.get_binary_stream("stdout").write(content)
        return
    write(output, content)
    document = {"version_id": version, "format": form or suffix, "output": str(output), "bytes": len(content)}
    emit(document, as_json, lambda _: _show_written(document, looked_at))


def _show_written(document: Mapping[str, Any], looked_at: Sequence[str]) -> None:
    print_line(f"{document['output']}: {document['bytes']} bytes")
    print_lines(format_next("measure", "suspicious", *looked_at))
