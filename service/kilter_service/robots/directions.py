"""Errors of a robot's axes that none of its parameters takes up, in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from kilter_service.ground.core import core_model

if TYPE_CHECKING:
    from kilter_core.arm import Robot


def notes_on_missing_directions(robot: Robot) -> list[str]:
    """Return which joints lack a direction of their axis' error, and how to get it; empty where none does."""
    missing = core_model.missing_directions(robot)
    lacking = [f"{joint.name} ({count})" for joint, count in zip(robot.joints, missing.tolist(), strict=True) if count]
    if not lacking:
        return []
    return [
        f"Directions in which an axis may be off and no parameter says so: {', '.join(lacking)}. Errors there stay. To have "
        "all, convert the robot (`kilter robot convert FILE --to mcpc`) and add it under another name; of a URDF, add the "
        "file itself again."
    ]
