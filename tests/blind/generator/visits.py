"""How a campaign was measured: poses, visits of each, approach, payload, clock, thermometer, sessions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arm import Arm, Load

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SAME = 0  # kind of a second visit at which nothing changes
SETTLING_DEG = 5e-5  # readings of two visits of a pose differ by the servo's last digit


@dataclass(frozen=True)
class Options:
    """How a campaign is measured.

    ``approach`` "random" (each joint comes from a random side), "one_sided", or "path" (from where the last pose was).
    ``payload`` "two" (0 or the arm's, at random), "one", "none", or "correlated" (heavy where joint 2 reads high).
    ``temperature`` "constant", "cycling" or "warming" (with time). ``revisited`` is the share of poses visited twice.
    ``wrong_masses``: the document's link masses are up to 20 % off. ``outliers``: share of rows that are wrong.
    """

    approach: str = "random"
    payload: str = "two"
    temperature: str = "constant"
    sessions: int = 1
    revisited: float = 0.4
    repeats: int = 3
    wrong_masses: bool = False
    outliers: float = 0.0
    range_um: float = 5.0
    range_um_per_m: float = 0.5
    angle_urad: float = 3.0
    approach_um: float = 8.0


@dataclass(frozen=True)
class Visits:
    """V visits in the order they were made: ``q``, ``direction (V, n)``, ``payload_kg``, ``temperature_c``, ``t_s``
    ``(V,)``, ``session`` and ``pose (V,)`` integers, and the loads of the true arm.
    """

    q: Floats
    direction: Floats
    payload_kg: Floats
    temperature_c: Floats
    t_s: Floats
    session: Ints
    pose: Ints
    load: Load

    def __len__(self) -> int:
        return len(self.q)


def plan(arm: Arm, poses: int, options: Options, rng: np.random.Generator) -> Visits:
    """Visit ``poses`` random poses, some of them twice: other direction, other payload, or nothing changed."""
    targets = reachable(arm, poses, rng)
    signs = np.ones((poses, arm.n)) if options.approach == "one_sided" else rng.choice([-1.0, 1.0], (poses, arm.n))
    kg = _payloads(arm, targets, options, rng)
    again = rng.permutation(poses)[: round(options.revisited * poses)]
    first = np.arange(poses)
    pose = np.concatenate([first, again])
    direction, payload = signs[pose], kg[pose]
    kind = np.concatenate([np.full(poses, SAME), np.arange(len(again)) % 4])
    for row in range(poses, len(pose)):
        _change(row, int(kind[row]), direction, payload, arm.drawn.payload_kg, options)
    order = _order(kind, again, poses, rng)
    q = targets[pose] + rng.normal(0.0, np.radians(SETTLING_DEG), (len(pose), arm.n))
    if options.approach == "path":
        direction = _moved(q, direction, order, kind, again, poses)
    pose, q, direction, payload = pose[order], q[order], direction[order], payload[order]
    session = (np.arange(len(pose)) * options.sessions // len(pose)).astype(np.int64)
    t = np.cumsum(rng.uniform(20.0, 45.0, len(pose))) + 5400.0 * session
    return Visits(q, direction, payload, _temperature(t, options, rng), t, session, pose, arm.load(q, payload))


def _order(kind: Ints, again: Ints, poses: int, rng: np.random.Generator) -> Ints:
    """Order of the visits: at random, but a pose approached again unchanged comes soon after its first visit."""
    when = rng.uniform(size=len(kind))
    soon = np.flatnonzero(kind[poses:] % 2 == SAME)
    when[poses + soon] = when[again[soon]] + rng.uniform(0.0, 0.05, len(soon))
    return np.argsort(when).astype(np.int64)


def _moved(q: Floats, direction: Floats, order: Ints, kind: Ints, again: Ints, poses: int) -> Floats:
    """Directions of a path through the visits; an unchanged second visit goes back and comes the same way again."""
    steps = np.diff(q[order], axis=0, prepend=np.zeros((1, q.shape[1])))
    out = np.empty_like(direction)
    out[order] = np.where(np.abs(steps) > np.radians(0.01), np.sign(steps), direction[order])
    soon = np.flatnonzero(kind[poses:] % 2 == SAME)
    out[poses + soon] = out[again[soon]]
    return out


def reachable(arm: Arm, count: int, rng: np.random.Generator) -> Floats:
    """Random joint readings (count, n) within the limits, the tool above the floor and clear of the column."""
    lower, upper = arm.drawn.limits.T
    found: list[Floats] = []
    while sum(map(len, found)) < count:
        q = rng.uniform(0.97 * lower, 0.97 * upper, (4 * count, arm.n))
        p = (arm.positions(q) - arm.foot[:3, 3]) @ arm.foot[:3, :3]
        found.append(q[(p[:, 2] > arm.drawn.lowest_m) & (np.hypot(p[:, 0], p[:, 1]) > 0.12)])
    return np.concatenate(found)[:count]


def _payloads(arm: Arm, q: Floats, options: Options, rng: np.random.Generator) -> Floats:
    heavy = arm.drawn.payload_kg
    if options.payload == "two":
        return heavy * rng.integers(0, 2, len(q)).astype(np.float64)
    if options.payload == "correlated":
        return np.where(q[:, 1] > np.median(q[:, 1]), heavy, 0.0)
    return np.full(len(q), heavy if options.payload == "one" else 0.0)


def _change(row: int, kind: int, direction: Floats, payload: Floats, heavy: float, options: Options) -> None:
    """Make the second visit of a pose differ in direction (kind 1), payload (kind 3) or not at all (even kinds)."""
    if kind == 1 and options.approach == "random":
        direction[row] *= -1.0
    if kind == 3 and options.payload == "two":
        payload[row] = heavy - payload[row]


def _temperature(t: Floats, options: Options, rng: np.random.Generator) -> Floats:
    start = rng.uniform(20.0, 24.0)
    if options.temperature == "cycling":
        swing = 3.0 * np.sin(2.0 * np.pi * (1.3 * (t - t[0]) / (t[-1] - t[0]) + rng.uniform()))
    elif options.temperature == "warming":
        swing = 6.0 * (1.0 - np.exp(-2.0 * (t - t[0]) / (t[-1] - t[0])))
    else:
        swing = np.zeros_like(t)
    return np.asarray(np.round(start + swing + rng.normal(0.0, 0.03, len(t)), 2))
