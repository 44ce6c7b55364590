"""Several campaigns of one arm: what is carried in one of them, what all of them show, and what was held out by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.motion import MotionReport, find_missing_torque, to_document
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import Extra, Floats, Logger, State, reversed_softly, ur_like
from tests.core.truth import Arm, Body

MASS_KG, CENTRE_M = 2.0, (0.02, -0.03, 0.11)


def hand(arm: Arm, mass: float = MASS_KG) -> Arm:
    """The arm with something at its flange."""
    return replace(arm, bodies=(*arm.bodies, Body(5, mass, np.array(CENTRE_M), 0.004 * np.eye(3))))


def campaigns(arms: list[Arm], extra: list[Extra] | None = None, gain: Floats | None = None) -> list[Observations]:
    """A log of each arm, all with the same friction, each with paths of its own."""
    out = []
    for session, arm in enumerate(arms):
        logger = Logger(arm, seed=3, motions=3, extra=extra or [], gain=gain)
        logger.rng = np.random.default_rng(100 + session)
        log = logger.log()
        out.append(
            Observations(
                q=log["q"], t=log["t"], tau=log["tau"], session=np.full(len(log["t"]), session, dtype=np.int64)
            )
        )
    return out


def hunt(parts: list[Observations], held: tuple[int, ...] = ()) -> MotionReport:
    robot = robot_from_document(ur_like(np.random.default_rng(3)).document())
    return find_missing_torque(robot, Observations.concatenate(parts), held=held)


def load_friction(share: float) -> Extra:
    def torque(state: State) -> Floats:
        return np.asarray(share * reversed_softly(state.qd, 0.004) * np.abs(state.rigid) * (np.arange(6) == 1))

    return torque


def test_a_weight_that_one_campaign_does_not_state_is_named_on_its_link() -> None:
    arm = ur_like(np.random.default_rng(3))
    (one,) = hunt(campaigns([arm, hand(arm)])).judged
    assert (one.term.effect.id, one.term.joint, one.term.session) == ("carried_mass", 5, 1)
    assert one.verdict in ("confirmed", "class_confirmed")
    mass = float(one.value[0])
    assert abs(mass - MASS_KG) < max(0.02 * MASS_KG, 4.0 * float(one.sigma[0]))


def with_stated_weight(gain: Floats | None = None) -> list[Observations]:
    """A campaign with nothing in the hand, and one that states what it holds."""
    arm = ur_like(np.random.default_rng(3))
    centre = (np.linalg.inv(arm.tool) @ np.append(CENTRE_M, 1.0))[:3]
    parts = campaigns([arm, hand(arm)], gain=gain)
    return [
        replace(one, payload_kg=np.full(len(one), kg), payload_com=np.tile(centre, (len(one), 1)))
        for one, kg in zip(parts, (0.0, MASS_KG), strict=True)
    ]


def test_a_weight_that_is_stated_is_not_named() -> None:
    assert not hunt(with_stated_weight()).judged


def test_a_known_weight_tells_the_gain_of_each_drive() -> None:
    """Without it, gains and masses are one number."""
    gains = np.array([1.0, 1.08, 0.95, 1.1, 1.0, 1.05])
    found = hunt(with_stated_weight(gains)).judged
    values = {one.term.joint: one for one in found if one.term.effect.id == "drive_gain"}
    assert set(values) == {1, 2, 3, 5}
    assert len(found) == len(values)
    for joint, one in values.items():
        assert abs(float(one.value[0]) - (gains[joint] - 1.0)) < 4.0 * float(one.sigma[0]) + 0.004


def test_friction_that_each_campaign_shows_by_itself_is_replicated() -> None:
    arm = ur_like(np.random.default_rng(3))
    found = {
        (one.term.effect.id, one.term.joint): one for one in hunt(campaigns([arm] * 3, [load_friction(0.06)])).judged
    }
    friction = found["load_friction", 1]
    assert friction.sessions == (True, True, True)
    assert friction.verdict == "replicated"
    assert abs(float(friction.value[0]) - 0.06) < 4.0 * float(friction.sigma[0]) + 0.004


def test_a_campaign_that_is_held_out_by_name_chooses_nothing() -> None:
    """Its torques are turned into noise: what the others show is found all the same, and is not borne out there."""
    arm = ur_like(np.random.default_rng(3))
    parts = campaigns([arm] * 3, [load_friction(0.06)])
    good = hunt(parts, held=(2,))
    assert [(one.term.effect.id, one.term.joint) for one in good.judged] == [("load_friction", 1)]
    assert good.unseen
    assert parts[2].tau is not None
    parts[2] = replace(parts[2], tau=np.random.default_rng(0).permutation(parts[2].tau))
    assert {one.verdict for one in hunt(parts, held=(2,)).judged} <= {"provisional", "contradicted"}


@pytest.mark.parametrize("again", [True, False])
def test_a_path_that_is_driven_again_is_not_an_unseen_motion(again: bool) -> None:
    logger = Logger(ur_like(np.random.default_rng(3)), seed=3, motions=1, seconds=40.0)
    parts = [logger.log()]
    if again:
        logger.rng = np.random.default_rng(3)
        logger.rng.uniform(size=12)  # those of its friction
    parts.append(logger.log() | {})
    offset = 1000.0
    rows = [Observations(q=p["q"], t=p["t"] + k * offset, tau=p["tau"]) for k, p in enumerate(parts)]
    report = hunt(rows)
    assert report.unseen is not again
    assert report.motions == (1 if again else 2)
    assert ("one_motion" in {w["code"] for w in to_document(report)["warnings"]}) is again


def test_motions_end_where_all_joints_rest() -> None:
    logger = Logger(ur_like(np.random.default_rng(3)), seed=3, motions=4, seconds=15.0)
    log = logger.log()
    q, tau, t = [], [], []
    for motion in range(4):
        own = log["motion"] == motion
        q += [log["q"][own], np.repeat(log["q"][own][-1:], 100, axis=0)]
        tau += [log["tau"][own], np.repeat(log["tau"][own][-1:], 100, axis=0)]
    rows = sum(map(len, q))
    t = np.arange(rows) * 0.01
    joined = np.concatenate(q)
    assert len(joined) == rows
    report = hunt([Observations(q=joined, t=t, tau=np.concatenate(tau))])
    assert report.motions == 4
    assert report.unseen
