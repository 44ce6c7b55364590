"""The arm as it stands: hidden geometry errors, finite motions joint by joint, and loads by Pinocchio."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from tests.blind.generator.arms import Drawn
from tests.blind.generator.rigid import about_z, motion, six, turn

Floats = NDArray[np.float64]
GRAVITY = 9.80665


@dataclass
class Deflection:
    """What physics does to V visits of an arm of n joints, on top of its geometry.

    ``dq (V, n)`` rad at the joints; ``tilt (V, n, 3)`` rad, turns right after them; ``bend`` and ``sag (V, n, 3)``
    turn and shift of the far end of each link, in the frame of its joint; ``growth (V, n + 1)`` relative growth up to
    the flange; ``base (V, 6)`` motion of the foot; ``tool (V, 3)`` m; ``field (V, 3)`` m in the foot's frame;
    ``scale (V,)`` of what the tracker reads.
    """

    dq: Floats
    tilt: Floats
    bend: Floats
    sag: Floats
    growth: Floats
    base: Floats
    tool: Floats
    field: Floats
    scale: Floats

    @staticmethod
    def none(rows: int, n: int) -> Deflection:
        """No deflection."""
        three = (rows, n, 3)
        return Deflection(
            np.zeros((rows, n)), np.zeros(three), np.zeros(three), np.zeros(three), np.zeros((rows, n + 1)),
            np.zeros((rows, 6)), np.zeros((rows, 3)), np.zeros((rows, 3)), np.zeros(rows),
        )  # fmt: skip


@dataclass(frozen=True)
class Load:
    """Loads of V visits in the joint frames: what everything outboard does to each joint.

    ``force`` and ``moment (V, n, 3)`` about the joint's origin; ``end_force`` and ``end_moment (V, n, 3)`` on the
    far end of each link, about that end; ``weight (V, n, 3)`` N of the link itself; ``base (V, 3)`` N m on the foot.
    """

    force: Floats
    moment: Floats
    end_force: Floats
    end_moment: Floats
    weight: Floats
    base: Floats


@dataclass(frozen=True)
class Arm:
    """A built arm: ``placements (n + 2, 4, 4)`` as made, ``foot (4, 4)`` in the tracker's frame.

    ``up (3,)`` is the vertical in the frame of the foot; the payload hangs ``hung (3,)`` m from the tool point, in the
    tool's frame.
    """

    drawn: Drawn
    placements: Floats
    foot: Floats
    up: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    hung: Floats = field(default_factory=lambda: np.zeros(3))

    @staticmethod
    def nominal(drawn: Drawn) -> Arm:
        """The arm as drawn."""
        return Arm(drawn, drawn.placements, drawn.base_placement)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.drawn.n

    def varied(self, errors: Floats) -> Arm:
        """The arm with small errors ``(6 (n + 3),)``: six of the foot, six per placement (flange and tool last)."""
        moved = six(errors.reshape(-1, 6))
        return replace(self, foot=self.foot @ moved[0], placements=self.placements @ moved[1:])

    def positions(self, q: Floats, deflection: Deflection | None = None) -> Floats:
        """Tool points (V, 3) m in the tracker's frame at the readings ``q (V, n)``."""
        d = deflection or Deflection.none(len(q), self.n)
        T = self.foot @ motion(d.base[:, :3], d.base[:, 3:]) if d.base.any() else np.tile(self.foot, (len(q), 1, 1))
        foot = T[:, :3, :3]
        tilts, grows = _acting(d.tilt), bool(d.growth.any())
        bends = [a or b for a, b in zip(_acting(d.bend), _acting(d.sag), strict=True)]
        for i in range(self.n + 1):
            own = self.placements[i]
            if grows or (i > 0 and bends[i - 1]):
                own = np.tile(own, (len(q), 1, 1))
                own[:, :3, 3] *= 1.0 + d.growth[:, i, None]
            if i > 0 and bends[i - 1]:
                own[:, :3, :3] = turn(d.bend[:, i - 1]) @ own[:, :3, :3]
                own[:, :3, 3] += d.sag[:, i - 1]
            T = T @ own
            if i < self.n:
                T = T @ about_z(q[:, i] + d.dq[:, i])
                T = T @ motion(np.zeros((len(q), 3)), d.tilt[:, i]) if tilts[i] else T
        T = T @ self.placements[-1]
        p = T[:, :3, 3] + _apply(T[:, :3, :3], d.tool) + _apply(foot, d.field)
        return np.asarray(p * (1.0 + d.scale[:, None]))

    def load(self, q: Floats, payload: Floats) -> Load:
        """Static loads with a point mass ``payload (V,)`` kg at, or near, the tool point."""
        n = self.n
        a, b, c, d, e = np.zeros((5, len(q), n, 3))
        out = Load(a, b, c, d, e, np.zeros((len(q), 3)))
        for kg in np.unique(payload):
            model = self.pinocchio(float(kg))
            data = model.createData()
            for v in np.flatnonzero(payload == kg):
                self._load_of(model, data, q[v], float(kg), out, int(v))
        return out

    def pinocchio(self, payload: float = 0.0) -> pin.Model:
        """Pinocchio model in the foot's frame, the payload fixed to the last joint at the tool point."""
        model = pin.Model()
        model.gravity.linear = -GRAVITY * self.up
        parent = 0
        for i in range(self.n):
            T = self.placements[i]
            parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(T[:3, :3], T[:3, 3]), f"j{i + 1}")
            mass, com = float(self.drawn.mass[i]), self.drawn.com[i]
            model.appendBodyToJoint(parent, pin.Inertia(mass, com, 1e-3 * mass * np.eye(3)), pin.SE3.Identity())
        tool = self.placements[-2] @ self.placements[-1]
        at = pin.SE3(tool[:3, :3], tool[:3, 3])
        model.appendBodyToJoint(parent, pin.Inertia(payload, self.hung, np.zeros((3, 3))), at)
        model.addFrame(pin.Frame("tool", parent, at, pin.FrameType.OP_FRAME))
        return model

    def _load_of(self, model: pin.Model, data: pin.Data, q: Floats, payload: float, out: Load, v: int) -> None:
        # rnea leaves data.oMi as it was: forward kinematics sets it.
        pin.forwardKinematics(model, data, q)
        pin.rnea(model, data, q, np.zeros(self.n), np.zeros(self.n))
        for i in range(self.n):
            # data.f is what the parent exerts to hold the body: the load on the joint is its opposite.
            load = -data.f[i + 1]
            out.force[v, i], out.moment[v, i] = load.linear, load.angular
            down = data.oMi[i + 1].rotation.T @ (-GRAVITY * self.up)
            out.weight[v, i] = self.drawn.mass[i] * down
            if i + 1 < self.n:
                onward = -data.f[i + 2]
                R = data.liMi[i + 2].rotation
                out.end_force[v, i], out.end_moment[v, i] = R @ onward.linear, R @ onward.angular
            else:
                out.end_force[v, i] = payload * down
                held = self.placements[-1][:3, 3] + self.placements[-1][:3, :3] @ self.hung
                beyond = self.placements[-2][:3, :3] @ held
                out.end_moment[v, i] = np.cross(beyond, payload * down)
        out.base[v] = -data.oMi[1].act(data.f[1]).angular


def _acting(x: Floats) -> list[bool]:
    """Joints at which an array (V, n, 3) is not all zero."""
    return [bool(x[:, j].any()) for j in range(x.shape[1])]


def _apply(R: Floats, x: Floats) -> Floats:
    return np.asarray(np.einsum("vij,vj->vi", R, x))


def built(drawn: Drawn, rng: np.random.Generator, foot_m: float | None = None, lean_deg: float | None = None) -> Arm:
    """An arm with hidden errors, standing some metres from the tracker, turned at random, its foot not quite level.

    ``foot_m`` is the distance and ``lean_deg`` how far from level, None as usual. Every placement is off by 0.1-0.5 mm
    and 0.02-0.1 deg per element, the tool point by a few millimetres.
    """
    n = drawn.n
    errors = rng.choice([-1.0, 1.0], (n + 2, 6))
    errors[:, :3] *= rng.uniform(0.1e-3, 0.5e-3, (n + 2, 3))
    errors[:, 3:] *= np.radians(rng.uniform(0.02, 0.1, (n + 2, 3)))
    errors[-1, :3] *= 10.0
    direction = rng.normal(size=3)
    usual = rng.uniform(2.0, 4.0)
    away = (usual if foot_m is None else foot_m) * direction / np.linalg.norm(direction)
    foot = motion(away, _any_turn(rng))
    tip = rng.normal(0.0, np.radians(0.05), 2)
    if lean_deg is not None:
        tip *= np.radians(lean_deg) / np.linalg.norm(tip)
    return Arm(drawn, drawn.placements @ six(errors), foot, turn(np.array([*tip, 0.0]))[:, 2])


def _any_turn(rng: np.random.Generator) -> Floats:
    """A rotation vector, uniform over all rotations (a random unit quaternion)."""
    w, *v = rng.normal(size=4)
    axis = np.array(v)
    return np.asarray(axis / np.linalg.norm(axis) * 2.0 * np.arctan2(np.linalg.norm(axis), w))
