"""Loads where the arm hangs: against arms whose equilibrium Pinocchio finds, with sag about and across the joints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_slopes import payload_sensitivity
from kilter_core.arm.load_wrenches import LoadChain
from kilter_core.effects import make_effect
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from tests.core.truth import JOINT_FRAME, Arm, Body, Step, some_arm, with_bodies

PASSES = 40  # of the equilibrium found here


@dataclass(frozen=True)
class Tilt(Step):
    """A small rotation (3,), rad, behind a joint."""

    vector: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def motion(self) -> Any:
        return pin.SE3(pin.exp3(np.array(self.vector)), np.zeros(3))


def given_way(arm: Arm, about: np.ndarray, across: np.ndarray) -> Arm:
    """The arm with angles ``about (n,)`` added to its joints, and rotations ``across (n, 3)`` behind them."""
    steps: list[Step] = []
    for step in arm.steps:
        if step.joint is None:
            steps.append(step)
            continue
        steps.append(replace(step, value=step.value + step.ratio * about[step.joint]))
        steps.append(Tilt("rz", vector=tuple(across[step.joint])))
    turns = [pin.exp3(w) for w in across]
    bodies = [
        Body(b.joint, b.mass, turns[b.joint] @ b.com, turns[b.joint] @ b.inertia @ turns[b.joint].T) for b in arm.bodies
    ]
    return replace(arm, steps=tuple(steps), bodies=tuple(bodies))


def hanging(arm: Arm, q: np.ndarray, soft: tuple[np.ndarray, np.ndarray], payload: tuple[float, np.ndarray]) -> Arm:
    """The arm where its loads leave it at the readings ``q (n,)``: compliances about and across the joints, rad/(N m)."""
    about, across = np.zeros(arm.n), np.zeros((arm.n, 3))
    axes = [JOINT_FRAME[arm.moving[arm.first_of(j)].axis[1]] for j in range(arm.n)]
    for _ in range(PASSES):
        torques, wrenches, _ = given_way(arm, about, across).reactions(q, payload=payload)
        about = -soft[0] * torques
        moments = -wrenches[:, 3:] * np.array([1.0, 1.0, 0.0])
        across = np.stack([F @ (c * m) for F, c, m in zip(axes, soft[1], moments, strict=True)])
    return given_way(arm, about, across)


def soft_arm(n: int, seed: int) -> tuple[Arm, Calibration, tuple[np.ndarray, np.ndarray]]:
    """A plain arm, its compliances, and the calibration that knows them."""
    rng = np.random.default_rng(seed)
    arm = replace(with_bodies(some_arm(rng, n), rng), base=pin.SE3.Identity())
    arm = replace(arm, steps=tuple(replace(step, ratio=1.0) for step in arm.steps))
    robot = robot_from_document(arm.document())
    model = RobotModel(robot, (make_effect("axial_compliance"), make_effect("radial_compliance")))
    heaviest = np.abs([arm.reactions(q)[1][:, 3:] for q in rng.uniform(-2.0, 2.0, (30, n))]).max(axis=(0, 2))
    soft = (0.02 / heaviest, 0.004 / heaviest)  # a degree about, a quarter across
    values = model.values0()
    for effect, own in zip(model.effect_slices().values(), soft, strict=True):
        values[effect] = own
    return arm, Calibration(model, values), soft


@pytest.mark.parametrize(("n", "seed"), [(3, 5), (6, 6), (7, 7)])
def test_predictions_are_those_of_the_arm_that_hangs(n: int, seed: int) -> None:
    arm, at_readings, soft = soft_arm(n, seed)
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.0, 2.0, (12, n))
    kg, place = rng.uniform(0.0, 2.0, 12), rng.uniform(-0.1, 0.1, (12, 3))
    rows = Observations(q, payload_kg=kg, payload_com=place)
    true = np.array([hanging(arm, q[k], soft, (kg[k], place[k])).poses(q[[k]])[0][0] for k in range(len(q))])
    model, values = at_readings.model, at_readings.values
    told = model.with_loads_at_values(values).predict(rows, values).position
    before = at_readings.predict(rows).position
    sag = np.linalg.norm(true - model.predict(rows, model.values0()).position, axis=1).max()
    off, was = (np.linalg.norm(found - true, axis=1).max() for found in (told, before))
    assert sag > 0.01
    assert was > 1e-4  # at the readings, by the square of the sag
    assert off < 1e-7


def test_loads_on_links_and_of_wrong_masses_are_taken_there_too() -> None:
    """A stated mass on a link is one more body; a fitted error of a mass is one the arm has."""
    arm, at_readings, soft = soft_arm(6, 9)
    rng = np.random.default_rng(9)
    q = rng.uniform(-2.0, 2.0, (8, 6))
    extra = np.zeros((8, 6, 4))
    extra[:, 3] = [1.5, 0.05, -0.02, 0.08]
    model, values = at_readings.model, at_readings.values
    hung = model.with_loads_at_values(values)
    found = hung.predict(Observations(q, link_mass=extra), values).position
    heavier = next(b for b in arm.bodies if b.joint == 3)
    whole = heavier.mass + 1.5
    com = (heavier.mass * heavier.com + 1.5 * extra[0, 3, 1:]) / whole
    other = replace(arm, bodies=tuple(Body(3, whole, com) if b is heavier else b for b in arm.bodies))
    none = (0.0, np.zeros(3))
    true = np.array([hanging(other, row, soft, none).poses(row[None])[0][0] for row in q])
    np.testing.assert_allclose(found, true, atol=2e-8, rtol=0)
    weighed = RobotModel(model.robot, (*model.effects, make_effect("load_error")))
    more = dict(zip(model.names, values, strict=True))
    given = np.array([more.get(p.name, p.value) for p in weighed.parameters])
    amounts = (1.5, *(1.5 * (extra[0, 3, 1:] - heavier.com)))
    for part, amount in zip(("mass", "moment_x", "moment_y", "moment_z"), amounts, strict=True):
        given[weighed.names.index(f"link_{part}_4")] = amount
    told = weighed.with_loads_at_values(given).predict(Observations(q), given).position
    np.testing.assert_allclose(told, true, atol=2e-7, rtol=0)  # products of two errors are left out


@pytest.mark.parametrize("sided", [False, True])
def test_what_a_payload_adds_is_asked_once_where_the_arm_hangs(sided: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes as long as the loads of a round do, and an error of the payload that is zero reads none of it."""
    arm, at_readings, soft = soft_arm(6, 12)
    more = [make_effect("payload_error", compliances=(1e-5,) * 6)]
    more += [make_effect("backlash_load")] * sided
    model = RobotModel(at_readings.model.robot, (*at_readings.model.effects, *more))
    values = np.zeros(len(model.names))
    values[: len(at_readings.values)] = at_readings.values
    rng = np.random.default_rng(12)
    rows = Observations(rng.uniform(-2.0, 2.0, (6, 6)), payload_kg=np.full(6, 1.2), payload_com=np.full((6, 3), 0.05))
    if sided:
        values[len(values) - 6 :] = 1e-12  # the arm settles once more, in the same place
    asked = []

    def counted(*given: Any) -> Any:
        asked.append(given)
        return payload_sensitivity(*given)

    monkeypatch.setattr("kilter_core.model.robot_model.payload_sensitivity", counted)
    found = model.with_loads_at_values(values).batch(rows).payload_axial
    assert found is not None
    for k, q in enumerate(rows.q):
        place = np.full(3, 0.05)
        hung = hanging(arm, q, soft, (1.2, place))
        added = [hung.reactions(q, payload=(kg, place))[0] for kg in (1.2, 2.2)]
        np.testing.assert_allclose(found[k, :, 0], added[0] - added[1], atol=3e-5, rtol=0)
    assert len(asked) == 1
    values[model.names.index("payload_mass")] = 0.1  # now every round reads it
    assert model.with_loads_at_values(values).batch(rows).payload_axial is not None
    assert len(asked) > 3


def test_a_version_keeps_where_it_hangs_and_one_of_before_its_readings() -> None:
    _, at_readings, _ = soft_arm(6, 11)
    model, values = at_readings.model, at_readings.values
    rows = Observations(np.random.default_rng(1).uniform(-2.0, 2.0, (5, 6)))
    hung = Calibration(model.with_loads_at_values(values), values)
    document = hung.to_document()
    again = Calibration.from_document(model.robot, document)
    np.testing.assert_array_equal(again.predict(rows).position, hung.predict(rows).position)
    del document["load_chain"]["effects"]
    old = Calibration.from_document(model.robot, document)
    assert isinstance(old.model.load_chain, LoadChain)
    np.testing.assert_allclose(old.predict(rows).position, at_readings.predict(rows).position, atol=1e-12, rtol=0)
