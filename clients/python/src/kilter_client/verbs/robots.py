"""Verbs about robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from kilter_client import typed
from kilter_client.errors import UsageError
from kilter_client.files import files_robots
from kilter_client.requests.calls import robots as calls
from kilter_client.requests.steps import Steps
from kilter_client.results.record import Records
from kilter_client.verbs.inputs import Data, ResourceReference, parse_time, prepare_rows, reference

if TYPE_CHECKING:
    from datetime import date, datetime

    from kilter_files.robots import Described


Compensation = Literal["none", "factory", "kilter", "unknown"]


def add_robot(
    source: str | PathLike[str] | Mapping[str, Any] | None = None,
    *,
    preset: str | None = None,
    name: str | None = None,
    convention: str | None = None,
    base_link: str | None = None,
    tip_link: str | None = None,
    model: str | None = None,
    turned: Sequence[str] = (),
    follows: Sequence[str] = (),
    controller_compensation: Compensation | None = None,
) -> Steps[typed.robots.RobotReport]:
    """Add a robot from a file (JSON, URDF, a table, another tool's), from a document, or from a preset.

    The same robot twice changes nothing.

    Args:
        source: a path, or the document of a robot.
        preset: name of a preset instead, as ``"ur5e"``.
        name: name of the robot; a preset has its own where none is given.
        convention: of a table: ``"dh"``, ``"mdh"``, ...
        base_link: of a URDF, where the arm begins.
        tip_link: of a URDF, where it ends.
        model: of a calibration file of Universal Robots.
        turned: joints that the controller counts in the opposite direction.
        follows: pairs ``"j3=j2"`` of joints of which the first is read against the horizontal; ``"j3=j2:linkage"``
            says who carries the load of that axis (linkage, controller or series).
        controller_compensation: whether the controller corrects by itself: ``"none"``, ``"factory"`` (its maker's
            calibration), ``"kilter"`` (a calibration that Kilter exported) or ``"unknown"``, which it is where nobody says.

    Raises:
        UsageError: neither or both of ``source`` and ``preset``, or something is missing that the file does not say.
        FileError: the file is not what it should be.
        RobotError: it cannot be an arm; ConflictError: another robot has that name.

    """
    given = files_robots.Described(name, base_link, tip_link, convention, model, turned, follows)
    document = _document(source, preset, given)
    if controller_compensation is not None:
        document = {**document, "controller_compensation": controller_compensation}
    return typed.robots.RobotReport.read((yield from calls.add(document)))


def set_controller_compensation(
    robot: ResourceReference, compensation: Compensation
) -> Steps[typed.robots.RobotReport]:
    """Say whether the controller of a robot corrects by itself: nothing is corrected twice.

    Args:
        robot: the robot, or its name.
        compensation: ``"none"``, ``"factory"``, ``"kilter"`` or ``"unknown"``.

    Raises:
        NotFoundError: there is no such robot.

    """
    return typed.robots.RobotReport.read((yield from calls.compensate(reference("robot", robot), compensation)))


def set_tolerance(
    robot: ResourceReference, tolerance_mm: float | None = None, *, check_interval_days: int | None = None
) -> Steps[typed.robots.RobotReport]:
    """Say how good a robot must be: ``today`` and the page then say whether it is.

    Args:
        robot: the robot, or its name.
        tolerance_mm: largest mean error of the tool that is good enough, mm; None: not stated.
        check_interval_days: days within which it is to be checked; None: not stated.

    Raises:
        NotFoundError: there is no such robot.

    """
    found = yield from calls.set_tolerance(reference("robot", robot), tolerance_mm, check_interval_days)
    return typed.robots.RobotReport.read(found)


def check_robot(
    source: str | PathLike[str] | Mapping[str, Any] | None = None,
    *,
    preset: str | None = None,
    name: str | None = None,
    convention: str | None = None,
    base_link: str | None = None,
    tip_link: str | None = None,
    model: str | None = None,
    turned: Sequence[str] = (),
    follows: Sequence[str] = (),
) -> Steps[typed.robots.RobotCheck]:
    """Evaluate a robot without adding it: axes, the arm at zero and its reach in mm, what looks wrong.

    Arguments are those of ``add_robot``.

    Raises:
        UsageError: neither or both of ``source`` and ``preset``, or something is missing that the file does not say.
        FileError: the file is not what it should be; RobotError: it cannot be an arm.

    """
    given = files_robots.Described(name or "unnamed", base_link, tip_link, convention, model, turned, follows)
    return typed.robots.RobotCheck.read((yield from calls.check(_document(source, preset, given))))


def convert_robot(source: str | PathLike[str] | Mapping[str, Any], to: str) -> Steps[dict[str, Any]]:
    """Return the same arm as a document of another convention; nothing is added.

    Args:
        source: the path of a document (JSON), or a document.
        to: ``"chain"``, ``"dh"``, ``"mdh"``, ``"s_model"``, ``"poe"``, ``"cpc"``, ``"mcpc"`` or ``"urdf"``.

    Raises:
        FileError: the file is not what it should be; RobotError: it cannot be an arm, or not be written like this.

    """
    return (yield from calls.convert(_document(source, None, files_robots.Described()), to))


def today(robot: ResourceReference) -> Steps[typed.server.Today]:
    """Return how good a robot is today: its newest error on rows that no fit used, and what is missing.

    Raises:
        NotFoundError: there is no such robot.

    """
    return typed.server.Today.read((yield from calls.today(reference("robot", robot))))


def bridges(robot: ResourceReference) -> Steps[typed.server.BridgeList]:
    """Return the bridges of a robot, those that run first: what each does, since when, and whether it is gone.

    Raises:
        NotFoundError: there is no such robot.

    """
    return typed.server.BridgeList.read((yield from calls.bridges(reference("robot", robot))))


def drift_history(robot: ResourceReference) -> Steps[typed.drifts.DriftHistory]:
    """Return the checks of a robot, the control charts of its active version, and how it stands by them.

    Raises:
        NotFoundError: there is no such robot.

    """
    return typed.drifts.DriftHistory.read((yield from calls.drift(reference("robot", robot))))


def add_repair(
    robot: ResourceReference, what: str, *, at: datetime | date | str | None = None
) -> Steps[typed.drifts.Repair]:
    """Record what was done to an arm: its checks, charts and comparisons begin anew with it.

    Args:
        robot: name of the robot.
        what: what was done, as ``"gear of joint 3 replaced"``.
        at: when, as ``"2026-11-18T14:30"``; left out: now. What was measured before is of the arm as it was.

    Raises:
        UsageError: it is not a time; NotFoundError: no such robot; ApiError: a time to come.

    """
    return typed.drifts.Repair.read((yield from calls.add_repair(reference("robot", robot), what, parse_time(at))))


def remove_repair(robot: ResourceReference, repair: str) -> Steps[None]:
    """Delete a repair that was recorded by mistake: checks from before it count again.

    Raises:
        NotFoundError: no such robot or repair.

    """
    yield from calls.remove_repair(reference("robot", robot), repair)


def drift_list() -> Steps[typed.drifts.DriftList]:
    """Return how all robots stand by their checks, the worst first."""
    return typed.drifts.DriftList.read((yield from calls.drifts()))


def accept(
    robot: ResourceReference,
    tolerance_mm: float,
    *,
    version: str | None = None,
    campaigns: Sequence[str] = (),
    refit: Sequence[str] | None = None,
    instrument: str | None = None,
) -> Steps[typed.acceptance.Acceptance]:
    """Decide by ISO 14253-1 whether an arm keeps a tolerance, on rows that its version was not fitted to.

    Its ``decision`` is ``"accepted"``, ``"rejected"`` or ``"not_proved"``.

    Args:
        robot: name of the robot.
        tolerance_mm: of the distance of the tool from where it should be, mm.
        version: id of the version; without one the active one.
        campaigns: ids of campaigns; without any those of today's number, or all.
        refit: frames to fit to the rows of each campaign: ``[]``, ``["base"]`` or ``["base", "tool"]``; None: as today's
            number does.
        instrument: name of the instrument of campaigns that name none.

    Raises:
        NotFoundError: there is no such robot, version, campaign or instrument.
        ConflictError: no row is left that was not fitted.

    """
    wanted = {
        "tolerance_mm": tolerance_mm,
        "version": version,
        "campaign": list(campaigns) or None,
        "refit": None if refit is None else ",".join(refit) or "none",
        "instrument": instrument,
    }
    return typed.acceptance.Acceptance.read((yield from calls.accept(reference("robot", robot), wanted)))


def find_robot(
    data: Data,
    name: str,
    *,
    columns: Sequence[str] | None = None,
    convention: str = "chain",
    base: str = "axis",
    follows: Sequence[str] = (),
) -> Steps[typed.robots.FoundRobot]:
    """Find a robot from rows in which one joint moved at a time: its document as ``robot``, and each axis.

    Args:
        data: a path, columns by name, a structured array, or a pandas DataFrame.
        name: name of the robot.
        columns: names of the columns of an array of two dimensions, with units.
        convention: of the document.
        base: ``"axis"`` puts the base on the first axis, ``"device"`` uses the frame of the device.
        follows: pairs ``"j3=j2"`` of joints that are read against the horizontal.

    Raises:
        ObservationError: the rows are not circles; FileError: the file is not what it should be.

    """
    found = yield from calls.from_circles(prepare_rows(data, columns), name, convention, base, follows)
    return typed.robots.FoundRobot.read(found)


def find_frame(points: Mapping[str, Any]) -> Steps[typed.robots.Frame]:
    """Find a frame from digitised ``points`` or ``features``: its pose in mm and deg, and how far each point is off.

    Raises:
        CalibrationError: the points make no frame.

    """
    return typed.robots.Frame.read((yield from calls.frame(points)))


def _document(
    source: str | PathLike[str] | Mapping[str, Any] | None, preset: str | None, given: Described
) -> Mapping[str, Any]:
    """Return the document of a robot, whatever it is given by."""
    if (source is None) == (preset is None):
        raise UsageError("A robot is given either by source (a path or a document) or by preset=.")
    if preset is not None:
        if replace(given, name=None) != files_robots.Described():
            raise UsageError(
                "A preset is complete: base_link= and tip_link= belong to a URDF, the others to other files. Write it as a "
                "document (k.convert_robot) to change it."
            )
        return {"name": given.name or preset, "convention": "preset", "preset": preset}
    if isinstance(source, Mapping):
        return files_robots.described_document(source, given)
    return files_robots.read_robot(Path(fspath(source or "")), given)


def robot(name: ResourceReference) -> Steps[typed.robots.RobotReport]:
    """Return a robot: joints with limits in deg or mm, names of its parameters, its active version.

    Raises:
        NotFoundError: there is no such robot.

    """
    return typed.robots.RobotReport.read((yield from calls.fetch_document(reference("robot", name))))


def robots(*, retired: bool = False) -> Steps[Records[typed.robots.RobotSummary]]:
    """Return the robots by name; with ``retired`` also those that are out of use."""
    return Records(
        typed.robots.RobotSummary,
        [typed.robots.RobotSummary.read(one) for one in (yield from calls.list_robots(retired))],
    )


FORMS: Mapping[str, calls.Form] = {".stl": "stl", ".obj": "obj"}


def meshes(robot: ResourceReference) -> Steps[Records[typed.robots.Mesh]]:
    """Return the shapes of a robot's links, from base to tool.

    Raises:
        NotFoundError: there is no such robot.

    """
    found = yield from calls.list_meshes(reference("robot", robot))
    return Records(typed.robots.Mesh, [typed.robots.Mesh.read(one) for one in found])


def set_mesh(
    robot: ResourceReference, link: str, file: str | PathLike[str], *, unit: Literal["mm", "m"] = "mm"
) -> Steps[typed.robots.Mesh]:
    """Give a link its shape, in place of the one it has. It is drawn only.

    Args:
        robot: the robot.
        link: ``"base"``, or the name of the joint that moves the link.
        file: STL or OBJ, in the frame in which the link's mass is stated.
        unit: of the file.

    Raises:
        UsageError: the file is of another kind.
        ApiError: the file is not a mesh, or the robot has no such link.

    """
    path = Path(fspath(file))
    form = FORMS.get(path.suffix.lower())
    if form is None:
        raise UsageError(f"{path}: give a file that ends in .stl or .obj.")
    return typed.robots.Mesh.read(
        (yield from calls.put_mesh(reference("robot", robot), link, path.read_bytes(), form, unit))
    )


def set_urdf_meshes(
    robot: ResourceReference, urdf: str | PathLike[str], *, packages: Mapping[str, str | PathLike[str]] | None = None
) -> Steps[Records[typed.robots.Mesh]]:
    """Give the links of a robot the shapes that its URDF names; needs trimesh.

    Args:
        robot: a robot that was added from a URDF.
        urdf: the URDF's file, beside or below which the files of the shapes lie.
        packages: folders of ROS packages by name.

    Raises:
        FileError: a file is not there, or cannot be read as a mesh.
        ApiError: the robot was not described by a URDF.

    """
    name = reference("robot", robot)
    folders = {package: Path(fspath(folder)) for package, folder in (packages or {}).items()}
    asked = yield from calls.list_urdf_meshes(name)
    made = []
    for one in files_robots.link_meshes(asked["shapes"], Path(fspath(urdf)), folders):
        put = yield from calls.put_mesh(name, one.link, one.content, "stl", "mm")
        made.append(typed.robots.Mesh.read(put))
    return Records(typed.robots.Mesh, made)


def remove_mesh(robot: ResourceReference, link: str) -> Steps[None]:
    """Delete the shape of a link: it is drawn as cylinders again.

    Raises:
        NotFoundError: it has none.

    """
    return (yield from calls.remove_mesh(reference("robot", robot), link))
