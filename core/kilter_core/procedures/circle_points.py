"""Circle point analysis: axes from rows in which one joint moved at a time, and with them a robot without a description.

What one joint carries goes round its axis. All points of a joint are fitted together as one rigid body that rotates by the
joint's readings, so that an arc does as well as a circle; short arcs are refused, because they say little about the middle.

On FANUC's and on parallelogram arms the third joint's reading is its angle in space. While the second moves alone, the forearm
keeps its direction, so every point goes round a circle of the upper arm's length about a middle of its own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.optimize

from kilter_core.arm.conversions import Screws, pose_document, robot_document
from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError, TooFewPosesError
from kilter_core.measurement.markers import fit_poses, marker_shape
from kilter_core.parameters import DEG, MM, mm
from kilter_core.transforms import align_z_axis, inverse, nearest_rotation, rotations_about
from kilter_core.types import Bools, Floats, Ints

LEAST_ROWS = 5
LEAST_ARC = math.radians(30.0)
LEAST_STROKE_M = 0.01
STILL = 2e-4  # rad or m: others that move less count as at rest
ROUND = 0.005  # share of the radius by which points may be off the circle, beside three times their noise
SCALE = 0.05  # share by which a prismatic joint's readings and travel may disagree
PARALLEL = 1e-3


@dataclass(frozen=True)
class AxisFit:
    """An axis as its circle shows it, in the device's frame with the other joints at ``others (n,)``.

    ``arc`` rad (m for a prismatic joint), ``radius`` m of the widest circle, ``rms`` m of the fit, and standard deviations of
    the direction (rad) and of the place across it (m).
    """

    direction: Floats
    point: Floats
    prismatic: bool
    others: Floats
    rows: int
    arc: float
    radius: float
    rms: float
    sigma_rad: float
    sigma_m: float


@dataclass(frozen=True)
class CircleRobot:
    """The robot document found, what each axis rests on, and how far the whole robot is from all rows (rms, m)."""

    document: dict[str, Any]
    axes: tuple[AxisFit, ...]
    rms: float


def robot_from_circles(
    q: Floats,
    prismatic: Bools,
    points: Floats,
    tip: Floats | None = None,
    *,
    name: str,
    convention: str = "chain",
    frame: str = "axis",
    follows: Mapping[int, int] | None = None,
) -> CircleRobot:
    """Find the axes of a robot from readings ``q (N, n)`` and measured ``points (N, m, 3)`` m (one point, or markers).

    The base frame is on the first axis, its z along it (``frame`` "axis"), or is the device's ("device"). The flange is
    the measured point (the markers' middle, or the digitised ``tip (N, 3)``), oriented as the markers or the base.
    ``follows`` are joints (from 0) read against the horizontal, follower -> leader: their links do not rotate with the leader.

    Raises:
        ObservationError: ``joint_constant``, ``arc_too_short`` or ``circle_not_round``, naming the joint.
        TooFewPosesError: fewer than five rows of a joint.

    """
    pairs = checked_follows(follows or {}, prismatic)
    middle = points.mean(axis=1, keepdims=True)
    seen = [middle if j in pairs.values() else points for j in range(q.shape[1])]
    fits = [_axis_or_pair(q, seen[j], j, prismatic) for j in range(q.shape[1])]
    for follower, leader in pairs.items():
        fits[leader] = _locate_leader_axis(q, middle, fits[leader], fits[follower], (leader, follower))
    screws = _at_zero(fits, pairs)
    home, rms = _home(screws, q, points, tip)
    base = np.eye(4) if frame == "device" else _on_first_axis(screws)
    placed = screws.compose_with_poses(inverse(base), np.eye(4))
    axes = [
        {
            "joint": f"j{placed.joint[k] + 1}",
            "ratio": float(placed.ratio[k]),
            "type": "prismatic" if placed.prismatic[k] else "revolute",
            "direction": placed.direction[k].tolist(),
            "point_mm": mm(placed.point[k]).tolist(),
        }
        for k in range(len(placed))
    ]
    document = {
        "name": name,
        "convention": "poe",
        "axes": axes,
        "home": pose_document(inverse(base) @ home),
        "base": pose_document(base),
    }
    return CircleRobot(robot_document(robot_from_document(document), convention), tuple(fits), rms)


def _axis_or_pair(q: Floats, points: Floats, j: int, prismatic: Bools) -> AxisFit:
    """Fit an axis; where its circle is none because a parallel joint is read against the horizontal, name that one."""
    try:
        return _axis(q, points, j, bool(prismatic[j]))
    except ObservationError as error:
        rows = _alone(q, j)
        rows = rows[~np.isnan(points[rows]).any(axis=(1, 2))]
        if error.code != "circle_not_round" or prismatic[j] or not keeps_direction(points[rows]):
            raise
        own = _axis(q, points.mean(axis=1, keepdims=True), j, False)
        for k in range(j + 1, q.shape[1]):
            if not prismatic[k] and abs(_axis(q, points, k, False).direction @ own.direction) > COUPLED_PARALLEL:
                refuse_coupled(j, k)
        raise


def _locate_leader_axis(q: Floats, middle: Floats, fit: AxisFit, follower: AxisFit, pair: tuple[int, int]) -> AxisFit:
    """The leader's axis: its circle's middle is off by as much as the points are off the follower's axis."""
    leader, last = pair
    before = [k for k in range(last) if k != leader]
    apart = float(np.abs(fit.others[before] - follower.others[before]).max(initial=0.0))
    if apart > STILL or abs(fit.direction @ follower.direction) < COUPLED_PARALLEL:
        what = "the axes are not parallel" if apart <= STILL else "the joints before were elsewhere for their circles"
        raise ObservationError(
            f"Joint {last + 1} cannot follow joint {leader + 1}: {what}. Leave it out of follows, or measure both circles with "
            "the joints before at the same readings.",
            joint=leader + 1,
            follower=last + 1,
        )
    rows = _alone(q, leader)
    rows = rows[~np.isnan(middle[rows]).any(axis=(1, 2))]
    at = float(follower.others[leader])
    point = leader_point(q[rows, leader], middle[rows, 0], fit.direction, fit.point, at, follower.point)
    return replace(fit, point=point)


def _axis(q: Floats, points: Floats, j: int, prismatic: bool) -> AxisFit:
    rows = _alone(q, j)
    name = f"Joint {j + 1}"
    span = float(np.ptp(q[rows, j])) if len(rows) else 0.0
    if span < 10 * STILL:
        raise ObservationError(
            f"{name} never moves alone: measure rows in which it moves and all others are at rest.",
            code="joint_constant",
            joint=j + 1,
        )
    seen = rows[~np.isnan(points[rows]).any(axis=(1, 2))]
    places = len(np.unique(np.round(q[seen, j] / STILL)))
    if places < LEAST_ROWS:
        raise TooFewPosesError(
            f"{name} has {places} places at which all points were seen: measure {LEAST_ROWS} or more along its arc.",
            joint=j + 1,
        )
    arc = float(np.ptp(q[seen, j]))
    least, what = (LEAST_STROKE_M, "mm") if prismatic else (LEAST_ARC, "degrees")
    if arc < least * (1.0 - 1e-9):
        scale = MM if prismatic else DEG
        raise ObservationError(
            f"{name} moves over {arc * scale:.3g} {what} only: {least * scale:.0f} are needed, and more are better, for a "
            "short arc hardly shows where its axis is.",
            code="arc_too_short",
            joint=j + 1,
            arc=arc,
        )
    fit = _prismatic_fit if prismatic else _revolute_fit
    return fit(q[seen, j], points[seen], q[seen[0]], j)


def _alone(q: Floats, j: int) -> Ints:
    """Rows (K,) in which the other joints are in one place: of all such places the one with the widest arc."""
    others = np.delete(q, j, axis=1)
    # Rows in one place are near in any one direction: looking there only, many places cost no more than their number.
    # The direction is drawn again each time, so that no table can be made whose rows all agree along it.
    weight: Floats = np.random.default_rng().uniform(0.5, 1.0, (others.shape[1],))
    along = others @ weight
    order = np.argsort(along, kind="stable")
    width = STILL * float(weight.sum()) * (1.0 + 1e-9)
    starts = np.searchsorted(along[order], along - width, side="left")
    ends = np.searchsorted(along[order], along + width, side="right")
    left, best = np.ones(len(q), dtype=bool), np.zeros(0, dtype=np.int64)
    for first in range(len(q)):
        if not left[first]:
            continue
        near = order[starts[first] : ends[first]]
        same = np.sort(near[np.all(np.abs(others[near] - others[first]) < STILL, axis=1)])
        left[same] = False
        if len(same) > 1 and (len(best) == 0 or np.ptp(q[same, j]) > np.ptp(q[best, j])):
            best = same
    return best


def _revolute_fit(angle: Floats, points: Floats, others: Floats, j: int) -> AxisFit:
    """Fit p = P + Rot(n, angle) X for all points: n and P by least squares, every X eliminated."""
    A = np.column_stack([np.ones(len(angle)), np.cos(angle), np.sin(angle)])
    flat = points.reshape(len(angle), -1)
    centre, cosine, sine = np.linalg.lstsq(A, flat, rcond=None)[0].reshape(3, -1, 3)
    z0, P0 = _circle_start(centre, cosine, sine)
    u, v = align_z_axis(np.eye(3), z0)[:, :2].T

    def place(x: Floats) -> tuple[Floats, Floats]:
        z = z0 + x[0] * u + x[1] * v
        return z / np.linalg.norm(z), P0 + x[2] * u + x[3] * v

    def body_residuals(x: Floats) -> Floats:
        z, P = place(x)
        back = rotations_about(z, -angle)
        local = np.einsum("kij,kmj->kmi", back, points - P)
        return np.asarray((local - local.mean(axis=0)).ravel())

    found = scipy.optimize.least_squares(body_residuals, np.zeros(4), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    z, P = place(found.x)
    arms = points - P
    radius = float(np.linalg.norm(arms - (arms @ z)[..., None] * z, axis=2).max())
    rms = float(np.sqrt(np.mean(found.fun**2) * 3.0))
    free = _free_rms(angle, flat)
    if rms > max(ROUND * radius, 3.0 * free + 1e-9) or radius < 1e-6:
        _refuse_not_round(j, radius, rms)
    freedom = max(points.size - 3 * points.shape[1] - 4, 1)
    J = np.asarray(found.jac)
    covariance = np.linalg.pinv(J.T @ J) * float(found.fun @ found.fun) / freedom
    sigma = np.sqrt(np.diag(covariance))
    arc = float(np.ptp(angle))
    return AxisFit(
        z, P, False, others, len(angle), arc, radius, rms, float(np.hypot(*sigma[:2])), float(np.hypot(*sigma[2:]))
    )


def _circle_start(centre: Floats, cosine: Floats, sine: Floats) -> tuple[Floats, Floats]:
    """Direction and point to start from; ellipses of short arcs still tilt the right way."""
    normal = np.cross(cosine, sine).sum(axis=0)
    size = float(np.linalg.norm(normal))
    z = normal / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    weight = np.linalg.norm(np.cross(cosine, sine), axis=1)
    P = np.average(centre, axis=0, weights=weight + 1e-12)
    return z, P


def _free_rms(angle: Floats, flat: Floats) -> float:
    """Scatter m about a smooth curve of the reading, whatever its shape: the noise, where readings and circle disagree."""
    x = (angle - angle.mean()) / max(float(np.ptp(angle)), 1e-12)
    A = np.vander(x, min(6, len(angle) - 1))
    left = flat - A @ np.linalg.lstsq(A, flat, rcond=None)[0]
    return float(np.sqrt(np.sum(left**2) / (max(len(angle) - A.shape[1], 1) * flat.shape[1] / 3.0)))


def _refuse_not_round(j: int, radius: float, rms: float) -> None:
    raise ObservationError(
        f"The points of joint {j + 1} are {mm(rms):.3g} mm (rms) off the circle that its readings ask for (radius "
        f"{mm(radius):.4g} mm): the readings are in another unit or of another joint, or another joint moved along.",
        code="circle_not_round",
        joint=j + 1,
        rms_m=rms,
    )


def _prismatic_fit(shift: Floats, points: Floats, others: Floats, j: int) -> AxisFit:
    A = np.column_stack([np.ones(len(shift)), shift])
    flat = points.reshape(len(shift), -1)
    start, slope = np.linalg.lstsq(A, flat, rcond=None)[0]
    mean = slope.reshape(-1, 3).mean(axis=0)
    size, left = float(np.linalg.norm(mean)), flat - A @ np.vstack([start, slope])
    rms = float(np.sqrt(np.mean(left**2) * 3.0))
    stroke = float(np.ptp(shift))
    if abs(size - 1.0) > SCALE or rms > SCALE * stroke:
        _refuse_not_round(j, stroke, max(rms, abs(size - 1.0) * stroke))
    spread = float(np.sqrt(np.sum((shift - shift.mean()) ** 2) * points.shape[1]))
    sigma = rms / math.sqrt(3.0) / spread * math.sqrt(2.0)
    point = start.reshape(-1, 3).mean(axis=0)
    return AxisFit(mean / size, point, True, others, len(shift), stroke, 0.0, rms, sigma, 0.0)


def _at_zero(fits: Sequence[AxisFit], pairs: Mapping[int, int]) -> Screws:
    """Axes with all joints at zero: each was seen with the joints before it wherever they were.

    The axis of a follower comes twice: its leader rotates it back, then it rotates itself.
    """
    out = Screws(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, bool), np.zeros(0, np.int64), np.zeros(0), np.eye(4))
    for i, fit in enumerate(fits):
        back = inverse(out.poses(fit.others[None])[0])
        direction, point = back[:3, :3] @ fit.direction, back[:3, :3] @ fit.point + back[:3, 3]
        if i in pairs:
            sense = math.copysign(1.0, fit.direction @ fits[pairs[i]].direction)
            out = _append_screw(out, direction, point, fit.prismatic, pairs[i], -sense)
        out = _append_screw(out, direction, point, fit.prismatic, i, 1.0)
    return out


def _append_screw(
    screws: Screws, direction: Floats, point: Floats, prismatic: bool, joint: int, ratio: float
) -> Screws:
    return Screws(
        np.vstack([screws.direction, direction]),
        np.vstack([screws.point, point]),
        np.append(screws.prismatic, prismatic),
        np.append(screws.joint, joint),
        np.append(screws.ratio, ratio),
        screws.home,
    )


def _home(screws: Screws, q: Floats, points: Floats, tip: Floats | None) -> tuple[Floats, float]:
    """Pose (4, 4) of the measured point at zero, the mean over all rows, and what is left of the rows (rms, m)."""
    T = screws.poses(q)
    home = np.eye(4)
    if points.shape[1] >= 3:
        position, rotation, usable = fit_poses(marker_shape(points, tip), points)
        home[:3, :3] = nearest_rotation(np.mean(T[usable, :3, :3].transpose(0, 2, 1) @ rotation[usable], axis=0))
    else:
        position, usable = points[:, 0], np.asarray(~np.isnan(points[:, 0]).any(axis=1))
    local = np.einsum("kji,kj->ki", T[usable, :3, :3], position[usable] - T[usable, :3, 3])
    home[:3, 3] = local.mean(axis=0)
    return home, float(np.sqrt(np.mean(np.sum((local - home[:3, 3]) ** 2, axis=1))))


def _on_first_axis(screws: Screws) -> Floats:
    """Frame on the first axis where the second comes nearest; the device's own where the first joint is prismatic."""
    base = np.eye(4)
    if screws.prismatic[0]:
        return base
    z, p = screws.direction[0], screws.point[0]
    base[:3, :3] = align_z_axis(np.eye(3), z)
    towards = screws.home[:3, 3]
    if len(screws) > 1 and not screws.prismatic[1]:
        a = screws.direction[1]
        across = np.cross(np.cross(z, a), a)
        bend = float(z @ across)
        towards = screws.point[1] if abs(bend) < PARALLEL else p + z * ((screws.point[1] - p) @ across / bend)
    base[:3, 3] = p + z * (z @ (towards - p))
    return base


ROTATES = 0.02  # markers that rotate with a joint by 30 degrees change by a quarter of their distances
COUPLED_PARALLEL = math.cos(math.radians(2.0))


def checked_follows(follows: Mapping[int, int], prismatic: Bools) -> dict[int, int]:
    """Return follower -> leader (from 0) of revolute joints.

    Raises:
        ObservationError: a joint that is not there, is prismatic, or does not come after the one it follows.

    """
    for follower, leader in follows.items():
        if not 0 <= leader < follower < len(prismatic) or prismatic[follower] or prismatic[leader]:
            raise ObservationError(
                f"Joint {follower + 1} cannot follow joint {leader + 1}: both must be revolute, and the follower comes "
                f"after the leader; the rows have {len(prismatic)} joints.",
                follower=follower + 1,
                joint=leader + 1,
            )
    return dict(follows)


def keeps_direction(points: Floats) -> bool:
    """Return whether points (N, m, 3) move without rotation."""
    if points.shape[1] < 2:
        return False
    body = points - points.mean(axis=1, keepdims=True)
    size = float(np.sqrt(np.mean(body**2)))
    return float(np.sqrt(np.mean((body - body.mean(axis=0)) ** 2))) < ROTATES * size


def refuse_coupled(leader: int, follower: int) -> None:
    """Refuse circles that show a follower.

    Raises:
        ObservationError: always.

    """
    pair = f"j{follower + 1}=j{leader + 1}"
    raise ObservationError(
        f"The points of joint {leader + 1} go round but do not rotate: another joint moved along. It is joint {follower + 1}, "
        f"whose axis is parallel: its reading is the angle in space, not the one to link {leader + 1}, as on FANUC's and on "
        f"parallelogram arms. Uncouple them: --follows {pair} (over HTTP follows={pair}).",
        code="circle_not_round",
        joint=leader + 1,
        follower=follower + 1,
    )


def leader_point(angle: Floats, middle: Floats, direction: Floats, centre: Floats, at: float, elbow: Floats) -> Floats:
    """Return a point (3,) on the leader's axis.

    The middle of all points (N, 3) at readings ``angle`` goes round ``centre`` as ``elbow``, a point on the follower's axis
    while the leader was at ``at``, goes round the axis.
    """
    rotated = np.array([_rotate_about_axis(direction, at - a, p - centre) for a, p in zip(angle, middle, strict=True)])
    arm = rotated.mean(axis=0)
    return np.asarray(elbow - (arm - direction * (direction @ arm)))


def _rotate_about_axis(z: Floats, angle: float, v: Floats) -> Floats:
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(c * v + s * np.cross(z, v) + (1.0 - c) * (z @ v) * z)
