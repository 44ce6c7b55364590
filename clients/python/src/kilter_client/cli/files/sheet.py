"""``kilter measure sheet``, ``kilter measure sheet-read``: print the pencil sheet, and read it back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from kilter_client.cli.files.inspect import check_numpy
from kilter_client.cli.stored.versions import write
from kilter_client.cli.terminal.arguments import File, Json
from kilter_client.cli.terminal.output import emit, note, print_line, say_remarks, show_rows
from kilter_client.errors import MissingPackageError, UsageError
from kilter_client.files import files_formats, files_rig
from kilter_client.results.plots import draw
from kilter_files import read_joints
from kilter_files.ground import read_head
from kilter_files.ground.later import np
from kilter_files.rig import save_sheet, sheet_for

if TYPE_CHECKING:
    from kilter_files.rig import Circle

PACKAGES = "numpy scipy opencv-python-headless pillow pypdfium2 reportlab"
RadiusMm = Annotated[
    float | None, typer.Option("--radius-mm", help="The sheet's radius, where its marker is missing; else checked.")
]
PageNumber = Annotated[int, typer.Option("--page", min=1, help="Page of a PDF.")]
BarsMm = Annotated[
    str | None,
    typer.Option("--bars-mm", metavar="X,Y", help="The two scale bars as measured on the paper, across and upright."),
]
AllowGaps = Annotated[bool, typer.Option("--allow-gaps", help="Accept a line with gaps.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.command("sheet", epilog="Example: kilter measure sheet --radius-mm 80 -o sheet.pdf")(sheet)
    app.command("sheet-read", epilog="Example: kilter measure sheet-read scan.png --plot error.svg")(sheet_read)
    app.command(
        "sheet-join",
        epilog="Example: kilter measure sheet-join scan.png joints.csv --points points.csv --height rig.tdms -o rows.csv",
    )(sheet_join)


def sheet(
    radius_mm: Annotated[float, typer.Option("--radius-mm", help="Radius of the circle to draw along.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="sheet.pdf or sheet.svg.")],
    page: Annotated[
        Literal["a4", "a3", "letter"] | None,
        typer.Option(help="Paper; largest radius 87 mm (A4), 90 (letter), 130.5 (A3); default is A4, else A3."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write the sheet to print for the pencil: circle, quarter points, markers, scale bars, in true mm."""
    made = sheet_for(radius_mm, page)
    size = save_sheet(made, output)
    document = {
        "file": str(output),
        "bytes": size,
        "page": made.page,
        "radius_mm": made.radius_mm,
        "gaps": made.dashes,
        "bar_mm": made.bar_mm,
    }
    emit(document, as_json, _show_sheet)


def sheet_read(
    file: File,
    radius_mm: RadiusMm = None,
    page: PageNumber = 1,
    bars_mm: BarsMm = None,
    allow_gaps: AllowGaps = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write the errors as CSV.", dir_okay=False)
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Draw the errors: .png or .svg.", dir_okay=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Read a scan or photo of a drawn sheet (PNG, JPEG, PDF): how far the line is from the circle, by angle."""
    if plot is not None and plot.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"--plot {plot}: end it in .png or .svg.")
    reading = read(file, radius_mm, page, bars_mm, allow_gaps)
    if output is not None:
        write(output, files_rig.to_csv(reading))
        note(f"{output}: {len(reading.angle_deg)} angles", as_json)
    if plot is not None:
        draw(files_rig.figure(reading), plot.with_suffix(""), (plot.suffix.lower().removeprefix("."),))
        note(f"{plot}: drawn", as_json)
    emit(reading.to_document(), as_json, _show_reading)


def sheet_join(
    file: File,
    joints: Annotated[
        Path, typer.Argument(help="Joint log with commanded x_mm, y_mm, z_mm.", metavar="JOINTS", exists=True)
    ],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="Where the rows go, as CSV.")],
    points: Annotated[
        Path | None,
        typer.Option(
            help="CSV of quarter points 1 to 4 in the robot's base: x_mm, y_mm, z_mm; else rows are in the sheet's.",
            exists=True,
        ),
    ] = None,
    faces_down: Annotated[
        bool, typer.Option("--faces-down", help="The sheet's face is below, as on a ceiling.")
    ] = False,
    height: Annotated[
        Path | None, typer.Option(help="Log of the potentiometer: TDMS, CSV or .mat.", exists=True, dir_okay=False)
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Its channel or column.")] = None,
    calibration: Annotated[str | None, typer.Option(metavar="V:MM,V:MM", help="Volts to mm by gauge blocks.")] = None,
    height_time: Annotated[str | None, typer.Option(help="Its time column, where its name does not say so.")] = None,
    height_starts_s: Annotated[float, typer.Option(help="Time of the joint log at which it begins.")] = 0.0,
    take_command: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Use the command for what was not measured, with this uncertainty."),
    ] = None,
    joints_map: Annotated[
        Path | None, typer.Option(help="Column map of the joint log (TOML).", exists=True, dir_okay=False)
    ] = None,
    radius_mm: RadiusMm = None,
    page: PageNumber = 1,
    bars_mm: BarsMm = None,
    allow_gaps: AllowGaps = False,
    as_json: Json = False,
) -> None:
    """Join a drawn sheet (or a ball bar's log) and the tool's height with the joint log: rows for kilter upload."""
    if take_command is not None and not 0 < take_command < 100:
        raise UsageError(f"--take-command {take_command:g}: give mm above 0, for example 1.")
    check_numpy()
    volts = None if calibration is None else files_rig.read_calibration(calibration)
    heights = None if height is None else files_rig.read_heights(height, channel, volts, height_time)
    circle = _circle(file, radius_mm, page, bars_mm, allow_gaps)
    frame = (
        files_rig.Frame.sheet_frame()
        if points is None
        else files_rig.register(points, files_rig.read_points(points), circle.radius_mm, faces_down)
    )
    log = read_joints(joints, joints_map)
    joined = files_rig.join(
        circle, log, heights, frame, files_rig.JoinOptions(starts_s=height_starts_s, taken_mm=take_command)
    )
    joined.table.notes.append(
        f"upload it with --device {'ballbar' if circle.is_bar else 'pencil'}: identify then checks which quarter is the first, "
        "and gives it a base of its own"
    )
    write(output, joined.table.to_csv())
    document = {"file": str(output), "notes": joined.table.notes, "warnings": joined.table.warnings} | joined.report
    emit(document, as_json, _show_join)


def _circle(file: Path, radius_mm: float | None, page: int, bars_mm: str | None, allow_gaps: bool) -> Circle:
    """Errors of the circle in a scan, or in a ball bar's log."""
    if read_head(file, 1024).lstrip()[:4] not in (b"%PDF", b"\x89PNG") and read_head(file, 2) != b"\xff\xd8":
        bar = files_formats.read_ballbar(file, radius_mm)
        out, turn = bar.radius_mm - bar.nominal_mm, np.radians(bar.angle_deg)
        return files_rig.Circle(
            file, bar.nominal_mm, turn, out, np.full(len(out), files_formats.BAR_SIGMA_MM), None, None, True
        )
    found = read(file, radius_mm, page, bars_mm, allow_gaps)
    turn = np.radians(found.angle_deg)
    return files_rig.Circle(
        file, found.sheet.radius_mm, turn, found.out_mm, found.out_sigma_mm, found.along_mm, found.along_sigma_mm
    )


def read(file: Path, radius_mm: float | None, page: int, bars_mm: str | None, allow_gaps: bool) -> Any:
    """Read a sheet with the options of the command line.

    Raises:
        UsageError: bars that are not two lengths.
        MissingPackageError: the extra ``sheet`` is not installed.

    """
    try:
        from kilter_files.rig import Options, read_sheet
    except ImportError as error:
        raise MissingPackageError(
            f"Reading a pencil sheet needs {error.name}. Install it with: pip install {PACKAGES}",
            package=str(error.name),
        ) from error
    return read_sheet(file, Options(radius_mm, page, bars(bars_mm), allow_gaps))


def bars(text: str | None) -> tuple[float, float] | None:
    """Understand --bars-mm: two lengths, or one for both.

    Raises:
        UsageError: something else.

    """
    if text is None:
        return None
    try:
        lengths = [float(part) for part in text.split(",")]
    except ValueError:
        lengths = []
    if len(lengths) not in (1, 2) or not all(1 < length < 1000 for length in lengths):
        raise UsageError(f"--bars-mm {text}: give the length of both bars in mm, for example 89.8,90.1.")
    return lengths[0], lengths[-1]


def _show_join(document: dict[str, Any]) -> None:
    print_line(f"{document['file']}: {document['rows']} rows for kilter upload")
    say_remarks(document)
    if any(document["frame"]["left_mm"]):
        print_line(f"  the four points fit the sheet within {max(document['frame']['left_mm']):.3f} mm")
    print_line(f"  rms distance from the command: {document['off_command_rms_mm']:.3f} mm")


def _show_sheet(document: dict[str, Any]) -> None:
    print_line(
        f"{document['file']}: {document['page'].upper()}, radius {document['radius_mm']:g} mm, {document['gaps']} gaps"
    )
    print_line(f"  Print it at 100 % and measure both scale bars: {document['bar_mm']:g} mm.")


def _show_reading(document: dict[str, Any]) -> None:
    line, placing = document["line"], document["placing"]
    print_line(f"{document['file']}: sheet of radius {document['radius_mm']:g} mm, {placing['dpi']:.0f} dpi")
    say_remarks(document)
    marks = f"{placing['marks']} marks within {placing['marks_rms_mm']:.3f} mm"
    print_line(f"  {marks}; line {line['width_mm']:.2f} mm wide, seen in {line['seen']} of {line['gaps']} gaps")
    errors = f"mean {line['mean_abs_mm']:.3f}, rms {line['rms_mm']:.3f}, largest {line['max_abs_mm']:.3f} mm"
    print_line(f"  error out of the circle: {errors}; mean radius {line['radius_mm']:.3f} mm")
    head = {"angle_deg": "deg", "out_mm": "out mm", "out_sigma_mm": "sigma", "along_mm": "along mm"}
    head |= {"along_sigma_mm": "sigma"}
    names = [name for name in head if name in document["rows"][0]]
    rows = [tuple(_cell(row[name], name) for name in names) for row in document["rows"]]
    show_rows([head[name] for name in names], rows, numbers=True)


def _cell(value: float | None, name: str) -> str:
    return "" if value is None else f"{value:.2f}" if name == "angle_deg" else f"{value:.3f}"
