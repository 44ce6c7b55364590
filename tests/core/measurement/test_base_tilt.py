"""An inclinometer on the base beside the tool: it tells a mount that deflects from the first joints. Pinocchio measures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.gap import find_gap
from kilter_core.gap.options import GapOptions
from kilter_core.identify import Folds, Identification, IdentifyOptions, identify
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.procedures.inclinometers import Log
from tests.core.truth import Body, ur10

Floats = NDArray[np.float64]
ARM = replace(ur10(), bodies=tuple(Body(j, 3.0, np.array([-0.2, 0.02, 0.05])) for j in range(6)))
MOUNT = np.array([1.2e-5, 0.8e-5])  # rad/(N m) about x and y of the base
READ_RAD = 5e-6
GEAR, BEARING = {"id": "axial_compliance", "joints": [2]}, {"id": "radial_compliance", "joints": [1]}
# What nods the arm beside its mount: the gear of joint 2 or the bearing of joint 1, rad/(N m).
CASES = {"compliance_2": (GEAR, 2e-5), "radial_compliance_1": (BEARING, 0.9e-5)}


def campaign(
    name: str = "compliance_2", rows: int = 60, noise_m: float = 1e-4, again: int = 0, seed: int = 5
) -> tuple[Observations, Floats]:
    """Poses on a mount that tilts under an arm that yields too; and readings (N, 7, 3), the base last."""
    gear, bearing = (CASES[name][1] * (name == own) for own in CASES)
    rng = np.random.default_rng(seed)
    q = np.array([0.0, -1.2, 1.4, -0.6, 0.9, 0.2]) + rng.uniform(-1.0, 1.0, (rows, 6))
    q = np.concatenate([q, q[:again]])
    position, tilt = np.empty((len(q), 3)), np.empty((len(q), 2))
    for k, row in enumerate(q):
        torque, wrench, root = ARM.reactions(row)
        bent = row.copy()
        bent[1] -= gear * torque[1]
        tilted = pin.exp3(np.append(-bearing * wrench[0, 3:5], 0.0))
        tilt[k] = -MOUNT * root[3:5]
        turn = pin.exp3(row[0] * np.array([0.0, 0.0, 1.0]))
        up = np.array([0.0, 0.0, ARM.steps[0].value]) if ARM.steps[0].axis == "tz" else np.zeros(3)
        arm = turn @ tilted @ turn.T @ (ARM.poses(bent[None])[0][0] - up) + up
        position[k] = pin.exp3(np.append(tilt[k], 0.0)) @ arm
    reading = np.full((len(q), 7, 3), np.nan)
    reading[:, 6, :2] = tilt + 0.03 + rng.normal(0.0, READ_RAD, tilt.shape)
    return Observations(q, position=position + rng.normal(0.0, noise_m, position.shape)), reading


def found(name: str, rows: Observations, validation: Folds | None = None) -> Identification:
    options = IdentifyOptions(effects=("base_compliance", CASES[name][0]), masses="as_stated")  # they are exact here
    return identify(robot_from_document(ARM.document()), rows, validation, options)


def values(result: Identification) -> dict[str, tuple[float, float]]:
    at = dict(zip(result.calibration.names, result.calibration.values, strict=True))
    return {n: (at[n], sigma) for n, sigma in zip(result.fit.names, result.fit.sigma, strict=True) if "compl" in n}


@pytest.mark.parametrize("name", CASES)
def test_the_base_tells_its_mount_from_the_first_joints(name: str) -> None:
    rows, reading = campaign(name)
    both, alone = found(name, replace(rows, tilt=reading), Folds(3)), values(found(name, rows))
    told = values(both)
    true = {"base_compliance_x": MOUNT[0], "base_compliance_y": MOUNT[1], name: CASES[name][1]}
    assert told.keys() == true.keys()
    for each, value in true.items():
        assert abs(told[each][0] - value) < 3.5 * told[each][1], each
        assert told[each][1] < 0.15 * alone[each][1], each
    document = both.to_document()
    levels = next(row for row in document["measurements"] if row["kind"] == "inclination")
    assert {"base_compliance_x", "base_compliance_y"} <= set(levels["tells_alone"])
    assert levels["numbers"] == 2 * 60 - 2
    assert levels["noise"] == pytest.approx(np.degrees(READ_RAD), rel=0.2)
    assert levels["validation"]["identified"] == pytest.approx(np.degrees(READ_RAD), rel=0.2)


def test_the_result_says_what_is_known_because_of_the_base() -> None:
    rows, reading = campaign(noise_m=3e-4)
    document = found("compliance_2", replace(rows, tilt=reading)).to_document()
    levels = next(row for row in document["measurements"] if row["kind"] == "inclination")
    assert {"base_compliance_x", "base_compliance_y"} <= set(levels["known_because_of_it"])
    assert levels["sharpens"]["compliance_2"] > 4.0


def test_the_derivative_of_the_base_is_that_of_differences() -> None:
    rows, reading = campaign(rows=8)
    effects = IdentifyOptions(effects=("base_compliance", GEAR)).make_effects()
    model = Calibration.nominal(robot_from_document(ARM.document()), effects).model
    measurement = Measurement.from_observations(replace(rows, tilt=reading))
    at = model.values0() + 1e-6
    block = measurement.residual(*model.jacobian(rows, at, None, True, True)).blocks[1]
    assert block.J is not None
    for k, name in enumerate(model.names):
        ahead, behind = at.copy(), at.copy()
        ahead[k], behind[k] = at[k] + 1e-5, at[k] - 1e-5
        sides = [measurement.residual(model.predict(rows, v)).blocks[1].r for v in (ahead, behind)]
        slope = (sides[1] - sides[0]) / 2e-5
        seen = ~np.isnan(slope)
        np.testing.assert_allclose(block.J[..., k][seen], slope[seen], rtol=1e-6, atol=1e-8, err_msg=name)


def test_campaigns_with_and_without_the_base_go_together() -> None:
    rows, reading = campaign()
    joints = np.full((60, 6, 3), np.nan)
    joints[:, 0, 0] = 0.0
    first = replace(rows.select(slice(0, 30)), tilt=joints[:30])
    second = replace(rows.select(slice(30, 60)), position=None, tilt=reading[30:])
    together = Observations.concatenate([first, second])
    assert together.tilt is not None
    assert together.tilt.shape == (60, 7, 3)
    assert np.array_equal(np.isnan(together.tilt[:, 6, 0]), np.arange(60) < 30)
    assert np.array_equal(np.isnan(together.tilt[:, 0, 0]), np.arange(60) >= 30)


def test_readings_of_the_base_measure_no_joint() -> None:
    rows, reading = campaign(rows=8)
    with pytest.raises(ObservationError, match="of the base alone"):
        Log.from_observations(replace(rows, tilt=reading), 1e-5)


CANDIDATES = ("base_compliance", "axial_compliance", "radial_compliance", "encoder_scale", "eccentricity")


def report(rows: Observations) -> dict[str, Any]:
    robot = robot_from_document(ARM.document())
    return find_gap(robot, rows, GapOptions(permutations=30, effects=CANDIDATES)).to_document()


def named(document: dict[str, Any]) -> set[tuple[str, tuple[int, ...]]]:
    return {(effect["id"], tuple(effect["joints"] or ())) for effect in document["effects"]}


def test_a_search_names_the_mount_and_not_the_joint() -> None:
    rows, reading = campaign("radial_compliance_1", rows=120, again=40, seed=0)
    both, alone = report(replace(rows, tilt=reading)), report(rows)
    hidden = {("base_compliance", ()), ("radial_compliance", (1,))}
    assert named(both) == hidden, named(both)
    assert named(alone) != hidden, named(alone)
    assert both["verdict"] == "closed"
    assert both["adequacy"]["lack_of_fit_f"] == pytest.approx(1.0, abs=0.4)  # cells without a reading repeat nothing
