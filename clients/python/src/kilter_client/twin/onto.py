"""A twin laid onto somebody's own model of MuJoCo: a copy with the calibrated poses and drives, meshes untouched.

The exported twin knows where its joints nominally are; by these the axes of the other model are found, wherever it stands.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kilter_client.errors import FileError
from kilter_client.twin.settled import find_element_id, load_model, mujoco_package
from kilter_client.twin.step import TABLE
from kilter_files.ground.later import np

if TYPE_CHECKING:
    from kilter_files.ground import Floats


NOMINAL, TOOL, BACKLASH = "kilter_nominal", "kilter_tool", "_backlash"


@dataclass(frozen=True)
class Laid:
    """The model's text, and what to know of it."""

    text: str
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Twin:
    """The exported twin: its compiled model, joints, and frames (n + 1, 4, 4), joints then tool, nominal and calibrated."""

    model: Any
    joints: Sequence[str]
    nominal: Floats
    calibrated: Floats
    table: dict[str, Any] | None


def lay_onto(source: Path, twin: str, joints: Sequence[str] = (), site: str | None = None) -> Laid:
    """Write a copy of ``source`` with the poses and drives of an exported twin.

    Args:
        source: an MJCF file; it and what it names stay as they are.
        twin: the text of ``kilter version export --format mjcf``.
        joints: what the source calls the robot's joints, in their order; by default as the robot does.
        site: a site behind the last joint that moves with the calibrated tool.

    Raises:
        FileError: the source is of another arm or has another zero, or lacks a joint.

    """
    mujoco = mujoco_package()
    load_model(source)
    spec = mujoco.MjSpec.from_file(str(source))
    found = _read(twin)
    names = list(joints) or list(found.joints)
    _Copy(source, spec, found, names).apply(site)
    spec.meshdir, spec.texturedir = (
        str(source.resolve().parent / folder) for folder in (spec.meshdir, spec.texturedir)
    )
    spec.compile()
    return Laid(spec.to_xml(), tuple(_notes(found)))


def _read(text: str) -> _Twin:
    mujoco = mujoco_package()
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    joints = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, k) for k in range(model.nu)]
    frames = [_pose(data.body(f"{name}_link").xpos, data.body(f"{name}_link").xmat) for name in joints]
    frames.append(_pose(data.site("tool").xpos, data.site("tool").xmat))
    numbers = np.array(model.numeric(NOMINAL).data).reshape(-1, 7)
    nominal = []
    for row in numbers:
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, row[3:])
        nominal.append(_pose(row[:3], matrix))
    raw = [
        bytes(model.text_data[a : a + n]).rstrip(b"\0") for a, n in zip(model.text_adr, model.text_size, strict=True)
    ]
    return _Twin(model, joints, np.array(nominal), np.array(frames), json.loads(raw[0]) if raw else None)


class _Copy:
    """The source as it is changed: its joints and bodies at zero, and where the robot's base is in it."""

    def __init__(self, path: Path, spec: Any, twin: _Twin, names: Sequence[str]) -> None:
        mujoco = mujoco_package()
        self.path, self.spec, self.twin, self.names = path, spec, twin, names
        self.model = spec.compile()
        data = mujoco.MjData(self.model)
        self.ids = [find_element_id(self.model, "joint", name, path) for name in names]
        for j in self.ids:
            data.qpos[self.model.jnt_qposadr[j]] = 0.0
        mujoco.mj_kinematics(self.model, data)
        self.poses = [_pose(data.xpos[b], data.xmat[b]) for b in range(self.model.nbody)]
        self.sites = [_pose(data.site_xpos[k], data.site_xmat[k]) for k in range(self.model.nsite)]
        self.bodies = [int(self.model.jnt_bodyid[j]) for j in self.ids]
        self.base = base_in_model(
            path,
            names,
            twin.nominal[:-1],
            data.xanchor[self.ids],
            data.xaxis[self.ids],
            self.poses[int(self.model.body_parentid[self.bodies[0]])],
        )

    def apply(self, site: str | None) -> None:
        """Move the bodies, set the drives, and place the tool."""
        mujoco = mujoco_package()
        # How each body that hangs on a joint, or on nothing that moves, goes from nominal to calibrated.
        moves = [np.eye(4)]
        for j, body in enumerate(self.bodies):
            before = moves[-1] @ self.poses[int(self.model.body_parentid[body])]
            moves.append(self.base @ self.twin.calibrated[j] @ _inverse(self.base @ self.twin.nominal[j]))
            _place(self.spec.body(self._name(body)), _inverse(before) @ moves[-1] @ self.poses[body])
            self._drive(j)
        last = self.spec.body(self._name(self.bodies[-1]))
        here = _inverse(moves[-1] @ self.poses[self.bodies[-1]])
        added = last.add_site(name=TOOL)
        _place(added, here @ self.base @ self.twin.calibrated[-1])
        if site is not None:
            self._move_site(site, moves[-1])
        self.spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        self.spec.option.tolerance = 1e-14
        self._table()

    def _drive(self, j: int) -> None:
        """Gain, friction and backlash of a joint as the twin has them."""
        mujoco = mujoco_package()
        twin, name = self.twin.model, self.twin.joints[j]
        own = twin.joint(name)
        joint = self.spec.joint(self.names[j])
        joint.armature = float(own.armature[0])
        joint.stiffness = 0.0 * joint.stiffness  # a polynomial in MuJoCo 4, a number before
        joint.frictionloss, joint.actfrclimited = float(own.frictionloss[0]), mujoco.mjtLimited.mjLIMITED_FALSE
        dof = int(own.dofadr[0])
        joint.solref_friction, joint.solimp_friction = twin.dof_solref[dof], twin.dof_solimp[dof]
        drive = next((a for a in self.spec.actuators if a.target == self.names[j]), None)
        if drive is None:
            drive = self.spec.add_actuator(name=name, target=self.names[j], trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive.set_to_position(kp=float(twin.actuator(name).gainprm[0]), dampratio=1.0)
        drive.forcelimited = mujoco.mjtLimited.mjLIMITED_FALSE
        drive.name = drive.name or name
        try:
            behind = twin.joint(f"{name}{BACKLASH}")
        except KeyError:
            return
        degrees = 57.29577951308232 if self.spec.compiler.degree and joint.type == mujoco.mjtJoint.mjJNT_HINGE else 1.0
        k = int(behind.dofadr[0])
        joint.parent.add_joint(
            name=f"{self.names[j]}{BACKLASH}",
            type=joint.type,
            axis=joint.axis,
            pos=joint.pos,
            stiffness=0.0,
            frictionloss=0.0,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=degrees * behind.range,
            armature=float(twin.dof_armature[k]),
            damping=float(behind.damping[0]),
            solref_limit=twin.jnt_solref[behind.id],
            solimp_limit=twin.jnt_solimp[behind.id],
        )

    def _move_site(self, name: str, move: Floats) -> None:
        k = find_element_id(self.model, "site", name, self.path)
        body = int(self.model.site_bodyid[k])
        nominal, real = (self.base @ frames[-1] for frames in (self.twin.nominal, self.twin.calibrated))
        _place(self.spec.site(name), _inverse(move @ self.poses[body]) @ real @ _inverse(nominal) @ self.sites[k])

    def _table(self) -> None:
        """Of the twin's table what needs no bodies of its own: curves of the drives."""
        table = _curves_only(self.twin.table)
        if table is None:
            return
        drives = {
            self.twin.joints[j]: next(a.name for a in self.spec.actuators if a.target == name)
            for j, name in enumerate(self.names)
        }
        self.spec.add_text(name=TABLE, data=json.dumps(table | {"drives": drives}))
        self.spec.nuserdata = max(self.spec.nuserdata, 2 * len(self.names) + 1)

    def _name(self, body: int) -> str:
        mujoco = mujoco_package()
        name = mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_BODY, body)
        if not name:
            joint = self.names[self.bodies.index(body)]
            raise FileError(f"{self.path}: the body of joint {joint!r} has no name. Give it one.", file=str(self.path))
        return str(name)


def _curves_only(table: Mapping[str, Any] | None) -> dict[str, Any] | None:
    curves = [] if table is None else [curve for curve in table["curves"] if curve["twist"] is None]
    if table is None or not curves:
        return None
    return {
        "format": table["format"],
        "order": table["order"],
        "joints": {},
        "twists": {},
        "curves": curves,
        "bending": [],
    }


def _notes(twin: _Twin) -> Iterator[str]:
    yield "Masses and the rest of the source are as they were: sag is that of its own masses."
    yield "Force limits and springs of the joints are taken off: they would hold a joint away from where it is."
    table = twin.table
    if table is not None and (
        table["joints"] or table["bending"] or any(c["twist"] is not None for c in table["curves"])
    ):
        yield "Left out: what the exported twin moves by loads in its step (tilts, bending, hardening). Use that twin for them."
    if any(twin.model.joint(k).name in ("base_x", "base_y") for k in range(twin.model.njnt)):
        yield "Left out: the compliance of the base."


def _pose(place: Floats, matrix: Floats) -> Floats:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.reshape(matrix, (3, 3)), place
    return T


def _inverse(T: Floats) -> Floats:
    return _pose(-T[:3, :3].T @ T[:3, 3], T[:3, :3].T)


def _place(element: Any, T: Floats) -> None:
    """Put a body or site there, whatever way its source says its orientation."""
    mujoco = mujoco_package()
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(T[:3, :3]).ravel())
    element.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    element.pos, element.quat = T[:3, 3], quat


NEAR_M, NEAR_RAD = 1e-3, 5e-3  # between an axis of the model and that of the robot, at zero joints
ROUNDS = 60


def base_in_model(
    path: Path, names: Sequence[str], nominal: Floats, anchors: Floats, axes: Floats, start: Floats
) -> Floats:
    """Pose (4, 4) of the robot's base in the model.

    Args:
        path: the model, for messages.
        names: what it calls its joints.
        nominal: frames (n, 4, 4) of the robot's joints, z along the axis of each.
        anchors: points (n, 3) on the axes of the model, m.
        axes: directions (n, 3) of unit length.
        start: a pose (4, 4) to begin at.

    Raises:
        FileError: no such pose: the joint that is farthest off is named.

    """
    T = start
    for _ in range(ROUNDS):
        rows, left = [], []
        for frame, anchor, axis in zip(nominal, anchors, axes, strict=True):
            here, along = T[:3, :3] @ frame[:3, 3] + T[:3, 3], T[:3, :3] @ frame[:3, 2]
            across = np.eye(3) - np.outer(axis, axis)
            rows += [np.hstack([-across @ _skew(here), across]), np.hstack([-_skew(along), np.zeros((3, 3))])]
            left += [across @ (anchor - here), axis - along]
        step = np.linalg.lstsq(np.vstack(rows), np.concatenate(left), rcond=1e-9)[0]
        T = _pose_from_motion(step) @ T
    for name, frame, anchor, axis in zip(names, nominal, anchors, axes, strict=True):
        here = T @ frame
        gap = anchor - here[:3, 3]
        off_m = float(np.linalg.norm(gap - axis * (axis @ gap)))
        off_rad = float(np.arccos(np.clip(axis @ here[:3, 2], -1.0, 1.0)))
        if off_m > NEAR_M or off_rad > NEAR_RAD:
            raise FileError(
                f"{path}: joint {name!r} is {off_m * 1e3:.1f} mm and {np.degrees(off_rad):.1f} deg from where the "
                "robot nominally has it: the model is of another arm, or of another zero. Take the model that the robot "
                "was described by.",
                file=str(path),
            )
    return T


def _skew(v: Floats) -> Floats:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def _pose_from_motion(step: Floats) -> Floats:
    """A small motion (w, v) as a pose."""
    T, angle = np.eye(4), float(np.linalg.norm(step[:3]))
    if angle > 0.0:
        K = _skew(step[:3] / angle)
        T[:3, :3] += np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K
    T[:3, 3] = step[3:]
    return T
