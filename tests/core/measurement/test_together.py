"""Link-side encoders, inclinometers and the tool in one fit, on an arm that Pinocchio measures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import Folds, Identification, IdentifyOptions, identify
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.truth import Body, ur10

Floats = NDArray[np.float64]
ARM = replace(ur10(), bodies=tuple(Body(j, 3.0, np.array([-0.2, 0.02, 0.05])) for j in range(6)))
AXIAL, RADIAL = 2e-5, 1e-5  # rad/(N m): gears 2 and 3 about their axes, the bearing of joint 1 across it
JOINT_RAD = 5e-6
EFFECTS = ({"id": "axial_compliance", "joints": [2, 3]}, {"id": "radial_compliance", "joints": [1]})
ASKED = IdentifyOptions(effects=EFFECTS, masses="as_stated")  # the masses of the truth are exact
BENDS = {"compliance_2", "compliance_3", "radial_compliance_1"}


def campaign(rows: int = 60, seed: int = 0, noise_m: float = 1e-4, again: int = 0) -> tuple[Observations, Floats]:
    """Poses whose gears yield and whose first bearing tilts: both nod the arm. Rows, and readings (N, 6, 3) of the tilts."""
    rng = np.random.default_rng(seed)
    q = np.array([0.0, -1.2, 1.4, -0.6, 0.9, 0.2]) + rng.uniform(-1.0, 1.0, (rows, 6))
    q, rows = np.concatenate([q, q[:again]]), rows + again
    reactions = [ARM.reactions(row) for row in q]
    bent = q.copy()
    bent[:, 1:3] -= AXIAL * np.array([torque for torque, _, _ in reactions])[:, 1:3]
    tilt = -RADIAL * np.array([wrench[0, 3:5] for _, wrench, _ in reactions])
    position = np.empty((rows, 3))
    for k, (p, w) in enumerate(zip(ARM.poses(bent)[0], tilt, strict=True)):
        turn = pin.exp3(bent[k, 0] * np.array([0.0, 0.0, 1.0]))
        position[k] = turn @ pin.exp3(np.append(w, 0.0)) @ turn.T @ p
    # Encoders on the links: behind the gears, each with a zero of its own.
    link = bent + 0.01 * np.arange(6) + rng.normal(0.0, JOINT_RAD, q.shape)
    seen = position + rng.normal(0.0, noise_m, position.shape)
    reading = np.full((rows, 6, 3), np.nan)
    reading[:, 0, :2] = tilt + 0.02 + rng.normal(0.0, JOINT_RAD, tilt.shape)
    return Observations(q, position=seen, link_q=link), reading


def found(rows: Observations, options: IdentifyOptions = ASKED, validation: Folds | None = None) -> Identification:
    return identify(robot_from_document(ARM.document()), rows, validation, options)


def kind(result: Identification, name: str) -> dict:  # type: ignore[type-arg]
    return next(row for row in result.to_document()["measurements"] if row["kind"] == name)


def values(result: Identification) -> dict[str, tuple[float, float]]:
    at = dict(zip(result.calibration.names, result.calibration.values, strict=True))
    return {n: (at[n], sigma) for n, sigma in zip(result.fit.names, result.fit.sigma, strict=True) if n in BENDS}


def test_together_they_tell_what_each_alone_cannot_and_the_report_names_it() -> None:
    rows, _ = campaign(noise_m=2e-3)
    both, tool = found(rows).to_document(), found(replace(rows, link_q=None))
    assert not {p["name"] for p in tool.to_document()["parameters"] if p["identifiable"]} >= BENDS
    of_tool, of_links = both["measurements"]
    assert (of_tool["kind"], of_links["kind"]) == ("points", "link_encoders")
    assert {"compliance_2", "radial_compliance_1"} <= set(of_links["known_because_of_it"])
    assert of_links["sharpens"]["compliance_3"] > 100.0
    assert set(of_links["tells_alone"]) == {"compliance_2", "compliance_3"}  # no geometry, no tilt of a bearing
    assert "radial_compliance_1" in of_tool["known_because_of_it"]
    assert both["known_together"] == ["radial_compliance_1"]


def test_each_kind_has_its_own_noise_and_the_truth_is_found() -> None:
    rows, _ = campaign()
    both, alone = values(result := found(rows)), values(found(replace(rows, link_q=None)))
    true = {"compliance_2": AXIAL, "compliance_3": AXIAL, "radial_compliance_1": RADIAL}
    for name, value in true.items():
        assert abs(both[name][0] - value) < 3.5 * both[name][1]
        assert both[name][1] < 0.15 * alone[name][1]
    of_tool, of_links = kind(result, "points"), kind(result, "link_encoders")
    assert of_tool["noise"] == pytest.approx(0.1, rel=0.25)
    assert of_links["noise"] == pytest.approx(np.degrees(JOINT_RAD), rel=0.1)
    assert (of_tool["unit"], of_links["unit"]) == ("mm", "deg")


def test_errors_of_each_kind_on_poses_held_out() -> None:
    result = found(campaign()[0], validation=Folds(4))
    links = kind(result, "link_encoders")
    held = links["validation"]
    assert held["identified"] == pytest.approx(np.degrees(JOINT_RAD), rel=0.15)
    assert held["registration_only"] > 20.0 * held["identified"]
    assert kind(result, "points")["validation"]["identified"] < 0.3
    assert links["numbers"] == 6 * 60 - 6


def test_inclinometers_beside_the_tool_tell_the_tilt_of_a_bearing() -> None:
    rows, reading = campaign(noise_m=2e-3)
    result = found(replace(rows, link_q=None, tilt=reading))
    levels = kind(result, "inclination")
    assert "radial_compliance_1" in levels["tells_alone"]
    at, sigma = values(result)["radial_compliance_1"]
    assert abs(at - RADIAL) < 3.5 * sigma
    assert sigma < 0.01 * RADIAL
    assert levels["noise"] == pytest.approx(np.degrees(JOINT_RAD), rel=0.2)


def test_rows_may_have_some_of_the_readings_only() -> None:
    rows, reading = campaign(120)
    position, link, tilt = rows.position.copy(), rows.link_q.copy(), reading.copy()  # type: ignore[union-attr]
    position[:40] = np.nan
    link[40:80] = np.nan
    tilt[80:] = np.nan
    mixed = values(result := found(replace(rows, position=position, link_q=link, tilt=tilt), validation=Folds(3)))
    for name, value in {"compliance_2": AXIAL, "compliance_3": AXIAL, "radial_compliance_1": RADIAL}.items():
        assert abs(mixed[name][0] - value) < 3.5 * mixed[name][1]
    assert kind(result, "points")["numbers"] == 240
    assert kind(result, "inclination")["numbers"] == 2 * 80 - 2


def test_campaigns_that_measured_different_things_are_fitted_together() -> None:
    rows, _ = campaign(120)
    first = replace(rows.select(slice(0, 60)), link_q=None)
    second = replace(rows.select(slice(60, 120)), position=None)
    together = Observations.concatenate([first, second])
    apart = values(found(together))
    assert abs(apart["compliance_2"][0] - AXIAL) < 3.5 * apart["compliance_2"][1]
    assert apart["compliance_2"][1] < 0.01 * AXIAL


def test_an_encoder_that_is_referenced_anew_says_the_same() -> None:
    rows, _ = campaign()
    session = (np.arange(60) >= 30).astype(np.int64)
    moved = replace(rows, session=session, link_q=rows.link_q + 0.05 * session[:, None])  # type: ignore[operator]
    assert values(found(moved))["compliance_2"][0] == pytest.approx(AXIAL, rel=0.01)


def test_derivatives_of_what_the_joints_turn_are_those_of_differences() -> None:
    rows, reading = campaign(8)
    robot = robot_from_document(ARM.document())
    model = Calibration.nominal(robot, IdentifyOptions(effects=(*EFFECTS, "load_error")).make_effects()).model
    measurement = Measurement.from_observations(replace(rows, tilt=reading))
    at = model.values0() + 1e-6
    prediction, J = model.jacobian(rows, at, None, True, True)
    residual = measurement.residual(prediction, J)
    for k, name in enumerate(model.names):
        if name in BENDS or name.startswith("link"):
            step = 1e-6 * model.parameters[k].prior_sigma
            sides = []
            for way in (1.0, -1.0):
                moved = at.copy()
                moved[k] += way * step
                sides.append(measurement.residual(model.predict(rows, moved)).blocks[1:])
            for block, ahead, behind in zip(residual.blocks[1:], *sides, strict=True):
                slope = (behind.r - ahead.r) / (2.0 * step)
                seen = ~np.isnan(slope)
                np.testing.assert_allclose(block.J[..., k][seen], slope[seen], rtol=2e-3, atol=1e-9)  # type: ignore[index]
