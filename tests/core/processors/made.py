"""Campaigns of every kind of measurement on arms that Pinocchio moves, laid out as people do: grids, circles, sockets.

Such layouts have ties that random poses never have: a circle lies in one plane, a tool point on the last axis, two
parameters do exactly the same. There a rounding error can decide what a fit holds, on which side it looks and what it names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from kilter_core.observations import Observations
from tests.core.campaigns import MARKERS, held, joints, measured, table_errors
from tests.core.drawing import PLANE, drawn
from tests.core.truth import Arm, Body, Step, dh_steps, some_arm, some_pose, ur10

Floats = NDArray[np.float64]
NOISE = 2e-5
HOME = np.array([0.3, -1.2, 1.4, -0.6, -1.1, 0.4])


@dataclass(frozen=True)
class Campaign:
    """What a person would send: a robot, rows and options; and for a procedure that is not a fit its name."""

    kind: str
    seed: int
    robot: dict[str, Any]
    rows: Observations
    options: dict[str, Any] = field(default_factory=dict)
    circles: Floats | None = None  # (N, m, 3), points of joints that moved one at a time

    @property
    def name(self) -> str:
        """Kind and seed."""
        return f"{self.kind} {self.seed}"


def campaigns(seed: int) -> Iterator[Campaign]:
    """One campaign of every kind."""
    for kind, make in KINDS.items():
        rng = np.random.default_rng([seed, sum(map(ord, kind))])
        campaign = make(rng)
        yield replace(campaign, kind=kind, seed=seed)


def _campaign(arm: Arm, rows: Observations, **more: Any) -> Campaign:
    return Campaign("", 0, arm.document(), rows, **more)


def _pair(rng: np.random.Generator, **fields: Any) -> tuple[Arm, Arm]:
    """An arm as drawn and as it is: a UR10, a selective compliance arm, or any arm of four to seven joints."""
    which = int(rng.integers(4))
    if which < 2:
        drawn_ = ur10(**fields)
    elif which == 2:
        rows = ((0.4, 0.325, 0.0), (0.0, 0.275, np.pi), (0.0, 0.0, 0.0), (0.05, 0.0, 0.0))
        drawn_ = replace(Arm(dh_steps(rows), 4), **fields)
    else:
        drawn_ = replace(some_arm(rng, int(rng.integers(4, 8)), prismatic=bool(rng.integers(2))), **fields)
    return drawn_, drawn_.moved(table_errors(drawn_, rng))


def _probe(rng: np.random.Generator) -> tuple[Arm, Arm]:
    """A UR10 with a probe on its flange."""
    tool = pin.SE3(np.eye(3), np.array([0.03, -0.02, 0.12]))
    arm = ur10(tool=tool, limits=(-6.3, 6.3))
    return arm, arm.moved(table_errors(arm, rng))


def _about(rng: np.random.Generator, count: int, spread: float) -> Floats:
    return HOME + rng.uniform(-spread, spread, (count, 6))


def _points(rng: np.random.Generator) -> Campaign:
    arm, actual = _pair(rng)
    return _campaign(arm, measured(actual, joints(arm, 60, rng), rng, NOISE))


def _grid(rng: np.random.Generator) -> Campaign:
    """Points on a grid at one orientation, the wrist at rest: much that no row can tell."""
    arm, actual = _pair(rng)
    steps = np.linspace(-0.6, 0.6, 4)
    q = np.zeros((64, arm.n)) + rng.choice([0.0, 0.5], arm.n)
    q[:, :3] += np.array(np.meshgrid(steps, steps, steps)).reshape(3, -1).T
    return _campaign(arm, measured(actual, q, rng, NOISE))


def _poses(rng: np.random.Generator) -> Campaign:
    arm, actual = _pair(rng)
    return _campaign(arm, measured(actual, joints(arm, 40, rng), rng, NOISE, "pose"))


def _markers(rng: np.random.Generator) -> Campaign:
    arm, actual = _pair(rng)
    return _campaign(arm, measured(actual, joints(arm, 40, rng), rng, NOISE, "markers"))


def _distances(rng: np.random.Generator) -> Campaign:
    arm, actual = _pair(rng)
    elsewhere = replace(actual, base=some_pose(rng, 5.0))
    rows = measured(elsewhere, joints(arm, 60, rng), rng, NOISE)
    return _campaign(arm, rows, options={"base": "removed"})


def _sockets(rng: np.random.Generator) -> Campaign:
    arm, actual = _probe(rng)
    q, number = [], []
    places = np.array([[0.45, 0.25, 0.25], [0.75, 0.05, 0.45], [0.35, -0.35, 0.6]])
    for k, place in enumerate(places, 1):
        found = held(actual, _about(rng, 16, 0.7), lambda p, c=place: (p - c, np.eye(3)))
        q.append(found)
        number += [k] * len(found)
    apart = float(np.linalg.norm(places[0] - places[1]))
    known = {"socket_distances_mm": {"1-2": 1e3 * apart}} if rng.integers(2) else {}
    return _campaign(arm, Observations(np.concatenate(q), socket=np.array(number)), options=known)


def _planes(rng: np.random.Generator) -> Campaign:
    arm, actual = _probe(rng)
    q, number = [], []
    for k, (normal, d) in enumerate((([0, 0, 1.0], 0.3), ([1.0, 0, 0], 0.6), ([0.6, 0, 0.8], 0.65)), 1):
        n = np.array(normal)
        found = held(actual, _about(rng, 30, 0.9), lambda p, n=n, d=d: (np.array([n @ p - d]), n[None]))
        q.append(found)
        number += [k] * len(found)
    rows = Observations(np.concatenate(q), plane=np.array(number))
    return _campaign(arm, rows)


def _bars(rng: np.random.Generator) -> Campaign:
    arm, actual = _probe(rng)
    feet = np.array([[0.5, 0.5, 0.0], [0.9, -0.3, 0.1]])
    q, number = _about(rng, 100, 0.8), np.repeat([1, 2], 50)
    length = np.linalg.norm(actual.poses(q)[0] - feet[number - 1], axis=1) + rng.normal(0.0, 1e-5, len(q))
    return _campaign(arm, Observations(q, bar=number, bar_length=length))


def _bar_circles(rng: np.random.Generator) -> Campaign:
    """Circles of a double ball bar, commanded exactly in one plane and about a foot in it."""
    arm, actual = _probe(rng)
    q, number, feet = [], [], []
    for k, normal in enumerate(rng.permutation([2, 2, 0, 1, 1]), 1):
        foot = np.array([0.55, 0.05, 0.4]) + np.round(rng.uniform(-0.15, 0.15, 3), 2)
        u, v = np.delete(np.eye(3), normal, axis=0)
        for a in np.radians(np.arange(0, 360, 15)):
            place = foot + 0.15 * (np.cos(a) * u + np.sin(a) * v)
            found = held(arm, HOME[None] + 0.1 * k, lambda p, c=place: (p - c, np.eye(3)))
            q.append(found)
            number += [k] * len(found)
        feet.append(foot)
    joined, of = np.concatenate(q), np.array(number)
    length = np.linalg.norm(actual.poses(joined)[0] - np.array(feet)[of - 1], axis=1) + rng.normal(0.0, 1e-6, len(of))
    return _campaign(arm, Observations(joined, bar=of, bar_length=length))


def _circles(rng: np.random.Generator) -> Campaign:
    """Every joint in turn over an arc: no description of the arm is needed."""
    _, actual = _pair(rng)
    q = []
    for j in range(actual.n):
        block = np.tile(rng.uniform(-1.0, 1.0, actual.n), (15, 1))
        reach = 1.5 if actual.moving[j].axis[0] == "r" else 0.3
        block[:, j] += np.linspace(-reach / 2, reach / 2, 15)
        q.append(block)
    rows = np.concatenate(q)
    position, rotation = actual.poses(rows)
    points = position[:, None] + np.einsum("nij,mj->nmi", rotation, MARKERS)
    return _campaign(actual, Observations(rows), circles=points + rng.normal(0.0, NOISE, points.shape))


def _sheet(rng: np.random.Generator) -> Campaign:
    """A circle drawn on a sheet and read off: one plane, one orientation, the joints hardly move."""
    arm = ur10()
    offsets = {s.name: 5e-3 * rng.normal() for s in arm.steps if s.name and s.joint is not None}
    actual = arm.moved(table_errors(arm, rng, 1e-5, 1e-4) | offsets)
    d = drawn(arm, actual, np.array([0.2, -1.2, 1.6, -1.9, -1.2, 0.3]), np.array([0.5, -0.3, 0.3]), 0.08, 68)
    r = d.radius + d.out
    local = np.stack([r * np.cos(d.turn + d.along / r), r * np.sin(d.turn + d.along / r), d.error[:, 2]], axis=1)
    seen = d.centre + (local + rng.normal(0.0, 1e-5, local.shape)) @ PLANE.T
    return _campaign(arm, Observations(d.q, seen), options={"level": int(rng.integers(1, 3))})


def _loaded(rng: np.random.Generator) -> tuple[Arm, Floats, Floats]:
    arm = ur10(bodies=tuple(Body(j, 3.0, np.array([-0.2, 0.02, 0.05])) for j in range(6)))
    q = np.array([0.0, -1.2, 1.4, -0.6, 0.9, 0.2]) + rng.uniform(-1.0, 1.0, (50, 6))
    bent = q.copy()
    bent[:, 1:3] -= 2e-5 * arm.torques(q)[:, 1:3]
    return arm, q, bent


COMPLIANT = {"effects": ({"id": "axial_compliance", "joints": [2, 3]},)}


def _links(rng: np.random.Generator) -> Campaign:
    """Encoders behind the gears beside the tool."""
    arm, q, bent = _loaded(rng)
    position = arm.moved(table_errors(arm, rng)).poses(bent)[0] + rng.normal(0.0, 1e-4, (len(q), 3))
    link = bent + 0.01 * np.arange(6) + rng.normal(0.0, 5e-6, q.shape)
    return _campaign(arm, Observations(q, position=position, link_q=link), options=COMPLIANT)


def _inclinometers(rng: np.random.Generator) -> Campaign:
    """Inclinometers on the first link beside the tool, where the bearing of joint 1 tilts."""
    arm, q, bent = _loaded(rng)
    tilt = np.array([-1e-5 * arm.reactions(row)[1][0, 3:5] for row in q])
    up = np.array([0.0, 0.0, arm.steps[0].value])
    position = arm.poses(bent)[0]
    for k, (p, w) in enumerate(zip(position, tilt, strict=True)):
        turn = pin.exp3(q[k, 0] * np.array([0.0, 0.0, 1.0]))
        position[k] = turn @ pin.exp3(np.append(w, 0.0)) @ turn.T @ (p - up) + up
    reading = np.full((len(q), 7, 3), np.nan)
    reading[:, 0, :2] = tilt + 0.02 + rng.normal(0.0, 5e-6, tilt.shape)
    effects = (*COMPLIANT["effects"], {"id": "radial_compliance", "joints": [1]})
    rows = Observations(q, position=position + rng.normal(0.0, 1e-4, position.shape), tilt=reading)
    return _campaign(arm, rows, options={"effects": effects})


def _wrist(rng: np.random.Generator) -> Campaign:
    """Three axes through one point and a tool point on the last: a whole family of frames makes the same poses."""
    rows = ((0.4, 0.025, -np.pi / 2), (0.0, 0.455, 0.0), (0.0, 0.035, -np.pi / 2),
            (0.42, 0.0, np.pi / 2), (0.0, 0.0, -np.pi / 2), (0.08, 0.0, 0.0))  # fmt: skip
    arm = Arm(dh_steps(rows), 6)
    actual = arm.moved(table_errors(arm, rng))
    loss = str(rng.choice(["linear", "huber"]))
    return _campaign(arm, measured(actual, joints(arm, 60, rng), rng, NOISE), options={"loss": loss})


def _scara(rng: np.random.Generator) -> Campaign:
    """Four parallel axes, one of them sliding."""
    steps = (
        Step("tz", 0.4, name="d_1"), Step("rz", 0.0, 0, name="o_1"), Step("tx", 0.325, name="a_1"),
        Step("rx", 0.0, name="alpha_1"), Step("ry", 0.0, name="beta_1"), Step("rz", 0.0, 1, name="o_2"),
        Step("tx", 0.275, name="a_2"), Step("rx", np.pi, name="alpha_2"), Step("ry", 0.0, name="beta_2"),
        Step("tz", 0.1, 2, name="o_3"), Step("rz", 0.0, 3, name="o_4"),
    )  # fmt: skip
    arm = Arm(steps, 4, limits=(-2.0, 2.0))
    actual = arm.moved(table_errors(arm, rng))
    return _campaign(arm, measured(actual, joints(arm, 50, rng), rng, NOISE))


KINDS: dict[str, Callable[[np.random.Generator], Campaign]] = {
    "points": _points,
    "points on a grid": _grid,
    "spherical wrist": _wrist,
    "parallel axes": _scara,
    "poses": _poses,
    "markers": _markers,
    "distances": _distances,
    "sockets": _sockets,
    "planes": _planes,
    "ball bars": _bars,
    "circles of a ball bar": _bar_circles,
    "circles of joints": _circles,
    "sheets": _sheet,
    "link encoders": _links,
    "inclinometers": _inclinometers,
}
