"""The servos that a search found, for simulators other than MuJoCo: a model in SDF, or a group of actuators of Isaac Lab."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element, SubElement, indent, register_namespace, tostring

from kilter_client.errors import FileError
from kilter_client.twin.settled import HINGE, SLIDE
from kilter_files.ground.later import mujoco, np

if TYPE_CHECKING:
    from kilter_files.ground import Floats

DRAKE, KILTER = "drake.mit.edu", "kilter"
ENDLESS = 1e9  # N m (N): no limit of the torque
ROTOR_KG, ROTOR_KG_M2 = 1e-4, 1e-7  # of a motor between two joints on one axis, whose inertia is the armature
BY_COMMAND = "command_delay"
SECOND_JOINT = frozenset({"backlash", "flexible_gear"})


@dataclass(frozen=True)
class ExportedServo:
    """Numbers of a joint, SI: ``damping`` of joint and servo together, ``servo_damping`` that of the servo.

    ``effects`` are what else was found, by name with the unit; ``delay_s`` is a late command and its interval. ``creep`` is
    how friction lets a joint creep: MuJoCo's impedance and rate 1/s, None where it holds.
    """

    joint: str
    armature: float
    friction: float
    damping: float
    servo_damping: float
    gain: float
    effort: float | None
    delay_s: tuple[float, float, float] | None  # value, and the ends of its interval
    effects: Mapping[str, float]
    creep: tuple[float, float] | None


@dataclass(frozen=True)
class Rendered:
    """A file for a simulator, and what to know of it."""

    text: str
    notes: tuple[str, ...]


def write_sdf(name: str, model: Any, servos: Sequence[ExportedServo]) -> Rendered:
    """Write the bodies and joints of a copy as SDF 1.9, as Gazebo and Drake read it.

    Raises:
        FileError: the model has a free or ball joint.

    """
    for uri, prefix in ((DRAKE, "drake"), (KILTER, "kilter")):
        register_namespace(prefix, uri)
    root = Element("sdf", {"version": "1.9"})
    tree = SubElement(root, "model", name=re.sub(r"\s+", "_", name))
    by_joint = {servo.joint: servo for servo in servos}
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0  # where a joint of SDF is at zero
    mujoco.mj_kinematics(model, data)
    for body in range(1, model.nbody):
        _write_body(tree, model, data, body, by_joint)
    for servo in servos:
        _write_gazebo_controller(tree, servo)
    indent(root)
    notes = (
        "SDF: bodies and joints without their shapes. Gazebo holds a joint within <friction>; Drake ignores <friction>.",
        "Gains: JointPositionController of Gazebo, controller_gains of Drake. All damping is that of the joint.",
        "The armature is drake:rotor_inertia: Gazebo has none, there the arm is lighter by it.",
        *_list_creeping(servos),
        *_list_without_element(servos, "SDF", SECOND_JOINT),
    )
    return Rendered('<?xml version="1.0"?>\n' + tostring(root, encoding="unicode") + "\n", notes)


def _write_body(tree: Element, model: Any, data: Any, body: int, servos: Mapping[str, ExportedServo]) -> None:
    """A link, and its joints; of two on one body the first moves a link of its own, the motor."""
    name, parent = _body_name(model, body), int(model.body_parentid[body])
    R, Q = data.xmat[parent].reshape(3, 3), data.xmat[body].reshape(3, 3)
    pose = _pose(R.T @ (data.xpos[body] - data.xpos[parent]), R.T @ Q)
    first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    before = "world" if parent == 0 else _body_name(model, parent)
    relative = {} if parent == 0 else {"relative_to": before}
    for k in range(max(count, 1)):
        last = k >= count - 1
        link = SubElement(tree, "link", name=name if last else f"{name}_motor_{k + 1}")
        SubElement(link, "pose", relative if k == 0 else {"relative_to": before}).text = (
            pose if k == 0 else "0 0 0 0 0 0"
        )
        if last:
            inertia = _rotation(model.body_iquat[body])
            _write_inertia(
                link, _pose(model.body_ipos[body], inertia), float(model.body_mass[body]), model.body_inertia[body]
            )
        else:
            _write_inertia(link, "0 0 0 0 0 0", ROTOR_KG, np.full(3, ROTOR_KG_M2))
        if count:
            _write_joint(tree, model, first + k, before, link.attrib["name"], servos)
        else:
            fixed = SubElement(tree, "joint", name=f"{name}_fixed", type="fixed")
            SubElement(fixed, "parent").text, SubElement(fixed, "child").text = before, name
        before = link.attrib["name"]


def _write_joint(
    tree: Element, model: Any, joint: int, parent: str, child: str, servos: Mapping[str, ExportedServo]
) -> None:
    name, kind = model.joint(joint).name, int(model.jnt_type[joint])
    if kind not in (HINGE, SLIDE):
        raise FileError(
            f"{name} is a ball joint or free, and SDF is written for revolute and prismatic joints.", code="model_joint"
        )
    own = SubElement(tree, "joint", name=name, type="revolute" if kind == HINGE else "prismatic")
    SubElement(own, "parent").text, SubElement(own, "child").text = parent, child
    SubElement(own, "pose").text = _pose(model.jnt_pos[joint], np.eye(3))
    axis, servo = SubElement(own, "axis"), servos.get(name)
    SubElement(axis, "xyz").text = _numbers(model.jnt_axis[joint])
    dof = int(model.jnt_dofadr[joint])
    dynamics, limit = SubElement(axis, "dynamics"), SubElement(axis, "limit")
    damping = float(np.ravel(model.dof_damping[dof])[0]) if servo is None else servo.damping
    _set(dynamics, "damping", damping)
    _set(dynamics, "friction", float(model.dof_frictionloss[dof]) if servo is None else servo.friction)
    _set(dynamics, "spring_stiffness", float(np.ravel(model.jnt_stiffness[joint])[0]))
    if bool(model.jnt_limited[joint]):
        _set(limit, "lower", float(model.jnt_range[joint, 0]))
        _set(limit, "upper", float(model.jnt_range[joint, 1]))
    _set(limit, "effort", 0.0 if servo is None else servo.effort or ENDLESS)
    if servo is None:
        return
    _set(own, f"{{{DRAKE}}}rotor_inertia", servo.armature)
    _set(own, f"{{{DRAKE}}}gear_ratio", 1.0)
    SubElement(own, f"{{{DRAKE}}}controller_gains", p=repr(servo.gain), d="0")
    if servo.delay_s is not None:
        _set(own, f"{{{KILTER}}}command_delay_s", servo.delay_s[0])
    creep = (
        {}
        if servo.creep is None
        else dict(zip(("friction_impedance", "friction_rate_per_s"), servo.creep, strict=True))
    )
    for key, value in (*servo.effects.items(), *creep.items()):
        _set(own, f"{{{KILTER}}}{key}", value)


def _write_gazebo_controller(tree: Element, servo: ExportedServo) -> None:
    plugin = SubElement(
        tree,
        "plugin",
        filename="gz-sim-joint-position-controller-system",
        name="gz::sim::systems::JointPositionController",
    )
    SubElement(plugin, "joint_name").text = servo.joint
    limit = servo.effort or ENDLESS
    for key, value in (
        ("p_gain", servo.gain),
        ("i_gain", 0.0),
        ("d_gain", 0.0),
        ("cmd_max", limit),
        ("cmd_min", -limit),
    ):
        _set(plugin, key, value)


def _write_inertia(link: Element, pose: str, mass: float, moments: Floats) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "pose").text = pose
    _set(inertial, "mass", mass)
    tensor = SubElement(inertial, "inertia")
    for key, value in zip(("ixx", "iyy", "izz"), moments, strict=True):
        _set(tensor, key, float(value))
    for key in ("ixy", "ixz", "iyz"):
        _set(tensor, key, 0.0)


def _set(parent: Element, name: str, value: float) -> None:
    SubElement(parent, name).text = repr(float(value))


def _body_name(model: Any, body: int) -> str:
    return str(model.body(body).name or f"body_{body}")


def _rotation(quat: Floats) -> Floats:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def _pose(place: Floats, R: Floats) -> str:
    """Place and angles about the fixed axes x, y and z, as SDF has them."""
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) > 1e-9:
        roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    else:
        roll, yaw = np.arctan2(-R[1, 2], R[1, 1]), 0.0
    return _numbers([*place, roll, pitch, yaw])


def _numbers(values: Sequence[float] | Floats) -> str:
    return " ".join(repr(float(value) + 0.0) for value in values)


def write_isaaclab(name: str, model: Any, servos: Sequence[ExportedServo]) -> Rendered:
    """Write the servos as actuators of an ArticulationCfg of Isaac Lab 2.3 and later."""
    step = float(model.opt.timestep)
    lines = [
        f'"""Servos of {name} as logs show them, written by Kilter. SI; delays count in physics steps of {step!r} s."""',
        "",
        "from isaaclab.actuators import DelayedPDActuatorCfg, IdealPDActuatorCfg",
        "",
        f"PHYSICS_DT = {step!r}",
        "ACTUATORS = {",
    ]
    for servo in servos:
        lines += _actuator_lines(servo, step)
    lines += ["}", "# ROBOT_CFG = ROBOT_CFG.replace(actuators=ACTUATORS)", ""]
    notes = (
        "Isaac Lab: friction is a torque from Isaac Sim 5 on (of 4.5 a coefficient: leave it out there). PhysX holds a joint "
        "within it, Newton lets it creep.",
        f"Delays count in physics steps: set sim.dt to {step!r}. Each reset draws one between the ends of its 95 % interval.",
        *_list_creeping(servos),
        *_list_without_element(servos, "Isaac Lab", frozenset({BY_COMMAND})),
    )
    return Rendered("\n".join(lines), notes)


def _actuator_lines(servo: ExportedServo, step: float) -> list[str]:
    fields: dict[str, object] = {
        "joint_names_expr": [re.escape(servo.joint)],
        "stiffness": servo.gain,
        "damping": servo.servo_damping + 0.0,
        "viscous_friction": servo.damping - servo.servo_damping,
        "armature": servo.armature,
        "friction": servo.friction,
        "dynamic_friction": servo.friction,
        "effort_limit": servo.effort or ENDLESS,
    }
    kind = "IdealPDActuatorCfg"
    if servo.delay_s is not None and servo.delay_s[0] > 0.0:
        kind = "DelayedPDActuatorCfg"
        low, high = (max(round(end / step), 0) for end in servo.delay_s[1:])
        fields |= {"min_delay": low, "max_delay": high}
    inner = [f"        {key}={value!r}," for key, value in fields.items()]
    return [f"    {servo.joint!r}: {kind}(", *inner, "    ),"]


def _list_creeping(servos: Sequence[ExportedServo]) -> tuple[str, ...]:
    named = ", ".join(one.joint for one in servos if one.creep is not None)
    what = "as MuJoCo's, which lets a joint creep; where it holds, the same numbers are a few per cent further off"
    return (f"Friction of {named} was fitted {what}.",) if named else ()


def _list_without_element(servos: Sequence[ExportedServo], simulator: str, has: frozenset[str]) -> tuple[str, ...]:
    """Name what was found and is not done by the file."""
    rest = [
        f"{key} of {servo.joint} ({value:.4g})"
        for servo in servos
        for key, value in servo.effects.items()
        if not any(key.startswith(one) for one in has)
    ]
    late = [
        f"command_delay_s of {one.joint} ({one.delay_s[0]:.4g})"
        for one in servos
        if one.delay_s is not None and BY_COMMAND not in has
    ]
    named = ", ".join([*late, *rest])
    return (
        (f"{simulator} has no element for {named}: a program that steps the simulation has to do it.",) if named else ()
    )


def write_usd(name: str, model: Any, servos: Sequence[ExportedServo]) -> Rendered:
    """Write the bodies and joints of a copy as a stage of USD with drives, and friction and armature as PhysX has them.

    Raises:
        FileError: the model has a free or ball joint.

    """
    root, by_joint = f"/{_identifier(name)}", {servo.joint: servo for servo in servos}
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    lines = [f'def Xform "{root[1:]}" (prepend apiSchemas = ["PhysicsArticulationRootAPI"])', "{"]
    for body in range(1, model.nbody):
        lines += _usd_body(model, data, body, root, by_joint)
    notes = (
        "USD: bodies and joints without their shapes. Drives and viscous friction are per degree, as UsdPhysics has them.",
        "Friction and armature are PhysxJointAxisAPI, which Isaac Sim reads from 5.0 on. PhysX holds a joint within friction.",
        *_list_creeping(servos),
        *_list_without_element(servos, "USD", SECOND_JOINT),
    )
    about = json.dumps(" ".join(notes))
    head = f'#usda 1.0\n(\n    defaultPrim = "{root[1:]}"\n    doc = {about}\n    metersPerUnit = 1\n'
    head += '    kilogramsPerUnit = 1\n    upAxis = "Z"\n)\n'
    return Rendered("\n".join([head, *lines, "}", ""]), notes)


def _identifier(name: str) -> str:
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    return plain if plain[:1].isalpha() or plain[:1] == "_" else f"_{plain}"


def _usd_body(model: Any, data: Any, body: int, root: str, servos: Mapping[str, ExportedServo]) -> list[str]:
    """A body, and its joints; of two on one body the first moves a body of its own, the motor."""
    parent, own = int(model.body_parentid[body]), _identifier(_body_name(model, body))
    R, Q = data.xmat[parent].reshape(3, 3), data.xmat[body].reshape(3, 3)
    before = (
        None if parent == 0 else _identifier(_body_name(model, parent)),
        R.T @ (data.xpos[body] - data.xpos[parent]),
        R.T @ Q,
    )
    first, count, lines = int(model.body_jntadr[body]), int(model.body_jntnum[body]), []
    for k in range(max(count, 1)):
        last = k >= count - 1
        link = own if last else f"{own}_motor_{k + 1}"
        inertia = (model.body_mass[body], model.body_ipos[body], model.body_inertia[body], model.body_iquat[body])
        small = (ROTOR_KG, np.zeros(3), np.full(3, ROTOR_KG_M2), np.array([1.0, 0.0, 0.0, 0.0]))
        mass, centre, moments, turn = inertia if last else small
        lines += [
            f'    def Xform "{link}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"])',
            "    {",
            f"        float physics:mass = {float(mass)!r}",
            f"        point3f physics:centerOfMass = {_tuple(centre)}",
            f"        float3 physics:diagonalInertia = {_tuple(moments)}",
            f"        quatf physics:principalAxes = {_tuple(turn)}",
            f"        double3 xformOp:translate = {_tuple(data.xpos[body])}",
            f"        quatd xformOp:orient = {_tuple(data.xquat[body])}",
            '        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]',
            "    }",
            *_usd_joint(model, first + k if count else None, root, before, link, servos),
        ]
        before = (link, np.zeros(3), np.eye(3))
    return lines


def _usd_joint(
    model: Any,
    joint: int | None,
    root: str,
    before: tuple[str | None, Floats, Floats],
    link: str,
    servos: Mapping[str, ExportedServo],
) -> list[str]:
    """A joint along its own z, with its limits, drive, friction and armature; a weld without a ``joint``."""
    parent, shift, R = before
    turn, place = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    inner: list[str] = []
    name, kind, schemas = f"{link}_fixed", "Fixed", ""
    if joint is not None:
        name, place = model.joint(joint).name, model.jnt_pos[joint]
        mujoco.mju_quatZ2Vec(turn, model.jnt_axis[joint])
        kind, axis, inner = _usd_joint_numbers(model, joint, name, servos.get(name))
        schemas = f' (prepend apiSchemas = ["PhysicsDriveAPI:{axis}", "PhysxJointAxisAPI:{axis}"])'
    turned, whole = np.empty(4), np.empty(4)
    mujoco.mju_mat2Quat(turned, np.ascontiguousarray(R).ravel())
    mujoco.mju_mulQuat(whole, turned, turn)
    held = [] if parent is None else [f"        rel physics:body0 = <{root}/{parent}>"]
    return [
        f'    def Physics{kind}Joint "{_identifier(name)}"{schemas}',
        "    {",
        *held,
        f"        rel physics:body1 = <{root}/{link}>",
        f"        point3f physics:localPos0 = {_tuple(shift + R @ place)}",
        f"        quatf physics:localRot0 = {_tuple(whole)}",
        f"        point3f physics:localPos1 = {_tuple(place)}",
        f"        quatf physics:localRot1 = {_tuple(turn)}",
        *(f"        {line}" for line in inner),
        "    }",
    ]


def _usd_joint_numbers(model: Any, joint: int, name: str, servo: ExportedServo | None) -> tuple[str, str, list[str]]:
    """Kind, axis and attributes of a joint; angles, and what is per angle, in degrees."""
    hinge = int(model.jnt_type[joint]) == HINGE
    if not hinge and int(model.jnt_type[joint]) != SLIDE:
        raise FileError(f"{name} is a ball joint or free, and USD is written for others.", code="model_joint")
    axis, per = ("angular", 180.0 / np.pi) if hinge else ("linear", 1.0)
    dof = int(model.jnt_dofadr[joint])
    stiffness, damping, effort = float(np.ravel(model.jnt_stiffness[joint])[0]), 0.0, None
    viscous, friction = float(np.ravel(model.dof_damping[dof])[0]), float(model.dof_frictionloss[dof])
    armature, kilter = float(model.dof_armature[dof]), {}
    if servo is not None:
        stiffness, damping, effort, armature = servo.gain, servo.servo_damping, servo.effort, servo.armature
        viscous, friction, kilter = servo.damping - servo.servo_damping, servo.friction, dict(servo.effects)
        kilter |= {} if servo.delay_s is None else {"command_delay_s": servo.delay_s[0]}
    drive, own = f"float drive:{axis}:physics", f"float physxJointAxis:{axis}"
    lines = ['uniform token physics:axis = "Z"', f'uniform token drive:{axis}:physics:type = "force"']
    if bool(model.jnt_limited[joint]):
        low, high = (float(end) * per for end in model.jnt_range[joint])
        lines += [f"float physics:lowerLimit = {low!r}", f"float physics:upperLimit = {high!r}"]
    values = {
        f"{drive}:stiffness": stiffness / per,
        f"{drive}:damping": damping / per,
        f"{own}:armature": armature,
        f"{own}:staticFrictionEffort": friction,
        f"{own}:dynamicFrictionEffort": friction,
        f"{own}:viscousFrictionCoefficient": viscous / per,
        **({} if effort is None else {f"{drive}:maxForce": effort}),
        **{f"custom double kilter:{key}": value for key, value in kilter.items()},
    }
    return (
        "Revolute" if hinge else "Prismatic",
        axis,
        [*lines, *(f"{key} = {float(value)!r}" for key, value in values.items())],
    )


def _tuple(values: Floats) -> str:
    return f"({', '.join(repr(float(value) + 0.0) for value in values)})"


WRITERS: Mapping[str, Callable[[str, Any, Sequence[ExportedServo]], Rendered]] = {
    "sdf": write_sdf,
    "isaaclab": write_isaaclab,
    "usd": write_usd,
}
