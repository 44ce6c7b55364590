"""Independent robots: the tests' truth, built in Pinocchio from plain steps. Nothing here imports the core.

A step is one elementary motion. Fixed steps are multiplied into joint placements, moving steps become Pinocchio joints
of their own, so gear ratios, couplings and zero offsets enter only through the joint vector.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOVERS = {
    "tx": pin.JointModelPX, "ty": pin.JointModelPY, "tz": pin.JointModelPZ,
    "rx": pin.JointModelRX, "ry": pin.JointModelRY, "rz": pin.JointModelRZ,
}  # fmt: skip
# Joint frame of the core in the frame of a Pinocchio joint: z is the joint axis, x and y follow it in cyclic order.
JOINT_FRAME = {
    "x": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "y": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "z": np.eye(3),
}


@dataclass(frozen=True)
class Step:
    """One elementary motion, m or rad; ``joint`` counts from 0."""

    axis: str
    value: float = 0.0
    joint: int | None = None
    ratio: float = 1.0
    name: str = ""

    def motion(self) -> Any:
        k = "xyz".index(self.axis[1])
        if self.axis[0] == "t":
            return pin.SE3(np.eye(3), self.value * np.eye(3)[k])
        return pin.SE3(pin.exp3(self.value * np.eye(3)[k]), np.zeros(3))


@dataclass(frozen=True)
class Body:
    """A link at the moving step of a joint: com m and inertia about it in the frame after the step.

    ``moving`` is another moving step that carries it, counted from 0, of a joint that drives several.
    """

    joint: int
    mass: float
    com: Floats
    inertia: Floats = field(default_factory=lambda: np.zeros((3, 3)))
    moving: int | None = None


@dataclass(frozen=True)
class Arm:
    """A serial arm; ``base`` and ``tool`` are SE3 poses, gravity is in the frame after ``base``."""

    steps: tuple[Step, ...]
    n: int
    base: Any = field(default_factory=pin.SE3.Identity)
    tool: Any = field(default_factory=pin.SE3.Identity)
    bodies: tuple[Body, ...] = ()
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.80665)
    limits: tuple[float, float] = (-2.5, 2.5)

    def moved(self, errors: dict[str, float]) -> Arm:
        """The arm with ``errors`` (SI) added to the steps of these names."""
        assert set(errors) <= {s.name for s in self.steps}, errors
        return replace(self, steps=tuple(replace(s, value=s.value + errors.get(s.name, 0.0)) for s in self.steps))

    @cached_property
    def moving(self) -> list[Step]:
        return [s for s in self.steps if s.joint is not None]

    def first_of(self, joint: int) -> int:
        """Place, among the moving steps, of the one that carries a joint's load: ratio ±1 if any, else the first."""
        own = [k for k, s in enumerate(self.moving) if s.joint == joint]
        return next((k for k in own if abs(self.moving[k].ratio) == 1.0), own[0])

    def pinocchio(self, payload: tuple[float, Floats] | None = None) -> tuple[Any, int]:
        """Model and the id of its tool frame; ``payload`` is a point mass kg at a place m in the tool frame."""
        model, placement, parent = pin.Model(), self.base, 0
        model.gravity.linear = np.array(self.gravity)
        ids: list[int] = []
        for step in self.steps:
            if step.joint is None:
                placement = placement * step.motion()
                continue
            parent = model.addJoint(parent, MOVERS[step.axis](), placement, f"m{len(ids)}")
            ids.append(parent)
            placement = pin.SE3.Identity()
        for body in self.bodies:
            inertia = pin.Inertia(body.mass, body.com, body.inertia)
            carrier = self.first_of(body.joint) if body.moving is None else body.moving
            model.appendBodyToJoint(ids[carrier], inertia, pin.SE3.Identity())
        tool = placement * self.tool
        if payload is not None:
            model.appendBodyToJoint(parent, pin.Inertia(payload[0], payload[1], np.zeros((3, 3))), tool)
        frame = model.addFrame(pin.Frame("tool", parent, 0, tool, pin.FrameType.OP_FRAME))
        return model, frame

    def motors(self, q: Floats) -> Floats:
        """Pinocchio joint vector of a joint vector, of each of many (..., n)."""
        return self.rates(q) + np.array([s.value for s in self.moving])

    def rates(self, qd: Floats) -> Floats:
        return np.take(qd, [s.joint for s in self.moving], axis=-1) * np.array([s.ratio for s in self.moving])

    @cached_property
    def _built(self) -> dict[bytes, tuple[Any, int]]:
        """Models by their payload: reactions are asked row by row, and building one takes longer than they do."""
        return {}

    def _carrying(self, payload: tuple[float, Floats] | None) -> tuple[Any, int]:
        key = b"" if payload is None else np.array([payload[0], *payload[1]]).tobytes()
        if key not in self._built:
            self._built[key] = self.pinocchio(payload)
        return self._built[key]

    def poses(self, q: Floats) -> tuple[Floats, Floats]:
        """Tool positions (N, 3) and rotations (N, 3, 3)."""
        model, frame = self.pinocchio()
        data = model.createData()
        p, R = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
        for k, motors in enumerate(self.motors(q)):
            pin.forwardKinematics(model, data, motors)
            pose = pin.updateFramePlacement(model, data, frame)
            p[k], R[k] = pose.translation, pose.rotation
        return p, R

    def joint_axes(self, q: Floats) -> tuple[Floats, Floats]:
        """Axes and places (n, N, 3) of the joints."""
        model, _ = self.pinocchio()
        data = model.createData()
        axes, places = np.empty((self.n, len(q), 3)), np.empty((self.n, len(q), 3))
        for k, row in enumerate(q):
            pin.forwardKinematics(model, data, self.motors(row))
            for m, step in enumerate(self.moving):
                axes[step.joint, k] = data.oMi[m + 1].rotation[:, "xyz".index(step.axis[1])]
                places[step.joint, k] = data.oMi[m + 1].translation
        return axes, places

    def joint_jacobians(self, q: Floats) -> Floats:
        """Derivative (N, 6, n) of tool point and tool orientation, in the axes of the outermost frame."""
        model, frame = self.pinocchio()
        data = model.createData()
        out = np.zeros((len(q), 6, self.n))
        for k, motors in enumerate(self.motors(q)):
            J = pin.computeFrameJacobian(model, data, motors, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
            for m, step in enumerate(self.moving):
                out[k, :, step.joint] += step.ratio * J[:, m]
        return out

    def parameter_jacobian(self, q: Floats, name: str, h: float = 1e-3) -> Floats:
        """Derivative (N, 6) by the constant of a step: fourth-order differences of rebuilt models."""
        weights = {-2: 1.0 / 12.0, -1: -2.0 / 3.0, 1: 2.0 / 3.0, 2: -1.0 / 12.0}
        _, R0 = self.poses(q)
        out = np.zeros((len(q), 6))
        for k, weight in weights.items():
            p, R = self.moved({name: k * h}).poses(q)
            out[:, :3] += weight * p / h
            out[:, 3:] += weight * np.array([pin.log3(a @ b.T) for a, b in zip(R, R0, strict=True)]) / h
        return out

    def torques(self, q: Floats, payload: tuple[float, Floats] | None = None) -> Floats:
        """Joint torques (N, n) of many rows at rest: the first that :meth:`reactions` returns of each."""
        model, _ = self._carrying(payload)
        data, rest = model.createData(), np.zeros(len(self.moving))
        first = [self.first_of(j) for j in range(self.n)]
        sides = np.sign([self.moving[k].ratio for k in first])
        return np.array([sides * pin.rnea(model, data, motors, rest, rest)[first] for motors in self.motors(q)])

    def reactions(
        self,
        q: Floats,
        qd: Floats | None = None,
        qdd: Floats | None = None,
        payload: tuple[float, Floats] | None = None,
        external: Floats | None = None,
    ) -> tuple[Floats, Floats, Floats]:
        """Reactions of one row by recursive Newton-Euler: what holds each joint.

        Returns joint torques (n,), wrenches (n, 6) in the joint frames of the core, and the wrench (6,) on the root.
        ``external (6,)`` acts on the tool point, in the tool frame.
        """
        model, frame = self._carrying(payload)
        data, none = model.createData(), np.zeros(self.n)
        forces = pin.StdVec_Force()
        for _ in range(model.njoints):
            forces.append(pin.Force.Zero())
        if external is not None:
            forces[model.njoints - 1] = model.frames[frame].placement.act(pin.Force(external))
        rates = self.rates(none if qd is None else qd)
        # A ratio is a transmission: its second derivative carries over like its first.
        accelerations = self.rates(none if qdd is None else qdd)
        tau = pin.rnea(model, data, self.motors(q), rates, accelerations, forces)
        torques, wrenches = np.empty(self.n), np.empty((self.n, 6))
        for j in range(self.n):
            k = self.first_of(j)
            step, f = self.moving[k], data.f[k + 1]
            turn = JOINT_FRAME[step.axis[1]]
            if step.ratio < 0:
                turn = turn @ np.diag([1.0, -1.0, -1.0])
            torques[j] = np.sign(step.ratio) * tau[k]
            wrenches[j] = np.concatenate([turn.T @ f.linear, turn.T @ f.angular])
        root = data.liMi[1].act(data.f[1])
        return torques, wrenches, np.concatenate([root.linear, root.angular])

    def document(self) -> dict[str, Any]:
        """The arm as a robot document of convention ``chain`` (mm, degrees)."""
        kinds = ["deg" if self.moving[self.first_of(j)].axis[0] == "r" else "mm" for j in range(self.n)]
        joints = [
            {"name": f"j{j + 1}", f"limits_{kind}": [self.wire(kind, b) for b in self.limits]}
            for j, kind in enumerate(kinds)
        ]
        links = []
        for j in range(self.n if self.bodies else 0):
            own = (b for b in self.bodies if b.joint == j and b.moving is None)
            links.append(_link(next(own, Body(j, 0.0, np.zeros(3)))))
        links += [_link(b) | {"on_axis": b.moving + 1} for b in self.bodies if b.moving is not None]
        return {
            "name": "arm", "convention": "chain", "joints": joints, "links": links,
            "elements": [self._element(s) for s in self.steps],
            "gravity_m_s2": list(self.gravity), "base": pose_document(self.base), "tool": pose_document(self.tool),
        }  # fmt: skip

    @staticmethod
    def wire(unit: str, value: float) -> float:
        return math.degrees(value) if unit == "deg" else 1e3 * value

    def _element(self, step: Step) -> dict[str, Any]:
        out: dict[str, Any] = {"axis": step.axis.capitalize(), "name": step.name}
        out["value"] = self.wire("deg" if step.axis[0] == "r" else "mm", step.value)
        if step.joint is not None:
            out |= {"joint": f"j{step.joint + 1}", "ratio": step.ratio}
        return out


def _link(body: Body) -> dict[str, Any]:
    inertia = [body.inertia[i, k] for i, k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return {"mass_kg": body.mass, "com_mm": list(1e3 * body.com), "inertia_kg_m2": inertia}


def pose_document(pose: Any) -> dict[str, float]:
    """x, y, z in mm and URDF roll, pitch, yaw in degrees."""
    rpy = np.degrees(pin.rpy.matrixToRpy(pose.rotation))
    xyz = 1e3 * pose.translation
    return {f"{k}_mm": float(v) for k, v in zip("xyz", xyz, strict=True)} | {
        f"r{k}_deg": float(v) for k, v in zip("xyz", rpy, strict=True)
    }


def some_pose(rng: np.random.Generator, metres: float = 1.0) -> Any:
    """A pose anywhere within a ball of ``metres`` and of any orientation."""
    return pin.SE3(pin.Quaternion(*_unit(rng)).matrix(), metres * rng.uniform(-0.5, 0.5, 3))


def small_pose(rng: np.random.Generator, metres: float, radians: float) -> Any:
    """A pose near the identity: Gaussian translations and rotation vectors."""
    return pin.SE3(pin.exp3(rng.normal(0.0, radians, 3)), rng.normal(0.0, metres, 3))


def _unit(rng: np.random.Generator) -> Floats:
    q = rng.normal(size=4)
    return np.asarray(q / np.linalg.norm(q))


def some_arm(rng: np.random.Generator, n: int, *, prismatic: bool = False, coupled: bool = False) -> Arm:
    """A random arm: any axes, either sense of turning; where asked, sliding joints and joints that drive two steps."""
    steps: list[Step] = []

    def fixed(count: int) -> None:
        for _ in range(count):
            axis = rng.choice(["tx", "ty", "tz", "rx", "ry", "rz"])
            steps.append(Step(axis, rng.uniform(-0.4, 0.4) * (1.0 if axis[0] == "t" else 3.0), name=f"p{len(steps)}"))

    for j in range(n):
        fixed(int(rng.integers(1, 4)))
        kind = "t" if prismatic and j % 3 == 1 else "r"
        ratio = float(rng.choice([-1.0, 1.0]))
        steps.append(Step(kind + rng.choice(list("xyz")), rng.uniform(-0.2, 0.2), j, ratio, f"p{len(steps)}"))
        if coupled and j > 0:
            steps.append(
                Step("r" + rng.choice(list("xyz")), 0.1, j - 1, -0.3 if kind == "r" else 0.7, f"p{len(steps)}")
            )
    fixed(3)
    return Arm(tuple(steps), n, some_pose(rng, 3.0), some_pose(rng, 0.3))


def with_bodies(arm: Arm, rng: np.random.Generator, followers: bool = False) -> Arm:
    """The arm with a random link at every joint and gravity from a random side; with ``followers`` at every moving step."""

    def body(joint: int, moving: int | None = None) -> Body:
        A = rng.normal(size=(3, 3))
        return Body(joint, rng.uniform(0.5, 5.0), rng.uniform(-0.2, 0.2, 3), A @ A.T * 0.02, moving)

    bodies = [body(j) for j in range(arm.n)]
    if followers:
        own = {arm.first_of(j) for j in range(arm.n)}
        bodies += [body(step.joint or 0, k) for k, step in enumerate(arm.moving) if k not in own]
    return replace(arm, bodies=tuple(bodies), gravity=tuple(rng.normal(0.0, 6.0, 3)))


def dh_steps(rows: Sequence[Sequence[float]]) -> tuple[Step, ...]:
    """Standard DH rows (d, a, alpha), revolute, with Hayati's rotation where alpha is 0 and another row follows."""
    steps: list[Step] = []
    for i, (d, a, alpha) in enumerate(rows, start=1):
        steps += [Step("tz", d, name=f"d_{i}"), Step("rz", 0.0, i - 1, name=f"theta_offset_{i}")]
        steps += [Step("tx", a, name=f"a_{i}"), Step("rx", alpha, name=f"alpha_{i}")]
        if alpha == 0.0 and i < len(rows):
            steps.append(Step("ry", 0.0, name=f"beta_{i}"))
    return tuple(steps)


UR10_ROWS = (
    (0.1273, 0.0, math.pi / 2), (0.0, -0.612, 0.0), (0.0, -0.5723, 0.0),
    (0.163941, 0.0, math.pi / 2), (0.1157, 0.0, -math.pi / 2), (0.0922, 0.0, 0.0),
)  # fmt: skip


def ur10(**fields: Any) -> Arm:
    """Universal Robots' UR10 by its published DH table."""
    return replace(Arm(dh_steps(UR10_ROWS), 6), **fields)


def with_hidden_errors(arm: Arm, rng: np.random.Generator, metres: float = 5e-4, radians: float = 1e-3) -> Arm:
    """The arm with six errors after every joint, far more than any table of it has: a real one knows no convention."""
    steps: list[Step] = []
    for step in arm.steps:
        steps.append(step)
        if step.joint is not None:
            for axis in ("tx", "ty", "tz", "rx", "ry", "rz"):
                steps.append(
                    Step(axis, rng.normal(0.0, metres if axis[0] == "t" else radians), name=f"hidden{len(steps)}")
                )
    return replace(arm, steps=tuple(steps))
