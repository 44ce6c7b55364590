"""Markers that sit on one rigid body: its pose by least squares, and the tool point on it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import fault
from kilter_files.ground.orientation import matrices_from_quaternions, quaternions_from_matrices
from kilter_files.match.dwells import mean_seen, thin
from kilter_files.tables.recording import Block, Recording

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
