"""Options for the checks of ``kilter match``: the robot's model, parts of the recording, what is allowed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from kilter_client import Kilter
from kilter_client.errors import UsageError
from kilter_client.files import clock_checks, cut_recording, files_arm

if TYPE_CHECKING:
    from kilter_files.match.arm import Arm
    from kilter_files.match.clock_checks import Checks
    from kilter_files.tables.recording import Recording

Model = Annotated[str | None, typer.Option(help="Robot whose model checks the pairing; default is --robot's.")]
Piecewise = Annotated[bool, typer.Option("--piecewise", help="Match the parts between jumps of the clocks.")]
Unchecked = Annotated[bool, typer.Option("--unchecked", help="Only warn of wrong pairs and knocks.")]


def build_checks(
    robot: str | None, piecewise: bool, unchecked: bool, since: float | None, until: float | None
) -> Checks:
    """Return the checks, with the model of a robot of the server.

    Raises:
        UsageError: times the wrong way round, or ``--piecewise`` without a robot.

    """
    if since is not None and until is not None and not since < until:
        raise UsageError(f"--since {since:g} --until {until:g}: the first must be earlier than the second.")
    if piecewise and robot is None:
        raise UsageError("--piecewise needs the robot's model: name it with --robot or --model.")
    start, end = -float("inf") if since is None else since, float("inf") if until is None else until
    return clock_checks.Checks(None if robot is None else fetch_arm_model(robot), piecewise, unchecked, start, end)


def fetch_arm_model(robot: str) -> Arm:
    """Return the model of a robot of the server."""
    with Kilter() as kilter:
        return files_arm.arm_from_check(kilter.robots.check(kilter.robots.get(robot)["document"]))


def drop_markers_if_any(recording: Recording, without: Sequence[str] | None) -> Recording:
    """Return a recording without some markers."""
    return cut_recording.drop_markers(recording, without) if without else recording


def in_time(recording: Recording, checks: Checks) -> Recording:
    """Return the part of a recording that counts."""
    return cut_recording.cut_to_interval(recording, checks.since_s, checks.until_s)
