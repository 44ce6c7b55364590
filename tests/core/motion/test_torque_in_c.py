"""The torques of one setpoint, compiled and in C: as the model tells them of a path, rigid bodies as Pinocchio does."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilter_core.arm.robot import Robot
from kilter_core.motion.effects import MOTION_EFFECTS
from kilter_core.motion.kernels.torque import TORQUE_COLUMNS, feed_forward
from kilter_core.motion.layout import Layout, Term
from kilter_core.motion.model import COLUMNS, TorqueModel
from kilter_core.motion.record import Path as Motion
from kilter_core.motion.regressor import base_columns, base_sums, stated_numbers
from kilter_core.types import Floats
from tests.core.arm.test_moments import KINDS, arm_robot
from tests.core.correct.c_corrector import COMPILER, FOLDER, WARNINGS

NEEDS_TEMPERATURE = "thermal_friction"


def model_of(robot: Robot, rng: np.random.Generator | None = None) -> TorqueModel:
    """A model of the bodies as described; with every effect that is told ahead, at every joint, where ``rng`` draws them."""
    n, terms, values = robot.n_joints, [], [base_sums(robot) @ stated_numbers(robot)]
    at = len(values[0])
    for effect in MOTION_EFFECTS if rng is not None else ():
        for j in range(n) if effect.ahead else ():
            terms.append(Term(effect, j, np.arange(at, at + len(effect.parameters))))
            values.append(rng.uniform(-1.0, 1.0, len(effect.parameters)))
            at += len(effect.parameters)
    speeds = np.ones(n) if rng is None else rng.uniform(0.5, 2.0, n)
    middles = np.zeros(n) if rng is None else rng.uniform(-0.5, 0.5, n)
    layout = Layout(robot, base_columns(robot), tuple(terms), at, speeds, middles, (7.0,) * n, 0.0, np.nan)
    return TorqueModel(layout, np.concatenate(values), robot.links, tuple(range(n)))


def compiled(model: TorqueModel, *motion: Floats) -> Floats:
    """Torques of setpoints (N, n), one by one."""
    P, n = model.table(), model.layout.robot.n_joints
    out = np.empty_like(motion[0])
    for k, x in enumerate(np.concatenate(motion, axis=1)):
        feed_forward(P, np.zeros((len(P) - n, TORQUE_COLUMNS)), len(P) - n - 1, n, x, out[k])
    return out


def path(*motion: Floats) -> Motion:
    return Motion(0, 0.0, np.zeros(3), np.zeros(len(motion[0])), *motion, None, 0.01)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 100_000), n=st.integers(1, 8), kind=st.sampled_from(sorted(KINDS)))
def test_bodies_of_any_arm_take_pinocchio_s_torques(seed: int, n: int, kind: str) -> None:
    arm, robot, rng = arm_robot(kind, n, seed)
    motion = [rng.uniform(-1.0, 1.0, (3, n)) for _ in range(3)]
    told = compiled(model_of(robot), *motion)
    for k in range(3):
        right = arm.reactions(*(one[k] for one in motion))[0]
        np.testing.assert_allclose(told[k], right, atol=1e-9 * (1.0 + np.abs(right).max()))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_effect_that_is_told_ahead_is_told_of_one_setpoint(kind: str) -> None:
    assert {effect.id for effect in MOTION_EFFECTS if effect.ahead} == {*COLUMNS, NEEDS_TEMPERATURE}
    _, robot, rng = arm_robot(kind, 6, 4)
    model = model_of(robot, rng)
    motion = [rng.uniform(-2.0, 2.0, (200, 6)) for _ in range(3)]
    right = model.torques(path(*motion))
    np.testing.assert_allclose(compiled(model, *motion), right, atol=1e-12 * (1.0 + np.abs(right).max()))


@pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")
def test_c_tells_what_the_kernel_tells_bit_for_bit(tmp_path: Path) -> None:
    _, robot, rng = arm_robot("revolute", 6, 5)
    model = model_of(robot, rng)
    model = TorqueModel(model.layout, model.values, model.links, (0, 1, 2, 4, 5))
    table = model.table()
    sizes = {"JOINTS": 6, "ELEMENTS": len(table) - 7, "COLUMNS": TORQUE_COLUMNS}
    lines = [f"#define KT_{name} {size}" for name, size in sizes.items()]
    numbers = ", ".join("{" + ", ".join(map(repr, row)) + "}" for row in table.tolist())
    lines.append(f"static const double kt_table[{len(table)}][KT_COLUMNS] = {{{numbers}}};")
    source, made = tmp_path / "torque.c", tmp_path / "torque.so"
    source.write_text("\n".join([*lines, (FOLDER / "kilter_torque.c").read_text()]))
    command = [str(COMPILER), *WARNINGS, "-O2", "-shared", "-fPIC", "-o", str(made), str(source), "-lm"]
    subprocess.run(command, check=True)
    library = ctypes.CDLL(str(made))
    motion = [rng.uniform(-2.0, 2.0, (500, 6)) for _ in range(3)]
    told = np.empty((500, 6))
    for k in range(500):
        rows = [np.ascontiguousarray(one[k]) for one in motion]
        library.kt_torques(*(ctypes.c_void_p(row.ctypes.data) for row in (*rows, told[k])))
    expected = compiled(model, *motion)
    assert np.isnan(told[:, 3]).all()
    np.testing.assert_array_equal(told, expected)
