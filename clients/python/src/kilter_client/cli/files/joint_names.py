"""The joint names of a robot of the server, for files that name their joints."""

from __future__ import annotations

from kilter_client import Kilter


def fetch_joint_names(robot: str | None) -> list[str]:
    """Return the joint names of a robot of the server, for logs that name them; prismatic ones end in ``:m``."""
    if robot is None:
        return []
    with Kilter() as kilter:
        joints = kilter.robots.get(robot)["joints"]
    return [joint["name"] + (":m" if joint["kind"] == "prismatic" else "") for joint in joints]
