"""Orientation that is given in another convention than it is read in, where the positions fit."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations
from typing import Any, Literal

import numpy as np

from kilter_core.identify.plausibility.mix_ups import mix_ups
from kilter_core.identify.plausibility.set_up_changes import Sample
from kilter_core.parameters import degrees
from kilter_core.transforms import nearest_rotation, rotation_log, scipy_rotation
from kilter_core.types import Floats

NEAR_RAD = np.radians(5.0)  # scatter of the tool's rotation on the flange that real arms stay below
FACTOR = 5.0
RIGHT_RAD = np.radians(3.0)
POSITION = 1.5  # times the residual of the positions that another reading of the joints may leave
Angles = Literal["ZXZ", "ZYX", "XYZ", "ZYZ", "xyz", "zyx"]
EULER: dict[Angles, str] = {
    "ZXZ": "ZXZ (phi, theta, psi)",
    "ZYX": "ZYX",
    "XYZ": "XYZ",
    "ZYZ": "ZYZ",
    "xyz": "roll, pitch, yaw (fixed X, Y, Z)",
    "zyx": "fixed Z, Y, X",
}

Accusation = tuple[tuple[str, ...], tuple[str, ...], float, float]


@dataclass(frozen=True)
class Reading:
    """Another way to read the rotations: one or two variants (V, K, 3, 3) per row, of which each row may take either."""

    sentence: str
    remedy: str
    flange: Floats  # rotations (K, 3, 3) of the flange in the frame of the measurements
    variants: Floats


def rotation_faults(sample: Sample, stated: bool) -> tuple[Accusation | None, tuple[dict[str, Any], ...]]:
    """What is wrong with the rotations where positions fit; ``stated``: by angles or quaternions, not seen by markers.

    Returns an accusation (sentences, remedies, degrees left before and after) or None, and warnings.
    """
    assert sample.rotations is not None
    flange = sample.fitted_placement.rotation @ sample.flange[:, :3, :3]
    before, tool = scatter(flange, sample.rotations[None])
    if before <= NEAR_RAD:
        return None, _right_angle(sample, tool) if stated else ()
    readings = [*_of_joints(sample), *(_of_rotations(sample, flange) if stated else ())]
    if not readings:
        return None, ()
    sizes = [scatter(r.flange, r.variants)[0] for r in readings]
    best = min(sizes)
    if best * FACTOR > before or best > NEAR_RAD:
        return None, ()
    alike = [r for r, size in zip(readings, sizes, strict=True) if size < 1.5 * best + 1e-6]
    return (
        tuple(dict.fromkeys(r.sentence for r in alike)),
        tuple(dict.fromkeys(r.remedy for r in alike)),
        float(degrees(before)),
        float(degrees(best)),
    ), ()


def scatter(flange: Floats, variants: Floats) -> tuple[float, Floats]:
    """Scatter (rad, the median of rows) of the tool's rotation on the flange, and that rotation (3, 3)."""
    rotations = flange.transpose(0, 2, 1) @ variants
    best, tool = np.inf, np.eye(3)
    for row in range(0, rotations.shape[1], max(1, rotations.shape[1] // 8)):
        for reference in rotations[:, row]:
            angle = _angles(reference, rotations).min(axis=0)
            if np.median(angle) < best:
                best, tool = float(np.median(angle)), reference
    near = _angles(tool, rotations)
    chosen = np.take_along_axis(rotations, near.argmin(axis=0)[None, :, None, None], axis=0)[0]
    tool = nearest_rotation(chosen[near.min(axis=0) <= np.quantile(near.min(axis=0), 0.7)].mean(axis=0))
    return float(np.median(_angles(tool, rotations).min(axis=0))), tool


def _angles(reference: Floats, rotations: Floats) -> Floats:
    """Angle of each rotation (..., 3, 3) against one."""
    trace = np.einsum("ij,...ij->...", reference, rotations)
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))


def _of_joints(sample: Sample) -> Iterator[Reading]:
    """Mix-ups of joints that the positions do not see, as of those behind the last bend."""
    limit = POSITION * sample.fitted_placement.size + 1e-4
    for m in mix_ups(sample.begin.robot):
        if m.length != 1.0 or m.mirror or m.inverted or m.offset is not None:
            continue
        read = sample.undo_mix_up(m)
        if read.fitted_placement.size <= limit and read.rotations is not None:
            yield Reading(
                m.sentence, m.remedy, read.fitted_placement.rotation @ read.flange[:, :3, :3], read.rotations[None]
            )


def _of_rotations(sample: Sample, flange: Floats) -> Iterator[Reading]:
    assert sample.rotations is not None
    rotations = sample.rotations
    what = "name the columns, or the convention in the column map, as they are, and upload again"
    yield Reading(
        "The orientation looks transposed (tool to base given as base to tool)",
        "invert the rotations",
        flange,
        rotations.transpose(0, 2, 1)[None],
    )
    wxyz = scipy_rotation().from_matrix(rotations).as_quat()[:, [3, 0, 1, 2]]
    for order in permutations(range(4)):
        if order != (0, 1, 2, 3):
            meant = "".join("wxyz"[order.index(k)] for k in range(4))
            again = scipy_rotation().from_quat(wxyz[:, order][:, [1, 2, 3, 0]]).as_matrix()
            yield Reading(f"The quaternion looks to be in the order {meant}, read as wxyz", what, flange, again[None])
    for read, meant, variants in _of_angles(rotations):
        yield Reading(f"The angles look to be {EULER[meant]}, read as {EULER[read]}", what, flange, variants)
    yield from _other_axes(rotations, flange)


def _of_angles(rotations: Floats) -> Iterator[tuple[Angles, Angles, Floats]]:
    parsed = scipy_rotation().from_matrix(rotations)
    for read in EULER:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # at gimbal lock any of the angles do
            angles = parsed.as_euler(read)
        middle = -angles[:, 1] if read[0] == read[2] else np.pi - angles[:, 1]
        other = np.stack([angles[:, 0] + np.pi, middle, angles[:, 2] + np.pi], axis=1)
        for meant in EULER:
            if meant != read:
                both = [scipy_rotation().from_euler(meant, a).as_matrix() for a in (angles, other)]
                yield read, meant, np.stack(both)


def _other_axes(rotations: Floats, flange: Floats) -> Iterator[Reading]:
    """Rotations given about other axes than the positions: the rotation between both, from pairs of rows (Procrustes)."""
    step = np.roll(np.arange(len(rotations)), -max(1, len(rotations) // 3))
    seen = rotation_log(rotations[step] @ rotations.transpose(0, 2, 1))
    moved = rotation_log(flange[step] @ flange.transpose(0, 2, 1))
    axes = nearest_rotation(seen.T @ moved)
    about = rotation_log(axes[None])[0]
    angle = float(np.linalg.norm(about))
    if angle > np.radians(30.0):
        axis = np.round(about / angle, 2) + 0.0
        named = _axis(about)
        yield Reading(
            f"The orientation looks to be given about other axes than the positions, rotated by "
            f"{degrees(angle):.0f} degrees about {named or axis.tolist()}",
            "give positions and orientations in one frame",
            flange,
            (axes.T @ rotations)[None],
        )


def _right_angle(sample: Sample, tool: Floats) -> tuple[dict[str, Any], ...]:
    """Warn of a tool that is rotated against the robot's by a right angle about one of its axes."""
    about = rotation_log((sample.begin.robot.T_tool[:3, :3].T @ tool)[None])[0]
    angle = float(np.linalg.norm(about))
    nearest = round(angle / (np.pi / 2.0))
    axis = _axis(about)
    if nearest == 0 or not axis or abs(angle - nearest * np.pi / 2.0) > RIGHT_RAD:
        return ()
    return (
        {
            "code": "orientation_right_angle",
            "axis": axis,
            "angle_deg": 90 * nearest,
            "message": f"Positions fit, and the measured orientation is rotated by {90 * nearest} degrees about the "
            f"tool's {axis} axis against the robot's tool. If that is not how the target "
            "sits, correct the tool of the robot or the axes of the orientation; a free tool takes it up.",
        },
    )


def _axis(about: Floats) -> str:
    """Name of the axis, with its sign, that a rotation is about; empty when it is about none."""
    size = float(np.linalg.norm(about))
    k = int(np.argmax(np.abs(about)))
    off = float(np.linalg.norm(np.delete(about, k))) / max(size, 1e-12)
    return ("-" if about[k] < 0 else "") + "xyz"[k] if off < np.sin(RIGHT_RAD) else ""
