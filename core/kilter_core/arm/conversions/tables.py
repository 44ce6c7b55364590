"""The axes of an arm as a DH, MDH or Hayati table.

All three come from one row of motions: base · Rz(θ1) Tz(d1) · L1 · Rz(θ2) Tz(d2) · L2 ... Rz(θn) Tz(dn) · Ln · tool, with
links L = Rx(α) Ry(β) Tx(a). DH takes a joint with the link behind it, MDH with the link before it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from kilter_core.arm.chain import Axis
from kilter_core.arm.conventions import PARALLEL_RAD, Row
from kilter_core.arm.conversions.screws import Screws
from kilter_core.parameters import degrees, mm
from kilter_core.transforms import align_z_axis, inverse
from kilter_core.types import Bools, Floats

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
