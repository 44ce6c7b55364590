"""The axes of an arm as screws, with a frame on each of them, and as a DH, MDH or Hayati table.

All three come from one row of motions: base · Rz(θ1) Tz(d1) · L1 · Rz(θ2) Tz(d2) · L2 ... Rz(θn) Tz(dn) · Ln · tool, with
links L = Rx(α) Ry(β) Tx(a). DH takes a joint with the link behind it, MDH with the link before it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from kilter_core.arm.chain import Axis, Chain
from kilter_core.arm.conventions import PARALLEL_RAD, Row
from kilter_core.errors import RobotError
from kilter_core.parameters import degrees, mm
from kilter_core.transforms import align_z_axis, inverse, rotations_about
from kilter_core.types import Bools, Floats, Ints

SAME_M = 1e-12
EXACTLY_PARALLEL = 1e-9


@dataclass(frozen=True)
class Link:
    """From one axis to the next: Rx(alpha) Ry(beta) Tx(a); beta is None where there is none."""

    alpha: float
    a: float
    beta: float | None = None

    def pose(self) -> Floats:
        """The motion (4, 4)."""
        return Axis.RX.motion(self.alpha) @ Axis.RY.motion(self.beta or 0.0) @ Axis.TX.motion(self.a)


@dataclass(frozen=True)
class Table:
    """Joints ``theta (n,)`` rad, ``d (n,)`` m, ``prismatic (n,)``, the links behind them, base and tool (4, 4)."""

    theta: Floats
    d: Floats
    prismatic: Bools
    links: tuple[Link, ...]
    base: Floats = field(default_factory=lambda: np.eye(4))
    tool: Floats = field(default_factory=lambda: np.eye(4))

    def dh_rows(self) -> tuple[Row, ...]:
        """Rows Tz(d) Rz(θ) Tx(a) Rx(α); only for a table without β."""
        return tuple(self._row(k, self.links[k]) for k in range(len(self.links)))

    def mdh_rows(self) -> tuple[Row, ...]:
        """Rows Rx(α) [Ry(β)] Tx(a) Rz(θ) Tz(d), α, β, a being those of the link before."""
        before = (Link(0.0, 0.0), *self.links[:-1])
        return tuple(self._row(k, link) for k, link in enumerate(before))

    def mdh_tool(self) -> Floats:
        """Tool frame (4, 4) of the MDH rows: the last link is part of it."""
        return np.asarray(self.links[-1].pose() @ self.tool)

    def _row(self, k: int, link: Link) -> Row:
        # A Hayati row of a revolute joint has no d of its own unless it needs one.
        no_d = link.beta is not None and self.d[k] == 0.0 and not self.prismatic[k]
        return Row(
            link.alpha,
            link.a,
            float(self.theta[k]),
            None if no_d else float(self.d[k]),
            link.beta,
            bool(self.prismatic[k]),
        )


def link_table(screws: Screws, hayati: bool) -> Table:
    """Table of an arm with one axis per joint.

    Axes less than one degree from parallel get a Hayati link when ``hayati``. Else they are taken as parallel: their
    tilt is lost, because a common normal metres or kilometres away describes it only on paper.

    Raises:
        RobotError: a joint drives several axes.

    """
    arm = screws.one_axis_per_joint()
    lines = [(z, p) for z, p in zip(arm.direction, arm.point, strict=True)]
    lines.append((arm.home[:3, 2], arm.home[:3, 3]))
    start = _start(*lines[0])
    theta, d, links, frame = [], [], [], start
    for k, (z, p) in enumerate(lines[1:], 1):
        rotated, link = _to_axis(frame, z, p, hayati, arm.home if k == len(arm) else None)
        theta.append(_angle(frame, rotated[:3, 0]))
        d.append(float((rotated[:3, 3] - frame[:3, 3]) @ frame[:3, 2]))
        links.append(link)
        frame = rotated @ link.pose()
    return Table(np.array(theta), np.array(d), arm.prismatic, tuple(links), start, inverse(frame) @ arm.home)


def _start(z: Floats, p: Floats) -> Floats:
    """Frame on the first axis, nearest to the base frame: the base frame itself when its z is that axis."""
    frame = np.eye(4)
    frame[:3, :3] = align_z_axis(np.eye(3), z)
    frame[:3, 3] = p - z * (p @ z)
    return frame


def _to_axis(frame: Floats, z: Floats, p: Floats, hayati: bool, tip: Floats | None) -> tuple[Floats, Link]:
    """Frame rotated and shifted along its axis so that a link leads to the axis (z, p), and that link.

    ``tip`` is the pose the last link leads to: where the tables leave a choice, it ends there.
    """
    z0 = frame[:3, 2]
    sine = float(np.linalg.norm(np.cross(z0, z)))
    if sine < EXACTLY_PARALLEL or (sine < math.sin(PARALLEL_RAD) and not (hayati and tip is None)):
        return _parallel(frame, z, p, hayati and tip is None, tip if sine < EXACTLY_PARALLEL else None)
    if sine < math.sin(PARALLEL_RAD):
        return _hayati(frame, z, p)
    return _skew(frame, z, p)


def _skew(frame: Floats, z: Floats, p: Floats) -> tuple[Floats, Link]:
    """Link along the common normal."""
    z0, p0 = frame[:3, 2], frame[:3, 3]
    x = np.cross(z0, z)
    x /= np.linalg.norm(x)
    x = -x if _far_rotation(frame, x) else x
    # Where the axis comes nearest: p0 + s z0.
    across = np.cross(z, x)
    s = float((p - p0) @ across / (z0 @ across))
    rotated = _replace_x_and_origin(frame, x, p0 + s * z0)
    return rotated, Link(_about(x, z0, z), float((p - rotated[:3, 3]) @ x))


def _parallel(frame: Floats, z: Floats, p: Floats, hayati: bool, tip: Floats | None) -> tuple[Floats, Link]:
    """Link square to parallel axes: from where the frame is, or level with the tip."""
    z0, p0 = frame[:3, 2], frame[:3, 3]
    if tip is not None:
        p0 = p0 + z0 * ((tip[:3, 3] - p0) @ z0)
    v = p - p0
    v = v - z0 * (v @ z0)
    length = float(np.linalg.norm(v))
    if length < SAME_M:
        x, length = (frame[:3, 0] if tip is None else tip[:3, 0] - z0 * (tip[:3, 0] @ z0)), 0.0
        x = x / np.linalg.norm(x)
    else:
        x = v / length
        x, length = (-x, -length) if _far_rotation(frame, x) else (x, length)
    alpha = 0.0 if z0 @ z > 0 else math.pi
    return _replace_x_and_origin(frame, x, p0), Link(alpha, length, 0.0 if hayati else None)


def _hayati(frame: Floats, z: Floats, p: Floats) -> tuple[Floats, Link]:
    """Link square to the next axis, tilted by α and β against the last: exact where DH is singular."""
    z0, p0 = frame[:3, 2], frame[:3, 3]
    v = p - p0
    v = v - z * (v @ z)
    length = float(np.linalg.norm(v))
    if length < SAME_M:
        v, length = frame[:3, 0] - z * (frame[:3, 0] @ z), 0.0
    towards = v / np.linalg.norm(v)
    x = np.cross(np.cross(z, towards), z0)
    x /= np.linalg.norm(x)
    if _far_rotation(frame, x):
        x, towards, length = -x, -towards, -length
    rotated = _replace_x_and_origin(frame, x, p0)
    local, along = rotated[:3, :3].T @ z, rotated[:3, :3].T @ towards
    alpha = math.atan2(-local[1], local[2])
    beta = math.atan2(local[0], math.hypot(local[1], local[2]))
    if along[0] < 0:  # the next axis points the other way: the same tilt, reached by 180 degrees about x
        length = -length
    return rotated, Link(alpha, length, beta)


def _far_rotation(frame: Floats, x: Floats) -> bool:
    """Whether x is more than 90 degrees from the frame's: then its opposite is nearer."""
    return bool(frame[:3, 0] @ x < -1e-12 or (abs(frame[:3, 0] @ x) <= 1e-12 and frame[:3, 1] @ x < 0))


def _replace_x_and_origin(frame: Floats, x: Floats, origin: Floats) -> Floats:
    out = frame.copy()
    out[:3, 0], out[:3, 1], out[:3, 3] = x, np.cross(frame[:3, 2], x), origin
    return out


def _angle(frame: Floats, x: Floats) -> float:
    return math.atan2(frame[:3, 1] @ x, frame[:3, 0] @ x)


def _about(x: Floats, z0: Floats, z: Floats) -> float:
    return math.atan2(float(np.cross(z0, z) @ x), float(z0 @ z))


def angles_and_lengths(row: Row) -> Iterator[tuple[str, float | None]]:
    """Cells of a row as they are written: mm and degrees under the names of the robot document."""
    yield "theta_offset_deg", degrees(row.theta_offset)
    yield "d_mm", None if row.d is None else mm(row.d)
    yield "a_mm", mm(row.a)
    yield "alpha_deg", degrees(row.alpha)
    yield "beta_deg", None if row.beta is None else degrees(row.beta)


@dataclass(frozen=True)
class JointFrames:
    """``origin (M, 4, 4)`` of each axis in the frame before, z along the axis, and ``end (4, 4)`` from the last to the tip."""

    origin: Floats
    end: Floats


def joint_frames(screws: Screws) -> JointFrames:
    """Frames on the axes at zero, as near as they can be to those before: the tip's first, so plain arms stay plain."""
    T, origins = np.eye(4), []
    for direction, point in zip(screws.direction, screws.point, strict=True):
        frame = np.eye(4)
        frame[:3, :3] = align_z_axis(T[:3, :3], direction)
        frame[:3, 3] = point
        origins.append(inverse(T) @ frame)
        T = frame
    return JointFrames(np.array(origins), inverse(T) @ screws.home)


@dataclass(frozen=True)
class Screws:
    """M moving axes at zero joints: T(q) = exp(S_1 r_1 q_j1) ... exp(S_M r_M q_jM) home.

    ``direction (M, 3)`` unit, ``point (M, 3)`` m on the axis, ``prismatic (M,)``, ``joint (M,)`` that drives it times
    ``ratio (M,)``, ``home (4, 4)``. Everything is in the base frame.
    """

    direction: Floats
    point: Floats
    prismatic: Bools
    joint: Ints
    ratio: Floats
    home: Floats

    def __len__(self) -> int:
        return len(self.joint)

    def compose_with_poses(self, before: Floats, after: Floats) -> Screws:
        """The arm ``before · T(q) · after`` for two poses (4, 4)."""
        R, p = before[:3, :3], before[:3, 3]
        return replace(
            self, direction=self.direction @ R.T, point=self.point @ R.T + p, home=before @ self.home @ after
        )

    def poses(self, q: Floats) -> Floats:
        """Poses (N, 4, 4) at joints ``q (N, n)``."""
        *_, moved = self.link_motions(q)
        return np.asarray(moved @ self.home)

    def link_motions(self, q: Floats) -> Iterator[Floats]:
        """Rigid motions (N, 4, 4) of the base and of the link behind each axis at joints ``q (N, n)``, from joints zero."""
        T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        yield T
        for k in range(len(self)):
            T = T @ self._motion(k, q[:, self.joint[k]] * self.ratio[k])
            yield T

    def _motion(self, k: int, amount: Floats) -> Floats:
        """Rigid motions (N, 4, 4) by ``amount (N,)`` along or about axis k."""
        out = np.broadcast_to(np.eye(4), (len(amount), 4, 4)).copy()
        w = self.direction[k]
        if self.prismatic[k]:
            out[:, :3, 3] = amount[:, None] * w
            return out
        out[:, :3, :3] = rotations_about(w, amount)
        out[:, :3, 3] = self.point[k] - out[:, :3, :3] @ self.point[k]
        return out

    def one_axis_per_joint(self) -> Screws:
        """The same arm with ratios 1, axes reversed where a ratio is -1.

        Raises:
            RobotError: a joint drives more than one axis, or one with a ratio; the message names it.

        """
        for j in range(int(self.joint.max()) + 1):
            ratios = self.ratio[self.joint == j]
            if len(ratios) != 1 or abs(ratios[0]) != 1.0:
                raise RobotError(
                    f"Joint {j + 1} moves {len(ratios)} axes with ratios {ratios.tolist()}: this format knows one axis "
                    "per joint. Export JSON, or URDF for a joint that others follow.",
                    joint=j + 1,
                )
        if np.any(np.diff(self.joint) < 0):
            raise RobotError("The joints are not in their order along the chain: this format cannot say so.")
        return replace(self, direction=self.direction * self.ratio[:, None], ratio=np.ones(len(self)))


def chain_frames(chain: Chain, values: Floats | None = None) -> Floats:
    """Poses (E + 1, 4, 4) before the first and after each of E elements, at zero joints.

    ``values`` are the named constants, in the order of ``chain.named``; the nominal ones when None.
    """
    constants = np.array([e.value for e in chain.elements])
    if values is not None:
        constants[list(chain.named_elements)] = values
    frames = [np.eye(4)]
    for e, value in zip(chain.elements, constants, strict=True):
        frames.append(frames[-1] @ e.axis.motion(float(value)))
    return np.array(frames)


def screws_of_chain(chain: Chain, values: Floats | None = None) -> Screws:
    """Axes of a chain whose named constants have ``values``, see :func:`chain_frames`."""
    frames = chain_frames(chain, values)
    moving = [k for k, e in enumerate(chain.elements) if e.joint is not None]
    elements = [chain.elements[k] for k in moving]
    return Screws(
        direction=np.array([frames[k][:3, e.axis % 3] for k, e in zip(moving, elements, strict=True)]),
        point=frames[moving, :3, 3],
        prismatic=np.array([not e.axis.rotates for e in elements]),
        joint=np.array([e.joint for e in elements], dtype=np.int64),
        ratio=np.array([e.ratio for e in elements]),
        home=frames[-1],
    )
