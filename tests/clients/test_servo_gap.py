"""`kilter gap --model`: what MuJoCo hides in a log is named at its joint, sized, and written into a copy that moves so."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

import kilter.twin
from kilter_client.cli import run
from kilter_client.errors import FileError
from kilter_client.twin.servo_gap import find_servo_gap
from kilter_client.twin.servo_model import ServoModel
from tests.clients.files.formats.test_lerobot import FPS, calibration, dataset
from tests.clients.servo_arm import NOMINAL, TICK_RAD, Hidden, Log, Servos, arm_xml, record

NOISE_DEG = np.degrees(TICK_RAD) / np.sqrt(12.0)
DEG = np.pi / 180.0
ONE = replace(Servos().of_joint(1), payload_kg=0.3)
STATED = NOMINAL.of_joint(1)
HIDDEN = (
    (Hidden("command_delay", 0, 0.02), "command_delay", 20.0, 0.1),
    (Hidden("effort_delay", 0, 0.01), "effort_delay", 10.0, 0.1),
    (Hidden("backlash", 0, 0.8 * DEG, "body"), "backlash", 0.8, 0.05),
    (Hidden("backlash", 0, 0.55 * DEG), "backlash", 0.55, 0.06),
    (Hidden("load_friction", 0, 0.12), "load_friction", 12.0, 0.1),
    (Hidden("torque_limit", 0, 0.9), "torque_limit", 0.9, 0.03),
    (Hidden("flexible_gear", 0, 0.05, "body"), "flexible_gear", 0.05 / DEG, 0.03),
    (Hidden("reading_offset", 0, 0.6 * DEG), "reading_offset", 0.6, 0.05),
)


def write_logs(folder: Path, hidden: Hidden | None, servos: Servos, count: int, seconds: float = 12.0) -> list[Path]:
    paths = [folder / f"log{k}.csv" for k in range(count)]
    for k, path in enumerate(paths):
        record(10 + k, hidden, servos, seconds).write(path)
    return paths


def write_model(folder: Path, servos: Servos = STATED, name: str = "arm.xml") -> Path:
    path = folder / name
    path.write_text(arm_xml(servos))
    return path


@pytest.mark.parametrize(("hidden", "name", "size", "within"), HIDDEN, ids=lambda one: getattr(one, "effect", None))
def test_what_is_hidden_is_named_and_the_copy_moves_as_the_arm(
    tmp_path: Path, hidden: Hidden, name: str, size: float, within: float
) -> None:
    logs = write_logs(tmp_path, hidden, ONE, 5, 10.0)
    found, copy = find_servo_gap(write_model(tmp_path), logs[:3], logs[3:])

    (effect,) = found["effects"]
    assert name in (effect["id"], *effect["alias_set"])
    assert effect["sure"] == "certain"
    if effect["id"] == name:
        assert effect["parameters"][0]["value"] == pytest.approx(size, rel=within)
    assert found["refuted"]
    # another simulator's steps, the whole arm, logs that no choice saw
    assert found["whole_arm"]["found"]["rms_deg"] < 1.15 * NOISE_DEG
    assert found["whole_arm"]["found"]["rms_deg"] == pytest.approx(found["joints"][0]["found"], rel=0.05)
    by_name = {one["name"]: one for one in found["joints"][0]["servo"]}
    for number, truth in zip(("armature", "damping", "gain"), (ONE.armature, ONE.damping, ONE.gain), strict=True):
        assert by_name[number]["found"] == pytest.approx(truth[0], rel=0.05), number
    assert mujoco.MjModel.from_xml_string(copy.text).nu == 1


def test_nothing_is_named_where_nothing_is_hidden_and_the_servo_is_found(tmp_path: Path) -> None:
    truth = Servos()
    found, _ = find_servo_gap(write_model(tmp_path, NOMINAL), write_logs(tmp_path, None, truth, 3))

    assert found["effects"] == []
    assert found["verdict"] == "no_gap"
    assert found["whole_arm"]["found"]["rms_deg"] < 1.1 * NOISE_DEG
    # nothing weighs on the first joint: its scale is that of its bodies' inertia, 5 % of the armature
    assert [one["joints"] for one in found["warnings"] if one["code"] == "servo_scale"] == [["j1"]]
    for one, values in zip(found["joints"][0]["servo"], (truth.armature, truth.friction), strict=False):
        half = one["interval_high"] - one["found"]
        assert 0.02 < half / one["found"] < 0.1
        assert one["found"] == pytest.approx(values[0], abs=1.6 * half)
    for j, joint in enumerate(found["joints"][1:], 1):
        for one, values in zip(
            joint["servo"], (truth.armature, truth.friction, truth.damping, truth.gain), strict=True
        ):
            assert one["found"] == pytest.approx(values[j], rel=0.05), one["name"]


def test_a_hidden_delay_is_told_with_what_had_absorbed_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = write_logs(tmp_path, Hidden("command_delay", 0, 0.05), ONE, 4)
    copy = tmp_path / "copy.xml"
    written = ["--ranges", str(tmp_path / "ranges.json"), "--ranges-percent", "80"]
    assert run(["gap", *map(str, logs), "--model", str(write_model(tmp_path)), "-o", str(copy), *written]) == 0
    told = capsys.readouterr().out

    assert "delay of the command of j1 (50 ms)" in " ".join(told.split())
    assert "A fit without it makes armature of j1" in " ".join(told.split())
    assert len(told.splitlines()) <= 25
    model = mujoco.MjModel.from_xml_path(str(copy))
    assert model.actuator_delay[0] == pytest.approx(0.05, abs=0.002)
    text = (tmp_path / "ranges.json").read_text()
    ranges = json.loads(text)
    assert yaml.safe_load(text) == ranges
    delay = next(one for one in ranges["parameters"] if one["name"] == "j1.command_delay_s")
    assert ranges["level"] == 0.8
    assert delay["low"] < delay["value"] < delay["high"]
    drawn = np.array([one["j1.command_delay_s"] for one in ranges["draws"]])
    assert np.mean((drawn > delay["low"]) & (drawn < delay["high"])) == pytest.approx(0.8, abs=0.12)
    assert (
        np.corrcoef(drawn, [one["j1.damping_nm_s_rad"] for one in ranges["draws"]])[0, 1] < 0.0
    )  # what one takes the other gives


def test_logs_with_other_loads_judge_what_was_found_without(tmp_path: Path) -> None:
    hidden = Hidden("load_friction", 0, 0.15)
    empty = write_logs(tmp_path, hidden, ONE, 3)
    loaded = tmp_path / "loaded.csv"
    record(99, hidden, replace(ONE, payload_kg=0.5), 12.0).write(loaded)
    found, _ = find_servo_gap(write_model(tmp_path), empty, [loaded])

    assert [one["id"] for one in found["effects"]] == ["load_friction"]
    assert found["held_out_episodes"] == [3]
    assert found["whole_arm"]["found"]["rms_deg"] < 0.8 * found["whole_arm"]["servo_fitted"]["rms_deg"]


def test_pendulums_of_other_masses_and_lengths_name_both_effects(tmp_path: Path) -> None:
    """A servo on a bench, as public logs of hobby servos have it: the arm that judges has a load that no choice saw."""
    friction = Hidden("load_friction", 0, 0.1)
    logs = []
    for seed, (kg, lever) in enumerate([(0.2, 0.0), (0.3, 0.05), (0.5, -0.05), (0.2, 0.0), (0.3, 0.05), (0.4, 0.03)]):
        bench, path = replace(ONE, payload_kg=kg, lever_m=lever), tmp_path / f"log{seed}.csv"
        log = record(10 + seed, friction, bench, 12.0)
        # what was told came two rows, 40 ms, before it acted
        replace(log, command=np.vstack([log.command[2:], log.command[-1:], log.command[-1:]])).write(path)
        logs.append(path)
    found, _ = find_servo_gap(write_model(tmp_path), logs[:5], logs[5:])

    by_id = {one["id"]: one for one in found["effects"]}
    assert set(by_id) == {"load_friction", "command_delay"}
    assert by_id["command_delay"]["parameters"][0]["value"] == pytest.approx(40.0, abs=2.0)
    assert by_id["load_friction"]["parameters"][0]["value"] == pytest.approx(10.0, rel=0.15)
    assert {one["sure"] for one in found["effects"]} == {"certain"}
    assert found["held_out_episodes"] == [5]
    assert found["whole_arm"]["found"]["rms_deg"] < 1.15 * NOISE_DEG


def test_of_several_models_the_log_says_which_is_nearest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    logs = write_logs(tmp_path, None, ONE, 3)
    near = write_model(tmp_path, replace(ONE, payload_kg=0.0, gain=(22.02,)), "near.xml")
    models = [f"--model={write_model(tmp_path)}", f"--model={near}"]
    assert run(["gap", *map(str, logs), *models, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)

    assert found["headline"].startswith(f"Nearest to the log as it stands: {near}")
    assert [one["refuted"] for one in found["models"]] == [True, False]


def test_the_copy_of_a_played_joint_takes_the_step(tmp_path: Path) -> None:
    hidden = Hidden("backlash", 0, 1.0 * DEG, "body")
    logs = write_logs(tmp_path, hidden, ONE, 4)
    degrees = tmp_path / "arm.xml"
    degrees.write_text(arm_xml(STATED).replace('angle="radian"', 'angle="degree"'))
    _, copy = find_servo_gap(degrees, logs)
    model = mujoco.MjModel.from_xml_string(copy.text)
    data = mujoco.MjData(model)
    for _ in range(500):
        kilter.twin.apply(model, data)
        mujoco.mj_step(model, data)
    motor = float(data.qpos[model.joint("j1").qposadr[0]])
    assert abs(kilter.twin.read_joints(model, data)["j1"] - motor) == pytest.approx(0.5 * DEG, rel=0.1)


def test_a_lerobot_data_set_is_searched_in_one_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Thirty frames a second, degrees from the middle of the range; the gripper takes no part."""
    hidden, episodes, actions = Hidden("command_delay", 0, 0.04), [], []
    for seed in range(4):
        log = record(50 + seed, hidden, ONE, 12.0, 1.0 / FPS, 1.0 / 600.0)
        gripper = np.full((len(log.t), 1), 50.0)
        episodes.append(np.hstack([np.degrees(log.reading), gripper]))
        actions.append(np.hstack([np.degrees(log.command), gripper]))
    path = dataset(tmp_path / "set", "v3.0", episodes, ("shoulder_lift", "gripper"), actions=actions)
    model = write_model(tmp_path, replace(STATED, payload_kg=0.3))
    servos = calibration(tmp_path, shoulder_lift={"range_min": 0, "range_max": 4095})
    calibrated = ["--calibration", str(servos), "--norm-mode", "DEGREES"]
    # the body that carries is not the log's to say here
    assert run(["gap", str(path), "--model", str(model), *calibrated, "--payload-body", "none", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)

    assert [one["physical_class"]["id"] for one in found["effects"]] == ["delay"]
    assert found["effects"][0]["parameters"][0]["value"] == pytest.approx(40.0, abs=2.0)
    assert found["episodes"] == 4


def refusal(model: Path, logs: list[Path], **more: Any) -> FileError:
    with pytest.raises(FileError) as refused:
        find_servo_gap(model, logs, **more)
    return refused.value


def test_models_and_logs_that_cannot_be_are_refused_with_a_remedy(tmp_path: Path) -> None:
    logs = write_logs(tmp_path, None, ONE, 1)
    text = arm_xml(STATED)

    def changed(old: str, new: str) -> Path:
        path = tmp_path / "changed.xml"
        path.write_text(text.replace(old, new))
        assert path.read_text() != text
        return path

    assert refusal(changed('<position name="a1" joint="j1" kp="30.0"/>', ""), logs).code == "model_without_actuator"
    assert refusal(changed('timestep="0.002"', 'timestep="0.02"'), logs).code == "model_step"
    circle = changed("<worldbody>", '<include file="changed.xml"/><worldbody>')
    assert "a second time" in str(refusal(circle, logs))
    mesh = changed("<worldbody>", '<asset><mesh name="m" file="absent.stl"/></asset><worldbody>')
    assert "absent.stl" in str(refusal(mesh, logs))
    heavy = changed('name="payload"', 'name="held"')
    carried = write_logs(tmp_path, None, replace(ONE, payload_kg=0.1), 1)
    assert refusal(heavy, carried).code == "model_payload"


POSITION = '<position name="a1" joint="j1" kp="30.0"/>'
OTHERS = {
    "torque": '<motor name="a1" joint="j1"/>',
    "velocity": '<velocity name="a1" joint="j1" kv="3"/>',
    "damper": '<damper name="a1" joint="j1" kv="3" ctrlrange="0 1"/>',
    "integrates": '<intvelocity name="a1" joint="j1" kp="30" actrange="-3 3"/>',
    "filters": '<position name="a1" joint="j1" kp="30" timeconst="0.02"/>',
    "not a position": '<general name="a1" joint="j1" gainprm="3" biastype="affine" biasprm="0 -30 0"/>',
    "a1, a2": f'{POSITION}<velocity name="a2" joint="j1" kv="3"/>',
}


@pytest.mark.parametrize("named", OTHERS)
def test_other_actuators_are_refused_and_the_remedy_works(tmp_path: Path, named: str) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(arm_xml(STATED).replace(POSITION, OTHERS[named]))
    with pytest.raises(FileError) as refused:
        ServoModel.from_file(path)
    assert refused.value.code == "model_actuator"
    assert named in str(refused.value) or named == "damper"
    assert "j1" in str(refused.value)
    remedy = re.search("<position .*?/>", str(refused.value))
    assert remedy is not None
    filled = remedy[0].replace('kp="..."', 'kp="30"').replace('kv="..."', 'kv="0.5"')
    path.write_text(arm_xml(STATED).replace(POSITION, filled))
    assert ServoModel.from_file(path).servo(0).servo_damping == 0.5


def test_a_delay_that_the_model_states_is_not_missing(tmp_path: Path) -> None:
    logs = write_logs(tmp_path, Hidden("command_delay", 0, 0.05), ONE, 4)
    path = tmp_path / "arm.xml"
    path.write_text(
        arm_xml(STATED).replace(POSITION, POSITION.replace("/>", ' delay="0.05" nsample="27" interp="linear"/>'))
    )
    found, copy = find_servo_gap(path, logs)
    assert found["effects"] == []
    assert copy.model.actuator_delay[0] == pytest.approx(0.05)
    assert found["whole_arm"]["found"]["rms_deg"] < 1.2 * NOISE_DEG


def test_logs_that_are_not_of_this_arm_are_refused(tmp_path: Path) -> None:
    model = write_model(tmp_path, NOMINAL)
    log = record(5, None, Servos(), 15.0)

    def write(changed: Log) -> list[Path]:
        changed.write(tmp_path / "log.csv")
        return [tmp_path / "log.csv"]

    swapped = refusal(model, write(replace(log, reading=log.reading[:, [1, 0, 2]])))
    assert swapped.code == "command_mismatch"
    assert "follows that of j2" in str(swapped)
    ticks = refusal(model, write(replace(log, reading=log.reading * 11.4)))
    assert ticks.code == "command_unit"
    still = np.zeros_like(log.command)
    assert refusal(model, write(replace(log, command=still))).code == "log_at_rest"
    short = replace(log, t=log.t[:200], command=log.command[:200], reading=log.reading[:200])
    assert refusal(model, write(short)).code == "log_too_short"
    two = ServoModel.from_file(model, ["j1", "j2"])
    assert two.joints == ("j1", "j2")
    assert "3 joints, the model 1" in str(refusal(write_model(tmp_path, STATED, "one.xml"), write(log)))


def test_a_push_is_left_out_and_said(tmp_path: Path) -> None:
    log = record(5, None, ONE, 30.0)
    pushed = log.reading.copy()
    pushed[700:760] += 0.1
    replace(log, reading=pushed).write(tmp_path / "log.csv")
    found, _ = find_servo_gap(write_model(tmp_path), [tmp_path / "log.csv"])

    assert found["effects"] == []
    assert "log_pushed" in [one["code"] for one in found["warnings"]]
    assert "one_episode" in [one["code"] for one in found["warnings"]]
