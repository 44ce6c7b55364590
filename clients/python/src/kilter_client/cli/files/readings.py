"""What `kilter upload` takes a file for where nobody said it; where two readings are possible, a person decides."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.files.inspect import fetch_joint_names
from kilter_client.cli.terminal.output import note
from kilter_client.errors import FileError, KilterError, UsageError
from kilter_client.files import files_match
from kilter_files import Prepared, draft, prepare, read_joints
from kilter_files.formats import DEVICE, MAP, PRESET, Head, Hints, LogHints, RecordingReader, find_reader

if TYPE_CHECKING:
    from kilter_files.look import Draft

MOST_UNUSED = 4  # columns that are named
UNITS = {"rad": "radians", "deg": "degrees"}
ORDERS = {"XYZ": "about the moving axes", "xyz": "about the fixed axes"}


def is_recording(file: Path) -> bool:
    """Tell whether a file holds frames of markers, which `kilter measure match` joins with a joint log."""
    return isinstance(find_reader(Head(file)), RecordingReader)


def guess_pairing(file: Path, joints: Path, hints: LogHints, as_json: bool) -> Literal["order", "time"]:
    """Return how a joint log is paired with a recording, and say it: by time where it shows the arm moving, else in order."""
    log = read_joints(joints, None, hints)
    moving = log.t_s is not None and len(files_match.pose_row_indices(log)) < len(log)
    by: Literal["order", "time"] = "time" if moving else "order"
    note(f"{file}: taken as a recording of markers, joined with {joints} by {by} (`kilter measure match`)", as_json)
    return by


def read_unstated(
    robot: str, file: Path, joints: Path | None, euler: str | None, joint_unit: str | None, hints: LogHints
) -> tuple[Prepared, str]:
    """Return the rows of a file of which nobody said what it is, and what device it is taken for; empty: none.

    The first note says what was taken. A file that has columns of the contract is sent as it is.

    Raises:
        FileError: the file, or what it was taken for, is not what it should be.
        UsageError: two readings are possible; the message names both and the option that decides.

    """
    if (hints.topic or hints.order) and joints is None:
        return prepare(file, euler=euler, hints=hints), ""
    reader, names = find_reader(Head(file)), list[str]()
    if isinstance(reader, RecordingReader):
        raise FileError(f"{file}: is a recording of markers, without joints. Name the joint log too: --joints FILE.")
    if reader.use in (MAP, PRESET) and joints is None:
        names = _joint_names_if_known(robot)  # columns that carry them are those joints
        reader = find_reader(Head(file, Hints(robot=names)))
    if reader.use == DEVICE and joints is None:
        read = prepare(file, reader.name)
        taken = (f"taken as {reader.title} (--device {reader.name})",) if read.rows is not None else ()
        return replace(read, notes=(*taken, *read.notes)), reader.name
    if reader.use == PRESET and joints is not None:
        return _read_points(file, joints, euler, hints), "generic"
    if reader.use == MAP and joints is None:
        found = draft(file, names)
        if not found.has_contract_joints and (euler is None or found.open == ["orientation"]):
            return _read_drafted(file, found, _decide(robot, file, found, euler, joint_unit)), ""
    return prepare(file, joined=joints, euler=euler, hints=hints), ""


def _read_points(file: Path, joints: Path, euler: str | None, hints: LogHints) -> Prepared:
    try:
        read = prepare(file, joined=joints, preset="generic", euler=euler, hints=hints)
    except FileError as why:
        try:
            return prepare(file, joined=joints, euler=euler, hints=hints)
        except UsageError as usage:
            raise UsageError(f"{why.detail} {usage.detail}") from why
    return replace(read, notes=("taken as points of a tracker or CMM (--preset generic)", *read.notes))


def _read_drafted(file: Path, found: Draft, text: str) -> Prepared:
    """Read a file through the text of a map, and say in a line what was taken."""
    with tempfile.TemporaryDirectory() as folder:
        column_map = Path(folder) / "columns.toml"
        column_map.write_text(text, encoding="utf-8")
        read = prepare(file, None, column_map)
    left = found.unused[:MOST_UNUSED]
    more = f" and {len(found.unused) - len(left)} more" if len(found.unused) > len(left) else ""
    unused = f"; not used: {', '.join(left)}{more}" if left else ""
    return replace(read, notes=(f"taken as {found.readings}{unused} (--map says otherwise)",))


def _decide(robot: str, file: Path, found: Draft, euler: str | None, joint_unit: str | None) -> str:
    """Return the text of the map where one reading is possible or was said."""
    remedy = f"`kilter measure inspect {quote(str(file))} --robot {robot} --draft columns.toml` writes a map for --map."
    text, still_open = found.text, list(found.open)
    if still_open == ["orientation"] and 'euler = "?"' in text:
        order = _choose(file, "its angles are", ORDERS, euler, "--euler", remedy)
        text, still_open = text.replace('euler = "?"', f'euler = "{order}"'), []
    if still_open:
        raise UsageError(f"{file}: could not find out {', '.join(still_open)}. {remedy}")
    if found.rivals:
        raise UsageError(
            f"{file}: two readings are possible: {found.readings.partition(';')[0]}, or {' and '.join(found.rivals)}. {remedy}"
        )
    if found.least_reach_mm is not None and (joint_unit or not _is_out_of_reach(robot, found.least_reach_mm)):
        unit = _choose(file, "its joints are in", UNITS, joint_unit, "--joint-unit", remedy)
        text = text.replace('unit = "rad"', f'unit = "{unit}"')
    return text


def _choose(file: Path, what: str, readings: Mapping[str, str], said: str | None, option: str, remedy: str) -> str:
    """Return which of two readings holds: the one that was said, or that a person at the terminal chooses.

    Raises:
        UsageError: nobody is there to be asked, or neither was said.

    """
    options = " or ".join(f"{words} ({option} {word})" for word, words in readings.items())
    if said is None and sys.stdin.isatty():
        said = typer.prompt(f"{file}: {what} {options}. Which", err=True)
    if said is not None and said in readings:
        return said
    raise UsageError(f"{file}: two readings are possible: {what} {options}. Say which; or {remedy}")


def _is_out_of_reach(robot: str, least_mm: float) -> bool:
    """Tell whether no arm of this size moves as was measured; not where the robot is not known."""
    try:
        with Kilter() as kilter:
            return bool(kilter.robots.check(kilter.robots.get(robot)["document"])["reach_mm"] < least_mm)
    except KilterError:
        return False


def _joint_names_if_known(robot: str) -> list[str]:
    try:
        return fetch_joint_names(robot)
    except KilterError:  # a dry run needs no server
        return []
