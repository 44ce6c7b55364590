"""Inverse dynamics as a matrix: joint torques are linear in ten numbers of each link.

The numbers of a link are its mass m, first moment m c and inertia I about the origin of its frame, all in that frame
(Atkeson, An and Hollerbach 1986; Khalil and Dombre 2002, ch. 12). Only some sums of them, the base parameters, show in the
torques (Gautier and Khalil 1990).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from kilter_core.arm.chain import LINKAGE, Chain, Element
from kilter_core.arm.robot import Link, Robot
from kilter_core.transforms import rotations_about, skew
from kilter_core.types import Floats, Ints

PER_LINK = 10
NUMBERS = ("m", "mx", "my", "mz", "ixx", "ixy", "ixz", "iyy", "iyz", "izz")
RANDOM_STATES = 400
NO_LIMIT_RAD = np.pi
SAME = 1e-9  # columns below this share of the largest add nothing


@dataclass(frozen=True)
class _Frame:
    """Of a body, in base coordinates: rotation (N, 3, 3), origin, angular velocity, angular acceleration and the
    acceleration of the origin less gravity, (N, 3) each.
    """

    R: Floats
    origin: Floats
    w: Floats
    dw: Floats
    a: Floats


@dataclass(frozen=True)
class _Drive:
    """An element that a joint moves: its direction and place (N, 3), and how far it moves for the joint."""

    element: int
    joint: int
    ratio: float
    rotates: bool
    z: Floats
    origin: Floats


def link_elements(robot: Robot) -> tuple[int, ...]:
    """Elements of the chain behind which each body has its frame: the links as described, else one behind every joint."""
    return tuple(link.element for link in robot.links) or robot.chain.primary


def moving_elements(robot: Robot) -> frozenset[int]:
    """Return the elements of the chain whose load the drive of their joint carries."""
    chain = robot.chain
    return frozenset(k for k, one in enumerate(chain.elements) if one.joint is not None and _carries(chain, k))


def rigid_regressor(robot: Robot, q: Floats, qd: Floats, qdd: Floats) -> Floats:
    """Return the matrix ``Y (N, n, 10 L)`` of rigid bodies: torques N m (forces N) are ``Y @ pi``.

    ``q``, ``qd`` and ``qdd (N, n)`` are joints, speeds and accelerations, rad or m. ``pi (10 L,)`` has :data:`NUMBERS` of
    each of the bodies of :func:`link_elements`. A joint carries what its own axis carries, and what is linked to it.
    """
    frames, drives = _walk(robot, q, qd, qdd)
    Y = np.zeros((*q.shape, PER_LINK * len(frames)))
    for k, (element, frame) in enumerate(frames):
        force, moment = _wrench_of_numbers(frame)
        for drive in drives:
            if drive.element > element:
                continue
            if drive.rotates:
                lever = frame.origin - drive.origin
                on_axis = np.einsum("ni,nik->nk", drive.z, moment)
                on_axis += np.einsum("ni,nik->nk", np.cross(drive.z, lever), force)
            else:
                on_axis = np.einsum("ni,nik->nk", drive.z, force)
            Y[:, drive.joint, PER_LINK * k : PER_LINK * (k + 1)] += drive.ratio * on_axis
    return Y


def tool_wrench_regressor(robot: Robot, q: Floats, qd: Floats, qdd: Floats, place: Floats) -> Floats:
    """Return the matrix ``Y (N, 6, 10)`` of a body behind the last joint: force N and moment N m that move it are ``Y @ pi``.

    All, ``pi (10,)`` too, are about the origin and in the axes of the frame that stands at ``place (4, 4)`` of the outermost
    body's frame.
    """
    _, frame = max(_walk(robot, q, qd, qdd)[0], key=lambda one: one[0])
    lever = frame.R @ place[:3, 3]
    swing = np.cross(frame.dw, lever) + np.cross(frame.w, np.cross(frame.w, lever))
    moved = replace(frame, R=frame.R @ place[:3, :3], origin=frame.origin + lever, a=frame.a + swing)
    back = moved.R.transpose(0, 2, 1)
    return np.concatenate([back @ one for one in _wrench_of_numbers(moved)], axis=1)


def stated_numbers(robot: Robot) -> Floats:
    """Return numbers ``pi (10 L,)`` of the links as the robot's description states them; zero where it states no link."""
    if not robot.links:
        return np.zeros(PER_LINK * robot.n_joints)
    return np.concatenate([_numbers_of_link(link) for link in robot.links])


def _numbers_of_link(link: Link) -> Floats:
    at_centre = numbers_of_point(link.mass, np.asarray(link.com, dtype=np.float64))
    at_centre[4:] += link.inertia[np.triu_indices(3)]
    return at_centre


def numbers_of_point(mass: float, centre: Floats) -> Floats:
    """Return the numbers (10,) of a point mass, kg, at ``centre (3,)`` m in the frame of its body."""
    about_origin = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.array([mass, *(mass * centre), *about_origin[np.triu_indices(3)]])


def describe_body(numbers: Floats) -> tuple[float, Floats, Floats]:
    """Return mass, centre (3,) and inertia (3, 3) about it of a body with these numbers (10,), in its frame."""
    mass, centre = float(numbers[0]), numbers[1:4] / numbers[0]
    return mass, centre, symmetric(numbers[4:]) - symmetric(numbers_of_point(mass, centre)[4:])


def symmetric(six: Floats) -> Floats:
    """Return the matrix (3, 3) of its numbers xx, xy, xz, yy, yz, zz."""
    out = np.zeros((3, 3))
    out[np.triu_indices(3)] = six
    return np.asarray(out + np.triu(out, 1).T)


def joint_behind_link(robot: Robot, link: int) -> int:
    """Return the joint (from 0) that moves a body last."""
    element = link_elements(robot)[link]
    return max(j for j, k in enumerate(robot.chain.primary) if k <= element)


def tool_in_link(robot: Robot) -> Floats:
    """Return the pose (4, 4) of the tool in the frame of the outermost body."""
    return np.asarray(flange_in_link(robot) @ robot.T_tool)


def flange_in_link(robot: Robot) -> Floats:
    """Return the pose (4, 4) of the flange in the frame of the outermost body."""
    T = np.eye(4)
    for element in robot.chain.elements[max(link_elements(robot)) + 1 :]:
        T = T @ element.axis.motion(element.value)
    return T


def shown_columns(robot: Robot) -> list[Ints]:
    """Return, for each body, its columns that show in the torques by themselves."""
    Y = _random_regressor(robot)
    largest = float(np.linalg.norm(Y, axis=0).max())
    every = np.arange(Y.shape[1]).reshape(-1, PER_LINK)
    return [own[_independent_columns(Y[:, own], largest)] for own in every]


def base_columns(robot: Robot) -> Ints:
    """Return the columns (p,) of the regressor that are independent.

    By QR with pivoting of the regressor at random states within the joints' limits (Gautier 1991).
    """
    return _independent_columns(_random_regressor(robot))


def base_sums(robot: Robot) -> Floats:
    """Return ``K (p, 10 L)``: base parameters are ``K @ pi``, in the order of :func:`base_columns`."""
    Y = _random_regressor(robot)
    K, *_ = np.linalg.lstsq(Y[:, _independent_columns(Y)], Y, rcond=None)
    return np.asarray(K, dtype=np.float64)


def _random_regressor(robot: Robot) -> Floats:
    """Rows of all joints (n RANDOM_STATES, 10 L) at random states within the limits."""
    rng = np.random.default_rng(0)
    limits = np.clip(robot.limits, -NO_LIMIT_RAD, NO_LIMIT_RAD)
    shape = (RANDOM_STATES, robot.n_joints)
    q = rng.uniform(limits[:, 0], limits[:, 1], shape)
    Y = rigid_regressor(robot, q, rng.normal(size=shape), rng.normal(size=shape))
    return Y.reshape(-1, Y.shape[2])


def _independent_columns(Y: Floats, largest: float = 0.0) -> Ints:
    R, order = scipy.linalg.qr(Y, mode="r", pivoting=True)
    size = np.abs(np.diag(R))
    rank = int(np.count_nonzero(size > SAME * max(size[0], largest)))
    return np.sort(order[:rank]).astype(np.int64)


def _wrench_of_numbers(frame: _Frame) -> tuple[Floats, Floats]:
    """Force (N, 3, 10) and moment about the body's origin, in base coordinates, for each of a body's numbers."""
    R, a = frame.R, frame.a
    turn = skew(frame.dw) + skew(frame.w) @ skew(frame.w)
    force = np.zeros((len(a), 3, PER_LINK))
    force[:, :, 0] = a
    force[:, :, 1:4] = turn @ R
    moment = np.zeros_like(force)
    moment[:, :, 1:4] = -skew(a) @ R
    w, dw = (np.einsum("nji,nj->ni", R, v) for v in (frame.w, frame.dw))
    inner = _times_inertia(dw) + skew(w) @ _times_inertia(w)
    moment[:, :, 4:] = R @ inner
    return force, moment


def _times_inertia(v: Floats) -> Floats:
    """Matrix (N, 3, 6) that takes ixx, ixy, ixz, iyy, iyz, izz to I v."""
    out = np.zeros((len(v), 3, 6))
    x, y, z = v.T
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = x, y, z
    out[:, 1, 1], out[:, 1, 3], out[:, 1, 4] = x, y, z
    out[:, 2, 2], out[:, 2, 4], out[:, 2, 5] = x, y, z
    return out


def _walk(robot: Robot, q: Floats, qd: Floats, qdd: Floats) -> tuple[list[tuple[int, _Frame]], list[_Drive]]:
    """Frames of the bodies with the elements that they follow, and the elements that joints move, from the base on."""
    rows = len(q)
    R, origin = np.tile(np.eye(3), (rows, 1, 1)), np.zeros((rows, 3))
    w, dw, a = np.zeros((rows, 3)), np.zeros((rows, 3)), np.tile(-robot.gravity, (rows, 1))
    bodies, frames, drives = link_elements(robot), {}, []
    for k, element in enumerate(robot.chain.elements):
        z, j = R[:, :, element.axis % 3], element.joint
        moved, speed, rate = _follow_element(element, q, qd, qdd)
        if j is not None and _carries(robot.chain, k):
            drives.append(_Drive(k, j, element.ratio, element.axis.rotates, z.copy(), origin))
        if element.axis.rotates:
            dw = dw + z * rate + np.cross(w, z * speed)
            w = w + z * speed
            R = R @ rotations_about(np.eye(3)[element.axis % 3], moved[:, 0])
        else:
            arm = z * moved
            swing = np.cross(dw, arm) + np.cross(w, np.cross(w, arm))
            a = a + swing + 2.0 * np.cross(w, z * speed) + z * rate
            origin = origin + arm
        if k in bodies:
            frames[k] = _Frame(R, origin, w, dw, a)
    return [(k, frames[k]) for k in bodies], drives


def _follow_element(element: Element, q: Floats, qd: Floats, qdd: Floats) -> tuple[Floats, Floats, Floats]:
    """How far (N, 1) an element has moved, how fast, and how that changes."""
    if element.joint is None:
        return np.full((len(q), 1), element.value), np.zeros((len(q), 1)), np.zeros((len(q), 1))
    at = slice(element.joint, element.joint + 1)
    return element.ratio * q[:, at] + element.value, element.ratio * qd[:, at], element.ratio * qdd[:, at]


def _carries(chain: Chain, k: int) -> bool:
    """Whether the drive of the element's joint carries the load on it."""
    return k in chain.primary or chain.elements[k].drive == LINKAGE
