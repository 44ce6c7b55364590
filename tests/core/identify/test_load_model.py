"""Which masses the data could see, and what is said of those that the data pull far from what was stated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from kilter_core.arm.robot import Robot
from kilter_core.effects import make_effect
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.report.report import GapReport
from kilter_core.identify import Identification, IdentifyOptions, identify
from kilter_core.identify.identifiability import load_rows
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from tests.core.gap.simulated import campaign, katana

COMPLIANCE = ("axial_compliance", (1, 2, 3), (6e-5, 6e-5, 9e-5))
HEAVIER_KG, FURTHER_M = 0.4, 0.02
QUICK = GapOptions(effects=("axial_compliance", "backlash"), resamples=10, permutations=5, bootstraps=499, next_poses=0)


def stated(robot: Robot, sigma_kg: float) -> Robot:
    """The arm with masses known to ``sigma_kg`` and centres to 1 mm per 10 g of it."""
    links = (replace(link, mass_sigma=sigma_kg, com_sigma=0.1 * sigma_kg) for link in robot.links)
    return replace(robot, links=tuple(links), payload_sigma=(0.1 * sigma_kg, 0.1 * sigma_kg))


def believed(robot: Robot, sigma_kg: float) -> Robot:
    """The arm as its user describes it: link 3 lighter by ``HEAVIER_KG``, its centre ``FURTHER_M`` too near."""
    link = robot.links[2]
    wrong = replace(link, mass=link.mass - HEAVIER_KG, com=link.com - [FURTHER_M, 0.0, 0.0])
    return stated(replace(robot, links=(*robot.links[:2], wrong, *robot.links[3:])), sigma_kg)


@cache
def rows() -> Observations:
    return campaign(katana(), [COMPLIANCE], poses=150, revisits=20, noise_m=1e-6, seed=4)


@cache
def identified(sigma_kg: float) -> Identification:
    effects = ({"id": "axial_compliance", "joints": [2, 3, 4]}, "load_error")
    return identify(believed(katana(), sigma_kg), rows(), options=IdentifyOptions(effects=effects))


@cache
def hunted(sigma_kg: float) -> GapReport:
    return find_gap(believed(katana(), sigma_kg), rows(), QUICK)


def of_link(document: list[dict], link: int | None, parameter: str) -> dict:
    return next(row for row in document if (row["link"], row["parameter"]) == (link, parameter))


def test_rows_say_stated_found_and_seen_in_the_units_of_the_robot_document() -> None:
    robot = believed(katana(), 0.3)
    model = RobotModel(robot, (make_effect("load_error", payload_kg=2.0),))
    values = model.values0()
    names = model.names[model.n_geometric :]
    for name, value in {
        "link_mass_3": 0.1,
        "link_moment_x_3": 0.01,
        "load_payload_mass": 0.2,
        "load_payload_x": 3e-3,
    }.items():
        values[model.names.index(name)] = value
    prior = np.array([model.parameter(name).prior_sigma for name in names])
    sigma = np.where(np.char.find(np.array(names), "_mass_3") > 0, 0.4, 0.6) * prior
    found = load_rows(Calibration(model, values), names, sigma, prior)
    assert len(found) == len(names)
    mass, centre, link = of_link(found, 3, "mass"), of_link(found, 3, "com_x"), robot.links[2]
    assert mass == pytest.approx(
        {"link": 3, "parameter": "mass", "unit": "kg", "stated": link.mass, "value": link.mass + 0.1, "sigma": 0.12,
         "prior_sigma": 0.3, "seen": True}
    )  # fmt: skip
    assert centre["unit"] == "mm"
    assert centre["stated"] == pytest.approx(1e3 * link.com[0])
    assert centre["value"] == pytest.approx(1e3 * (link.com[0] + 0.01 / (link.mass + 0.1)))
    assert centre["prior_sigma"] == pytest.approx(30.0)
    assert not centre["seen"]
    payload, place = of_link(found, None, "mass"), of_link(found, None, "shift_x")
    assert (payload["stated"], payload["value"]) == pytest.approx((2.0, 2.2))
    assert (place["stated"], place["value"], place["prior_sigma"]) == pytest.approx((0.0, 3.0, 30.0))
    assert load_rows(Calibration(model, values), ("link_mass_3",), sigma[:1], prior[:1])[0]["parameter"] == "mass"


def test_a_hunt_that_names_no_effect_of_the_load_says_nothing_of_masses() -> None:
    plain = campaign(katana(), [("backlash", (1,), (6e-4,))], seed=3)
    assert find_gap(katana(), plain, QUICK).to_document()["load_model"] == []


@pytest.mark.parametrize("find", [identified, hunted])
def test_masses_that_the_data_see_are_told_from_those_they_do_not(find) -> None:
    """Of a mass and a compliance the data know the product; of the ratio of masses, what no compliance imitates."""
    document = find(0.3).to_document()
    found = document["load_model"]
    assert any(row["seen"] for row in found)
    assert not of_link(found, 2, "com_z")["seen"]  # along the axis of its joint: no load about it
    for row in found:
        assert row["seen"] == (row["sigma"] <= 0.5 * row["prior_sigma"])
    assert "mass_far_from_stated" not in {w["code"] for w in document["warnings"]}


@pytest.mark.parametrize("find", [identified, hunted])
def test_a_mass_far_from_stated_is_a_warning_and_its_remedy_ends_it(find) -> None:
    (said,) = [w for w in find(0.01).to_document()["warnings"] if w["code"] == "mass_far_from_stated"]
    assert "mass_kg" in said["message"]
    assert said["masses"]
    right = stated(katana(), 0.01)
    if find is identified:
        effects = ({"id": "axial_compliance", "joints": [2, 3, 4]}, "load_error")
        again = identify(right, rows(), options=IdentifyOptions(effects=effects)).to_document()
    else:
        again = find_gap(right, rows(), QUICK).to_document()
    assert "mass_far_from_stated" not in {w["code"] for w in again["warnings"]}
