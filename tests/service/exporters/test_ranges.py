"""Ranges and draws of a version: MuJoCo poses each drawn arm, and held-out readings of an arm of plain numpy judge them."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import OptionError
from kilter_core.identify import FleetVersion, identify
from kilter_core.parameters import FittedNumber, draw_ranges, write_json_for_yaml
from kilter_service.contract.fits import Covariance
from kilter_service.ground.errors import ServiceError
from kilter_service.robots.exporters.exportable import Exportable
from kilter_service.robots.exporters.registry import export
from tests.core.identify.fleet.simulated import Arm, Floats, Type, document, poses
from tests.service.exporters.test_exporters import exportable

NOISE = 5e-5


def fitted(arm: Arm, rng: np.random.Generator, count: int = 40) -> tuple[Exportable, dict[str, Any]]:
    """A version of an arm, and its covariance."""
    found = identify(robot_from_document(document()), arm.measured(poses(count, rng), rng, NOISE))
    known = found.predictive.to_document()
    version = exportable(document(), found.calibration)
    held = version.version.model_copy(update={"covariance": Covariance(**known)})
    return dataclasses.replace(version, version=held), known


def tool_points(text: str, numbers: dict[str, Any], q: Floats) -> Floats:
    """Where the tool is (N, 3) m at joints (N, 6) in the exported model with the numbers of a draw."""
    spec = mujoco.MjSpec.from_string(text)
    for key, value in numbers.items():
        body, _, attribute = key.rpartition(".")
        {"pos_m": "pos", "quat_wxyz": "quat"}[attribute]
        setattr(spec.body(body), attribute.partition("_")[0], value)
    model = spec.compile()
    data = mujoco.MjData(model)
    out = np.empty((len(q), 3))
    for k, row in enumerate(q):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        out[k] = data.site("tool").xpos
    return out


def coverage(seed: int, count: int, draws: int) -> float:
    rng = np.random.default_rng(seed)
    arm = Type.drawn(rng).arm(rng)
    version, _ = fitted(arm, rng, count)
    found, text = json.loads(str(export("ranges", version).text)), str(export("mjcf", version).text)
    q = poses(60, rng)
    measured = arm.measured(q, rng, NOISE).position
    assert measured is not None
    base = np.array(version.document["wanted_base"])
    points = np.array([tool_points(text, one, q) for one in found["arm"]["model_draws"][:draws]])
    seen = points @ base[:3, :3].T + base[:3, 3]
    half = 1.96 * np.hypot(seen.std(axis=0), found["tool_sigma_m"])
    return float(np.mean(np.abs(measured - seen.mean(axis=0)) <= half))


def test_draws_cover_held_out_poses() -> None:
    assert np.mean([coverage(seed, 40, 30) for seed in range(10)]) == pytest.approx(0.95, abs=0.015)


def test_ranges_are_read_as_json_and_as_yaml_and_leave_the_gauge() -> None:
    rng = np.random.default_rng(3)
    arm = Type.drawn(rng).arm(rng)
    version, known = fitted(arm, rng)
    written = export("ranges", dataclasses.replace(version, ranges_percent=80.0))
    found = json.loads(str(written.text))
    assert yaml.safe_load(str(written.text)) == found
    assert written.name == "arm-ver_1a.ranges.json"
    assert "type" not in found
    assert any("0 have a version" in note for note in written.notes)
    arms = found["arm"]
    assert arms["level"] == 0.8
    assert len(arms["draws"]) == len(arms["model_draws"]) == 100
    assert all(one["name"].endswith(("_m", "_rad")) for one in arms["parameters"])
    inside = [one["low"] < draw[one["name"]] < one["high"] for one in arms["parameters"] for draw in arms["draws"]]
    assert np.mean(inside) == pytest.approx(0.8, abs=0.03)
    # the height of the base and the first offset are one number to every pose: the fit leaves their priors
    sigma = dict(zip(known["names"], np.sqrt(np.diag(known["matrix"])), strict=True))
    width = next(one["high"] - one["low"] for one in arms["parameters"] if one["name"] == "d_1_m")
    assert sigma["d_1"] > 1e-3
    assert width < 1e-4


def test_versions_of_five_others_tell_how_arms_of_the_type_spread() -> None:
    rng = np.random.default_rng(4)
    kind = Type.drawn(rng)
    version, _ = fitted(kind.arm(rng), rng)
    others = []
    for k in range(6):
        other, known = fitted(kind.arm(rng), rng)
        others.append(FleetVersion.from_calibration(f"r{k}", f"v{k}", other.calibration, known))
    found = json.loads(str(export("ranges", dataclasses.replace(version, fleet=tuple(others))).text))
    own = {one["name"]: one["high"] - one["low"] for one in found["arm"]["parameters"]}
    wider = [(one["high"] - one["low"]) / own[one["name"]] for one in found["type"]["parameters"]]
    assert np.median(wider) > 3.0  # arms differ by 0.3 mm and 0.03 deg, and one of them is known to some 0.02 mm
    assert len(found["type"]["model_draws"]) == 100


def test_a_version_without_covariance_has_no_ranges() -> None:
    rng = np.random.default_rng(5)
    version, _ = fitted(Type.drawn(rng).arm(rng), rng, 20)
    bare = version.version.model_copy(update={"covariance": Covariance()})
    with pytest.raises(ServiceError) as refused:
        export("ranges", dataclasses.replace(version, version=bare))
    assert refused.value.code == "ranges_unknown"


def test_numbers_of_a_range_have_their_unit_and_a_point() -> None:
    damping = FittedNumber("j1.damping", "N m s/rad", 2e-5, log=True)
    found = draw_ranges([damping, FittedNumber("j1.share", "1", 0.1, low=0.0)], np.diag([0.01, 0.04]), 0.95, draws=3)
    assert [one["name"] for one in found["parameters"]] == ["j1.damping_nm_s_rad", "j1.share"]
    assert found["parameters"][1]["low"] == 0.0
    text = write_json_for_yaml({"a": 1e-05, "b": [2e-07, -3e22], "c": "1e-05", "d": 1})
    assert yaml.safe_load(text) == json.loads(text) == {"a": 1e-05, "b": [2e-07, -3e22], "c": "1e-05", "d": 1}
    with pytest.raises(OptionError, match="say how much"):
        draw_ranges([damping], np.eye(1), 1.0)
