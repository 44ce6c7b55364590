"""A version as MJCF: bodies as identified, drives that deflect as the joints do, and a table for the rest.

The bodies of an arm in MJCF: a frame on every axis, masses where the robot has them, places for tool and payload.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Comment, Element, SubElement, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from kilter_core.arm import Link, moved_link
from kilter_core.model import flange_frames, flange_screws, wanted_tool
from kilter_core.transforms import inverse, pose_from_twist, rotation_along
from kilter_service.robots.exporters.exportable import Exportable, Written, numbers
from kilter_service.robots.exporters.mjcf_notes import (
    BACKLASH_RATE,
    FRICTION,
    KNOWN_OF_MUJOCO,
    LIMITS,
    Drive,
    ExportedEffects,
    drives,
    exported_effects,
    in_mujoco,
    notes,
    of_sharpened,
    passive_joint_part,
    table,
    twisting,
)

if TYPE_CHECKING:
    from kilter_core.model import Calibration
    from kilter_core.types import Floats


if TYPE_CHECKING:
    from kilter_core.model import Calibration

TABLE, NOMINAL = "kilter", "kilter_nominal"  # names of the text and of the numbers among <custom>
# Every release of MuJoCo since 2.3.3 has this integrator; what it needs of stiff gains is in drives.py.
OPTION = {"integrator": "implicitfast", "timestep": "0.002", "tolerance": "1e-14"}
COMPILER = {"angle": "radian", "boundmass": "1e-9", "boundinertia": "1e-9", "balanceinertia": "true"}


def mjcf(version: Exportable) -> Written:
    """Write the model; a comment at its head has what it cannot say.

    Raises:
        RobotError: a joint drives several axes.

    """
    calibration = version.calibration
    exported = exported_effects(calibration)
    written = notes(version.version, calibration, in_mujoco(exported), (*of_sharpened(exported), *KNOWN_OF_MUJOCO))
    root = model_element(calibration)
    root.set("model", f"{version.version.robot} {version.version.id}")
    head = [f" Calibrated by Kilter: version {version.version.id} of robot {version.version.robot}.", *written]
    root.insert(0, Comment("\n  ".join(head).replace("--", "-") + "\n"))
    indent(root)
    return Written('<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n", written)


def model_element(calibration: Calibration) -> Element:
    """Return the model without what is to be known of it.

    Raises:
        RobotError: a joint drives several axes.

    """
    exported = exported_effects(calibration)
    driven = drives(exported.robot, [passive_joint_part(joint) for joint in exported.form.joints])
    root = Element("mujoco")
    SubElement(root, "compiler", COMPILER)
    SubElement(root, "option", OPTION | {"gravity": numbers(exported.robot.gravity)})
    SubElement(root, "size", nuserdata=str(2 * calibration.robot.n_joints + 1))
    bodies(SubElement(root, "worldbody"), calibration, exported, driven, twisting(exported.form))
    actuators = SubElement(root, "actuator")
    for joint, drive in zip(calibration.robot.joints, driven, strict=True):
        own = {"name": joint.name, "joint": joint.name, "kp": repr(drive.gain), "dampratio": "1"}
        if abs(joint.lower) != float("inf") and abs(joint.upper) != float("inf"):
            own["ctrlrange"] = f"{joint.lower!r} {joint.upper!r}"
        SubElement(actuators, "position", own)
    custom = SubElement(root, "custom")
    SubElement(custom, "numeric", name=NOMINAL, data=nominal_frames(calibration))
    rest = table(exported.form)
    if rest is not None:
        SubElement(custom, "text", name=TABLE, data=rest)
    return root


MOUNT_ARMATURE_S2 = 1e-4  # kg m² for each N m/rad of a mount: it swings within 10 ms, and is damped within as many
LEAST_INERTIA = 1e-9  # kg m²
THINNEST_M, THIN = 0.004, 0.06  # of what is drawn: at least, and as a share of the longest link


@dataclass(frozen=True)
class Axes:
    """Poses (n, 4, 4) of the joint frames at zero joints, in the robot's base frame, and what comes after them."""

    base: Floats
    joints: list[Floats]
    flange: Floats
    bodies: list[tuple[int, Link]]  # the joint that carries it (-1: the base), and the link in that joint's frame


def identified_axes(calibration: Calibration, exported: ExportedEffects) -> Axes:
    """Frames of the identified arm, what is constant of the effects folded in.

    Raises:
        RobotError: a joint drives several axes.

    """
    flange_screws(calibration).one_axis_per_joint()
    robot, form = calibration.robot, exported.form
    flange = flange_frames(calibration)
    elements, at = flange.elements, _joint_frames(calibration, flange.elements)
    still = elements[0]  # each frame moves by what the constant errors before it do
    moved = still @ pose_from_twist(form.base_shift, form.base_tilt) @ inverse(still)
    base, frames, bodies = moved @ still, [], []
    for j, here in enumerate(at):
        frames.append(moved @ here @ _along(robot.joints[j].kind, form.joints[j].offset))
        twist = form.joints[j].twist
        moved = frames[-1] @ pose_from_twist(twist[:3], twist[3:]) @ inverse(here)
    for link in exported.robot.links:
        if link.mass > 0.0:
            j = sum(k <= link.element for k in robot.chain.primary) - 1
            seen = elements[0] if j < 0 else at[j]
            bodies.append((j, moved_link(link, inverse(seen) @ elements[link.element + 1])))
    return Axes(base, frames, moved @ elements[-1] @ flange.end, bodies)


def _joint_frames(calibration: Calibration, elements: Floats) -> list[Floats]:
    """Poses (4, 4) of the joint frames, z along the axis of each, by those of the elements."""
    chain, out = calibration.robot.chain, []
    for k, rotation in zip(chain.primary, chain.program.joint_frame, strict=True):
        T = np.eye(4)
        T[:3, :3] = rotation
        out.append(elements[k + 1] @ T)
    return out


def _along(kind: str, amount: float) -> Floats:
    T = np.eye(4)
    if kind == "prismatic":
        T[2, 3] = amount
    else:
        T[:3, :3] = rotation_along(2, amount)
    return T


def bodies(
    world: Element, calibration: Calibration, exported: ExportedEffects, driven: list[Drive], stepped: set[int]
) -> None:
    """Write base, joints, flange, tool and payload below ``world``; ``stepped`` joints get a body that the step moves."""
    robot, axes = calibration.robot, identified_axes(calibration, exported)
    thick = thickness(axes)
    body = _body(world, "base", axes.base)
    _mount(body, exported.form.base_compliance)
    _masses(body, axes, -1)
    before = axes.base
    for j, joint in enumerate(robot.joints):
        T = inverse(before) @ axes.joints[j]
        _drawn(body, T, thick)
        body = _body(body, f"{joint.name}_link", T)
        _axis(body, joint.name, joint.kind, driven[j])
        before = axes.joints[j]
        twist = exported.form.joints[j].twist
        if j in stepped or np.any(twist):
            behind = pose_from_twist(twist[:3], twist[3:])
            body, before = _body(body, f"{joint.name}_behind", behind), before @ behind
        _masses(body, axes, j)
    T = inverse(before) @ axes.flange
    _drawn(body, T, thick)
    body = _body(_body(body, "flange", T), "tool", wanted_tool(calibration))
    SubElement(body, "site", name="tool", size=repr(thick))
    _payload(body, exported)


def _payload(tool: Element, exported: ExportedEffects) -> None:
    """A body whose mass a program sets: at the tool point unless the robot carries its load elsewhere."""
    body = SubElement(tool, "body", name="payload", pos=numbers(np.asarray(exported.payload.com)))
    SubElement(body, "inertial", pos="0 0 0", mass=repr(exported.payload.mass), diaginertia="0 0 0")
    SubElement(body, "site", name="payload", size=repr(THINNEST_M))


def nominal_frames(calibration: Calibration) -> str:
    """Where joint frames and tool nominally are at zero joints, seven numbers each: by them a model of others is found."""
    return " ".join(f"{numbers(T[:3, 3])} {_quat(T)}" for T in nominal_poses(calibration))


def nominal_poses(calibration: Calibration) -> list[Floats]:
    """Nominal poses (4, 4) of the joint frames and the tool at zero joints, in the base frame."""
    nominal = flange_frames(calibration.nominal_in_wanted_frames())
    tool = nominal.elements[-1] @ nominal.end @ wanted_tool(calibration)
    return [*_joint_frames(calibration, nominal.elements), tool]


def _body(parent: Element, name: str, T: Floats) -> Element:
    return SubElement(parent, "body", name=name, pos=numbers(T[:3, 3]), quat=_quat(T))


def _quat(T: Floats) -> str:
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    return numbers(np.array([w, x, y, z]))


def _axis(body: Element, name: str, kind: str, drive: Drive) -> None:
    """The joint, and behind it the hinge that has backlash."""
    form = "slide" if kind == "prismatic" else "hinge"
    own = {"name": name, "type": form, "axis": "0 0 1", "armature": repr(drive.armature)}
    if drive.friction > 0.0:
        own |= {"frictionloss": repr(drive.friction)} | FRICTION
    SubElement(body, "joint", own)
    if drive.backlash > 0.0:
        backlash = {
            "name": f"{name}_backlash",
            "type": form,
            "axis": "0 0 1",
            "range": f"{-drive.backlash!r} {drive.backlash!r}",
            "armature": repr(drive.backlash_armature),
            "damping": repr(drive.backlash_armature * BACKLASH_RATE),
        }
        SubElement(body, "joint", backlash | LIMITS)


def _mount(base: Element, compliance: tuple[float, float] | None) -> None:
    """A base that deflects about x and y: a ball joint has one stiffness, so it is two hinges."""
    for axis, name, c in zip(("1 0 0", "0 1 0"), "xy", compliance or (), strict=False):
        if c > 0.0:
            armature = MOUNT_ARMATURE_S2 / c
            SubElement(
                base,
                "joint",
                name=f"base_{name}",
                type="hinge",
                axis=axis,
                stiffness=repr(1.0 / c),
                armature=repr(armature),
                damping=repr(2.0 * (armature / c) ** 0.5),
            )


def _masses(body: Element, axes: Axes, joint: int) -> None:
    """The links of a body; MuJoCo knows one inertia of each, further ones get bodies of their own."""
    for place, (j, link) in enumerate(axes.bodies):
        if j != joint:
            continue
        at = body if body.find("inertial") is None else SubElement(body, "body", name=f"mass_{place + 1}")
        own = {"pos": numbers(link.com), "mass": repr(float(link.mass))}
        if np.any(link.inertia):
            inertia = possible(link.inertia)
            tensor = [inertia[a, b] for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
            own["fullinertia"] = numbers(np.array(tensor))
        else:
            own["diaginertia"] = "0 0 0"
        at.insert(0, Element("inertial", own))


def possible(inertia: Floats) -> Floats:
    """An inertia (3, 3) that MuJoCo takes: masses with errors may have made one about an axis negative."""
    sizes, axes = np.linalg.eigh(inertia)
    return np.asarray((axes * np.maximum(sizes, LEAST_INERTIA)) @ axes.T)


def thickness(axes: Axes) -> float:
    """Radius (m) of the rods that are drawn."""
    places = np.array([T[:3, 3] for T in (axes.base, *axes.joints, axes.flange)])
    return max(THINNEST_M, 0.5 * THIN * float(np.linalg.norm(np.diff(places, axis=0), axis=1).max()))


def _drawn(body: Element, T: Floats, thick: float) -> None:
    """A rod to the next frame, to look at: it weighs nothing and touches nothing."""
    if np.linalg.norm(T[:3, 3]) > thick:
        SubElement(
            body,
            "geom",
            type="capsule",
            fromto=f"0 0 0 {numbers(T[:3, 3])}",
            size=repr(thick),
            mass="0",
            contype="0",
            conaffinity="0",
            rgba="0.6 0.65 0.7 1",
        )
