"""Campaigns that are what they say, and the same with something mixed up between joints and measurements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.observations import Observations
from tests.core.campaigns import measured
from tests.core.truth import Floats, Step
from tests.mix_ups.arms import BUILDS, Pair, some_pair

SEES = ("position", "pose", "markers")


@dataclass(frozen=True)
class Genuine:
    """What was measured of an arm, how, and which joints moved."""

    robot: Robot
    rows: Observations
    pair: Pair
    kind: str


def genuine(
    seed: int, build: str | None = None, moving: int | None = None, see: str | None = None, worn: bool = False
) -> Genuine:
    """A campaign; ``moving`` joints next to each other move, the others stay somewhere. ``worn``: as arms in use are."""
    rng = np.random.default_rng(seed)
    build = build or list(BUILDS)[seed % len(BUILDS)]
    pair = some_pair(build, rng)
    see = see or SEES[int(rng.integers(3))]
    count = int(rng.choice([20, 40, 80]))
    low, high = pair.ranges.T
    share = 1.0 if moving else rng.choice([1.0, 0.5, 0.2])
    q = rng.uniform(share * low, share * high, (count, pair.drawn.n))
    if moving:
        first = int(rng.integers(0, pair.drawn.n - min(moving, pair.drawn.n) + 1))
        still = [j for j in range(pair.drawn.n) if not first <= j < first + moving]
        q[:, still] = rng.uniform(0.5 * low, 0.5 * high)[still]
    if rng.random() < 0.3:
        q = np.repeat(q, 3, axis=0)
    noise = float(rng.choice([1e-5, 5e-5, 2e-4]))
    robot = robot_from_document(pair.drawn.document())
    rows = _worn(pair, q, rng, noise, see) if worn else measured(pair.true, q, rng, noise, see)
    state = ", worn" if worn else ""
    return Genuine(robot, rows, pair, f"{build}, {moving or 'all'} move, {see}{state}")


def fixed_steps(g: Genuine) -> list[Step]:
    """Fixed steps of an arm that are not zero: what a table can lack."""
    return [s for s in g.pair.drawn.steps if s.joint is None and s.value]


def without_step(g: Genuine, number: int) -> Genuine:
    """The same campaign of an arm whose table lacks one of its fixed steps."""
    missing = fixed_steps(g)[number]
    drawn = replace(g.pair.drawn, steps=tuple(s for s in g.pair.drawn.steps if s is not missing))
    robot = robot_from_document(drawn.document())
    return replace(g, robot=robot, pair=replace(g.pair, drawn=drawn), kind=f"{g.kind}, without {missing.name}")


def _worn(pair: Pair, q: Floats, rng: np.random.Generator, noise: float, see: str) -> Observations:
    """A joint mastered up to 15 degrees wrong, joints that give under a load and tilt with it, sessions of one set-up."""
    n = pair.drawn.n
    turns = np.array([next(s for s in pair.true.moving if s.joint == j).axis[0] == "r" for j in range(n)])
    off = np.zeros(n)
    if rng.random() < 0.7:
        j = int(rng.integers(n))
        off[j] = np.radians(rng.uniform(-15.0, 15.0)) if turns[j] else rng.uniform(-0.05, 0.05)
    kg = rng.choice([0.0, 5.0], len(q)) if rng.random() < 0.5 else np.full(len(q), 5.0)
    axes, places = pair.true.joint_axes(q + off)
    lever = pair.true.poses(q + off)[0] - places
    moment = np.cross(lever, [0.0, 0.0, -9.81]) * kg[:, None]  # (n, N, 3)
    about = np.einsum("jnk,jnk->jn", moment, axes)
    gives = 10.0 ** rng.uniform(-7.0, -4.5, n) * turns  # rad per N m
    across = moment - about[:, :, None] * axes
    size = np.linalg.norm(across, axis=2)[:, :, None]
    tilt = 10.0 ** rng.uniform(-5.0, -3.3, n)[:, None, None] * np.tanh(size / 2.0) * across / np.maximum(size, 1e-9)
    shift = np.cross(tilt, lever).sum(axis=0)
    rows = measured(pair.true, q + off + (gives[:, None] * about).T, rng, noise, see)
    session = np.repeat([0, 1], [len(q) // 2, len(q) - len(q) // 2]) if rng.random() < 0.4 else None
    moved = (
        {"markers": rows.markers + shift[:, None]} if rows.markers is not None else {"position": rows.position + shift}
    )
    return replace(rows, q=q, session=session, payload_kg=kg if rng.random() < 0.5 else None, **moved)


def _units(robot: Robot) -> Floats:
    return np.array([180.0 / np.pi if j.kind == "revolute" else 1e3 for j in robot.joints])


def _swapped(g: Genuine, rng: np.random.Generator) -> Observations:
    order = np.arange(g.robot.n_joints)
    order[[0, 1]] = [1, 0]
    unit = _units(g.robot)
    return replace(g.rows, q=(g.rows.q * unit)[:, order] / unit)


def _sign(g: Genuine, rng: np.random.Generator) -> Observations:
    return replace(g.rows, q=g.rows.q * np.where(np.arange(g.robot.n_joints) == 1, -1.0, 1.0))


def _degrees(g: Genuine, rng: np.random.Generator) -> Observations:
    revolute = np.array([j.kind == "revolute" for j in g.robot.joints])
    return replace(g.rows, q=np.where(revolute, np.radians(g.rows.q), g.rows.q))


def _one_in_radians(g: Genuine, rng: np.random.Generator) -> Observations:
    joint = next(j for j in range(1, g.robot.n_joints) if g.robot.joints[j].kind == "revolute")
    return replace(g.rows, q=np.where(np.arange(g.robot.n_joints) == joint, np.radians(g.rows.q), g.rows.q))


def _zero(g: Genuine, rng: np.random.Generator) -> Observations:
    """Of the second joint that turns, which neither base nor tool takes up; the tool takes up the last joint's."""
    turning = [j for j in range(g.robot.n_joints) if g.robot.joints[j].kind == "revolute"]
    return replace(
        g.rows, q=g.rows.q - np.where(np.arange(g.robot.n_joints) == turning[int(len(turning) > 2)], np.pi / 2.0, 0.0)
    )


def _coupled(g: Genuine, rng: np.random.Generator) -> Observations:
    """The last joint but two, one before it or else one behind it is read with the motion of the joint before."""
    turns = [j.kind == "revolute" for j in g.robot.joints]
    n = g.robot.n_joints
    joint = next(j for j in (*range(n - 3, 0, -1), n - 2, n - 1) if turns[j] and turns[j - 1])
    return replace(g.rows, q=g.rows.q - np.outer(g.rows.q[:, joint - 1], np.arange(g.robot.n_joints) == joint))


def inverted(g: Genuine) -> Observations:
    """The reference in the frame of the tool, in place of the tool in that of the reference."""
    assert g.rows.position is not None
    assert g.rows.rotation is not None
    turned = g.rows.rotation.transpose(0, 2, 1)
    return replace(g.rows, position=-np.einsum("nij,nj->ni", turned, g.rows.position), rotation=turned)


def _points(change: Callable[[Floats], Floats]) -> Callable[[Genuine, np.random.Generator], Observations]:
    def mixed(g: Genuine, rng: np.random.Generator) -> Observations:
        if g.rows.markers is not None:
            return replace(g.rows, markers=change(g.rows.markers))
        assert g.rows.position is not None
        return replace(g.rows, position=change(g.rows.position))

    return mixed


def _joints_of(
    order: Callable[[int, np.random.Generator], NDArray[np.int64]],
) -> Callable[[Genuine, np.random.Generator], Observations]:
    return lambda g, rng: replace(g.rows, q=g.rows.q[order(len(g.rows), rng)])


MIXED: dict[str, Callable[[Genuine, np.random.Generator], Observations]] = {
    "two joints swapped": _swapped,
    "a joint of the other sign": _sign,
    "radians declared as degrees": _degrees,
    "one joint in radians": _one_in_radians,
    "a zero 90 degrees off": _zero,
    "a joint read with the one before": _coupled,
    "millimetres declared as metres": _points(lambda p: p * 1e3),
    "inches declared as millimetres": _points(lambda p: p / 25.4),
    "x and y exchanged": _points(lambda p: p[..., [1, 0, 2]]),
    "shifted by one row": _joints_of(lambda n, rng: np.roll(np.arange(n), 1)),
    "shuffled": _joints_of(lambda n, rng: rng.permutation(n)),
}
POSES_MIXED: dict[str, Callable[[Genuine, np.random.Generator], Observations]] = {
    "poses inverted": lambda g, rng: inverted(g),
}
"""The same of campaigns that measured poses."""
