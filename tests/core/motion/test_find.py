"""A search in torques: what is hidden in a simulator's log is named at its joint, and nothing is where nothing is hidden."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError, TooFewPosesError
from kilter_core.motion import MotionReport, find_missing_torque, to_document
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import Extra, Floats, Logger, State, reversed_softly, seven_like, ur_like

Make = Callable[[Logger], Extra]


def at_joint(j: int, shape: Callable[[State], Floats], share: float = 1.0) -> Make:
    """Add a torque of this shape to a joint, as large as its noise times ``share``."""

    def make(logger: Logger) -> Extra:
        scale: list[float] = []

        def extra(state: State) -> Floats:
            torque = shape(state)
            scale.append(share * logger.noise_share * logger.usual[j] / float(np.std(torque)))
            out = np.zeros_like(state.q)
            out[:, j] = scale[0] * torque
            return out

        return extra

    return make


def rows(logger: Logger) -> Observations:
    log = logger.log()
    return Observations(q=log["q"], t=log["t"], tau=log["tau"])


def hunt(logger: Logger) -> MotionReport:
    return find_missing_torque(robot_from_document(logger.arm.document()), rows(logger))


HIDDEN: dict[str, tuple[int, Callable[[State], Floats]]] = {
    "stribeck": (4, lambda s: reversed_softly(s.qd[:, 4], 0.004) * np.exp(-np.abs(s.qd[:, 4]) / 0.08)),
    "load_friction": (1, lambda s: reversed_softly(s.qd[:, 1], 0.004) * np.abs(s.rigid[:, 1])),
    "gear_ripple": (2, lambda s: np.sin(24.0 * s.q[:, 2] + 1.0)),
    "one_sided_damping": (3, lambda s: np.maximum(s.qd[:, 3], 0.0)),
    "warm_up": (0, lambda s: s.qd[:, 0] * s.seconds),
}


@pytest.mark.parametrize("name", HIDDEN)
def test_what_is_hidden_is_named_at_its_joint_and_nothing_else_is(name: str) -> None:
    joint, shape = HIDDEN[name]
    logger = Logger(ur_like(np.random.default_rng(7)), seed=7)
    logger.extra = [at_joint(joint, shape, 1.5)(logger)]
    found = hunt(logger)
    assert [(one.term.effect.id, one.term.joint) for one in found.judged] == [(name, joint)]
    assert found.judged[0].verdict in ("confirmed", "class_confirmed")
    assert found.held.found[joint] < found.held.common[joint]


@pytest.mark.parametrize("arm", [ur_like, seven_like])
def test_nothing_is_named_where_nothing_is_hidden(arm: Callable[[np.random.Generator], object]) -> None:
    found = hunt(Logger(arm(np.random.default_rng(11)), seed=11))  # type: ignore[arg-type]
    assert not found.judged
    assert np.all(found.held.common < 0.25 * found.held.rigid)


def test_load_friction_delay_and_gain_have_their_sizes() -> None:
    arm = seven_like(np.random.default_rng(5))
    logger = Logger(arm, seed=5)
    logger.extra = [lambda s: 0.06 * reversed_softly(s.qd, 0.004) * np.abs(s.rigid) * (np.arange(7) == 3)]
    logger.delay_s = 0.015 * (np.arange(7) == 1)
    found = {(one.term.effect.id, one.term.joint): one for one in hunt(logger).judged}
    friction, delay = found["load_friction", 3], found["torque_delay", 1]
    assert abs(friction.value[0] - 0.06) < 4.0 * friction.sigma[0] + 0.004
    assert abs(delay.value[0] - 0.015) < 4.0 * delay.sigma[0] + 0.001


@pytest.mark.parametrize("delay_s", [0.1, -0.06])
def test_a_long_delay_has_its_size(delay_s: float) -> None:
    """So long that a torque is no longer late by its slope, and that bodies and friction were fitted to what was late."""
    logger = Logger(ur_like(np.random.default_rng(4)), seed=4)
    logger.delay_s = delay_s * (np.arange(6) == 2)
    (found,) = (one for one in hunt(logger).judged if one.verdict != "contradicted")
    assert (found.term.effect.id, found.term.joint) == ("torque_delay", 2)
    assert found.value[0] == pytest.approx(delay_s, rel=0.05)


def test_breaking_loose_that_fades_late_is_named() -> None:
    """Friction that falls up to half of the usual speed, which a tenth of it would not show."""
    logger = Logger(ur_like(np.random.default_rng(8)), seed=8)
    speed = 0.4
    logger.extra = [
        at_joint(4, lambda s: reversed_softly(s.qd[:, 4], 0.004) * np.exp(-((s.qd[:, 4] / speed) ** 2)), 4.0)(logger)
    ]
    (found,) = (one for one in hunt(logger).judged if one.verdict != "contradicted")
    assert (found.term.effect.id, found.term.joint) == ("stribeck", 4)


def test_a_gain_of_a_drive_is_told_from_masses_by_the_other_joints() -> None:
    logger = Logger(ur_like(np.random.default_rng(2)), seed=2)
    logger.gain = np.array([1.0, 1.0, 1.1, 1.0, 1.0, 1.0])
    (one,) = hunt(logger).judged
    assert (one.term.effect.id, one.term.joint) == ("drive_gain", 2)
    assert abs(one.value[0] - 0.1) < 4.0 * one.sigma[0] + 0.01


def test_what_the_bodies_imitate_is_said_not_to_be_testable() -> None:
    """The inertia of the first motor and that of its link turn together: no motion tells them apart."""
    report = hunt(Logger(ur_like(np.random.default_rng(3)), seed=3, motor_inertia=np.array([2.0, 0, 0, 0, 0, 0])))
    assert ("motor_inertia", 0) in {(term.effect.id, term.joint) for term in report.hidden}
    assert not report.judged


def test_clipped_torques_and_resting_joints_are_left_out_by_name() -> None:
    logger = Logger(ur_like(np.random.default_rng(4)), seed=4)
    log = rows(logger)
    assert log.tau is not None
    most = np.quantile(np.abs(log.tau[:, 1]), 0.97)
    tau, q = log.tau.copy(), log.q.copy()
    tau[:, 1] = np.clip(tau[:, 1], -most, most)
    q[:, 5] = q[0, 5]
    report = find_missing_torque(robot_from_document(logger.arm.document()), replace(log, tau=tau, q=q))
    said = {one["code"]: one for one in to_document(report)["warnings"]}
    assert said["torque_clipped"]["joints"] == [2]
    assert said["joints_at_rest"]["joints"] == [6]
    assert not [one for one in report.judged if one.term.joint == 1]


def changed(change: Callable[[Floats], None], seed: int = 4) -> dict[str, dict[str, Any]]:
    """What is said of a log without anything hidden, its torques changed; nothing may be named."""
    logger = Logger(ur_like(np.random.default_rng(seed)), seed=seed)
    log = rows(logger)
    assert log.tau is not None
    change(log.tau)
    document = to_document(find_missing_torque(robot_from_document(logger.arm.document()), log))
    assert document["effects"] == []
    return {one["code"]: one for one in document["warnings"]}


def test_a_push_is_left_out_and_not_named() -> None:
    def push(tau: Floats) -> None:
        tau[2300:2450, 1] += 25.0
        tau[7000:7150, 2] -= 12.0

    assert "83" in changed(push)["log_pushed"]["message"]


def test_torques_of_another_clock_are_said_to_be() -> None:
    def shift(tau: Floats) -> None:
        tau[:] = np.roll(tau, 20, axis=0)

    assert 0.1 < changed(shift)["torque_clock"]["delay_s"] < 0.25


def test_swapped_joints_are_said_to_be_unexplained() -> None:
    def swap(tau: Floats) -> None:
        tau[:, [1, 2]] = tau[:, [2, 1]]

    assert set(changed(swap)["torques_unexplained"]["joints"]) & {2, 3}


def test_a_torque_of_the_other_sign_is_refused() -> None:
    def turn(tau: Floats) -> None:
        tau[:, 3] *= -1.0

    with pytest.raises(ObservationError, match="tau4_nm") as refused:
        changed(turn)
    assert refused.value.code == "torque_sign"


def test_currents_without_their_mean_name_nothing() -> None:
    def centre(tau: Floats) -> None:
        tau -= tau.mean(axis=0)

    assert not changed(centre)


def test_motions_without_their_means_name_nothing() -> None:
    def centre(tau: Floats) -> None:
        for motion in np.split(tau, 6):  # of 20 s each
            motion -= motion.mean(axis=0)

    assert "torque_mean" in changed(centre)


@pytest.mark.parametrize(
    ("factor", "joints"),
    [
        (np.full(6, 1000.0), {2, 3, 4}),  # N mm
        (np.full(6, 1.0 / 9.80665), {2, 3, 4}),  # kgf m
        (np.array([1.0, 1.0, 1.0, 0.01, 0.01, 0.01]), {4}),  # of the motors of the wrist
    ],
)
def test_torques_in_another_unit_are_compared_with_the_described_masses(factor: Floats, joints: set[int]) -> None:
    def scale(tau: Floats) -> None:
        tau *= factor

    said = changed(scale)["torque_unit"]
    assert joints <= set(said["joints"]) <= {j + 1 for j in range(6) if factor[j] != 1.0}
    assert f"are {float(f'{factor[3]:.2g}'):g} times" in said["message"]


def test_masses_that_are_half_wrong_are_no_other_unit() -> None:
    logger = Logger(ur_like(np.random.default_rng(4)), seed=4)
    robot = robot_from_document(logger.arm.document())
    links = tuple(replace(link, mass=link.mass * (2.0 if k % 2 else 0.5)) for k, link in enumerate(robot.links))
    for one in (replace(robot, links=links), replace(robot, links=())):
        document = to_document(find_missing_torque(one, rows(logger)))
        assert not document["warnings"]


@pytest.mark.parametrize(("acceleration", "tilt"), [(0.5, 0.0), (2.0, 0.0), (0.0, 0.02), (0.0, 0.08)])
def test_on_a_base_that_moves_nothing_is_named(acceleration: float, tilt: float) -> None:
    logger = Logger(ur_like(np.random.default_rng(5)), seed=5)

    def rigid(q: Floats, qd: Floats, qdd: Floats) -> Floats:
        model, _ = logger.arm.pinocchio()
        data, out = model.createData(), np.empty_like(q)
        for k, row in enumerate(zip(logger.arm.motors(q), logger.arm.rates(qd), logger.arm.rates(qdd), strict=True)):
            wave = np.sin(2.0 * np.pi * 0.3 * k / (4 * logger.hz))
            pull = np.array([-acceleration * np.sign(wave), 0.0, -9.80665])
            model.gravity.linear = pin.exp3(np.array([tilt * wave, 0.0, 0.0])) @ pull
            out[k] = pin.rnea(model, data, *row)
        return out

    logger._rigid = rigid  # type: ignore[method-assign]
    assert not [one for one in to_document(hunt(logger))["effects"] if one["verdict"] != "contradicted"]


def test_one_motion_confirms_nothing() -> None:
    logger = Logger(ur_like(np.random.default_rng(7)), seed=7, motions=1, seconds=90.0)
    joint, shape = HIDDEN["gear_ripple"]
    logger.extra = [at_joint(joint, shape, 2.0)(logger)]
    report = hunt(logger)
    assert not report.unseen
    assert {one.verdict for one in report.judged} == {"provisional"}
    assert [one["code"] for one in to_document(report)["warnings"]] == ["one_motion"]


@pytest.mark.parametrize(
    ("change", "code"),
    [({"t": None}, "log_incomplete"), ({"tau": None}, "log_incomplete"), ({"t": np.zeros(1000)}, "log_clock")],
)
def test_what_is_no_log_is_refused(change: dict[str, Any], code: str) -> None:
    q = np.zeros((1000, 6))
    log = Observations(q=q, t=np.arange(1000) * 0.01, tau=np.zeros_like(q))
    with pytest.raises(ObservationError) as refused:
        find_missing_torque(robot_from_document(ur_like(np.random.default_rng(0)).document()), replace(log, **change))
    assert refused.value.code == code


def test_a_log_at_rest_and_a_log_of_a_second_are_refused() -> None:
    robot = robot_from_document(ur_like(np.random.default_rng(0)).document())
    q = np.zeros((6000, 6))
    rest = Observations(q=q, t=np.arange(6000) * 0.01, tau=np.ones_like(q))
    with pytest.raises(ObservationError, match="move for 0 s") as refused:
        find_missing_torque(robot, rest)
    assert refused.value.code == "log_at_rest"
    with pytest.raises(TooFewPosesError):
        find_missing_torque(robot, rest.select(slice(0, 100)))
