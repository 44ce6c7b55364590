"""Every effect of the library: made up for at run time, or named as unsupported."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.chain import Axis, Chain, Element
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Joint, Link, Robot
from kilter_core.correct.program import CorrectionOptions, CorrectionProgram, Track, compile_program
from kilter_core.effects import EFFECTS, Effect, make_effect
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations

TEMPERATURE_C = 31.0
BASE_TILT = (3e-4, -2e-4)
DAMPED, RESIDUAL = 0x0800, 0x1000
CONFIG: dict[str, dict[str, Any]] = {
    "gear_error": {"joints": (0, 2), "ratios": (100.0, 121.0)},
    "gravity_spring": {"arms_m": (0.2, 0.5), "angle_rad": 0.3, "free_length_m": 0.2},
    "unknown_joint_curve": {"partner": 1},
    "payload_error": {"compliances": (1e-5,) * 6},
    "session_shift": {"sessions": (1, 2)},
    "drift": {"t0_s": 0.0},
    "zero_drift": {"t0_s": 0.0},
    "settling": {"t0_s": 0.0, "tau_s": 600.0},
    "measured_tilt": {"zero_x_rad": 1e-4, "zero_y_rad": 0.0},
    "random_walk": {"knots_s": (0.0, 600.0, 1800.0)},
    "unknown_smooth_curve": {"joints": (1, 3), "centres": (0.2, -0.1), "halves": (1.0, 1.5)},
    "straightness": {"joints": (0,), "centres": (0.1,), "halves": (1.2,)},
    "guide_rotation": {"joints": (0,), "centres": (0.1,), "halves": (1.2,)},
    "telescope_bending": {"joints": (0,), "roots_m": (-1.5,)},
    "unknown_residual": {"inputs": (1, 2), "length": 1.0, "centres": ((0.1, 0.5), (1.0, -0.4))},
}
WIDE: Any = {"largest_rad": 0.3, "farthest_m": 0.1, "base_tilt": BASE_TILT}
# An effect says in its own file whether it acts at run time; those apart do so for some loads only.
APART = ("payload_error", "tool_sag", "load_error")
ACTING = tuple(name for name, kind in EFFECTS.items() if kind.at_run_time is not Effect.at_run_time)
PAST = ("base_step", "zero_step")  # over for an arm that moves now
AT_RUN_TIME = tuple(name for name in ACTING if name not in (*APART, *PAST))
NAMED = ("drift", "thermal_drift", "unknown_field", "unknown_residual", "zero_drift", "settling", "random_walk")
OF_SLIDES = ("straightness", "guide_rotation", "telescope_bending")
RIVALS = ("strain_wave",)  # a joint has one side by its load: this or that of backlash_load
OF_ARMS = tuple(name for name in AT_RUN_TIME if name not in (*OF_SLIDES, *RIVALS))
OF_THE_INSTRUMENT = ("time_offset", "measurement_scale", "session_shift", "tool_step")


def robot_for(names: Iterable[str], preset: str = "ur10") -> Robot:
    """A preset, on a rail along y where an effect acts at prismatic joints alone."""
    arm = robot_from_document({"convention": "preset", "preset": preset, "name": preset})
    if not set(names) & set(OF_SLIDES):
        return arm
    moved = (replace(e, joint=None if e.joint is None else e.joint + 1) for e in arm.chain.elements)
    chain = Chain((Element(Axis.TY, name="rail", joint=0), *moved), arm.n_joints + 1)
    links = (Link(0, 12.0, np.array([0.05, 0.0, 0.1])), *(replace(k, element=k.element + 1) for k in arm.links))
    return replace(arm, joints=(Joint("rail", "prismatic", -1.4, 1.4), *arm.joints), chain=chain, links=links)


def calibration_with(*names: str) -> Calibration:
    """A UR10 whose effects have values of a third of their prior width."""
    robot = robot_for(names)
    model = RobotModel(robot, tuple(make_effect(name, **CONFIG.get(name, {})) for name in names))
    values = model.values0()
    rng = np.random.default_rng(len(names))
    for k in range(model.n_geometric, len(values)):
        p = model.parameters[k]
        values[k] = np.clip(p.prior_sigma * rng.uniform(0.1, 0.4), p.lower, p.upper)
        if p.unit == "s":
            values[k] = 1e-4
    return Calibration(model, values)


def landing(calibration: Calibration, program: CorrectionProgram, dynamic: bool, payload_kg: float = 0.0) -> np.ndarray:
    """Distance (N,) m between the full model at the corrected joints and the wanted points."""
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.3, 1.3, (60, calibration.robot.n_joints))
    qd, qdd = rng.normal(size=q.shape), 3.0 * rng.normal(size=q.shape)
    direction = np.sign(rng.normal(size=q.shape))
    motion = {"qd": qd, "qdd": qdd} if dynamic else {}
    result = program.correct_rows(q, direction=direction, **motion)
    good = (result.flags & RESIDUAL) == 0
    assert good.mean() > 0.5
    stated = {
        "direction": direction,
        "temperature_c": np.full(60, TEMPERATURE_C),
        "base_tilt_x": np.full(60, BASE_TILT[0]),
        "base_tilt_y": np.full(60, BASE_TILT[1]),
        "qd": 0.0 * q,
        "qdd": 0.0 * q,
        "payload_kg": np.full(60, payload_kg),
    } | motion
    wanted = calibration.nominal_in_wanted_frames().predict(Observations(q)).position
    actual = calibration.predict(Observations(result.q, **stated)).position
    return np.asarray(np.linalg.norm(actual - wanted, axis=1)[good])


def test_every_effect_has_its_place() -> None:
    assert not set(ACTING) & {*NAMED, *OF_THE_INSTRUMENT}
    assert set(NAMED) | set(OF_THE_INSTRUMENT) <= set(EFFECTS)
    assert len(ACTING) >= 27  # those of the library, which may only become more


@pytest.mark.parametrize("name", AT_RUN_TIME)
def test_an_effect_is_made_up_for(name: str) -> None:
    calibration = calibration_with(name)
    options = CorrectionOptions(**WIDE, least_softening_nm=0.0, temperature_c=TEMPERATURE_C, iterations=20)
    program = compile_program(calibration, options)
    assert (program.supported, program.unsupported) == ((name,), ())
    for dynamic in (False, True):
        assert landing(calibration, program, dynamic).max() < 1e-6


@pytest.mark.parametrize(
    ("names", "share"), [(OF_ARMS, 1.0), ((*OF_SLIDES, "axial_compliance", "clearance_tilt", "link_bending"), 0.2)]
)
def test_all_of_them_together(names: tuple[str, ...], share: float) -> None:
    calibration = calibration_with(*names)
    nominal = calibration.model.values0()
    calibration = replace(calibration, values=nominal + share * (calibration.values - nominal))
    options = CorrectionOptions(**WIDE, least_softening_nm=0.0, temperature_c=TEMPERATURE_C, iterations=30)
    program = compile_program(calibration, options)
    assert set(program.supported) == set(names)
    assert np.quantile(landing(calibration, program, True), 0.95) < 2e-6


@pytest.mark.parametrize("name", NAMED)
def test_what_the_kernel_cannot_do_is_named(name: str) -> None:
    program = compile_program(calibration_with("encoder_scale", name))
    assert (program.supported, program.unsupported) == (("encoder_scale",), (name,))


@pytest.mark.parametrize("name", OF_THE_INSTRUMENT)
def test_errors_of_the_instrument_are_none_of_the_arm(name: str) -> None:
    program = compile_program(calibration_with("encoder_scale", name))
    assert program.unsupported == ()


def test_growth_needs_a_temperature_and_a_payload_error_no_payload() -> None:
    grown = calibration_with("thermal_growth")
    assert compile_program(grown).unsupported == ("thermal_growth",)
    assert compile_program(grown, CorrectionOptions(temperature_c=20.0)).unsupported == ()
    loaded = calibration_with("payload_error")
    assert compile_program(loaded).unsupported == ()
    assert compile_program(loaded, CorrectionOptions(payload_kg=1.0)).unsupported == ("payload_error",)


def test_a_tool_that_sags_is_held_up_beside_a_link_that_bends() -> None:
    calibration = calibration_with("tool_sag", "link_bending", "reading_tilt")
    options = CorrectionOptions(least_softening_nm=0.0, payload_kg=3.0, iterations=20)
    program = compile_program(calibration, options)
    assert program.unsupported == ()
    for dynamic in (False, True):
        assert landing(calibration, program, dynamic, 3.0).max() < 1e-6
    alone = compile_program(calibration_with("tool_sag"))
    assert (alone.supported, alone.unsupported) == (("tool_sag",), ())


def test_what_follows_the_temperature_or_a_measured_tilt_needs_one() -> None:
    names = ("zero_thermal", "link_growth", "column_bending", "measured_tilt")
    calibration = calibration_with(*names, "drift")
    program = compile_program(calibration)
    assert program.unsupported == (*names, "drift")
    tilt = ("base_tilt_x", "base_tilt_y")
    assert program.where_stated == dict.fromkeys(names[:3], ("temperature_c",)) | {"measured_tilt": tilt}
    warm = compile_program(calibration, CorrectionOptions(temperature_c=20.0))
    assert (warm.unsupported, warm.where_stated) == (("measured_tilt", "drift"), {"measured_tilt": tilt})
    assert compile_program(calibration, CorrectionOptions(temperature_c=20.0, base_tilt=(0.0, 0.0))).where_stated == {}


def test_a_guess_that_goes_on_ends_where_one_from_zero_does() -> None:
    program = compile_program(calibration_with("axial_compliance", "eccentricity"))
    t = np.arange(1500) * 0.002
    q = np.array([0.3, -1.2, 1.4, -0.5, 0.9, 0.2]) + 0.3 * np.sin(3.0 * t)[:, None]
    done, out, info, _ = Track(program, settled=True).follow(q, 1, np.full(len(t), 0.002))
    assert done == len(q)
    assert np.abs(out - program.correct_rows(q).q).max() < 1e-8
    assert info[10:, 7].mean() < 1.5  # evaluations of the arm for each setpoint
    assert math.isfinite(info[:, 3].max())
