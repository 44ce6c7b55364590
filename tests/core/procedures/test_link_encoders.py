"""Two encoders per joint: a motion made here with known parameters, and the recordings of a real KUKA KR300."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import scipy.io
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError, TooFewPosesError
from kilter_core.observations import Observations
from kilter_core.procedures.link_encoders import LinkJoint, calibration_from_encoders, link_joints
from tests.core.truth import Body, ur10

Floats = NDArray[np.float64]
ARM = replace(ur10(), bodies=tuple(Body(j, 3.0, np.array([-0.2, 0.02, 0.05])) for j in range(6)))
ROBOT = robot_from_document(ARM.document())
C, B, TAU = 2e-5, 3e-4, 2e-3
KR300 = Path(__file__).resolve().parents[3] / "clients/python/examples/kr300.json"
RATIOS = np.array([1798 / 7, 1872 / 7, 757 / 3, 221.0, 5032 / 21, 154.323134])


def held_torques(q: Floats) -> Floats:
    """Torques (N, 6) that hold the arm, by Pinocchio; every ratio of this arm is one."""
    model, _ = ARM.pinocchio()
    data, none = model.createData(), np.zeros(6)
    return np.array([pin.rnea(model, data, ARM.motors(row), none, none) for row in q])


def motion(seed: int, noise: float = 2e-5, correlated: bool = True, rows: int = 800) -> Observations:
    """Ten seconds: the link behind the motor by yielding (moments of Pinocchio), play and a late reading."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 10.0, rows)
    w, phase = rng.uniform(0.5, 1.5, (3, 6)), rng.uniform(0.0, 6.0, (3, 6))
    amplitude = np.array([0.4, 0.2, 0.1])[:, None]
    turn = t[:, None, None] * w + phase
    q, qd = (amplitude * np.sin(turn)).sum(1), (amplitude * w * np.cos(turn)).sum(1)
    link = q - C * held_torques(q) + 0.5 * B * np.sign(qd) - TAU * qd + 0.01 * np.arange(6)
    white = rng.normal(0.0, noise, (rows, 6))
    if correlated:
        for k in range(1, rows):
            white[k] = 0.9 * white[k - 1] + np.sqrt(1 - 0.81) * white[k]
    return Observations(q, link_q=link + white, qd=qd, direction=np.sign(qd), t=t)


def values(joint: LinkJoint) -> dict[str, Any]:
    return {p.name.rsplit("_", 1)[0]: p for p in joint.parameters}


def test_sigmas_cover_the_truth_where_residuals_follow_each_other() -> None:
    wrong: list[float] = []
    plain: list[float] = []
    for seed in range(6):
        for joint in link_joints(ROBOT, [motion(seed)])[1:5]:
            for stem, truth in (("compliance", C), ("backlash", B), ("encoder_delay", TAU)):
                p = values(joint)[stem]
                wrong.append((p.value - truth) / p.sigma)
        independent = [values(j)["backlash"] for j in link_joints(ROBOT, [motion(seed, correlated=False)])[1:5]]
        plain += [(p.value - B) / p.sigma for p in independent]
    assert np.sqrt(np.mean(np.square(wrong))) == pytest.approx(1.0, abs=0.45)
    assert np.sqrt(np.mean(np.square(plain))) == pytest.approx(1.0, abs=0.45)


def test_what_was_fitted_on_one_motion_predicts_another() -> None:
    found = link_joints(ROBOT, [motion(0), motion(1)], [motion(7)])
    for joint in found[1:5]:
        assert len(joint.fitted) == 2
        (unseen,) = joint.predicted
        assert unseen is not None
        assert unseen.left == pytest.approx(2e-5, rel=0.15)
        assert unseen.raw > 5 * unseen.left
    known = calibration_from_encoders(ROBOT, found)
    assert dict(zip(known.names, known.values, strict=True))["compliance_2"] == pytest.approx(C, rel=0.02)
    assert not any("delay" in name for name in known.names)


def test_an_upright_axis_a_resting_joint_and_one_way_motion_say_what_is_missing() -> None:
    rows = motion(0)
    assert rows.link_q is not None
    still = replace(rows, q=np.where(np.arange(6) == 3, 0.2, rows.q))
    one_way = replace(rows, direction=np.where(np.arange(6) == 2, 1.0, rows.direction))
    found = link_joints(ROBOT, [rows])
    assert "load about this axis never changes" in values(found[0])["compliance"].reason
    assert values(found[0])["backlash"].value == pytest.approx(B, rel=0.1)
    assert "never moves" in str(link_joints(ROBOT, [still])[3].dead)
    assert "never reverses" in values(link_joints(ROBOT, [one_way])[2])["backlash"].reason


def test_a_load_that_would_be_yielded_against_is_not_called_compliance() -> None:
    rows = motion(0)
    turned = replace(rows, tau=-held_torques(rows.q))
    found = values(link_joints(ROBOT, [turned])[1])
    assert found["compliance"].value is None
    assert "negative" in found["compliance"].reason
    assert found["encoder_delay"].value is not None


def test_rows_without_a_link_side_are_refused() -> None:
    rows = motion(0)
    with pytest.raises(ObservationError, match="link1_deg"):
        link_joints(ROBOT, [replace(rows, link_q=None)])
    with pytest.raises(TooFewPosesError, match="not a motion"):
        link_joints(ROBOT, [rows.select(np.arange(20))])


def recorded(folder: Path, name: str) -> Observations:
    r = scipy.io.loadmat(folder / f"traj_{name}.mat", squeeze_me=True, struct_as_record=False)["rec"]
    speed = np.radians(r.act_vel_mot_deg_per_s.T)
    return Observations(
        q=np.radians(r.act_pos_mot_deg.T), link_q=np.radians(r.act_pos_se_deg.T), qd=speed,
        tau=r.act_torque_abs_nm.T * RATIOS, direction=np.sign(speed), t=r.time_cont,
    )  # fmt: skip


def test_the_kr300_trained_on_one_motion_predicts_the_two_others(shared_data: Path) -> None:
    """Target: what is left at most half of the raw standard deviation. Least squares by hand says the same numbers."""
    folder = shared_data / "kuka-kr300-secondary-encoder"
    A, B_, C_ = (recorded(folder, name) for name in "ABC")
    found = link_joints(robot_from_document(json.loads(KR300.read_text(encoding="utf-8"))), [A], [B_, C_])
    for joint in found[:3]:
        assert len(joint.predicted) == 2
        assert all(s is not None and s.left < 0.2 * s.raw for s in joint.predicted)
    assert [j.dead is not None for j in found] == [False] * 3 + [True] * 3
    assert all("dead channel" in str(j.dead) for j in found[3:])
    assert A.link_q is not None
    assert A.tau is not None
    assert A.qd is not None
    y = (A.link_q - A.q)[:, 2]
    X = np.stack([-A.tau[:, 2], 0.5 * np.sign(A.qd[:, 2]), -A.qd[:, 2], np.ones(len(y))], axis=1)
    by_hand = np.linalg.solve(X.T @ X, X.T @ y)
    assert [p.value for p in found[2].parameters] == pytest.approx(by_hand[:3].tolist(), rel=1e-6)
    assert found[2].fitted[0] is not None
    assert found[2].fitted[0].left == pytest.approx(float(np.std(y - X @ by_hand)), rel=1e-6)
