"""A robot added on the page: what somebody described, what it comes to, and the arm at zero as figures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import Form, Request, Response
from fastapi.responses import HTMLResponse
from pydantic import ValidationError

from kilter_core.arm import preset_names
from kilter_files.ground import KilterError, UsageError
from kilter_files.robots import Described, read_robot
from kilter_service.contract.robots import RobotDocument
from kilter_service.contract.units import ControllerCompensation
from kilter_service.ground.errors import ServiceError
from kilter_service.page.answers import redirect, render, router
from kilter_service.page.drop.drafts import plain_name
from kilter_service.page.figures.plot import BOTTOM, CORRECTED, LEFT, RIGHT, TOP, Axis, Plot
from kilter_service.page.shared.asking import parse_goals
from kilter_service.page.words import validation_words
from kilter_service.robots import service as robots
from kilter_service.robots.check import check
from kilter_service.robots.compensation import WORDS
from kilter_service.robots.wire import DOCUMENT
from kilter_service.web.auth.access import Admin
from kilter_service.web.bodies import compute
from kilter_service.web.routing import DatabaseOfApp, get_scratch

if TYPE_CHECKING:
    from kilter_service.contract.robot_reports import RobotCheck


SIDE = 260.0  # of a figure, pixels
ROOM = 1.15
ENDINGS = (".urdf", ".xml", ".csv", ".tsv", ".txt", ".json", ".yaml", ".yml", ".conf", ".cfg")
VIEWS = (("From the side", 0, 2), ("From the front", 1, 2), ("From above", 0, 1))


@dataclass(frozen=True)
class Told:
    """What the form says: a preset, or the text of a file with what the file does not say itself."""

    name: str
    preset: str = ""
    text: str = ""
    file: str = ""
    table: str = ""
    base_link: str = ""
    tip_link: str = ""
    compensation: str = "unknown"


def preview_robot(told: Told, folder: Path) -> dict[str, Any]:
    """Say what a description comes to, with the arm at zero, drawn; nothing is stored.

    ``text`` is the document, to be sent back when the robot is added.

    Raises:
        ServiceError: something is missing, or the text is not a robot.
        RobotError: the document cannot be an arm.

    """
    document = read({**_document_from_form(told, folder), "controller_compensation": told.compensation})
    report = check(document)
    return {"check": report, "drawn": draw(report), "text": document.model_dump_json(exclude_none=True)}


def read(document: object) -> RobotDocument:
    """Check the form of a document.

    Raises:
        ServiceError: it is not one.

    """
    try:
        return DOCUMENT.validate_python(document)
    except ValidationError as error:
        raise ServiceError(
            f"This does not describe a robot: {validation_words(error, 1)}.", code="payload_invalid"
        ) from error


def parse_posted_document(text: str) -> RobotDocument:
    """Read the document that was shown.

    Raises:
        ServiceError: it is not one.

    """
    try:
        return read(json.loads(text))
    except ValueError as error:
        raise ServiceError("The document is not JSON: check the robot again.", code="payload_invalid") from error


def _document_from_form(told: Told, folder: Path) -> dict[str, Any]:
    if told.preset:
        return {"name": told.name, "convention": "preset", "preset": told.preset}
    if not told.text.strip():
        raise ServiceError("Choose a preset, or drop a file that describes the arm.", code="payload_invalid")
    path = folder / plain_name(told.file or "robot.json")
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise ServiceError(f"{path.name}: give a file that ends in {', '.join(ENDINGS)}.", code="payload_invalid")
    if ending in (".urdf", ".xml") and not (told.base_link and told.tip_link):
        raise ServiceError(
            "A URDF may hold more than the arm: say which is its first link and which its last.", code="payload_invalid"
        )
    path.write_text(told.text, encoding="utf-8")
    return _from_file(path, told)


def _from_file(path: Path, told: Told) -> dict[str, Any]:
    urdf, table = path.suffix.lower() in (".urdf", ".xml"), path.suffix.lower() in (".csv", ".tsv", ".txt")
    described = Described(
        told.name,
        told.base_link if urdf else None,
        told.tip_link if urdf else None,
        told.table or None if table else None,
    )
    try:
        return read_robot(path, described)
    except UsageError as error:  # its words are those of the command; what a URDF lacks was asked for before
        said = (
            error.detail
            if not table
            else ("Say whether the rows are by Denavit and Hartenberg or by Craig: the same columns, another geometry.")
        )
        raise ServiceError(said, code="payload_invalid") from error
    except KilterError as error:
        raise ServiceError(error.detail.replace(f"{path}", path.name), code="payload_invalid") from error


def draw(check: RobotCheck) -> list[Plot]:
    """Draw the arm at zero from three sides, all to one scale: its base, a point on each axis, flange and tool."""
    points = [tuple(point) for point in check.zero.points_mm]
    half = max(max(abs(a - b) for a in axis for b in axis) for axis in zip(*points, strict=True)) * ROOM / 2 or 1.0
    ends = [(min(axis) + max(axis)) / 2 for axis in zip(*points, strict=True)]
    names = ["base", *(f"axis {place}" for place in range(1, len(points) - 2)), "flange", "tool"]
    table = [[name, *(f"{value:.1f}" for value in point)] for name, point in zip(names, points, strict=True)]
    out = []
    for title, across, up in VIEWS:
        axes = [Axis(f"{'xyz'[k]}, mm", ends[k] - half, ends[k] + half) for k in (across, up)]
        said = f"{title}: the arm at zero."
        plot = Plot(title, axes[0], axes[1], SIDE + LEFT + RIGHT, SIDE + TOP + BOTTOM, description=said, rigid=True)
        plot.table = (["Point", "x, mm", "y, mm", "z, mm"], table)
        xs, ys = [point[across] for point in points], [point[up] for point in points]
        plot.line(xs, ys, colour=CORRECTED, width=4.0)
        out.append(plot.points(xs, ys, colour=CORRECTED, names=names))
    return out


LONGEST = 900_000  # characters of a file
Short = Annotated[str, Form(max_length=200)]


@router.get("/new-robot")
def ask_for_robot(request: Request) -> HTMLResponse:
    """Ask what the robot is."""
    return render(request, "new_robot/new.html", presets=preset_names(), controllers=WORDS)


@router.post("/new-robot/check")
async def check_robot(
    request: Request,
    name: Short,
    preset: Short = "",
    text: Annotated[str, Form(max_length=LONGEST)] = "",
    file: Short = "",
    table: Short = "",
    base_link: Short = "",
    tip_link: Short = "",
    compensation: Annotated[ControllerCompensation, Form()] = "unknown",
) -> HTMLResponse:
    """Show what a description comes to."""
    told = Told(name.strip(), preset, text, file, table, base_link.strip(), tip_link.strip(), compensation)
    with get_scratch(request).folder_for("new-robot") as folder:
        looked = await compute(request, preview_robot, told, folder)
    return render(request, "new_robot/looked.html", looked=looked)


@router.post("/new-robot")
def add(
    request: Request,
    database: DatabaseOfApp,
    _: Admin,
    document: Annotated[str, Form(max_length=2 * LONGEST)],
    tolerance_mm: Short = "",
    check_interval_days: Short = "",
) -> Response:
    """Add the robot that was shown, with how good it must be where that was said."""
    goals = parse_goals(tolerance_mm, check_interval_days)
    report, new = robots.add(database, parse_posted_document(document))
    if new:
        robots.change(database, report.name, goals)
    return redirect(request, f"/robots/{report.name}")
