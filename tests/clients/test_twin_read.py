"""`kilter version twin read`: what a model states of its drives, as effects; the twin of an SO-101 by another program."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from kilter_service.contract.jobs.identify import IdentifyOptions
from tests.clients.lerobot.so101_arm import JOINTS, PRESET
from tests.clients.lerobot.so101_twin import Twin
from tests.clients.test_cli import Command

SOFT = Twin([0.0] * 5, [300.0, 33.0, 33.0, 40.0, 300.0], [0.0, 0.0, 1.1, 0.0, 0.0])


def test_gains_friction_and_backlash_become_effects_and_the_rest_is_named(tmp_path: Path, command: Command) -> None:
    model, copy = tmp_path / "so101.xml", tmp_path / "soft.json"
    text = SOFT.xml().replace('<joint name="wrist_flex"', '<joint name="wrist_flex" frictionloss="0.08" damping="0.6"')
    model.write_text(text)
    asked = ("twin", "read", model, "--joints", ",".join(JOINTS))
    found = command.json(*asked, "--robot-file", PRESET, "-o", copy)
    stated = {(one["joint"], one["effect"]): one["start"] for one in found["stated"]}
    assert stated["shoulder_lift", "axial_compliance"] == pytest.approx(57.29578 / 33.0)
    assert stated["elbow_flex", "backlash_load"] == pytest.approx(0.55)
    assert stated["wrist_flex", "friction_windup"] == pytest.approx(57.29578 * 0.08 / 40.0)
    assert found["effects"] == [
        {"id": "axial_compliance", "joints": [1, 2, 3, 4, 5]},
        {"id": "backlash_load", "joints": [3], "prior_sigma_rad": pytest.approx(math.radians(0.55), rel=1e-3)},
        {"id": "friction_windup", "joints": [4], "prior_sigma_rad": pytest.approx(0.08 / 40.0)},
    ]
    IdentifyOptions.model_validate({"effects": found["effects"]})
    left = "\n".join(found["left"])
    assert "damping (wrist_flex 0.6): an arm at rest does not depend on it" in left
    assert "armature (shoulder_pan 0.028" in left
    assert "kv of the drive" in left
    written = json.loads(copy.read_text())["joints"]
    assert [joint["drive_stiffness_nm_rad"] for joint in written] == [300.0, 33.0, 33.0, 40.0, 300.0]
    assert [joint["limits_deg"] for joint in written] == [
        j["limits_deg"] for j in json.loads(PRESET.read_text())["joints"]
    ]
    said = command(*asked)
    assert '--effects \'{"id": "backlash_load", "joints": [3], "prior_sigma_rad": 0.009599}' in said.replace("\n", " ")
    wide = model.read_text().replace('frictionloss="0.08"', 'frictionloss="4"')
    model.write_text(wide)
    assert command.json(*asked)["effects"][2]["prior_sigma_rad"] == 0.035


def test_what_cannot_be_read_is_refused_with_the_remedy(tmp_path: Path, command: Command) -> None:
    model = tmp_path / "so101.xml"
    model.write_text(SOFT.xml())
    assert "has no joint '9'" in command.json("twin", "read", model, "--joints", "9", code=1)["detail"]
    alone = command.json("twin", "read", model, "--joints", JOINTS[0], "-o", tmp_path / "a.json", code=2)
    assert "--robot-file and --output go together" in alone["detail"]
    other = command.json(
        "twin", "read", model, "--joints", JOINTS[0], "--robot-file", PRESET, "-o", tmp_path / "a.json", code=2
    )
    assert "--joints names 1 joints" in other["detail"]
    idle = SOFT.xml()
    model.write_text(idle[: idle.index("<actuator>")] + "</mujoco>")
    found = command.json("twin", "read", model, "--joints", ",".join(JOINTS))
    assert [one["effect"] for one in found["stated"]] == ["backlash_load"]
    assert "no position drive (shoulder_pan, shoulder_lift" in found["left"][-1]
