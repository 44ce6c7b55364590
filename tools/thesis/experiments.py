"""Each experiment of the thesis, done by Kilter on arms of :mod:`tools.thesis.arms`. Errors are mean |ΔP| in mm."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from kilter_client.cli.demo import circle
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import Robot
from kilter_core.effects import make_effect
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.estimate import prepare_problem
from kilter_core.identify.measured_rows import imposed_step, relative_influence
from kilter_core.identify.methods.per_pose import pose_solutions
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.plan.d_optimal import iso_poses
from kilter_core.types import Floats
from tests.core.correct.reference import CorrectOptions, correct
from tools.thesis.arms import CHAPTER_4, Arm, built

POSES, UNSEEN = 118, 60
TEN = 10  # uncalibrated poses of table 4.6
RESOLUTION_MM = 0.01  # of the Optotrak, taken as a coordinate's standard deviation
STEP_RAD, STEP_M = math.radians(0.05), 1e-4
TILTS = ("clearance_tilt", "backlash_load", "axial_compliance")
FIXED = IdentifyOptions(base="fixed", tool="fixed")
READING_RAD = math.radians(0.001)  # resolution of the thesis's inclinometers
STIFFNESS_SHARE = 0.05  # what such readings leave open of a stiffness
CHAPTER_3 = ("theta_offset_*", "alpha_*", "beta_*", "a_3", "a_4", "d_5", "d_6")  # the 17 parameters of eq. 3.5
POINTS = 180  # along the circle
FREE = CorrectOptions(max_joint_rad=0.1, max_shift_m=0.02)


def katana(chapter: int = 5) -> Robot:
    """The robot as Kilter is given it."""
    return robot_from_document(preset_document(f"katana450-chapter{chapter}"))


def poses(robot: Robot, seed: int = 0) -> tuple[Floats, Floats]:
    """Joints to calibrate with (118, n) and never to calibrate with (60, n), all by ISO 9283."""
    q = iso_poses(robot, POSES + UNSEEN, seed)
    return q[:POSES], q[POSES:]


def measured(arm: Arm, q: Floats, seed: int) -> Observations:
    """Positions with the noise of the instrument."""
    rng = np.random.default_rng(1000 + seed)
    return Observations(q, position=arm.positions(q) + rng.normal(0.0, RESOLUTION_MM * 1e-3, (len(q), 3)))


def mean_mm(calibration: Calibration, arm: Arm, q: Floats) -> float:
    """Mean of :func:`errors_mm`."""
    return float(errors_mm(calibration, arm, q).mean())


def errors_mm(calibration: Calibration, arm: Arm, q: Floats) -> Floats:
    """Distance (N,) mm of where the arm is from where the calibration says, without noise."""
    return np.asarray(np.linalg.norm(arm.positions(q) - calibration.predict(Observations(q)).position, axis=1) * 1e3)


def influence(q: Floats) -> dict[str, Floats]:
    """Displacement (N,) mm of the tool by +0.05 deg or +0.1 mm of each element alone (figure 3.8), chapter 3's arm."""
    still = Arm(tool_m=0.0).positions(q)
    out = {}
    for name, axis, _ in CHAPTER_4:
        step = STEP_M if axis[0] == "t" else STEP_RAD
        there = Arm(tool_m=0.0, errors={name: step}).positions(q)
        out[name] = np.linalg.norm(there - still, axis=1) * 1e3
    return out


def methods(seed: int, calibrate: Floats, unseen: Floats) -> dict[str, tuple[float, float]]:
    """Table 3.4: the 17 parameters by each method, tilting in the arm and in no model; errors on both sets of poses."""
    robot, arm = katana(3), replace(built(seed), tool_m=0.0, base_m=(0.0, 0.0, 0.0))
    rows = measured(arm, calibrate, seed)
    nominal = Calibration.nominal(robot)
    out = {"before": (mean_mm(nominal, arm, calibrate), mean_mm(nominal, arm, unseen))}
    for method in ("pose_pseudo_inverse", "influence", "least_squares"):
        options = replace(FIXED, method=method, free=CHAPTER_3, noise_mm=RESOLUTION_MM)
        found = identify(robot, rows, options=options).calibration
        out[method] = (mean_mm(found, arm, calibrate), mean_mm(found, arm, unseen))
    for name, weighted in (("pose_pseudo_inverse, one round", False), ("influence, one round", True)):
        found = one_round(nominal, rows, weighted)
        out[name] = (mean_mm(found, arm, calibrate), mean_mm(found, arm, unseen))
    return out


def one_round(nominal: Calibration, rows: Observations, weighted: bool) -> Calibration:
    """Every pose solved once from the drawing (eq. 3.6, or 3.7 and 3.8), and the mean taken, no pose asked again."""
    options = replace(FIXED, free=CHAPTER_3, noise_mm=RESOLUTION_MM)
    problem, values = prepare_problem(nominal, Measurement.from_observations(rows), options)
    J, r = problem.by_row(problem.linearise(values))
    steps = np.array([imposed_step(problem.model.parameters[k]) for k in problem.free]) / problem.prior_sigma
    k = relative_influence(np.linalg.norm(J[:, :3], axis=1) * steps) if weighted else np.ones((len(J), J.shape[2]))
    values[problem.free] += pose_solutions(J, r, k, 0.5, 1.0).mean(axis=0) * problem.prior_sigma
    return Calibration(problem.model, values)


def models(seed: int, calibrate: Floats) -> tuple[Arm, dict[str, Calibration]]:
    """An arm, and what each model makes of it: tables 4.5 and 4.6, and the circle."""
    robot, arm = katana(), built(seed)
    rows = measured(arm, calibrate, seed)
    stiff = replace(FIXED, effects=("axial_compliance",))
    found = {
        "before": Calibration.nominal(robot),
        "conventional": identify(robot, rows, options=replace(FIXED, level=2)).calibration,
        "stiffness only": identify(robot, rows, options=stiff).calibration,
        "full, tilt first": identify(
            robot, rows, options=replace(FIXED, level=3, tilt_first=True), start=by_inclinometer(robot, arm, seed)
        ).calibration,
        "full, together": identify(robot, rows, options=replace(FIXED, level=3)).calibration,
    }
    return arm, found


def by_inclinometer(robot: Robot, arm: Arm, seed: int) -> Calibration:
    """Joint parameters as inclinometers give them: the truth, read with their resolution."""
    model = RobotModel(robot, tuple(make_effect(e) for e in TILTS))
    rng, tilting, n = np.random.default_rng(2000 + seed), arm.tilting, robot.n_joints
    assert tilting is not None
    read = {
        "clearance": tilting.clearance + rng.uniform(-0.5, 0.5, n) * READING_RAD,
        "backlash_load": tilting.backlash + rng.uniform(-0.5, 0.5, n) * READING_RAD,
        "compliance": tilting.compliance * (1.0 + STIFFNESS_SHARE * rng.normal(size=n)),
    }
    values = model.values0()
    for stem, numbers in read.items():
        for j, number in enumerate(numbers):
            values[model.names.index(f"{stem}_{j + 1}")] = number
    return Calibration(model, values)


def along_circle(arm: Arm, found: Mapping[str, Calibration]) -> dict[str, Floats]:
    """Distance (N,) mm of the driven arm from the wanted circle, each model having corrected the joints (eq. 5.22)."""
    path = circle(katana(), seconds=POINTS / 20.0, rate_hz=20.0)
    out = {}
    for name, calibration in found.items():
        q = path.q if name == "before" else correct(calibration, path.q, options=FREE).q
        out[name] = np.linalg.norm(arm.positions(q) - path.wanted, axis=1) * 1e3
    return out


def tilting_alone(seed: int) -> dict[str, Floats]:
    """Figure 5.10: displacement (N,) mm along the circle by stiffness alone, and by clearance, backlash and stiffness."""
    path, tilts = circle(katana(), seconds=POINTS / 20.0, rate_hz=20.0), built(seed).tilting
    assert tilts is not None
    still = Arm().positions(path.q)
    none = np.zeros(5)
    stiff = Arm(tilting=replace(tilts, clearance=none, backlash=none)).positions(path.q)
    whole = Arm(tilting=tilts).positions(path.q)
    return {
        "stiffness alone": np.linalg.norm(stiff - still, axis=1) * 1e3,
        "clearance, backlash and stiffness": np.linalg.norm(whole - still, axis=1) * 1e3,
    }
