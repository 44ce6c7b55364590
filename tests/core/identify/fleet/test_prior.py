"""Which versions make a prior, what it does for a few poses, and what an arm does that is not as its type."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import CoreError, OptionError
from kilter_core.identify import Folds, Identification, IdentifyOptions, identify
from kilter_core.identify.fleet_prior import FleetVersion, same_type
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.plan.d_optimal import d_optimal_poses
from tests.core.identify.fleet.simulated import Arm, Type, document, poses

Floats = NDArray[np.float64]
NOISE = 5e-5
FLEET = IdentifyOptions(prior="fleet")


@dataclass(frozen=True)
class Fleet:
    kind: Type
    versions: list[FleetVersion]
    rng: np.random.Generator


def version_of(arm: Arm, name: str, rng: np.random.Generator, options: IdentifyOptions | None = None) -> FleetVersion:
    found = identify(robot_from_document(document()), arm.measured(poses(50, rng), rng, NOISE), options=options)
    return FleetVersion.from_calibration(name, f"ver_{name}", found.calibration, found.predictive.to_document())


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    rng = np.random.default_rng(30)
    kind = Type.drawn(rng)
    return Fleet(kind, [version_of(kind.arm(rng), f"r{k}", rng) for k in range(8)], rng)


def error_mm(found: Identification, arm: Arm) -> float:
    q = poses(300, np.random.default_rng(9))
    away = found.calibration.predict(Observations(q)).position - arm.points(q)
    return 1e3 * float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


def fitted(arm: Arm, rows: Observations, fleet: Fleet, options: IdentifyOptions = FLEET, **more: Any) -> Identification:
    return identify(robot_from_document(document()), rows, options=options, fleet=fleet.versions, **more)


def test_ten_poses_are_enough_where_there_are_too_few_without(fleet: Fleet) -> None:
    rng, errors = np.random.default_rng(1), []
    for _ in range(4):
        arm = fleet.kind.arm(rng)
        rows = arm.measured(poses(10, rng), rng, NOISE)
        with pytest.raises(CoreError, match="at least 12 poses"):
            identify(robot_from_document(document()), rows)
        errors.append(error_mm(fitted(arm, rows, fleet), arm))
    assert np.median(errors) < 0.25


def test_the_result_says_what_rests_on_the_prior(fleet: Fleet) -> None:
    rng = np.random.default_rng(2)
    arm = fleet.kind.arm(rng)
    few, many = (fitted(arm, arm.measured(poses(n, rng), rng, NOISE), fleet).to_document() for n in (8, 40))
    resting = [{row["name"] for row in told["parameters"] if row["from_prior"]} for told in (few, many)]
    assert len(resting[0]) > len(resting[1])
    assert resting[0] == set(few["prior"]["parameters"])
    assert few["prior"]["source"] == "fleet"
    assert [one["robot"] for one in few["prior"]["versions"]] == [f"r{k}" for k in range(8)]
    assert "d_1" not in resting[0]  # where the base is free no arm of the type could tell it
    assert not any(name.startswith(("base_", "tool_")) for name in resting[0])


def test_an_arm_is_called_odd_only_where_fewer_than_half_of_its_type_are_as_odd(fleet: Fleet) -> None:
    rng, seen = np.random.default_rng(21), set()
    for shift in (0.0, 0.0, 0.0, 1.2, 1.2, 1.2):
        arm = fleet.kind.arm(rng, shift)
        prior = fitted(arm, arm.measured(poses(14, rng), rng, NOISE), fleet).to_document()["prior"]
        if prior["state"] == "widened" and prior["widened_by"] / prior["limited_by"] >= 1.05:
            odd = "odder than most" in prior["sentence"]
            assert odd == (prior["p_value"] < 0.5), prior["sentence"]
            assert f"count {prior['widened_by']:.2g} times" in prior["sentence"]
            seen.add(odd)
    assert seen == {True, False}


def test_each_robot_is_predicted_by_the_others(fleet: Fleet) -> None:
    arm = fleet.kind.arm(fleet.rng)
    found = fitted(arm, arm.measured(poses(14, fleet.rng), fleet.rng, NOISE), fleet)
    assert found.fleet is not None
    out = found.fleet.left_one_out
    assert [one.robot for one in out] == [f"r{k}" for k in range(8)]
    assert min(one.p_value for one in out) > 1e-3
    assert np.mean([one.chi_square / one.compared for one in out]) == pytest.approx(1.0, abs=0.8)


@pytest.mark.parametrize("count", [12, 20])
def test_an_arm_ten_spreads_off_is_no_worse_than_without(fleet: Fleet, count: int) -> None:
    rng = np.random.default_rng(count)
    arm = fleet.kind.arm(rng, shift=10.0)
    rows = arm.measured(poses(count, rng), rng, NOISE)
    found = fitted(arm, rows, fleet)
    assert error_mm(found, arm) <= 1.05 * error_mm(identify(robot_from_document(document()), rows), arm)
    told = found.to_document()
    assert told["prior"]["state"] == "dropped"
    assert told["prior"]["p_value"] < 0.01
    assert "fleet_prior_dropped" in {one["code"] for one in told["warnings"]}
    assert not any(row.get("from_prior") for row in told["parameters"])


def test_one_zero_that_was_moved_is_left_to_the_rows(fleet: Fleet) -> None:
    rng = np.random.default_rng(4)
    arm = fleet.kind.arm(rng)
    arm.errors[2, 0] += np.radians(1.0)
    found = fitted(arm, arm.measured(poses(14, rng), rng, NOISE), fleet)
    assert found.fit.prior_use is not None
    assert found.fit.prior_use.odd[:1] == ("theta_offset_3",)
    zero = next(row for row in found.to_document()["parameters"] if row["name"] == "theta_offset_3")
    assert zero["value"] == pytest.approx(np.degrees(arm.errors[2, 0]), abs=0.06)


def test_an_odd_arm_of_too_few_poses_is_refused(fleet: Fleet) -> None:
    rng = np.random.default_rng(5)
    arm = fleet.kind.arm(rng, shift=10.0)
    with pytest.raises(CoreError, match=r"not as its type.*measure more poses") as refused:
        fitted(arm, arm.measured(poses(10, rng), rng, NOISE), fleet)
    assert refused.value.code == "fleet_conflict"


def test_four_robots_are_too_few(fleet: Fleet) -> None:
    arm = fleet.kind.arm(fleet.rng)
    rows = arm.measured(poses(14, fleet.rng), fleet.rng, NOISE)
    with pytest.raises(CoreError, match="at least 5 other robots of this type, and there are 4") as refused:
        fitted(arm, rows, replace(fleet, versions=fleet.versions[:4]))
    assert refused.value.code == "fleet_too_few"


def held_tool(fleet: Fleet) -> FleetVersion:
    return version_of(fleet.kind.arm(fleet.rng), "held", fleet.rng, IdentifyOptions(fix=("a_4",)))


def in_other_units(fleet: Fleet) -> FleetVersion:
    one = fleet.versions[0]
    gauge = replace(one.gauge, units={**one.gauge.units, "d_2": "rad"})
    return replace(one, robot="turned", version="ver_turned", gauge=gauge)


@pytest.mark.parametrize(
    ("other", "says"), [(held_tool, "a_4 was not fitted there"), (in_other_units, "d_2 is in rad there and in m here")]
)
def test_versions_of_another_gauge_are_refused_by_name(
    fleet: Fleet, other: Callable[[Fleet], FleetVersion], says: str
) -> None:
    arm, odd = fleet.kind.arm(fleet.rng), other(fleet)
    rows = arm.measured(poses(14, fleet.rng), fleet.rng, NOISE)
    with pytest.raises(CoreError, match=says) as refused:
        fitted(arm, rows, replace(fleet, versions=[*fleet.versions[:4], odd]))
    assert refused.value.code == "fleet_gauge"
    assert odd.robot in refused.value.message
    assert "Identify those robots with the same effects" in refused.value.message
    beside = fitted(arm, rows, replace(fleet, versions=[*fleet.versions[:5], odd])).to_document()
    assert [one["robot"] for one in beside["prior"]["left_out"]] == [odd.robot]
    assert "fleet_version_left_out" in {one["code"] for one in beside["warnings"]}


def test_a_fit_with_the_base_held_is_another_gauge(fleet: Fleet) -> None:
    arm = replace(fleet.kind.arm(fleet.rng), base=np.eye(4))
    rows = arm.measured(poses(14, fleet.rng), fleet.rng, NOISE)
    with pytest.raises(CoreError, match="the base was fitted there and is held here"):
        fitted(arm, rows, fleet, replace(FLEET, base="fixed"))


@pytest.mark.parametrize("more", [{"method": "kalman"}, {"tilt_first": True}, {"prior": "cousins"}])
def test_a_prior_goes_with_least_squares_alone(more: dict[str, Any]) -> None:
    with pytest.raises(OptionError, match=r"prior|Prior"):
        IdentifyOptions(**{"prior": "fleet", **more})


def test_folds_take_the_prior_too(fleet: Fleet) -> None:
    rng = np.random.default_rng(6)
    arm = fleet.kind.arm(rng)
    rows = arm.measured(poses(12, rng), rng, NOISE)
    found = fitted(arm, rows, fleet, validation=Folds(4))  # nine poses each: too few without
    assert found.metrics["validation"]["identified"]["rms_mm"] < 0.6


def test_the_type_is_the_chain_and_not_where_an_arm_stands() -> None:
    one, other = document("one"), document("other")
    other["tool"]["x_mm"] = 12.0
    other["joints"][0]["limits_deg"] = [-90, 90]
    assert same_type(robot_from_document(one), robot_from_document(other))
    other["rows"][2]["a_mm"] += 0.1
    assert not same_type(robot_from_document(one), robot_from_document(other))


def test_planned_poses_leave_alone_what_the_type_tells(fleet: Fleet) -> None:
    start = Calibration.nominal(robot_from_document(document()))
    plain, known = (d_optimal_poses(start, 9, seed=1, fleet=asked).q for asked in (None, fleet.versions))
    assert not np.array_equal(plain, known)
    rng, errors = np.random.default_rng(11), []
    for _ in range(4):
        arm = fleet.kind.arm(rng)
        errors.append([error_mm(fitted(arm, arm.measured(q, rng, NOISE), fleet), arm) for q in (plain, known)])
    assert np.mean(errors, axis=0)[1] < 0.2
    with pytest.raises(CoreError, match="at least 5 other robots") as refused:
        d_optimal_poses(start, 9, fleet=fleet.versions[:4])
    assert refused.value.code == "fleet_too_few"
