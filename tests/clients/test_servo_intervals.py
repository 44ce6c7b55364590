"""Intervals of what a search by a user's model finds hold: backlash in logs of MuJoCo, whose gear is harder at short steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kilter_client.twin.servo_gap import find_servo_gap
from kilter_client.twin.servo_model import ServoModel, read_command_log
from kilter_core.motion import JointRecord
from kilter_core.motion.kernels import joint as place
from kilter_core.motion.rollout.effects import BY_ID
from kilter_core.motion.rollout.fit import JointFit, Term, fit_base, fit_with, simulate
from kilter_core.motion.rollout.search import covariance
from tests.clients.score_servos import draw_servos
from tests.clients.servo_arm import NOMINAL, TICK_RAD, Hidden, Servos, arm_xml, record

DEG = np.pi / 180.0
NOISE_RAD = TICK_RAD / np.sqrt(12.0)
STEP_S = 0.001


def record_backlash(folder: Path, seed: int, size: float, servos: Servos, logs: int = 5) -> JointRecord:
    hidden = Hidden("backlash", 0, size)
    paths = [folder / f"log{k}.csv" for k in range(logs)]
    for k, path in enumerate(paths):
        record(7000 + 100 * seed + k, hidden, servos, 15.0, step_s=STEP_S).write(path)
    (folder / "arm.xml").write_text(arm_xml(NOMINAL.of_joint(1), None, STEP_S))
    arm = ServoModel.from_file(folder / "arm.xml")
    return arm.records([read_command_log(path, 1) for path in paths])[0]


def fit_backlash(joint: JointRecord) -> JointFit:
    every = np.ones(len(joint.reading), dtype=bool)
    base = fit_base(joint, every)
    return fit_with(joint, base, Term(BY_ID["backlash"]), every, float(np.sqrt(base.cost)))


def test_readings_have_no_jump_as_the_width_changes(tmp_path: Path) -> None:
    """Bodies that meet the motor a step later would: a fit would stop at the next of them."""
    joint = record_backlash(tmp_path, 23, 1.36 * DEG, replace(Servos().of_joint(1), payload_kg=0.3), 2)
    p = fit_backlash(joint).p
    widths = p[place.BACKLASH] + 2e-6 * np.arange(40)
    readings = []
    for width in widths:
        p[place.BACKLASH] = width
        readings.append(simulate(joint, p)[joint.used])
    moved = np.diff(readings, axis=0)
    assert np.abs(moved).max() > 0.0
    assert np.abs(moved - np.median(moved, axis=0)).max() < 0.02 * NOISE_RAD


def test_intervals_of_backlash_read_on_the_motor_cover(tmp_path: Path) -> None:
    apart = []
    for seed in range(20):
        rng = np.random.default_rng([seed, 77])
        size, servos = rng.uniform(0.3, 1.5) * DEG, replace(draw_servos(rng).of_joint(1), payload_kg=0.3)
        joint = record_backlash(tmp_path, seed, size, servos)
        fit = fit_backlash(joint)
        sigmas = np.sqrt(np.diag(covariance(joint, fit, joint.used))) * fit.scales
        truth = [servos.armature[0], servos.friction[0], servos.damping[0], servos.gain[0], size]
        apart.append((fit.p[[number.place for number in fit.fitted]] - truth) / sigmas)
    width = np.abs(np.array(apart)[:, -1])
    assert np.sum(width > 1.96) <= 3  # 1 of 20 is expected; more than 3 once in 60 times
    assert width.max() < 3.5
    assert np.median(width) > 0.3  # nor too wide
    assert np.sqrt(np.mean(np.square(apart), axis=0)) == pytest.approx(1.0, abs=0.35)


def carrying_arm(folder: Path, seed: int) -> tuple[Path, list[Path], Servos]:
    """An arm in whose elbow the bodies weigh more than the motor, with its logs at 100 Hz."""
    heavy = (
        ("0 0 0", "0 0 .06", 1.5, "4e-3 4e-3 4e-3"),
        ("0 0 .12", "0 0 .12", 1.2, "6e-3 6e-3 1e-3"),
        ("0 0 .25", ".2 0 0", 1.2, "1e-3 4e-3 4e-3"),
    )
    own = np.random.default_rng([seed, 79]).uniform(0.7, 1.4, (4, 3))
    usual = ((0.06, 0.05, 0.02), (0.15, 0.15, 0.06), (2.0, 1.5, 0.5), (90.0, 80.0, 25.0))
    servos = Servos(*(tuple(np.array(one) * factor) for one, factor in zip(usual, own, strict=True)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.clients.servo_arm.BODIES", heavy)
        logs = [folder / f"log{k}.csv" for k in range(4)]
        for k, path in enumerate(logs):
            record(9000 + 100 * seed + k, None, servos, 15.0, dt=0.01).write(path)
        (folder / "arm.xml").write_text(arm_xml(Servos((0.02,) * 3, (0.0,) * 3, (0.5,) * 3, (60.0, 60.0, 30.0))))
    return folder / "arm.xml", logs, servos


def test_the_armature_of_a_joint_that_carries_others_is_found(tmp_path: Path) -> None:
    model, logs, servos = carrying_arm(tmp_path, 1)
    found, _ = find_servo_gap(model, logs)
    assert found["effects"] == []
    for j in (1, 2):
        armature = found["joints"][j]["servo"][0]
        assert armature["found"] == pytest.approx(servos.armature[j], rel=0.03)
        assert found["joints"][j]["found"] < 1.1 * np.degrees(NOISE_RAD)
