"""Arms of the five usual builds with random sizes, as drawn and as they are: Pinocchio's, nothing here is of the core."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from tests.core.truth import Arm, Floats, Step, dh_steps, small_pose, some_pose, with_hidden_errors

RIGHT = math.pi / 2
Build = Callable[[np.random.Generator], tuple[Step, ...]]


def _six(rng: np.random.Generator) -> tuple[Step, ...]:
    """Elbow with a wrist whose axes meet, or are offset."""
    upper, fore = rng.uniform(0.25, 0.9, 2)
    offset = rng.choice([0.0, 0.08, 0.15])
    return dh_steps([
        (rng.uniform(0.1, 0.5), rng.choice([0.0, 0.15]), RIGHT), (0.0, upper, 0.0), (0.0, rng.choice([0.0, 0.1]), RIGHT),
        (fore, 0.0, -RIGHT), (offset, 0.0, RIGHT), (rng.uniform(0.06, 0.15), 0.0, 0.0),
    ])  # fmt: skip


def _seven(rng: np.random.Generator) -> tuple[Step, ...]:
    """Shoulder, elbow and wrist of three axes each way."""
    a, b = rng.uniform(0.25, 0.5, 2)
    return dh_steps([
        (rng.uniform(0.2, 0.4), 0.0, -RIGHT), (0.0, 0.0, RIGHT), (a, 0.0, RIGHT), (0.0, 0.0, -RIGHT), (b, 0.0, -RIGHT),
        (0.0, rng.choice([0.0, 0.088]), RIGHT), (rng.uniform(0.08, 0.15), 0.0, 0.0),
    ])  # fmt: skip


def _five(rng: np.random.Generator) -> tuple[Step, ...]:
    a, b = rng.uniform(0.15, 0.4, 2)
    rows = [(rng.uniform(0.1, 0.4), rng.choice([0.0, 0.033]), RIGHT), (0.0, a, 0.0), (0.0, b, 0.0),
            (0.0, 0.0, RIGHT), (rng.uniform(0.08, 0.2), 0.0, 0.0)]  # fmt: skip
    return dh_steps(rows)


def _scara(rng: np.random.Generator) -> tuple[Step, ...]:
    a, b = rng.uniform(0.2, 0.5, 2)
    return (
        Step("tz", rng.uniform(0.2, 0.5), name="d_1"), Step("rz", 0.0, 0, name="theta_1"), Step("tx", a, name="a_1"),
        Step("ry", 0.0, name="beta_1"), Step("rx", 0.0, name="alpha_1"), Step("rz", 0.0, 1, name="theta_2"),
        Step("tx", b, name="a_2"), Step("rx", math.pi, name="alpha_2"), Step("ry", 0.0, name="beta_2"),
        Step("tz", 0.0, 2, name="d_3"), Step("rz", 0.0, 3, name="theta_4"), Step("tz", 0.05, name="d_4"),
    )  # fmt: skip


def _gantry(rng: np.random.Generator) -> tuple[Step, ...]:
    """Three slides and a head of two or three axes."""
    slides = [Step("tx", 0.0, 0, name="x"), Step("ty", 0.0, 1, name="y"), Step("tz", 0.3, 2, name="z")]
    head = [Step("rz", 0.0, 3, name="c"), Step("tx", rng.choice([0.0, 0.1]), name="a_4"), Step("ry", 0.0, 4, name="b")]
    last = [Step("tz", rng.uniform(0.08, 0.2), name="d_5"), Step("rz", 0.0, 5, name="w")]
    return (*slides, *head, *(last if rng.random() < 0.5 else last[:1]))


BUILDS: dict[str, Build] = {"6R": _six, "7R": _seven, "5R": _five, "SCARA": _scara, "gantry": _gantry}


@dataclass(frozen=True)
class Pair:
    """An arm as drawn and as it is; ``ranges (n, 2)`` in which it moves, rad or m."""

    drawn: Arm
    true: Arm
    ranges: Floats


def some_pair(build: str, rng: np.random.Generator) -> Pair:
    """An arm with geometric errors, zeros off, somewhere in front of the instrument, with a tool that is not quite known."""
    steps = BUILDS[build](rng)
    n = 1 + max(s.joint for s in steps if s.joint is not None)
    nominal = small_pose(rng, 0.08, 0.3) if rng.random() < 0.7 else pin.SE3.Identity()
    drawn = Arm(steps, n, tool=nominal)
    kinds = [next(s for s in steps if s.joint == j).axis[0] for j in range(n)]
    half = np.where(np.array(kinds) == "r", rng.uniform(1.2, 2.6), rng.uniform(0.15, 0.5))
    drawn = replace(drawn, limits=(-2.7, 2.7))
    zeros = {s.name: float(rng.normal(0.0, 5e-3 if s.axis[0] == "r" else 1e-3)) for s in steps if s.joint is not None}
    true = with_hidden_errors(drawn.moved(zeros), rng, 5e-4, 1e-3)
    wrong = small_pose(rng, rng.choice([0.003, 0.02, 0.1]), 0.1)
    return Pair(drawn, replace(true, base=some_pose(rng, 4.0), tool=true.tool * wrong), np.stack([-half, half], axis=1))
