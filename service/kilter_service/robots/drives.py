"""Axes that follow a joint (mimic, parallelogram), and errors of axes that no parameter takes up, in words."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from kilter_service.ground.core import core_model

if TYPE_CHECKING:
    from kilter_core.arm import Robot

BY = {
    "controller": "because the controller moves its motor along",
    "series": "through gears of its own in series",
}

ERRORS = (
    " A deflection or error of the gear of {joint} counts as moving axis {number} by its ratio too, as with a linkage."
)


def said_of_drives(robot: Robot) -> list[str]:
    """Return a sentence for each axis that follows a joint and of which the document says who carries its load."""
    out = []
    for element, number, joint, own, ratio in _followers(robot):
        drive = robot.chain.elements[element].drive
        if drive == "linkage":
            share = f"{robot.chain.linkage_load_ratio(element):+.6g} times that on axis {number}"
            out.append(
                f"Axis {number} follows {joint} (ratio {ratio:g}) by a linkage: the gear of {joint} carries the load on axis "
                f"{own} and {share}."
            )
        elif drive is not None:
            out.append(
                f"Axis {number} follows {joint} (ratio {ratio:g}) {BY[drive]}: the gear of {joint} carries the load on axis "
                f"{own} alone.{ERRORS.format(joint=joint, number=number) if drive == 'controller' else ''}"
            )
    return out


def unsaid_drives(robot: Robot) -> Iterator[str]:
    """Say of which axes nobody says who carries their load, and what that means."""
    for element, number, joint, own, ratio in _followers(robot):
        if robot.chain.elements[element].drive is None:
            yield (
                f"Axis {number} follows {joint} (ratio {ratio:g}), and the document does not say who carries its load: the "
                f"gear of {joint} counts as carrying the load on axis {own} alone. Say it with drive: linkage (rods, a "
                "parallelogram driven from the base), controller, or series."
            )


def _followers(robot: Robot) -> Iterator[tuple[int, int, str, int, float]]:
    """Yield element, number of the axis from 1, name of the joint, number of that joint's own axis, and ratio."""
    chain = robot.chain
    for k in chain.followers:
        joint = chain.elements[k].joint
        assert joint is not None
        own = chain.driven.index(chain.primary[joint]) + 1
        yield k, chain.driven.index(k) + 1, robot.joints[joint].name, own, chain.elements[k].ratio


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
