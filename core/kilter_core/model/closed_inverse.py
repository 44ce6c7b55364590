"""All joints of a nominal six-axis arm that bring its flange to a pose, in closed form.

Two kinds of arms have one: those whose last three axes meet in a point and whose second and third are parallel, and
those whose second, third and fourth are parallel. The arm is read as its six axes with all joints at zero.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import RobotError
from kilter_core.transforms import inverse, rotations_about
from kilter_core.types import Floats

MEET_M = 1e-9  # axes that come nearer meet
PARALLEL = 1e-9
TOUCH = 1e-9  # beyond its reach by less than this share the arm still reaches
SINGULAR = 1e-7


@dataclass(frozen=True)
class Posture:
    """Joints (6,) rad, each within 180 degrees of zero, and which of the arm's branches they are.

    ``front``: the wrist is on the side of the root's x axis, with joint 1 at zero. ``elbow_up``: with the wrist in front
    the elbow is above the line to it. ``wrist``: which of the two bends of joint 5. ``singular``: two axes are in line, so
    that their joints cannot be told apart. ``named``: whether front, elbow_up and wrist tell the branches; an arm without
    a closed form has others, and these are False.
    """

    q: Floats
    front: bool
    elbow_up: bool
    wrist: bool
    singular: bool
    named: bool = True


@dataclass(frozen=True)
class Axes:
    """Six axes with all joints at zero: directions ``h (6, 3)``, points ``p (6, 3)`` m, the flange ``home (4, 4)``.

    ``joints (6, 6)`` are the joints per angle of an axis.
    """

    h: Floats
    p: Floats
    home: Floats
    joints: Floats


def postures(robot: Robot, T: Floats) -> list[Posture]:
    """Return the joints that bring the nominal flange to ``T (4, 4)``, in the frame of the robot's root; none: no reach.

    Raises:
        RobotError: the arm is of neither kind.

    """
    return solutions(read_six_axes(robot), T)


def solutions(axes: Axes, T: Floats) -> list[Posture]:
    """Return the postures of six axes.

    Raises:
        RobotError: the arm is of neither kind.

    """
    kind = closed_form_kind(axes)
    if kind is None:
        raise _no_closed_form_error(
            "the arm", "neither do its last three axes meet, nor are its axes 2, 3 and 4 parallel"
        )
    found = _with_wrist(axes, T) if kind == "wrist" else _with_parallels(axes, T)
    out: list[Posture] = []
    for angles, labels in found:
        q = axes.joints @ angles
        q = np.array([math.remainder(value, 2 * math.pi) for value in q])
        if not any((np.cos(q - other.q) > 1.0 - 1e-14).all() for other in out):
            out.append(Posture(q, *labels))
    return out


def read_six_axes(robot: Robot) -> Axes:
    """Read an arm as six axes; further axes of a joint that lie in one of these count with it.

    Raises:
        RobotError: it has not six revolute joints, or axes that follow others elsewhere.

    """
    if robot.n_joints != 6 or any(joint.kind != "revolute" for joint in robot.joints):
        raise _no_closed_form_error(robot.name, "it has not six revolute joints")
    T = np.eye(4)
    lines: list[tuple[Floats, Floats]] = []
    rows: list[Floats] = []
    for element in robot.chain.elements:
        if element.joint is not None:
            h, p = T[:3, element.axis % 3].copy(), T[:3, 3].copy()
            row = np.eye(6)[element.joint] * element.ratio
            side = float(lines[-1][0] @ h) if lines else 0.0
            if abs(abs(side) - 1.0) < PARALLEL and np.linalg.norm(np.cross(lines[-1][0], p - lines[-1][1])) < MEET_M:
                rows[-1] = rows[-1] + math.copysign(1.0, side) * row
            else:
                lines.append((h, p))
                rows.append(row)
        T = T @ element.axis.motion(element.value)
    angles = np.array(rows)
    if angles.shape != (6, 6) or abs(np.linalg.det(angles)) < 0.1:
        raise _no_closed_form_error(robot.name, "its joints do not move six axes")
    return Axes(np.array([h for h, _ in lines]), np.array([p for _, p in lines]), T, np.asarray(np.linalg.inv(angles)))


def flange(robot: Robot, q: Floats) -> Floats:
    """Return the nominal flange (4, 4) at joints ``q (n,)`` rad, in the frame of the robot's root."""
    T = np.eye(4)
    for element in robot.chain.elements:
        amount = element.value + (0.0 if element.joint is None else element.ratio * float(q[element.joint]))
        T = T @ element.axis.motion(amount)
    return T


def _no_closed_form_error(name: str, why: str) -> RobotError:
    return RobotError(
        f"The joints of {name!r} for a pose have no closed form: {why}. Give joint targets.", robot=name, field="chain"
    )


def closed_form_kind(axes: Axes) -> str | None:
    """Return which closed form an arm has, "wrist" or "parallels", if any."""
    h = axes.h
    if _parallel(h[1], h[2]) and _meeting(axes, 3, 4) is not None:
        point = _meeting(axes, 3, 4)
        if _distance(axes, 5, point) < MEET_M:
            return "wrist"
    if _parallel(h[1], h[2]) and _parallel(h[1], h[3]) and _meeting(axes, 4, 5) is not None:
        return "parallels"
    return None


def _with_wrist(axes: Axes, T: Floats) -> Iterator[tuple[Floats, tuple[bool, bool, bool, bool]]]:
    """Angles (6,) of an arm whose last three axes meet, and their labels."""
    h, p = axes.h, axes.p
    centre = _meeting(axes, 3, 4)
    assert centre is not None
    moved = T @ inverse(axes.home)
    wrist, turned = moved[:3, :3] @ centre + moved[:3, 3], moved[:3, :3]
    for first, in_line in _turns_to_plane(h[1], h[0], wrist - p[0], float(h[1] @ (centre - p[0]))):
        u = p[0] + _turn(h[0], -first) @ (wrist - p[0])
        for third, straight in _turns_to_length(h[2], p[2] - p[1], centre - p[2], u - p[1]):
            bent = p[2] + _turn(h[2], third) @ (centre - p[2])
            second = angle_about(h[1], bent - p[1], u - p[1])
            up = float(np.cross(p[2] - p[1], bent - p[2])[1]) > 0.0
            rest = (_turn(h[0], first) @ _turn(h[1], second) @ _turn(h[2], third)).T @ turned
            for four, fifth, six, positive, twisted in _wrist(h[3:], rest):
                labels = (float(u[0]) > 0.0, up, positive, in_line or straight or twisted)
                yield np.array([first, second, third, four, fifth, six]), labels


def _wrist(h: Floats, R: Floats) -> Iterator[tuple[float, float, float, bool, bool]]:
    """Angles of three axes that meet and rotate by R: the fourth, fifth and sixth, which bend, and whether none."""
    goal = R @ h[2]
    for k, (fifth, none) in enumerate(_turns_to_plane(h[0], h[1], h[2], float(h[0] @ goal), backwards=False)):
        bent = _turn(h[1], fifth) @ h[2]
        lost = none or np.linalg.norm(np.cross(h[0], goal)) < SINGULAR
        four = 0.0 if lost else angle_about(h[0], bent, goal)
        across = any_across(h[2])
        six = angle_about(h[2], across, (_turn(h[0], four) @ _turn(h[1], fifth)).T @ R @ across)
        yield four, fifth, six, k == 0, bool(lost)


def _with_parallels(axes: Axes, T: Floats) -> Iterator[tuple[Floats, tuple[bool, bool, bool, bool]]]:
    """Angles (6,) of an arm whose axes 2, 3 and 4 are parallel, and their labels."""
    h, p = axes.h, axes.p
    point = _meeting(axes, 4, 5)
    assert point is not None
    moved = T @ inverse(axes.home)
    seen, R = moved[:3, :3] @ point + moved[:3, 3], moved[:3, :3]
    for a, (first, in_line) in enumerate(_turns_to_plane(h[1], h[0], seen - p[0], float(h[1] @ (point - p[0])))):
        back = _turn(h[0], -first)
        for b, (fifth, flat) in enumerate(
            _turns_to_plane(h[1], h[4], h[5], float(h[1] @ (back @ R @ h[5])), backwards=False)
        ):
            seen_by_six = _turn(h[4], -fifth) @ h[1]
            lost = flat or np.linalg.norm(np.cross(seen_by_six, h[5])) < SINGULAR
            six = 0.0 if lost else angle_about(h[5], R.T @ back.T @ h[1], seen_by_six)
            three = about(h[0], p[0], -first) @ moved @ about(h[5], p[5], -six) @ about(h[4], p[4], -fifth)
            across = any_across(h[1])
            whole = angle_about(h[1], across, three[:3, :3] @ across)
            u = three[:3, :3] @ p[3] + three[:3, 3]
            for c, (third, straight) in enumerate(_turns_to_length(h[2], p[2] - p[1], p[3] - p[2], u - p[1])):
                bent = p[2] + _turn(h[2], third) @ (p[3] - p[2])
                second = angle_about(h[1], bent - p[1], u - p[1])
                left = whole - second - float(h[1] @ h[2]) * third
                fourth = left * float(h[1] @ h[3])
                angles = np.array([first, second, third, fourth, fifth, six])
                yield angles, (a == 0, c == 0, b == 0, bool(in_line or lost or straight))


def _turns_to_plane(
    n: Floats, h: Floats, v: Floats, height: float, *, backwards: bool = True
) -> Iterator[tuple[float, bool]]:
    """Angles of ``v`` about ``h`` (against it: ``backwards``) at which it has this height along ``n``; are both one."""
    along = h * float(h @ v)
    a, b = float(n @ (v - along)), float(n @ np.cross(h, v))
    yield from _roots(a, -b if backwards else b, height - float(n @ along))


def _turns_to_length(h: Floats, s: Floats, w: Floats, goal: Floats) -> Iterator[tuple[float, bool]]:
    """Angles of ``w`` about ``h`` that make ``s + w`` as long as ``goal``, across ``h``."""
    s, w, goal = (v - h * float(h @ v) for v in (s, w, goal))
    yield from _roots(float(s @ w), float(s @ np.cross(h, w)), 0.5 * (float(goal @ goal) - float(s @ s) - float(w @ w)))


def _roots(a: float, b: float, c: float) -> Iterator[tuple[float, bool]]:
    """Angles with a cos + b sin = c, and whether the two are one; none beyond reach."""
    size = math.hypot(a, b)
    if size < 1e-12 or abs(c) > size * (1.0 + TOUCH):
        return
    middle, half = math.atan2(b, a), math.acos(max(-1.0, min(1.0, c / size)))
    one = min(half, math.pi - half) < SINGULAR
    yield middle + half, one
    yield middle - half, one


def angle_about(h: Floats, v: Floats, w: Floats) -> float:
    """Return the angle about ``h`` from ``v`` to ``w``, rad."""
    v, w = v - h * float(h @ v), w - h * float(h @ w)
    return math.atan2(float(h @ np.cross(v, w)), float(v @ w))


def _turn(h: Floats, angle: float) -> Floats:
    return np.asarray(rotations_about(h, np.array([angle]))[0])


def about(h: Floats, p: Floats, angle: float) -> Floats:
    """Return the pose (4, 4) of a rotation about the line through ``p`` along ``h``."""
    T = np.eye(4)
    T[:3, :3] = _turn(h, angle)
    T[:3, 3] = p - T[:3, :3] @ p
    return T


def any_across(h: Floats) -> Floats:
    """Return a direction (3,) at right angles to another."""
    v = np.cross(h, np.eye(3)[int(np.argmin(np.abs(h)))])
    return np.asarray(v / np.linalg.norm(v))


def _parallel(g: Floats, h: Floats) -> bool:
    return bool(np.linalg.norm(np.cross(g, h)) < PARALLEL)


def _distance(axes: Axes, k: int, point: Floats | None) -> float:
    return math.inf if point is None else float(np.linalg.norm(np.cross(axes.h[k], point - axes.p[k])))


def _meeting(axes: Axes, i: int, j: int) -> Floats | None:
    """Point (3,) m where two axes meet; None where they do not."""
    g, h, between = axes.h[i], axes.h[j], axes.p[j] - axes.p[i]
    normal = np.cross(g, h)
    if np.linalg.norm(normal) < PARALLEL or abs(float(normal @ between)) > MEET_M * np.linalg.norm(normal):
        return None
    along = float(np.cross(between, h) @ normal) / float(normal @ normal)
    return np.asarray(axes.p[i] + along * g)
