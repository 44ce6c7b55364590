"""Verbs about robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.calls import robots as calls
from kilter_client.errors import UsageError
from kilter_client.results.record import Records
from kilter_client.steps import Steps
from kilter_client.verbs.things import Thing, reference

if TYPE_CHECKING:
    from kilter_client.typed.robots import RobotReport, RobotSummary


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
) -> Steps[RobotReport]:
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
        turned: joints whose controller counts the other way.
        follows: pairs ``"j3=j2"`` of joints of which the first is read against the horizontal.

    Raises:
        UsageError: neither or both of ``source`` and ``preset``, or something is missing that the file does not say.
        FileError: the file is not what it should be.
        RobotError: it cannot be an arm; ConflictError: another robot has that name.

    """
    from kilter_client.typed.robots import RobotReport

    if (source is None) == (preset is None):
        raise UsageError("add_robot() takes either a source (a path or a document) or preset=.")
    if preset is not None:
        document: Mapping[str, Any] = {"name": name or preset, "convention": "preset", "preset": preset}
    elif isinstance(source, Mapping):
        document = {**source, "name": name} if name else source
    else:
        from kilter_client.robots.read import Described, read_robot

        described = Described(name, base_link, tip_link, convention, model, turned, follows)
        document = read_robot(Path(fspath(source or "")), described)
    return RobotReport.read((yield from calls.add(document)))


def robot(name: Thing) -> Steps[RobotReport]:
    """Return a robot: joints with limits in deg or mm, names of its parameters, its active version.

    Raises:
        NotFoundError: there is no such robot.

    """
    from kilter_client.typed.robots import RobotReport

    return RobotReport.read((yield from calls.one(reference("robot", name))))


def robots(*, retired: bool = False) -> Steps[Records[RobotSummary]]:
    """Return the robots by name; with ``retired`` also those that are out of use."""
    from kilter_client.typed.robots import RobotSummary

    return Records(RobotSummary, [RobotSummary.read(one) for one in (yield from calls.listed(retired))])
