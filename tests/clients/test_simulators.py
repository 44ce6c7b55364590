"""A copy as SDF and for Isaac Lab, read by others: the arm moves in a second simulator as the search says it does.

Pinocchio reads what Python's XML has of the SDF; Drake, where it is installed, reads the file by itself. Dry friction, which
neither has, is written out here.
"""

from __future__ import annotations

import ast
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from kilter_client.cli import run
from kilter_client.twin.servo_gap import Patched, find_servo_gap, render_copy
from tests.clients.files.formats.test_lerobot import calibration
from tests.clients.servo_arm import NOMINAL, Floats, Hidden, Log, Servos, record
from tests.clients.test_servo_gap import DEG, ONE, write_logs, write_model

STEP_S, SETTLE_S = 0.002, 0.3
DRAKE = "{drake.mit.edu}"
LATE = Hidden("command_delay", 0, 0.03)
# https://isaac-sim.github.io/IsaacLab/v2.3.2/_modules/isaaclab/actuators/actuator_base_cfg.html
FIELDS = {
    "joint_names_expr", "effort_limit", "velocity_limit", "effort_limit_sim", "velocity_limit_sim", "stiffness", "damping",
    "armature", "friction", "dynamic_friction", "viscous_friction",
}  # fmt: skip


class Dynamics(Protocol):
    """Mass matrix (n, n) without motors, and what bodies ask for at rest and by speed (n,)."""

    def terms(self, q: Floats, v: Floats) -> tuple[Floats, Floats]: ...


def placed(element: ElementTree.Element | None) -> Any:
    """A pose of SDF: angles about fixed axes."""
    numbers = [float(x) for x in (element.text or "").split()] if element is not None else [0.0] * 6
    return pin.SE3(pin.rpy.rpyToMatrix(*numbers[3:]), np.array(numbers[:3]))


class OfPinocchio:
    """Bodies as Pinocchio has them."""

    def __init__(self, text: str, payload_kg: float) -> None:
        model = ElementTree.fromstring(text).find("model")
        assert model is not None
        self.model, frames = pin.Model(), {"world": (0, pin.SE3.Identity())}
        links = {one.get("name"): one for one in model.findall("link")}
        for joint in model.findall("joint"):
            parent, child = (str(joint.findtext(key)) for key in ("parent", "child"))
            link = links[child]
            carrier, at = frames[parent]
            here = at * placed(link.find("pose"))
            if joint.get("type") == "revolute":
                anchor = placed(joint.find("pose"))
                axis = np.array([float(x) for x in str(joint.findtext("axis/xyz")).split()])
                carrier = self.model.addJoint(
                    carrier, pin.JointModelRevoluteUnaligned(axis), here * anchor, str(joint.get("name"))
                )
                here = anchor.inverse()
            frames[child] = (carrier, here)
            mass = payload_kg if child == "payload" else float(str(link.findtext("inertial/mass")))
            moments = np.diag([float(str(link.findtext(f"inertial/inertia/{key}"))) for key in ("ixx", "iyy", "izz")])
            com = placed(link.find("inertial/pose"))
            inertia = pin.Inertia(mass, com.translation, com.rotation @ moments @ com.rotation.T)
            self.model.appendBodyToJoint(carrier, inertia, here)
        self.data = self.model.createData()

    def terms(self, q: Floats, v: Floats) -> tuple[Floats, Floats]:
        M = pin.crba(self.model, self.data, q)
        return np.triu(M) + np.triu(M, 1).T, pin.nonLinearEffects(self.model, self.data, q, v)


class OfDrake:
    """Bodies as Drake reads them."""

    def __init__(self, text: str, payload_kg: float) -> None:
        parsing, plants, tree = (
            pytest.importorskip(f"pydrake.multibody.{name}") for name in ("parsing", "plant", "tree")
        )
        self.plant = plants.MultibodyPlant(STEP_S)
        parsing.Parser(self.plant).AddModelsFromString(text, "sdf")
        self.plant.Finalize()
        self.context = self.plant.CreateDefaultContext()
        point = tree.UnitInertia(1e-9, 1e-9, 1e-9)
        body = self.plant.GetBodyByName("payload")
        body.SetSpatialInertiaInBodyFrame(self.context, tree.SpatialInertia(payload_kg, np.zeros(3), point))
        ids = self.plant.GetJointActuatorIndices()
        self.armature = np.array([self.plant.get_joint_actuator(k).default_rotor_inertia() for k in ids])
        self.gains = np.array([self.plant.get_joint_actuator(k).get_controller_gains().p for k in ids])

    def terms(self, q: Floats, v: Floats) -> tuple[Floats, Floats]:
        self.plant.SetPositions(self.context, q)
        self.plant.SetVelocities(self.context, v)
        bias = self.plant.CalcBiasTerm(self.context) - self.plant.CalcGravityGeneralizedForces(self.context)
        M = self.plant.CalcMassMatrix(self.context) - np.diag(self.armature)  # Drake has added the motors
        return M, bias


def joint_numbers(text: str) -> dict[str, Floats]:
    """Numbers of the driven joints in the file, each (n,)."""
    own = [
        one for one in ElementTree.fromstring(text).iter("joint") if one.find(f"{DRAKE}controller_gains") is not None
    ]
    paths = {
        "friction": "axis/dynamics/friction", "damping": "axis/dynamics/damping", "effort": "axis/limit/effort",
        "armature": f"{DRAKE}rotor_inertia", "delay": "{kilter}command_delay_s", "impedance": "{kilter}friction_impedance",
        "rate": "{kilter}friction_rate_per_s",
    }  # fmt: skip
    found = {key: np.array([float(one.findtext(path) or 0.0) for one in own]) for key, path in paths.items()}
    found["gain"] = np.array([float(one.find(f"{DRAKE}controller_gains").attrib["p"]) for one in own])  # type: ignore[union-attr]
    return found


def replay(arm: Dynamics, own: dict[str, Floats], log: Log) -> Floats:
    """Readings (N, n) of the arm, by steps of 2 ms: dry friction by projected sweeps over the joints."""
    n, rows = len(own["gain"]), len(log.t)
    q, v = log.reading[0].copy(), (log.reading[2] - log.reading[0]) / (log.t[2] - log.t[0])
    out, each = np.empty((rows, n)), np.arange(n)
    steps = round((log.t[1] - log.t[0]) / STEP_S)
    for k in range(rows):
        out[k] = q
        for s in range(steps):
            late = log.t[k] + (s + 0.5) * STEP_S - own["delay"]
            told = log.command[np.maximum(np.searchsorted(log.t, late, side="right") - 1, 0), each]
            torque = np.clip(own["gain"] * (told - q), -own["effort"], own["effort"])
            M, bias = arm.terms(q, v)
            inverse = np.linalg.inv(M + np.diag(own["armature"] + STEP_S * own["damping"]))
            free = inverse @ ((M + np.diag(own["armature"])) @ v + STEP_S * (torque - bias))
            held = np.zeros(n)
            for _ in range(1 if n == 1 else 20):
                for j in range(n):
                    alone = free[j] + STEP_S * (inverse[j] @ held - inverse[j, j] * held[j])
                    wanted = -alone / STEP_S
                    if own["rate"][j] > 0.0:
                        wanted = own["impedance"][j] * (-own["rate"][j] * v[j] - (alone - v[j]) / STEP_S)
                    held[j] = np.clip(wanted / inverse[j, j], -own["friction"][j], own["friction"][j])
            v = free + STEP_S * inverse @ held
            q = q + STEP_S * v
    return out


def rms_deg(arm: type[OfPinocchio] | type[OfDrake], text: str, logs: list[Log]) -> float:
    own = joint_numbers(text)
    apart = [
        (replay(arm(text, max(log.payload_kg, 1e-9)), own, log) - log.reading)[log.t > log.t[0] + SETTLE_S]
        for log in logs
    ]
    return float(np.degrees(np.sqrt(np.mean(np.concatenate(apart) ** 2))))


@pytest.fixture(scope="module")
def found_one(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Patched]:
    folder = tmp_path_factory.mktemp("logs")
    return find_servo_gap(write_model(folder), write_logs(folder, LATE, ONE, 5, 12.0))


@pytest.mark.parametrize("arm", [OfPinocchio, OfDrake])
def test_a_joint_moves_in_a_second_simulator_as_in_the_search(
    arm: type[OfPinocchio] | type[OfDrake], found_one: tuple[dict[str, Any], Patched]
) -> None:
    found, copy = found_one
    held = [record(10 + k, LATE, ONE, 12.0) for k in found["held_out_episodes"]]
    text = render_copy("sdf", "arm", copy).text
    assert rms_deg(arm, text, held) == pytest.approx(found["joints"][0]["found"], rel=0.05)


@pytest.mark.parametrize("arm", [OfPinocchio, OfDrake])
def test_an_arm_of_three_joints_moves_so_too(tmp_path: Path, arm: type[OfPinocchio] | type[OfDrake]) -> None:
    found, copy = find_servo_gap(write_model(tmp_path, NOMINAL), write_logs(tmp_path, None, Servos(), 3))
    held = [record(10 + k, None, Servos(), 12.0) for k in found["held_out_episodes"]]
    text = render_copy("sdf", "arm", copy).text
    assert rms_deg(arm, text, held) == pytest.approx(found["whole_arm"]["found"]["rms_deg"], rel=0.05)


def test_drake_reads_gains_and_armature(found_one: tuple[dict[str, Any], Patched]) -> None:
    servo = found_one[1].servos[0]
    read = OfDrake(render_copy("sdf", "arm", found_one[1]).text, 0.3)
    assert read.armature == pytest.approx([servo.armature])
    assert read.gains == pytest.approx([servo.gain])
    assert read.plant.GetJointByName("j1").default_damping() == pytest.approx(servo.damping)


def test_isaac_lab_gets_an_actuator_for_each_joint(found_one: tuple[dict[str, Any], Patched]) -> None:
    rendered = render_copy("isaaclab", "arm", found_one[1])
    names = {one.targets[0].id: one.value for one in ast.parse(rendered.text).body if isinstance(one, ast.Assign)}  # type: ignore[attr-defined]
    (actuator,) = names["ACTUATORS"].values
    fields = {one.arg: ast.literal_eval(one.value) for one in actuator.keywords}
    assert actuator.func.id == "DelayedPDActuatorCfg"
    assert set(fields) <= FIELDS | {"min_delay", "max_delay"}
    assert re.fullmatch(fields["joint_names_expr"][0], "j1")
    step = ast.literal_eval(names["PHYSICS_DT"])
    assert fields["min_delay"] * step <= 0.031
    assert fields["max_delay"] * step >= 0.029
    truth = {"stiffness": ONE.gain, "viscous_friction": ONE.damping, "armature": ONE.armature, "friction": ONE.friction}
    for key, value in truth.items():
        assert fields[key] == pytest.approx(value[0], rel=0.05)
    assert any("PhysX holds" in note for note in rendered.notes)


def test_a_gear_is_a_link_between_two_joints(tmp_path: Path) -> None:
    hidden = Hidden("backlash", 0, 1.0 * DEG, "body")
    _, copy = find_servo_gap(write_model(tmp_path), write_logs(tmp_path, hidden, ONE, 4))
    rendered = render_copy("sdf", "arm", copy)
    model = ElementTree.fromstring(rendered.text).find("model")
    assert model is not None
    chain = [(one.findtext("parent"), one.findtext("child"), one.get("name")) for one in model.findall("joint")]
    assert chain[:2] == [("world", "b1_motor_1", "j1"), ("b1_motor_1", "b1", "j1_gear")]
    width = [float(model.findtext(f"joint[@name='j1_gear']/axis/limit/{end}") or 0.0) for end in ("lower", "upper")]
    assert width[1] - width[0] == pytest.approx(1.0 * DEG, rel=0.1)
    assert any("backlash_rad of j1" in note for note in render_copy("isaaclab", "arm", copy).notes)
    assert not any("backlash" in note for note in rendered.notes)


def test_lerobot_gets_the_zero_that_gravity_shows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Commands and readings count from another zero than the bodies hang by."""
    zero_deg, logs = 10.0, []
    for k in range(4):
        log = record(10 + k, None, ONE, 12.0)
        logs.append(tmp_path / f"log{k}.csv")
        turned = np.radians(zero_deg)
        replace(log, reading=log.reading + turned, command=log.command + turned).write(logs[-1])
    servos = calibration(tmp_path)
    own = {"id": 9, "drive_mode": 0, "homing_offset": 7, "range_min": 0, "range_max": 4095}
    servos.write_text(json.dumps(json.loads(servos.read_text()) | {"j1": own}))
    asked = ["gap", *map(str, logs), "--model", str(write_model(tmp_path)), "--format", "lerobot"]
    output = ["-o", str(tmp_path / "trued.json")]
    assert run([*asked, *output]) == 2
    assert "name it with --calibration" in " ".join(capsys.readouterr().err.split())
    named = ["--calibration", str(servos), "--servos", "feetech", "--norm-mode", "DEGREES"]
    assert run([*asked, *output, *named]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "homing offsets of j1" in told
    before, after = (json.loads(path.read_text()) for path in (servos, tmp_path / "trued.json"))
    # Feetech's servos take the offset off what they read
    assert after["j1"]["homing_offset"] - before["j1"]["homing_offset"] == pytest.approx(zero_deg / 360 * 4096, rel=0.1)
    assert before.pop("j1")["id"] == after.pop("j1")["id"]
    assert before == after


def test_the_command_writes_the_file_and_says_what_friction_means(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = [str(path) for path in write_logs(tmp_path, LATE, ONE, 4)]
    model = ["--model", str(write_model(tmp_path)), "--format", "sdf"]
    assert run(["gap", *logs, *model]) == 2
    assert "add -o FILE" in " ".join(capsys.readouterr().err.split())
    assert run(["gap", *logs, *model, "-o", str(tmp_path / "arm.sdf")]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "Drake ignores <friction>" in told
    assert "no element for command_delay_s of j1" in told
    assert ElementTree.parse(tmp_path / "arm.sdf").getroot().tag == "sdf"
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml")).nu == 1
