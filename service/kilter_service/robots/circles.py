"""A robot found from circles: a table of readings and points into a robot document."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.errors import ObservationError, OptionError
from kilter_service.contract.robot_reports import CircleAxis, FoundRobot
from kilter_service.contract.robots import Target
from kilter_service.contract.units import MAX_JOINTS
from kilter_service.ground.core import circle_points
from kilter_service.ground.limits import MAX_CIRCLE_CELLS, MAX_CIRCLE_ROWS
from kilter_service.ground.tables import reading
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.tables.columns import read_columns
from kilter_service.ground.wire import to_deg, to_mm
from kilter_service.robots.wire import DOCUMENT

if TYPE_CHECKING:
    from kilter_core.procedures.circle_points import AxisFit


JOINT = re.compile(r"q([1-9][0-9]?)_(deg|rad|mm|m)")


FOLLOWS = re.compile(r"j([1-9][0-9]?)=j([1-9][0-9]?)")


def found_robot(
    path: Path, media: str, name: str, convention: Target, frame: str, follows: Sequence[str] = ()
) -> FoundRobot:
    """Read a table (``q1_deg`` or ``q1_mm`` ..., and ``x_mm`` ... or markers) and find the robot whose joints moved in it.

    ``follows`` are pairs "j3=j2" of joints that are read against the horizontal.

    Raises:
        ObservationError: the table cannot be read, or shows no axes. TooFewPosesError: too few rows of a joint.

    """
    names = reading.column_names(path, media)
    kinds = _kinds(names)
    columns = read_columns(names, kinds)
    table = reading.whole_table(path, media, min(MAX_CIRCLE_ROWS, MAX_CIRCLE_CELLS // len(columns)))
    rows = observations(table, columns, {})
    points = rows.markers if rows.markers is not None else rows.position
    if points is None:
        raise ObservationError("Nothing was measured in these rows: give x_mm, y_mm, z_mm, or markers m1x_mm ... .")
    slides = np.array([kind == "prismatic" for kind in kinds])
    found = circle_points.robot_from_circles(
        rows.q,
        slides,
        points.reshape(len(rows), -1, 3),
        rows.tip,
        name=name,
        convention=convention,
        frame=frame,
        follows=_follows(follows),
    )
    axes = [_axis(k, fit) for k, fit in enumerate(found.axes)]
    return FoundRobot(robot=_document(found.document), axes=axes, rms_mm=to_mm(found.rms))


def _follows(pairs: Sequence[str]) -> dict[int, int]:
    """Follower -> leader, from 0.

    Raises:
        OptionError: a pair that is not written j3=j2.

    """
    found = [FOLLOWS.fullmatch(pair.replace(" ", "")) for pair in pairs]
    wrong = [pair for pair, match in zip(pairs, found, strict=True) if match is None]
    if wrong:
        raise OptionError(
            f"follows is {wrong[0]!r}: give the follower and its leader, for example j3=j2.", option="follows"
        )
    return {int(match[1]) - 1: int(match[2]) - 1 for match in found if match}


def _kinds(names: list[str]) -> list[str]:
    """Kind of every joint, by the unit of its reading.

    Raises:
        ObservationError: no joint readings, or a gap in their numbers.

    """
    units = {int(match[1]): match[2] for match in map(JOINT.fullmatch, names) if match}
    if sorted(units) != list(range(1, len(units) + 1)) or not units:
        raise ObservationError(
            "The joints are not there or not numbered 1, 2, 3 ...: give q1_deg, q2_deg, ..., q3_mm for a prismatic joint.",
            column=f"q{len(units) + 1}",
        )
    if len(units) > MAX_JOINTS:
        raise ObservationError(
            f"The table has {len(units)} joints, an arm has at most {MAX_JOINTS}.", column=f"q{MAX_JOINTS + 1}"
        )
    return ["prismatic" if units[k] in ("mm", "m") else "revolute" for k in sorted(units)]


def _axis(k: int, fit: AxisFit) -> CircleAxis:
    return CircleAxis(
        joint=f"j{k + 1}",
        kind="prismatic" if fit.prismatic else "revolute",
        rows=fit.rows,
        arc_deg=None if fit.prismatic else to_deg(fit.arc),
        stroke_mm=to_mm(fit.arc) if fit.prismatic else None,
        radius_mm=None if fit.prismatic else to_mm(fit.radius),
        rms_mm=to_mm(fit.rms),
        sigma_deg=to_deg(fit.sigma_rad),
        sigma_mm=to_mm(fit.sigma_m),
    )


def _document(document: dict[str, Any]) -> Any:
    return DOCUMENT.validate_python(document)
