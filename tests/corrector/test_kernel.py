"""The compiled correction against core's model, core's compensation and Pinocchio."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.chain import Element
from kilter_core.arm.robot import Robot
from kilter_core.correct.kernels import chain, inverse, layout
from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_core.effects import Batch, Effect, Local
from kilter_core.errors import OptionError
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from tests.core.correct.reference import CorrectOptions, correct

EFFECTS = ("clearance_tilt", "backlash_load", "axial_compliance", "backlash")
EXACT = CorrectionOptions(least_softening_nm=0.0, largest_rad=0.3, largest_m=0.1, farthest_m=0.1)
WIDE = CorrectOptions(max_joint_rad=0.3, max_shift_m=0.1, tolerance_m=1e-12, iterations=60)
DAMPED, RESIDUAL = 0x0800, 0x1000


def rows(calibration: Calibration, count: int = 200, seed: int = 1, spread: float = 1.5) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    lower, upper = np.clip(calibration.robot.limits, -spread, spread).T
    n = calibration.robot.n_joints
    return {
        "q": rng.uniform(lower, upper, (count, n)),
        "qd": rng.normal(size=(count, n)),
        "qdd": 3.0 * rng.normal(size=(count, n)),
        "direction": np.sign(rng.normal(size=(count, n))),
    }


def landing(calibration: Calibration, data: dict[str, np.ndarray], q: np.ndarray, dynamic: bool) -> np.ndarray:
    """Distance (N,) m between where the full model puts the commands and where the nominal arm should be."""
    wanted = calibration.nominal_in_wanted_frames().predict(Observations(data["q"]))
    motion = {"qd": data["qd"], "qdd": data["qdd"]} if dynamic else {}
    actual = calibration.predict(Observations(q, direction=data["direction"], **motion))
    return np.linalg.norm(wanted.position - actual.position, axis=1)


@pytest.mark.parametrize("preset", ["katana450-chapter3", "katana450-chapter4", "katana450-chapter5", "ur10"])
@pytest.mark.parametrize("dynamic", [False, True])
def test_the_full_model_lands_on_the_wanted_point(
    preset: str, dynamic: bool, calibration_of: Callable[..., Calibration]
) -> None:
    calibration = calibration_of(preset)
    data = rows(calibration)
    motion = {"qd": data["qd"], "qdd": data["qdd"]} if dynamic else {}
    program = compile_program(calibration, EXACT)
    assert set(program.supported) == set(EFFECTS)
    result = program.correct_rows(data["q"], direction=data["direction"], **motion)
    good = (result.flags & RESIDUAL) == 0
    assert good.mean() > 0.95
    off = landing(calibration, data, result.q, dynamic)[good]
    assert np.quantile(off, 0.98) < 1e-8
    assert off.max() < 5e-6  # where a moment is next to zero its sign, which is hard here, is held after some rounds


@pytest.mark.parametrize("dynamic", [False, True])
def test_equals_the_readable_compensation_with_six_joints(
    dynamic: bool, calibration_of: Callable[..., Calibration]
) -> None:
    calibration = calibration_of("ur10")
    data = rows(calibration, 60)
    motion = {"qd": data["qd"], "qdd": data["qdd"]} if dynamic else {}
    ours = compile_program(calibration, EXACT).correct_rows(data["q"], direction=data["direction"], **motion)
    theirs = correct(calibration, data["q"], direction=data["direction"], options=WIDE, **motion)
    good = ((ours.flags & RESIDUAL) == 0) & (theirs.status == 0) & theirs.converged
    assert good.mean() > 0.9
    # The kernel looks at Jacobian and loads for the last time when a step is below 1e-7 rad.
    assert np.median(np.abs(ours.q - theirs.q)[good]) < 1e-10
    assert np.allclose(ours.q[good], theirs.q[good], rtol=0, atol=1e-7)
    assert np.allclose(ours.error_removed, theirs.error_removed, rtol=0, atol=1e-12)


def test_equals_the_readable_compensation_in_what_it_removes_with_five_joints(katana: Calibration) -> None:
    data = rows(katana, 60)
    ours = compile_program(katana, EXACT).correct_rows(data["q"], direction=data["direction"])
    theirs = correct(katana, data["q"], direction=data["direction"], options=WIDE)
    good = ((ours.flags & RESIDUAL) == 0) & (theirs.status == 0) & theirs.converged
    assert good.mean() > 0.9
    # Two joints are to spare, and both turn the tool with them as well as they can.
    assert np.median(np.abs(ours.q - theirs.q)[good]) < 1e-10
    assert np.allclose(ours.q[good], theirs.q[good], rtol=0, atol=1e-7)
    assert np.allclose(ours.error_removed, theirs.error_removed, rtol=0, atol=1e-12)


def pinocchio_model(calibration: Calibration) -> pin.Model:
    """The nominal chain and links as a Pinocchio model, built from the elements without core's folding."""
    robot = calibration.robot
    model = pin.Model()
    model.gravity = pin.Motion(np.array(robot.gravity), np.zeros(3))
    joint, place = 0, pin.SE3.Identity()
    makers = (
        pin.JointModelPX,
        pin.JointModelPY,
        pin.JointModelPZ,
        pin.JointModelRX,
        pin.JointModelRY,
        pin.JointModelRZ,
    )
    for k, element in enumerate(robot.chain.elements):
        assert element.ratio == 1.0
        place = place * elementary(element)
        if element.joint is not None:
            joint = model.addJoint(joint, makers[element.axis](), place, f"j{element.joint}")
            place = pin.SE3.Identity()
        for link in robot.links:
            if link.element == k and joint:
                model.appendBodyToJoint(joint, pin.Inertia(link.mass, link.com, link.inertia), place)
    model.addFrame(pin.Frame("tool", joint, place * pin.SE3(robot.T_tool), pin.FrameType.OP_FRAME))
    return model


def elementary(element: Element) -> pin.SE3:
    axis = np.eye(3)[element.axis % 3]
    if element.axis.rotates:
        return pin.SE3(pin.AngleAxis(element.value, axis).toRotationMatrix(), np.zeros(3))
    return pin.SE3(np.eye(3), element.value * axis)


@pytest.mark.parametrize("preset", ["katana450-chapter4", "ur10"])
@pytest.mark.parametrize("dynamic", [False, True])
def test_moments_and_poses_equal_pinocchio(
    preset: str, dynamic: bool, calibration_of: Callable[..., Calibration]
) -> None:
    calibration = calibration_of(preset)
    program = compile_program(calibration, EXACT)
    model = pinocchio_model(calibration)
    state = model.createData()
    data = rows(calibration, 20)
    n, m = program.n_joints, program.moves
    zeros = np.zeros(n)
    for q, qd, qdd in zip(data["q"], data["qd"], data["qdd"], strict=True):
        work = program.memory()[len(program.array) :]
        work[m + 1 : m + 1 + n, layout.WANTED] = work[m + 1 : m + 1 + n, layout.COMMAND] = q
        work[m + 1 : m + 1 + n, layout.SPEED_NOW], work[m + 1 : m + 1 + n, layout.ACCEL_NOW] = qd, qdd
        inverse.prepare(program.array, work, n, m, m + 1)
        tool = np.array(chain.load_frames(program.array, work, 0, m, m + 1))
        # Which calls load_moments and nothing else here; by itself that would be compiled for a call from Python.
        assert program.array[-1, layout.HANGING] == 0
        inverse._loads_where_it_hangs(program.array, work, len(program.array) - 1, n, m, m + 1, dynamic)
        tau = pin.rnea(model, state, q, qd if dynamic else zeros, qdd if dynamic else zeros)
        pin.framesForwardKinematics(model, state, q)
        # The load is what the links do to the joint: minus the torque that holds them.
        assert np.allclose(work[m + 1 : m + 1 + n, layout.MOMENT + 2], -tau, rtol=0, atol=1e-9)
        across = work[m + 1 : m + 1 + n, layout.MOMENT : layout.MOMENT + 2]
        for j, k in enumerate(calibration.robot.chain.primary):
            held = -state.f[j + 1].angular
            z = calibration.robot.chain.elements[k].axis % 3
            assert np.allclose(across[j], [held[(z + 1) % 3], held[(z + 2) % 3]], rtol=0, atol=1e-9)
        frame = state.oMf[model.getFrameId("tool")]
        assert np.allclose(tool[9:], frame.translation, rtol=0, atol=1e-12)
        assert np.allclose(tool[:9].reshape(3, 3), frame.rotation, rtol=0, atol=1e-12)


def test_a_row_alone_equals_a_row_in_a_batch(katana: Calibration) -> None:
    data = rows(katana, 20)
    program = compile_program(katana)
    batch = program.correct_rows(data["q"])
    for k, q in enumerate(data["q"]):
        assert np.array_equal(program.correct_rows(q[None]).q[0], batch.q[k])


def test_no_rows_are_no_rows(katana: Calibration) -> None:
    assert compile_program(katana).correct_rows(np.zeros((0, 5))).q.shape == (0, 5)


def test_a_nominal_robot_is_left_alone(katana: Calibration) -> None:
    data = rows(katana, 50)
    result = compile_program(Calibration.nominal(katana.robot)).correct_rows(data["q"])
    assert np.allclose(result.q, data["q"], rtol=0, atol=1e-12)


def test_the_correction_stays_bounded_and_continuous_through_a_singularity(
    calibration_of: Callable[..., Calibration],
) -> None:
    calibration = calibration_of("ur10", ("axial_compliance",))
    program = compile_program(calibration)
    wrist = np.linspace(-0.05, 0.05, 4001)  # the wrist is singular where joint 5 is zero
    q = np.tile([0.3, -1.2, 1.4, -0.5, 0.0, 0.2], (len(wrist), 1))
    q[:, 4] = wrist
    result = program.correct_rows(q)
    delta = result.q - q
    assert np.all(np.isfinite(delta))
    assert np.abs(delta).max() < math.radians(1.3)
    assert (result.flags & DAMPED).any()
    assert np.abs(np.diff(delta, axis=0)).max() < math.radians(0.05)


@dataclass(frozen=True)
class Sag(Effect):
    """An effect that no kernel has heard of."""

    id = "sag"
    summary = "for this test"
    source = "nowhere"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        return ()

    def local(self, batch: Batch, values: np.ndarray) -> Local:
        return Local()


def test_effects_the_kernel_does_not_know_are_named(katana: Calibration) -> None:
    program = compile_program(katana.with_effects([*katana.model.effects, Sag()]))
    assert program.unsupported == ("sag",)
    assert set(program.supported) == set(EFFECTS)


def test_a_task_with_more_rows_than_joints_is_refused(katana: Calibration) -> None:
    with pytest.raises(OptionError, match="pose"):
        compile_program(katana, CorrectionOptions(task="pose"))
    assert compile_program(katana, CorrectionOptions(task="axis")).held_rows == ("x", "y", "z", "rx", "ry")


def test_payload_counts_at_its_place(katana: Calibration) -> None:
    data = rows(katana, 40)
    com = (0.01, 0.02, 0.05)
    program = compile_program(katana, CorrectionOptions(least_softening_nm=0.0, payload_kg=0.5, payload_com=com))
    result = program.correct_rows(data["q"], direction=data["direction"])
    theirs = correct(
        katana, data["q"], direction=data["direction"], payload_kg=np.full(40, 0.5), payload_com=np.tile(com, (40, 1))
    )
    assert np.allclose(result.error_removed, theirs.error_removed, rtol=0, atol=1e-12)


def test_the_filter_brings_dynamic_moments_without_speeds(katana: Calibration) -> None:
    t = np.arange(0, 1.0, 0.002)
    phase = 2 * math.pi * t
    q = 0.5 + 0.3 * np.sin(phase)[:, None] * np.ones(5)
    qd = 0.3 * 2 * math.pi * np.cos(phase)[:, None] * np.ones(5)
    qdd = -0.3 * (2 * math.pi) ** 2 * np.sin(phase)[:, None] * np.ones(5)
    dt = np.full(len(t), 0.002)
    free = {"rate_rad_s": 1e3, "change_rad_s": 1e3, "change_rad_s2": 1e6}
    options = {**free, "filter_hz": 50.0}
    filtered = Track(compile_program(katana, CorrectionOptions(**options)), settled=True).follow(q, 1, dt)
    given = Track(compile_program(katana, CorrectionOptions(**free)), settled=True).follow(
        np.hstack([q, qd, qdd]), 3, dt
    )
    assert filtered[0] == given[0] == len(t)
    late = slice(200, None)
    assert np.abs(filtered[1] - given[1])[late].mean() < math.radians(0.008)
