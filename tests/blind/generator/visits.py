"""How a campaign was measured: poses, visits of each, approach, payload, clock, thermometer, sessions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.blind.generator.arm import Arm, Load
from tests.blind.generator.options import Options

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

SAME = 0  # kind of a second visit at which nothing changes
SETTLING_DEG = 5e-5  # readings of two visits of a pose differ by the servo's last digit
HALF_RANGE = np.radians(75.0)  # of a restricted joint
HELD_OUT_FROM = 60  # poses from which a finder holds a quarter out
SEARCHED = 0.75


@dataclass(frozen=True)
class Visits:
    """V visits in the order they were made: ``q``, ``direction (V, n)``, ``payload_kg``, ``temperature_c``, ``t_s``
    ``(V,)``, ``session`` and ``pose (V,)`` integers, and the loads of the true arm. Visits of one number in
    ``approach (V,)`` were read without a motion between them; ``searched (V,)`` marks those that a finder searches when
    it holds poses out. ``box (n, 2)`` rad is where the joints were allowed to go.
    """

    q: Floats
    direction: Floats
    payload_kg: Floats
    temperature_c: Floats
    t_s: Floats
    session: Ints
    pose: Ints
    load: Load
    approach: Ints
    searched: Bools
    box: Floats

    def __len__(self) -> int:
        return len(self.q)


def plan(arm: Arm, poses: int, options: Options, rng: np.random.Generator) -> Visits:
    """Visit ``poses`` random poses, some of them twice: other direction, other payload, or nothing changed."""
    box = box_of(arm, options)
    targets = reachable(arm, poses, rng, box)
    signs = np.ones((poses, arm.n)) if options.approach == "one_sided" else rng.choice([-1.0, 1.0], (poses, arm.n))
    kg = _payloads(arm, targets, options, rng)
    again = rng.permutation(poses)[: round(options.revisited * poses)]
    first = np.arange(poses)
    pose = np.concatenate([first, again])
    direction, payload = signs[pose], kg[pose]
    kind = np.concatenate([np.full(poses, SAME), np.arange(len(again)) % 4])
    for row in range(poses, len(pose)):
        _change(row, int(kind[row]), direction, payload, arm.drawn.payload_kg, options)
    order = _order(kind, again, poses, options, rng)
    q = targets[pose] + rng.normal(0.0, np.radians(SETTLING_DEG), (len(pose), arm.n))
    if options.approach == "path":
        direction = _moved(q, direction, order, kind, again, poses)
    approach = np.arange(len(pose))
    if options.stays:
        stayed = np.flatnonzero(kind[poses:] % 2 == SAME)
        approach[poses + stayed] = again[stayed]
        q[poses + stayed] = q[again[stayed]]
    pose, q, direction, payload = pose[order], q[order], direction[order], payload[order]
    session = (np.arange(len(pose)) * options.sessions // len(pose)).astype(np.int64)
    pause = (options.repeats - 1) * options.shot_gap_s if options.shot_gap_s > 1.0 else 0.0
    t = np.cumsum(rng.uniform(20.0, 45.0, len(pose)) + pause) + 5400.0 * session
    kelvin, load = _temperature(t, options, rng), arm.load(q, payload)
    searched = _searched(pose, poses, rng)
    return Visits(q, direction, payload, kelvin, t, session, pose, load, approach[order], searched, box)


def _searched(pose: Ints, poses: int, rng: np.random.Generator) -> Bools:
    """Three quarters of the poses, where there are enough to hold some out."""
    if poses < HELD_OUT_FROM:
        return np.ones(len(pose), dtype=bool)
    return np.isin(pose, rng.permutation(poses)[: round(SEARCHED * poses)])


def box_of(arm: Arm, options: Options) -> Floats:
    """Where the joints may go (n, 2) rad: their limits, of a restricted joint 75 deg to both sides of the middle."""
    box = 0.97 * arm.drawn.limits
    for j in options.restricted:
        middle = 0.5 * box[j].sum() if np.ptp(box[j]) < 2.0 * np.pi else 0.0
        box[j] = np.clip([middle - HALF_RANGE, middle + HALF_RANGE], *box[j])
    return np.asarray(box)


def _order(kind: Ints, again: Ints, poses: int, options: Options, rng: np.random.Generator) -> Ints:
    """Order of the visits: at random, but a pose approached again unchanged comes soon after its first visit.

    The share ``spread`` of them comes at any time; when the arm stays, the second visit is the next.
    """
    when = rng.uniform(size=len(kind))
    soon = np.flatnonzero(kind[poses:] % 2 == SAME)
    if options.stays:
        when[poses + soon] = when[again[soon]] + 1e-9
        return np.argsort(when).astype(np.int64)
    soon = soon[round(options.spread * len(soon)) :]
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


def reachable(arm: Arm, count: int, rng: np.random.Generator, box: Floats) -> Floats:
    """Random joint readings (count, n) within the box, the tool above the floor and clear of the column."""
    lower, upper = box.T
    found: list[Floats] = []
    while sum(map(len, found)) < count:
        q = rng.uniform(lower, upper, (4 * count, arm.n))
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
