"""What cameras alone cannot tell apart, by name, each with what would settle it.

A camera's place takes what the first joint's zero or height does, a board's what the last joint's does, a board's scale what
all lengths do together. Which of the two a fit gives it to is a choice, and no pixel contradicts it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from kilter_core.arm.chain import Element
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.identifiable.identifiability import identifiable
from kilter_core.identify.scale_gauge import free_scale
from kilter_core.identify.setup_frames import of_the_arm
from kilter_core.identify.views.cameras import unknown_rig
from kilter_core.model.placed_rig import PlacedRig
from kilter_core.observations.rig import format_part_name

TRACKER = "a few points that a tracker or a measuring arm takes in the robot's own base"
SETTLES = {
    "base_yaw": "set the first joint's zero by its mark or a reference in the base, or measure " + TRACKER,
    "tool_roll": "set the last joint's zero by its mark, or measure two points of the tool whose place on it is known",
    "axis_place": "measure " + TRACKER,
    "tool_place": "measure a point of the tool whose place on the flange is known",
    "board_scale": "measure one long distance: between two corners with a caliper or a metre stick (state the board's scale "
    "as exact then), or between two places of the tool",
    "focal_length": "tilt the board by 30 degrees and more, take views at two distances, or calibrate the lens by itself and "
    "state `sigmas_px`",
}


def gauges(fit: Fit) -> Iterator[dict[str, Any]]:
    """Warnings ``camera_gauge``: what is given to one of two that act alike; nothing where a tracker measured too."""
    rig, names = unknown_rig(fit.problem.model), list(fit.names)
    if rig is None:
        return
    seen = np.asarray(identifiable(fit.sigma, fit.problem.prior_sigma))
    unknown = {n for n, told, arm in zip(names, seen, of_the_arm(fit), strict=True) if arm and not told}
    if fit.problem.measurement.tool.places_itself:
        yield from _of_ends(fit, rig, unknown)
    if free_scale(fit):
        boards = [f"board_{b.name}_scale" for b in rig.rig.boards]
        yield _gauge_warning(
            "board_scale", boards, "The scale of the board", "all link lengths and the distance to the camera"
        )
    for camera in rig.rig.cameras:
        focal = [f"camera_{camera.name}_{k}" for k in ("fx", "fy")]
        known = dict(zip(names, seen, strict=True))
        if any(not known.get(name, True) for name in focal):
            yield _gauge_warning(
                "focal_length",
                focal,
                f"The focal length of {format_part_name('camera', camera.name)}",
                "its distance to the board",
            )


def _of_ends(fit: Fit, rig: PlacedRig, unknown: set[str]) -> Iterator[dict[str, Any]]:
    robot = fit.problem.model.robot
    elements = robot.chain.elements
    joints = [k for k, e in enumerate(elements) if e.joint is not None]
    room, tool = _fixed_and_flange_parts(rig)
    for code, turns, found, what, other in (
        ("base_yaw", True, elements[: joints[0] + 1], "The zero of the first joint", f"how {room} is rotated"),
        ("axis_place", False, elements[: joints[1]], "The place of the first axis", f"where {room} stands"),
        ("tool_roll", True, elements[joints[-1] :], "The zero of the last joint", f"how {tool} is rotated"),
        ("tool_place", False, elements[joints[-1] :], "The length behind the last joint", f"where {tool} is mounted"),
    ):
        names = [str(e.name) for e in found if e.name in unknown and _is(e, turns)]
        if names:
            yield _gauge_warning(code, names, what, other)


def _is(element: Element, turns: bool) -> bool:
    return element.axis.rotates == turns


def _fixed_and_flange_parts(rig: PlacedRig) -> tuple[str, str]:
    """What stands in the room and what is on the flange, in words."""
    parts = [("camera", c.name, c.mount) for c in rig.rig.cameras] + [
        ("board", b.name, b.mount) for b in rig.rig.boards
    ]
    fixed = next(format_part_name(what, name) for what, name, mount in parts if mount == "fixed")
    return fixed, next(format_part_name(what, name) for what, name, mount in parts if mount == "flange")


def _gauge_warning(gauge: str, names: list[str], what: str, other: str) -> dict[str, Any]:
    return {
        "code": "camera_gauge",
        "gauge": gauge,
        "parameters": names,
        "message": f"{what} ({', '.join(names)}) cannot be told from {other} by these pixels: it keeps what it was given. To "
        f"settle it, {SETTLES[gauge]}.",
    }
