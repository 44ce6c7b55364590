"""Poses that leave much of base, tool and chain unseen, on arms with errors that no model has: the fit must still end.

Along what the poses hardly see the loss falls in a curved valley. The arms are Pinocchio's; each has six hidden errors
after every joint, springs, play and joint curves, so that what is left is far above the noise.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.estimate import estimate, prepare_problem
from kilter_core.identify.fit.least_squares import Linearised, solve
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.campaigns import measured
from tests.core.truth import UR10_ROWS, Arm, Body, Step, dh_steps, small_pose, some_pose, with_hidden_errors

Floats = NDArray[np.float64]

# Which poses are held out decides a part: of four draws fits of the grids ended after 16 to 69 iterations, and the column
# kept 60 to 79 % of the error. Fits that do not end at all are refused with an error.
MOST_ITERATIONS, MOST_KEPT = 75, 0.8
RIGHT = math.pi / 2
SEVEN = (
    (0.34, 0.0, -RIGHT), (0.0, 0.0, RIGHT), (0.4, 0.0, RIGHT), (0.0, 0.0, -RIGHT),
    (0.4, 0.0, -RIGHT), (0.0, 0.0, RIGHT), (0.126, 0.0, 0.0),
)  # fmt: skip
HUMAN = (
    (0.16, 0.0, -RIGHT), (0.0, 0.0, RIGHT), (0.3, 0.02, RIGHT), (0.0, -0.02, -RIGHT),
    (0.26, 0.0, -RIGHT), (0.0, 0.0, RIGHT), (0.1, 0.0, 0.0),
)  # fmt: skip


def heavy(steps: tuple[Step, ...], n: int, rng: np.random.Generator) -> Arm:
    bodies = [
        Body(j, 6.0 * (1.0 - 0.1 * j), rng.uniform(-0.15, 0.15, 3) + np.array([-0.2 * (j in (1, 2)), 0.0, 0.05]))
        for j in range(n)
    ]
    return Arm(steps, n, bodies=tuple(bodies))


def later(steps: tuple[Step, ...], by: int) -> tuple[Step, ...]:
    return tuple(replace(s, joint=None if s.joint is None else s.joint + by) for s in steps)


def reached(arm: Arm, place: Floats, rotation: Floats, q: Floats) -> Floats | None:
    """Joints that bring the flange to a pose, from ``q``."""
    model, frame = arm.pinocchio()
    data, target = model.createData(), pin.SE3(rotation, place)
    for _ in range(300):
        pin.forwardKinematics(model, data, arm.motors(q))
        error = pin.log6(pin.updateFramePlacement(model, data, frame).actInv(target)).vector
        if np.linalg.norm(error) < 1e-9:
            return q
        J = pin.computeFrameJacobian(model, data, arm.motors(q), frame, pin.LOCAL).reshape(6, -1)
        q = q + 0.7 * J.T @ np.linalg.solve(J @ J.T + 1e-5 * np.eye(6), error)
    return None


def grid(rng: np.random.Generator) -> tuple[Arm, Floats]:
    """Seven joints, a grid of places at one orientation."""
    arm = heavy(dh_steps(SEVEN), 7, rng)
    q = np.array([0.3, 0.6, 0.2, -1.2, 0.1, 0.8, 0.3])
    place, rotation = arm.poses(q[None])
    axes = (np.linspace(-0.2, 0.2, 5), np.linspace(-0.2, 0.2, 5), np.linspace(-0.15, 0.15, 4))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    found = [reached(arm, place[0] + p, rotation[0], q) for p in points]
    return arm, np.array([f for f in found if f is not None and np.all(np.abs(f) < 2.9)])


def lines(rng: np.random.Generator) -> tuple[Arm, Floats]:
    """Six joints, lines along which the tool does not turn."""
    arm = heavy(dh_steps(UR10_ROWS), 6, rng)
    q = np.array([0.3, -1.1, 1.4, -1.5, -1.4, 0.3])
    place, rotation = arm.poses(q[None])
    found = []
    for _ in range(6):
        along = rng.normal(size=3)
        start, near = place[0] + rng.uniform(-0.2, 0.2, 3), q
        for u in np.linspace(-0.25, 0.25, 25):
            joints = reached(arm, start + u * along / np.linalg.norm(along), rotation[0], near)
            if joints is not None:
                found.append(joints)
                near = joints
    return arm, np.array(found)


def column(rng: np.random.Generator) -> tuple[Arm, Floats]:
    """A prismatic column that carries six joints."""
    steps = (Step("tz", 0.3, name="h"), Step("rx", name="cx"), Step("ry", name="cy"), Step("tz", 0.0, 0, name="lift"))
    q = rng.uniform(-1.5, 1.5, (120, 7))
    q[:, 0] = rng.uniform(0.0, 0.6, 120)
    return heavy((*steps, *later(dh_steps(UR10_ROWS), 1)), 7, rng), q


def torso(rng: np.random.Generator) -> tuple[Arm, Floats]:
    """A torso of two joints with an arm of seven."""
    steps = (
        Step("tz", 0.2, name="t0"), Step("rz", 0.0, 0, name="torso_1"), Step("rx", name="t1"), Step("tz", 0.3, name="t2"),
        Step("ry", 0.0, 1, name="torso_2"), Step("tz", 0.4, name="t3"), Step("ty", 0.2, name="t4"),
        Step("rx", -RIGHT, name="t5"),
    )  # fmt: skip
    q = rng.uniform(-1.0, 1.0, (100, 9))
    q[:, 1] *= 0.4
    return heavy((*steps, *later(dh_steps(HUMAN), 2)), 9, rng), q


def six(rng: np.random.Generator) -> tuple[Arm, Floats]:
    q = rng.uniform(-2.0, 2.0, (118, 6))
    q[:, 1] = rng.uniform(-2.2, -0.6, 118)
    return heavy(dh_steps(UR10_ROWS), 6, rng), q


def observed(arm: Arm, q: Floats, rng: np.random.Generator, see: str) -> Observations:
    """What an instrument sees of an arm with springs, play, joint curves and errors in every direction."""
    tool = pin.SE3(np.eye(3), np.array([0.05, 0.02, 0.15])) * small_pose(rng, 0.02, 0.2)
    true = replace(with_hidden_errors(arm, rng, 1e-3, 2e-3), base=some_pose(rng, 4.0), tool=tool)
    stiffness = np.array([1.0 if step.axis[0] == "r" else 0.02 for step in arm.moving])
    moved = q - 2e-5 * arm.torques(q) * stiffness
    size, phase = rng.normal(0.0, 1e-3, (2, arm.n)), rng.uniform(0.0, 6.28, (2, arm.n))
    moved += size[0] * np.sin(2 * q + phase[0]) + size[1] * np.sin(3 * q + phase[1])
    moved += 2e-4 * rng.choice([-1.0, 1.0], q.shape)
    return replace(measured(true, moved, rng, 2e-5, see), q=q)


SHAPES: dict[str, tuple[Callable[[np.random.Generator], tuple[Arm, Floats]], dict[str, Any]]] = {
    "grid": (grid, {}),
    "grid with compliance": (grid, {"effects": ("axial_compliance",)}),
    "grid with full tilting": (grid, {"level": 3, "masses": "as_stated"}),
    "lines": (lines, {"effects": ("axial_compliance",)}),
    "column": (column, {}),
    "torso": (torso, {"effects": ("axial_compliance", "radial_compliance")}),
    "six": (six, {"effects": ("axial_compliance", "eccentricity", "encoder_scale", "second_harmonic")}),
}


# Each shape under one instrument and each instrument on two shapes or more; `tools.lab slow` tries the others.
EACH = [
    pytest.param(shape, see, marks=() if k % 3 == j else pytest.mark.slow)
    for k, shape in enumerate(SHAPES)
    for j, see in enumerate(("position", "pose", "markers"))
]


@pytest.mark.parametrize(("shape", "see"), EACH)
def test_a_fit_ends_where_the_poses_leave_much_unseen(shape: str, see: str) -> None:
    make, options = SHAPES[shape]
    rng = np.random.default_rng(5)
    arm, q = make(rng)
    robot = robot_from_document(arm.document())
    found = identify(robot, observed(arm, q, rng, see), 0.3, IdentifyOptions(**options))
    held_out = found.metrics["validation"]
    assert found.fit.iterations <= MOST_ITERATIONS
    assert held_out["identified"]["rms_mm"] < MOST_KEPT * held_out["registration_only"]["rms_mm"]


@pytest.mark.parametrize("make", [grid, lines])
def test_what_one_orientation_cannot_tell_is_said(make: Callable[[np.random.Generator], tuple[Arm, Floats]]) -> None:
    rng = np.random.default_rng(5)
    arm, q = make(rng)
    found = identify(robot_from_document(arm.document()), observed(arm, q, rng, "position"))
    unobservable = {name for direction in found.null_directions for name, _ in direction.weights}
    assert any(name.startswith("tool_") for name in unobservable)
    assert any(name.startswith("base_") for name in unobservable)


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_the_loss_never_rises(loss: str) -> None:
    rng = np.random.default_rng(5)
    arm, q = lines(rng)
    start = Calibration.nominal(robot_from_document(arm.document()))
    measurement = Measurement.from_observations(observed(arm, q, rng, "position"))
    options = IdentifyOptions(loss=loss)
    fit = estimate(start, measurement, options)
    problem, values = prepare_problem(start, measurement, options)
    problem = problem.with_weights(fit.problem.weights, fit.problem.held)
    seen: list[float] = [problem.linearise(values).loss]
    solve(problem, values, lambda _, loss_now: seen.append(loss_now))
    assert len(seen) > 3
    assert all(after <= before for before, after in itertools.pairwise(seen))


def test_an_early_end_is_no_worse_than_the_start() -> None:
    rng = np.random.default_rng(7)
    arm, q = grid(rng)
    start = Calibration.nominal(robot_from_document(arm.document()))
    problem, values = prepare_problem(
        start, Measurement.from_observations(observed(arm, q, rng, "pose")), IdentifyOptions()
    )
    here: Linearised = problem.linearise(values)
    rough = solve(problem, values, enough=0.5)
    assert rough.cost < here.loss
