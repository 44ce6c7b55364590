"""Markers that sit on one rigid body: its pose by least squares, and the tool point on it.

A robot's own geometry in the client: the axes of its joints at zero, as the server resolves them, and where they go.

The server's check of a robot document gives axes and tool of any convention; a product of exponentials needs no more.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.ground.units import matrices_from_quaternions, quaternions_from_matrices
from kilter_files.match.dwells import mean_seen, thin
from kilter_files.tables.recording import Block, Recording
from kilter_files.tables.table import JointLog

LEAST_WIDTH_MM = 1.0  # markers in a line, or in one place, fix no orientation
LEVER_MM = 100.0
ROUNDS = 3
TIP_STILL_MM = 1.0


@dataclass(frozen=True)
class Body:
    """``markers`` (m, 3) and the tool point ``tcp`` (3) in the body's frame, mm; where the shape came from."""

    markers: Floats
    tcp: Floats
    source: str


@dataclass(frozen=True)
class Poses:
    """The tool point (n, 3) mm, quaternions (n, 4; w first, w >= 0), and what the fit leaves (n) mm; NaN = not known."""

    position_mm: Floats
    quaternion: Floats
    rms_mm: Floats


def poses(body: Body, points: Floats) -> Poses:
    """Return where the body was for markers (n, m, 3); NaN with fewer than three markers, or all in a line."""
    turned, shift, rms = align_shape(body.markers, points)
    return Poses(np.einsum("nij,j->ni", turned, body.tcp) + shift, quaternions_from_matrices(turned), rms)


def align_shape(shape: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    """Return rotations (n, 3, 3), shifts (n, 3) and rms (n) that bring ``shape`` (m, 3) onto ``points`` (n, m, 3)."""
    seen = ~np.isnan(points[..., 0])
    weight = seen / np.maximum(seen.sum(axis=1), 1)[:, None]
    known = np.where(seen[..., None], points, 0.0)
    centre, middle = np.einsum("nm,nmi->ni", weight, known), weight @ shape
    away = (known - centre[:, None]) * seen[..., None]
    own = shape - middle[:, None]
    u, size, v = np.linalg.svd(np.einsum("nm,nmi,nmj->nij", weight, away, own))
    sign = np.ones_like(size)
    sign[:, 2] = np.linalg.det(u @ v)
    turned = np.einsum("nij,nj,njk->nik", u, sign, v)
    left = away - np.einsum("nij,nmj->nmi", turned, own) * seen[..., None]
    rms = np.sqrt(np.einsum("nm,nmi->n", weight, left * left))
    flat = (seen.sum(axis=1) < 3) | (size[:, 1] < LEAST_WIDTH_MM**2)
    turned[flat], rms[flat] = np.nan, np.nan
    return turned, centre - np.einsum("nij,nj->ni", turned, middle), rms


def mean_shape(points: Floats) -> Floats | None:
    """Return the mean shape (m, 3) of markers (n, m, 3) about its centre, oriented as when all were first seen.

    None when they are never seen together, or lie in a line.
    """
    whole = np.flatnonzero(~np.isnan(points[..., 0]).any(axis=1))
    if not len(whole):
        return None
    shape = points[whole[0]] - points[whole[0]].mean(axis=0)
    if len(shape) < 3 or np.linalg.svd(shape)[1][1] < LEAST_WIDTH_MM:
        return None
    for _ in range(ROUNDS):
        turned, shift, _ = align_shape(shape, points)
        shape = mean_seen(np.einsum("nji,nmj->nmi", turned, points - shift[:, None]), 0)
        shape = shape - shape.mean(axis=0)
    return np.asarray(shape)


def names_a_file(recording: Recording, tcp: str) -> bool:
    """Whether the tool point is given by a recording with the tip digitised, and neither as "mean" nor as "x,y,z"."""
    return recording.kind != VIRTUAL and tcp != "mean" and "," not in tcp


def find_body(recording: Recording, tcp: str | Recording) -> Body:
    """Return the body of a recording; ``tcp`` is "mean", "x,y,z" in its frame, or a recording with the tip digitised.

    Raises:
        FileError: markers that fix no orientation, or a recording that does not hold them and the tip.

    """
    if isinstance(tcp, Recording):
        return _body_with_tip(recording, tcp)
    if recording.kind == VIRTUAL:
        return Body(LEVERS, _point(recording, tcp) if tcp != "mean" else np.zeros(3), "the tool's own frame")
    shape = mean_shape(thin(recording).points_mm)
    if shape is None:
        what = "its markers fix no orientation: three that do not lie in a line must be seen at once"
        raise fault(recording.path, what, "Send the markers as they are (without --tcp).")
    return Body(shape, np.zeros(3) if tcp == "mean" else _point(recording, tcp), "the recording's mean shape")


def _point(recording: Recording, text: str) -> Floats:
    try:
        point = np.array([float(cell) for cell in text.split(",")])
    except ValueError:
        point = np.zeros(0)
    if len(point) != 3 or not np.isfinite(point).all():
        raise fault(recording.path, f"--tcp {text}: no point", "Give x,y,z in mm, mean, or a recording with the tip.")
    return point


def _body_with_tip(recording: Recording, with_tip: Recording) -> Body:
    """The body and the tip of a recording at rest that holds the same markers and, as the last one, the tip."""
    path = with_tip.path
    points = thin(with_tip).points_mm
    names = with_tip.markers[:-1]
    if len(names) > len(recording.markers) and set(recording.markers) <= set(names):
        # markers left out of the recording are left out here too
        points = points[:, [*(names.index(name) for name in recording.markers), -1]]
    elif len(names) != len(recording.markers):
        what = f"holds {len(with_tip.markers)} markers; the recording has {len(recording.markers)}"
        raise fault(path, what, "Record the same markers and, as the last one, the digitised tool point.")
    shape = mean_shape(points[:, :-1])
    if shape is None or np.isnan(points[:, -1]).all():
        raise fault(path, "the markers are never seen together, or the tip never", "Digitise the point again.")
    turned, shift, _ = align_shape(shape, points[:, :-1])
    tips = np.einsum("nji,nj->ni", turned, points[:, -1] - shift)
    tip = mean_seen(tips, 0)
    spread = float(np.sqrt(np.nanmean(np.sum((tips - tip) ** 2, axis=1))))
    if not spread < TIP_STILL_MM:
        what = f"the tip moves by {spread:.3g} mm on the body"
        raise fault(path, what, "Hold the probe still on the tool point, or is the last marker another one?")
    return Body(shape, tip, f"{path.name}, tip digitised to {spread:.3g} mm a frame")


VIRTUAL = "tool-as-markers"
LEVERS = LEVER_MM * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def tool_as_markers(recording: Recording, name: str | None = None) -> Recording:
    """Return a recording in which a tool with quaternions is three markers: its origin, and 100 mm along x and y.

    Raises:
        FileError: no such tool, or one without orientation.

    """
    if name is not None and name not in recording.markers:
        raise fault(recording.path, f"has no tool {name!r}", f"It has {', '.join(recording.markers)}.")
    k = 0 if name is None else recording.markers.index(name)

    def blocks() -> Iterator[Block]:
        for block in recording.blocks():
            if block.quaternions is None:
                raise fault(recording.path, "its tools have no orientation", "Leave out --tool.")
            turned = matrices_from_quaternions(block.quaternions[:, k])
            points = block.points_mm[:, k, None] + np.einsum("nij,mj->nmi", turned, LEVERS)
            yield replace(block, points_mm=points, quaternions=None)

    return replace(recording, kind=VIRTUAL, markers=("origin", "x", "y"), blocks=blocks)


def seen_enough(found: Poses) -> NDArray[np.bool_]:
    """Return where the pose is known."""
    return np.asarray(~np.isnan(found.rms_mm))


@dataclass(frozen=True)
class Arm:
    """Axes at zero: ``direction`` and ``point`` (k, 3) mm, the ``joint`` that drives each times ``ratio``; the tool's pose."""

    name: str
    joints: int
    joint: NDArray[np.int64]
    ratio: Floats
    slides: NDArray[np.bool_]
    direction: Floats
    point: Floats
    home_turn: Floats
    home_mm: Floats

    def reading(self, log: JointLog) -> Floats:
        """Return the joints of a log (n, joints) in rad and mm.

        Raises:
            FileError: the log has another number of joints, or an angle for a prismatic joint.

        """
        if len(log.joints) != self.joints:
            what = f"has {len(log.joints)} joints, and the robot {self.name} has {self.joints}"
            raise fault(log.path, what, "Is it the log of another robot? Name the robot that was measured.")
        slides = {int(j) for j in self.joint[self.slides]}
        for i, name in enumerate(log.joints):
            if (i in slides) != name.endswith(("_mm", "_m")):
                what = f"joint {i + 1} of {self.name} is {'prismatic' if i in slides else 'revolute'}"
                raise fault(log.path, what, f"Name the column q{i + 1}_{'mm' if i in slides else 'deg'}.", column=name)
        turns = np.array([i not in slides for i in range(self.joints)])
        return np.asarray(np.where(turns, np.radians(log.q_even()), log.q_even()))

    def poses(self, q: Floats) -> tuple[Floats, Floats]:
        """Return orientations (n, 3, 3) and positions (n, 3) mm of the tool at joints ``q`` (n, joints) in rad and mm."""
        turn, place = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3))
        for k in range(len(self.joint)):
            turn, place = self._apply_joint(k, q, turn, place)
        return turn @ self.home_turn, np.einsum("nij,j->ni", turn, self.home_mm) + place

    def axes(self, q: Floats) -> list[tuple[Floats, Floats]]:
        """Return for each axis the orientation (n, 3, 3) of the link before it and the position (n, 3) of its point, mm."""
        turn, place, out = np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)), []
        for k in range(len(self.joint)):
            out.append((turn, turn @ self.point[k] + place))
            turn, place = self._apply_joint(k, q, turn, place)
        return out

    def _apply_joint(self, k: int, q: Floats, turn: Floats, place: Floats) -> tuple[Floats, Floats]:
        amount = q[:, self.joint[k]] * self.ratio[k]
        if self.slides[k]:
            return turn, place + (turn @ self.direction[k]) * amount[:, None]
        own = rotations(self.direction[k] * amount[:, None])
        shift = self.point[k] - own @ self.point[k]
        return turn @ own, np.einsum("nij,nj->ni", turn, shift) + place


def rotations(vectors: Floats) -> Floats:
    """Return the rotations (n, 3, 3) about ``vectors`` (n, 3) by their lengths, rad (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=1)
    x, y, z = (vectors / np.where(angle > 0, angle, 1.0)[:, None]).T
    nil = np.zeros_like(x)
    cross = np.stack([nil, -z, y, z, nil, -x, -y, x, nil], axis=1).reshape(-1, 3, 3)
    sine, rest = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + rest * (cross @ cross))


def arm_from_check(checked: Mapping[str, Any]) -> Arm:
    """Return the arm of the server's check of a robot document (``kilter.robots.check``)."""
    names, axes = [joint["name"] for joint in checked["joints"]], checked["axes"]
    tool = checked["zero"]["tool"]
    angles = [math.radians(tool[f"r{axis}_deg"]) for axis in "xyz"]
    about_x, about_y, about_z = rotations(np.diag(angles))
    return Arm(
        name=str(checked["name"]),
        joints=len(names),
        joint=np.array([names.index(axis["joint"]) for axis in axes], dtype=np.int64),
        ratio=np.array([axis["ratio"] for axis in axes], dtype=np.float64),
        slides=np.array([axis["kind"] == "prismatic" for axis in axes]),
        direction=np.array([axis["direction"] for axis in axes], dtype=np.float64),
        point=np.array([axis["point_mm"] for axis in axes], dtype=np.float64),
        home_turn=about_z @ about_y @ about_x,
        home_mm=np.array([tool[f"{axis}_mm"] for axis in "xyz"], dtype=np.float64),
    )
