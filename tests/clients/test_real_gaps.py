"""Gap hunts on real measurements with the `kilter` command; the whole library only in the slow ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from kilter_client.cli import run

EXAMPLES = Path(__file__).resolve().parents[2] / "clients/python/examples"
QUICK = ("--option", "resamples=10", "--option", "permutations=5", "--option", "bootstraps=499")
SURE = ("confirmed", "class_confirmed")


class Session:
    """A person at the command line, with a robot of this test's own."""

    def __init__(self, capsys: pytest.CaptureFixture[str], robot: str) -> None:
        self._capsys, self.robot = capsys, robot

    def __call__(self, *arguments: object) -> dict[str, Any]:
        self._capsys.readouterr()
        code = run([*(str(argument) for argument in arguments), "--json"])
        printed = self._capsys.readouterr().out
        assert code == 0, printed
        found: dict[str, Any] = json.loads(printed)
        return found

    def upload(self, file: Path, *arguments: object) -> str:
        return str(self("upload", self.robot, file, *arguments)["campaign_id"])

    def hunt(self, *arguments: object) -> dict[str, Any]:
        return dict(self("gap", self.robot, *arguments)["result"])


@pytest.fixture
def person(server: Path, capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest) -> Session:
    return Session(capsys, request.node.name.replace("[", ".").replace("]", "")[:60])


def named(found: dict[str, Any]) -> dict[str, Any]:
    return {effect["id"]: effect for effect in found["effects"]}


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_two_encoders_per_joint(person: Session, shared_data: Path, whole: bool) -> None:
    person("robot", "add", EXAMPLES / "kr300.json", "--name", person.robot)
    folder = shared_data / "kuka-kr300-secondary-encoder"
    ids = [
        person.upload(folder / f"traj_{k}.mat", "--map", EXAMPLES / "kr300.toml", "--device", "secondary-encoder")
        for k in "ABC"
    ]
    quick = () if whole else ("--effects", "tracking_lag,time_offset,axial_compliance,backlash,encoder_scale", *QUICK)
    found = person.hunt("-c", ids[0], "-v", ids[1], "-v", ids[2], *quick)
    effects = named(found)
    # One delay of 2.9 ms between the encoders of all axes; the load's part on every axis with an encoder; the reversal on
    # axes 2 and 3, and on axis 1 where the search sees it: its 0.0013 deg are less than what this motion shows for sure.
    assert "tracking_lag" not in effects
    assert effects["time_offset"]["parameters"][0]["value"] == pytest.approx(-0.0029, abs=0.0001)
    assert {j for e in found["effects"] if e["id"] == "axial_compliance" for j in e["joints"]} == {1, 2, 3}
    reversal = {j for e in found["effects"] if e["id"] in ("backlash", "friction_windup") for j in e["joints"]}
    unseen = {
        j for x in found["not_testable"] if x["id"] in ("backlash", "friction_windup") for j in x["joints"] if j < 4
    }
    assert reversal >= {2, 3}
    assert reversal | unseen == {1, 2, 3}  # whichever is not named is said to be unseen
    assert unseen <= {1}
    # What motions B and C bear out, the encoders of each referenced anew: axis 1 by 0.13 deg in motion C.
    assert effects["time_offset"]["gates"]["held_out"]
    assert effects["axial_compliance"]["gates"]["held_out"]
    gap = found["gap"]
    assert "offsets" in gap["held_out"]
    assert gap["held_out_set_aside"] == 0
    assert gap["validation_after_deg"] < 0.5 * gap["validation_before_deg"]  # the target; 0.13 is reached
    assert gap["validation_after_deg"] < 0.006
    # One motion without repeats: whether the model as a whole is adequate is not known. What both halves of the motion show
    # with one amplitude rises by itself, as its class and never as a member.
    assert "not known" in found["adequacy"]["sentence"]
    for effect in (e for e in found["effects"] if e["verdict"] in SURE):
        assert effect["halves"]["lasts"]
        assert effect["halves"]["named"] == [True, True]
        assert (effect["verdict"], effect["claim"]["said"]) == ("class_confirmed", "class")
    # Beside the whole library a shape without a cause explains as much as the load's part does.
    sure = {"time_offset"} if whole else {"time_offset", "axial_compliance"}
    assert sure <= {e["id"] for e in found["effects"] if e["verdict"] in SURE}
    assert "dead_encoder" in {w["code"] for w in found["warnings"]}
    # Contrasts compare the same pose under two conditions, and axes 4 to 6 have no encoder to be wrong.
    assert not [p for p in found["where"] if p["factor"].startswith("contrast") or p["factor"][-1] in "456"]
    assert any(p["factor"].startswith("direction of joint") and p["p_value"] < 0.01 for p in found["where"])


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_humanoid_arm_confirms_nothing_its_held_out_poses_do_not_show(
    person: Session, shared_data: Path, whole: bool
) -> None:
    folder = shared_data / "talos-arm"
    urdf = ("--name", person.robot, "--base-link", "base_link", "--tip-link", "arm_left_7_link")
    person("robot", "add", folder / "talos_full_v2.urdf", *urdf)
    rows = person.upload(folder / "talos_left_arm_02_10_contact.csv", "--map", EXAMPLES / "talos.toml")
    quick = () if whole else ("--effects", "axial_compliance,radial_compliance,encoder_scale", *QUICK)
    found = person.hunt("-c", rows, "-v", "0.25", *quick)
    for effect in found["effects"]:
        held = effect["held_out_gain"]
        assert effect["verdict"] not in SURE or held["gain"] > 2 * held["standard_error"]
    assert not [e for e in found["effects"] if e["verdict"] in SURE]
    assert all(effect["p_value"] <= 0.01 for effect in found["effects"])
    assert "no_repeats" in {w["code"] for w in found["warnings"]}


@pytest.mark.parametrize("whole", [False, pytest.param(True, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_ur10_has_no_term_of_the_order_of_poses(person: Session, shared_data: Path, whole: bool) -> None:
    person("robot", "add", "--preset", "ur10", "--name", person.robot)
    file = shared_data / "ipa-ur10-lasertracker/Series_B/measurements_joint_configurations.csv"
    rows = person.upload(file, "--device", "ipa-lasertracker")
    quick = () if whole else ("--effects", "axial_compliance,backlash,drift", *QUICK)
    found = person.hunt("-c", rows, "-v", "0.3", *quick)
    effects = named(found)
    assert not {"backlash", "friction_windup", "drift"} & set(effects)
    gravity = {"axial_compliance", "radial_compliance", "link_bending", "base_compliance", "gravity_spring"}
    # Among the whole library it is hidden by smooth errors of the joints ten times as large, of which none lasts.
    assert whole or [e for e in found["effects"] if e["id"] in gravity and 0.0 < e["gain_mm"] < 0.1]
    assert not whole or not [e for e in found["effects"] if e["verdict"] in SURE]
    assert found["gap"]["validation_after_mm"] <= found["gap"]["validation_before_mm"]
