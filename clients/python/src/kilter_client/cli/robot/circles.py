"""``kilter robot from-circles`` and ``kilter robot frame``: a robot without a data sheet, and a frame from digitised points."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal.arguments import ColumnMap, File, Json
from kilter_client.cli.terminal.output import emit, note, print_line, show_rows
from kilter_client.errors import FileError
from kilter_files import prepare
from kilter_files.robots import checked_name, plain_name, read_text

FEATURES = ("plane", "line", "origin")
MEASURED, KNOWN = ("x_mm", "y_mm", "z_mm"), ("known_x_mm", "known_y_mm", "known_z_mm")


def register(robot: typer.Typer) -> None:
    """Add the commands to ``kilter robot``."""
    robot.command("from-circles", epilog="Example: kilter robot from-circles circles.csv --name arm -o arm.json")(
        from_circles
    )
    robot.command(epilog="Example: kilter robot frame digitised.csv --into arm.json")(frame)


def from_circles(
    file: File,
    name: Annotated[str | None, typer.Option(help="The robot's name; default is the file's.")] = None,
    convention: Annotated[
        str, typer.Option(metavar="CONVENTION", help="chain, dh, mdh, s_model, poe, cpc or mcpc.")
    ] = "chain",
    base: Annotated[
        Literal["axis", "device"], typer.Option(help="Base frame: on the first axis, or the device's own.")
    ] = "axis",
    column_map: ColumnMap = None,
    follows: Annotated[
        list[str] | None,
        typer.Option(metavar="J3=J2", help="J3 is read against the horizontal: uncouple it from J2 (repeat)."),
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write robot.json there.", dir_okay=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Find a robot from circles: points measured while one joint moved at a time; nothing is added."""
    named = checked_name(name) if name else plain_name(file.stem)
    prepared = prepare(file, column_map=column_map)
    with Kilter() as kilter:
        found = kilter.robots.from_circles(prepared, named, convention, base, [pair.lower() for pair in follows or ()])
    if output is not None:
        write(output, (json.dumps(found["robot"], indent=1) + "\n").encode())
        note(f"{output}: add it with `kilter robot add {output}`", as_json)
    emit(found, as_json, _show_axes)


def frame(
    file: File,
    into: Annotated[
        Path | None, typer.Option(help="Write the frame into this robot.json as its base.", exists=True, dir_okay=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Find a frame from digitised points: known points measured again, or a plane, a line in it and an origin."""
    with Kilter() as kilter:
        found = kilter.robots.frame(read_points(file))
    if into is not None:
        document = json.loads(read_text(into))
        write(into, (json.dumps({**document, "base": found["pose"]}, indent=1) + "\n").encode())
        note(f"{into}: base written", as_json)
    emit(found, as_json, _show_frame)


def read_points(file: Path) -> dict[str, Any]:
    """Read digitised points: x_mm, y_mm, z_mm beside known_x_mm ..., or beside a column feature (plane, line, origin).

    Raises:
        FileError: other columns, a cell that is not a number, or an unknown feature; file and line are named.

    """
    rows = list(csv.DictReader(read_text(file).splitlines()))
    columns = set(rows[0]) if rows else set()
    if set(MEASURED) | set(KNOWN) <= columns:
        points = [
            {
                "name": row.get("name") or str(k),
                "known_mm": _numbers(file, k, row, KNOWN),
                "measured_mm": _numbers(file, k, row, MEASURED),
            }
            for k, row in enumerate(rows, 1)
        ]
        return {"points": points}
    if not set(MEASURED) | {"feature"} <= columns:
        raise FileError(
            f"{file}: does not have the columns {', '.join(MEASURED)} with either {', '.join(KNOWN)} or feature "
            f"({', '.join(FEATURES)}).",
            file=str(file),
        )
    found: dict[str, list[list[float]]] = {name: [] for name in FEATURES}
    for k, row in enumerate(rows, 1):
        if row["feature"] not in found:
            raise FileError(
                f"{file}, line {k + 1}: feature is {row['feature']!r}: give {', '.join(FEATURES)}.", file=str(file)
            )
        found[row["feature"]].append(_numbers(file, k, row, MEASURED))
    if len(found["origin"]) != 1:
        raise FileError(f"{file}: {len(found['origin'])} rows have the feature origin: give one.", file=str(file))
    return {"features": {"plane_mm": found["plane"], "line_mm": found["line"], "origin_mm": found["origin"][0]}}


def _numbers(file: Path, k: int, row: dict[str, str], names: tuple[str, ...]) -> list[float]:
    try:
        return [float(row[name]) for name in names]
    except (TypeError, ValueError) as error:
        raise FileError(f"{file}, line {k + 1}: {', '.join(names)} must be numbers.", file=str(file)) from error


def _show_axes(found: dict[str, Any]) -> None:
    rows = [
        (
            axis["joint"],
            axis["kind"],
            str(axis["rows"]),
            f"{axis['arc_deg']:.1f} deg" if axis["kind"] == "revolute" else f"{axis['stroke_mm']:.1f} mm",
            "" if axis["radius_mm"] is None else f"{axis['radius_mm']:.1f}",
            f"{axis['rms_mm']:.4f}",
            f"{axis['sigma_deg']:.4f}",
            f"{axis['sigma_mm']:.4f}",
        )
        for axis in found["axes"]
    ]
    show_rows(("joint", "kind", "rows", "moved", "radius mm", "off mm", "axis ± deg", "axis ± mm"), rows)
    print_line(f"the whole robot is {found['rms_mm']:.4g} mm (rms) from all rows")


def _show_frame(found: dict[str, Any]) -> None:
    print_line(json.dumps(found["pose"]))
    show_rows(("point", "off mm"), [(point["name"], f"{point['left_mm']:.4f}") for point in found["points"]])
    print_line(f"rms {found['rms_mm']:.4g} mm")
