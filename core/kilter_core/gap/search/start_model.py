"""The model that a search begins with: that of the start, and a tool for each session where that is asked for."""

from __future__ import annotations

from dataclasses import replace

from kilter_core.arm.robot import Robot
from kilter_core.effects import EFFECTS
from kilter_core.errors import OptionError
from kilter_core.gap.options import GapOptions
from kilter_core.model import Calibration
from kilter_core.observations import Observations

SHIFT = "session_shift"


def beginning(robot: Robot, start: Calibration | None, rows: Observations, options: GapOptions) -> Calibration:
    """The start, which is the nominal robot where none is given.

    Raises:
        OptionError: a start of another robot, whose chain would be searched and what differs named as physics;
        tools of sessions where ``rows`` have fewer than two.

    """
    if start is None:
        return _with_tool_per_session(Calibration.nominal(robot), rows, options)
    if (start.robot.name, start.robot.chain.elements) != (robot.name, robot.chain.elements):
        raise OptionError(
            f"The start is a version of robot {start.robot.name!r}, the rows are of {robot.name!r}: name a version of "
            f"{robot.name!r}, or leave start out.",
            option="start",
        )
    return _with_tool_per_session(replace(start, doubts=()), rows, options)


def _with_tool_per_session(begin: Calibration, rows: Observations, options: GapOptions) -> Calibration:
    """Every session after the first has a tool of its own from the start, so that no step need be named for it."""
    if not options.refit or any(effect.id == SHIFT for effect in begin.model.effects):
        return begin
    if rows.session is None or len(set(rows.session.tolist())) < 2:
        raise OptionError(
            "A tool for each campaign and session needs two of them, and the rows are of one: name both campaigns, give "
            "the rows from where the marker was mounted again on another session number, or leave refit out.",
            option="refit",
        )
    return begin.with_effects([*begin.model.effects, EFFECTS[SHIFT]().configure_for_robot(begin.robot, rows)])
