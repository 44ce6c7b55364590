"""Exported files read by others: Pinocchio, PyYAML, matrices multiplied here; and back again to the same poses."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio
import pytest
import yaml
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_wrenches import axial_loads, joint_loads
from kilter_core.arm.presets import preset_document
from kilter_core.errors import RobotError
from kilter_core.model import Calibration
from kilter_core.model.table_fit import arm_poses
from kilter_core.observations import Observations
from kilter_core.transforms import pose_from_xyz_rpy
from kilter_core.twin import Twin, thesis_katana
from kilter_service.contract.versions import CorrectionLimits, Version
from kilter_service.ground.errors import ServiceError
from kilter_service.robots.documents import resolve
from kilter_service.robots.exporters.exportable import Exportable
from kilter_service.robots.exporters.registry import Exported, export
from kilter_service.robots.importers.urdf import chain_document
from kilter_service.robots.store import StoredRobot

Floats = NDArray[np.float64]

ERRORS = {
    "a_2": 3e-4, "a_3": -2e-4, "d_4": 2e-4, "d_5": 3e-4, "alpha_4": 2e-3, "alpha_5": -1e-3, "theta_offset_1": 1e-3,
    "theta_offset_2": -2e-3, "theta_offset_3": 1e-3, "theta_offset_5": 2e-3, "base_x": 2e-3, "base_ry": 1e-3,
    "tool_y": 1e-3, "tool_rx": 2e-3,
}  # fmt: skip
TILTS = {"beta_2": 8e-4, "beta_3": -6e-4}


def exportable(document: dict[str, Any], calibration: Calibration) -> Exportable:
    version = Version(
        id="ver_1a", robot=document["name"], active=False, parent_id=None, job_id="job_1a", effects=[], metrics={},
        created_at=datetime(2026, 1, 1, tzinfo=UTC), code_version="test", sha256="0", hash_scheme=2, robot_sha256="0",
        campaigns=[], limits=CorrectionLimits(),
        parameters=[], null_directions=[], noise_mm=None, warnings=[], covariance={}, details={},
    )  # fmt: skip
    resolved = resolve(document)
    arm = StoredRobot(1, document["name"], document, resolved.chain, resolved.sha256, resolved.source_sha256, [])
    return Exportable(arm, version, calibration.to_document())


def calibrated(errors: dict[str, float], preset: str = "ur10", **changes: Any) -> tuple[Exportable, Calibration]:
    document = preset_document(preset) | changes
    truth = Twin(robot_from_document(document), errors).truth
    # As an identification leaves it: the registration found the tracker's frame, which is no error of the arm.
    tracker = pose_from_xyz_rpy(np.array([2.0, -1.0, 0.3]), np.array([0.1, 0.2, 2.0]))
    model, values = truth.model.absorb_frame_increments(truth.values)
    seen = dataclasses.replace(model, T_base=tracker @ np.asarray(model.T_base))
    found = Calibration(seen, values, wanted_base=tracker @ truth.robot.T_base)
    return exportable(document, found), found


def poses_of(calibration: Calibration, q: Floats) -> Floats:
    """Tool poses in the robot's base frame by the model itself, registration taken off."""
    found = arm_poses(calibration, Observations(q))
    out = np.tile(np.eye(4), (len(q), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = found.rotation, found.position
    return out


def pinocchio_poses(urdf: str, frame: str, q: Floats) -> Floats:
    model = pinocchio.buildModelFromXML(urdf)
    data, out = model.createData(), []
    for row in q:
        pinocchio.framesForwardKinematics(model, data, _configuration(model, row))
        out.append(data.oMf[model.getFrameId(frame)].homogeneous)
    return np.array(out)


def _configuration(model: pinocchio.Model, row: Floats) -> Floats:
    """Pinocchio keeps a continuous joint as cosine and sine."""
    parts = [
        [v] if joint.nq == 1 else [math.cos(v), math.sin(v)] for joint, v in zip(model.joints[1:], row, strict=True)
    ]
    return np.concatenate(parts)


def joints(n: int, rows: int = 20) -> Floats:
    return np.random.default_rng(5).uniform(-2, 2, (rows, n))


def test_a_urdf_is_made_from_a_table(tmp_path: Path) -> None:
    tool = {"x_mm": 10.0, "z_mm": 120.0, "ry_deg": 30.0}
    file, calibration = calibrated(ERRORS | TILTS, tool=tool)
    text = export("urdf", file).text
    q = joints(6)
    expected = poses_of(calibration, q)
    assert np.abs(pinocchio_poses(text, "tool", q) - expected).max() < 1e-9
    assert "Nothing is lost" in text
    again = robot_from_document(chain_document(text, "base_link", "tool", "again").document)
    assert np.abs(poses_of(Calibration.nominal(again), q) - expected).max() < 1e-9
    assert [link.mass for link in again.links] == pytest.approx([link.mass for link in calibration.robot.links])
    assert again.limits == pytest.approx(calibration.robot.limits)


def test_masses_in_the_new_urdf_load_the_joints_as_before() -> None:
    file, calibration = calibrated({})
    text = export("urdf", file).text
    model = pinocchio.buildModelFromXML(text)
    model.gravity.linear = calibration.robot.gravity
    data = model.createData()
    for row in joints(6, 5):
        torques = pinocchio.computeGeneralizedGravity(model, data, row)
        wrench = joint_loads(calibration.robot, row[None]).joints
        assert np.abs(np.abs(wrench[0, :, 5]) - np.abs(torques)).max() < 1e-9


URDF = """<robot name="arm"><!-- kept --><link name="world"/><link name="base"/><link name="l1"/><link name="l2"/>
<link name="l3"/><link name="tip"/><link name="side"/>
<joint name="stand" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0 0 0.7" rpy="0 0 3.14159"/></joint>
<joint name="a" type="revolute"><parent link="base"/><child link="l1"/><origin xyz="0 0 0.3" rpy="0 0 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="10" velocity="1"/></joint>
<joint name="b" type="continuous"><parent link="l1"/><child link="l2"/><origin xyz="0.1 0 0.1" rpy="0 1.5707963267948966 0.2"/>
<axis xyz="0.6 0 0.8"/></joint>
<joint name="c" type="revolute"><parent link="l2"/><child link="l3"/><origin xyz="0.4 0 0" rpy="0.3 0 0"/><axis xyz="0 -1 0"/>
<limit lower="-2" upper="2" effort="10" velocity="1"/></joint>
<joint name="end" type="{kind}"><parent link="l3"/><child link="tip"/><origin xyz="0.2 0.1 0"/><axis xyz="1 0 0"/>
<limit lower="-2" upper="2" effort="10" velocity="1"/></joint>
<joint name="on_the_side" type="fixed"><parent link="l2"/><child link="side"/><origin xyz="0 0 0.1"/></joint></robot>"""


@pytest.mark.parametrize("kind", ["fixed", "revolute"])
def test_origins_of_the_robots_own_urdf_are_corrected(kind: str) -> None:
    urdf = URDF.format(kind=kind)
    posted = {"name": "arm", "convention": "urdf", "urdf": urdf, "base_link": "base", "tip_link": "tip"}
    robot = robot_from_document(chain_document(urdf, "base", "tip", "arm").document)
    errors = {
        "a_x": 1e-3,
        "b_rz": 2e-3,
        "b_ry": -1e-3,
        "b_rx": 1.5e-3,
        "c_z": 3e-4,
        "theta_offset_2": 4e-3,
        "theta_offset_3": -3e-3,
    }
    calibration = Twin(robot, errors | {"base_z": 1e-3, "tool_rx": 2e-3, "tool_x": 1e-3}).truth
    calibration = Calibration(calibration.model, calibration.values, wanted_base=robot.T_base, wanted_tool=robot.T_tool)
    text = export("urdf", exportable(posted, calibration)).text
    q = joints(robot.n_joints)
    expected = poses_of(calibration, q)
    again = robot_from_document(chain_document(text, "base", "tip", "again").document)
    assert np.abs(poses_of(Calibration.nominal(again), q) - expected).max() < 1e-9
    stand = pose_from_xyz_rpy(np.array([0, 0, 0.7]), np.array([0, 0, 3.14159]))
    assert np.abs(pinocchio_poses(text, "tip", q) - stand @ expected).max() < 1e-9
    assert " kept " in text
    assert text.count("<joint ") == urdf.count("<joint ") + (kind == "revolute")
    assert '<origin xyz="0 0 0.1"' in text  # what is not of the chain stays as it was


def test_an_arm_stored_with_errors_of_roll_pitch_and_yaw_is_exported_as_it_is() -> None:
    urdf = URDF.format(kind="fixed").replace("0 1.5707963267948966 0.2", "0.4 0.7 0.2")
    document = dict(chain_document(urdf, "base", "tip", "arm").document)
    kept = [e for e in document["elements"] if not str(e.get("name", "")).endswith(("_rx", "_ry", "_rz"))]
    names = iter(["b_yaw", "b_pitch", "b_roll"])
    turned = {k for k, e in enumerate(kept) if e.get("fixed") and e["value"] in np.degrees([0.2, 0.7, 0.4])}
    elements = [{**e, "fixed": False, "name": next(names)} if k in turned else e for k, e in enumerate(kept)]
    stored = document | {"elements": elements}
    robot = robot_from_document(stored)
    calibration = Twin(robot, {"b_yaw": 2e-3, "b_pitch": -1e-3, "b_roll": 1e-3}).truth
    calibration = Calibration(calibration.model, calibration.values, wanted_base=robot.T_base, wanted_tool=robot.T_tool)
    posted = {"name": "arm", "convention": "urdf", "urdf": urdf, "base_link": "base", "tip_link": "tip"}
    file = exportable(stored, calibration)
    file = dataclasses.replace(file, arm=StoredRobot(*file.arm)._replace(document=posted))
    text, q = export("urdf", file).text, joints(robot.n_joints)
    stand = pose_from_xyz_rpy(np.array([0, 0, 0.7]), np.array([0, 0, 3.14159]))
    assert np.abs(pinocchio_poses(text, "tip", q) - stand @ poses_of(calibration, q)).max() < 1e-9


def test_an_uncalibrated_urdf_comes_out_as_it_went_in() -> None:
    urdf = URDF.format(kind="fixed")
    posted = {"name": "arm", "convention": "urdf", "urdf": urdf, "base_link": "base", "tip_link": "tip"}
    robot = robot_from_document(chain_document(urdf, "base", "tip", "arm").document)
    text = export("urdf", exportable(posted, Calibration.nominal(robot))).text
    assert re.findall(r"<origin[^>]*>", text) == re.findall(r"<origin[^>]*>", urdf.replace('"/>', '" />'))


def test_coupled_joints_mimic() -> None:
    document = {
        "name": "fanuc", "convention": "chain", "joints": [{"name": "J1"}, {"name": "J2"}, {"name": "J3"}],
        "elements": [
            {"joint": "J1", "axis": "Rz"}, {"axis": "Tz", "value": 500, "name": "d_1"},
            {"joint": "J2", "axis": "Ry"}, {"axis": "Tz", "value": 600, "name": "a_2"},
            {"joint": "J2", "axis": "Ry", "ratio": -1}, {"joint": "J3", "axis": "Ry", "ratio": -1},
            {"axis": "Tx", "value": 700, "name": "a_3"},
        ],
    }  # fmt: skip
    calibration = Twin(robot_from_document(document), {"a_2": 1e-3, "theta_offset_3": 2e-3}).truth
    file = exportable(document, calibration)
    text, q = export("urdf", file).text, joints(3)
    again = robot_from_document(chain_document(text, "base_link", "flange", "again").document)
    assert np.abs(poses_of(Calibration.nominal(again), q) - poses_of(calibration, q)).max() < 1e-9
    for name in ("dh-csv", "matlab"):
        with pytest.raises(RobotError, match="Joint 2 moves 2 axes"):
            export(name, file)


def test_masses_of_coupled_joints_stand_in_the_urdf() -> None:
    body = {"mass_kg": 4.0, "com_mm": [20.0, -30.0, 200.0], "inertia_kg_m2": [0.02, 0.03, 0.04, 0.001, 0.0, -0.002]}
    document = {
        "name": "lift", "convention": "chain", "joints": [{"name": f"J{j}", "limits_deg": [-170, 170]} for j in (1, 2, 3)],
        "elements": [
            {"joint": "J1", "axis": "Rz"}, {"axis": "Tz", "value": 500, "name": "d_1"},
            {"joint": "J2", "axis": "Ry"}, {"axis": "Tz", "value": 600, "name": "a_2"},
            {"joint": "J2", "axis": "Ry", "ratio": -0.7}, {"axis": "Tx", "value": 300, "name": "b_2"},
            {"joint": "J3", "axis": "Ry", "ratio": -1}, {"axis": "Tx", "value": 700, "name": "a_3"},
        ],
        "links": [body, body, body, {**body, "mass_kg": 9.0, "on_axis": 3}],
    }  # fmt: skip
    robot = robot_from_document(document)
    text, q = export("urdf", exportable(document, Calibration.nominal(robot))).text, joints(3)
    model = pinocchio.buildModelFromXML(text)
    model.gravity.linear = robot.gravity
    assert sum(inertia.mass for inertia in model.inertias) == pytest.approx(21.0)
    loads = axial_loads(robot, joint_loads(robot, q))
    for row, load in zip(q, loads, strict=True):
        index = {name: model.joints[model.getJointId(name)].idx_q for name in model.names if name != "universe"}
        full = pinocchio.neutral(model)
        for name, at in index.items():
            leader = name.partition("_follower")[0]
            full[at] = row[int(leader[1:]) - 1] * (1.0 if name == leader else -0.7)
        torque = pinocchio.computeGeneralizedGravity(model, model.createData(), full)
        np.testing.assert_allclose(load, [-torque[index[f"J{j}"]] for j in (1, 2, 3)], atol=1e-9, rtol=0)
    again = robot_from_document(chain_document(text, "base_link", "flange", "again").document)
    np.testing.assert_allclose(axial_loads(again, joint_loads(again, q)), loads, atol=1e-9, rtol=0)


def table_of(file: Exported) -> tuple[list[dict[str, str]], dict[str, Floats]]:
    comments = [line[2:] for line in file.text.splitlines() if line.startswith("# ")]
    frames = {}
    for line in comments:
        word, _, rest = line.partition(" ")
        if word in ("base", "tool"):
            v = {name: float(value) for name, value in (part.split("=") for part in rest.split())}
            frames[word] = pose_from_xyz_rpy(
                np.array([v["x_mm"], v["y_mm"], v["z_mm"]]) / 1e3, np.radians([v["rx_deg"], v["ry_deg"], v["rz_deg"]])
            )
    text = "\n".join(line for line in file.text.splitlines() if not line.startswith("#"))
    return list(csv.DictReader(io.StringIO(text))), frames


def row_pose(row: dict[str, str], q: float, dh: bool) -> Floats:
    def number(name: str) -> float:
        return float(row.get(name) or 0.0)

    joint = pose_from_xyz_rpy(
        np.array([0, 0, number("d_mm") / 1e3]), np.array([0, 0, math.radians(number("theta_offset_deg")) + q])
    )
    R = pinocchio.utils.rotate("x", math.radians(number("alpha_deg"))) @ pinocchio.utils.rotate(
        "y", math.radians(number("beta_deg"))
    )
    link = np.eye(4)
    link[:3, :3], link[:3, 3] = R, R @ [number("a_mm") / 1e3, 0, 0]
    return joint @ link if dh else link @ joint


@pytest.mark.parametrize(("name", "errors"), [("dh-csv", ERRORS), ("mdh-csv", ERRORS | TILTS)])
def test_tables_multiply_out_to_the_same_poses(name: str, errors: dict[str, float]) -> None:
    file, calibration = calibrated(errors, tool={"z_mm": 100.0, "rx_deg": 20.0})
    written = export(name, file)
    rows, frames = table_of(written)
    for q, wanted in zip(joints(6), poses_of(calibration, joints(6)), strict=True):
        T = frames["base"]
        for row, value in zip(rows, q, strict=True):
            T = T @ row_pose(row, value, name == "dh-csv")
        assert np.abs(T @ frames["tool"] - wanted).max() < 1e-9
    assert written.notes == ("Nothing is lost: the poses are those of the version.",)
    assert [row["joint"] for row in rows] == [joint.name for joint in calibration.robot.joints]


def test_what_a_file_leaves_out_is_said_in_words() -> None:
    document = preset_document("katana450-chapter5") | {"name": "katana"}
    file = exportable(document, thesis_katana().truth)
    for name in ("urdf", "dh-csv", "mdh-csv", "matlab"):
        written = export(name, file)
        said = " ".join(written.notes)
        assert all(effect in said for effect in ("clearance_tilt", "backlash_load", "axial_compliance"))
        lost = re.search(r"differs from the version's by ([\d.]+) mm rms, ([\d.]+) mm at most", said)
        assert lost is not None
        assert 0.02 < float(lost[1]) < float(lost[2]) < 5
        assert written.notes[0] in written.text.replace("\n  ", "\n")


def test_ur_yaml_is_the_drivers_for_the_nominal_arm_and_true_for_the_calibrated() -> None:
    file, _ = calibrated({})
    nominal = yaml.safe_load(export("ur-yaml", file).text)["kinematics"]
    # default_kinematics.yaml of the driver's description package, UR10
    default = {
        "shoulder": (0, 0, 0.1273, 0, 0, 0), "upper_arm": (0, 0, 0, math.pi / 2, 0, 0),
        "forearm": (-0.612, 0, 0, 0, 0, 0), "wrist_1": (-0.5723, 0, 0.163941, 0, 0, 0),
        "wrist_2": (0, -0.1157, 0, math.pi / 2, 0, 0), "wrist_3": (0, 0.0922, 0, math.pi / 2, math.pi, math.pi),
    }  # fmt: skip
    for name, values in default.items():
        found = pose(nominal[name])
        assert np.abs(found - pose_from_xyz_rpy(np.array(values[:3]), np.array(values[3:]))).max() < 1e-9, name

    errors = {name: value for name, value in ERRORS.items() if not name.startswith("tool")} | TILTS
    file, calibration = calibrated(errors | {"theta_offset_6": 3e-3})
    written = export("ur-yaml", file)
    found = yaml.safe_load(written.text)["kinematics"]
    for q, wanted in zip(joints(6), poses_of(calibration, joints(6)), strict=True):
        T = np.eye(4)
        for name, value in zip(default, q, strict=True):
            T = T @ pose(found[name]) @ pose_from_xyz_rpy(np.zeros(3), np.array([0, 0, value]))
        assert np.abs(T - wanted).max() < 1e-9
    assert "tool frame" in " ".join(export("ur-yaml", calibrated(ERRORS)[0]).notes)
    with pytest.raises(RobotError, match="six revolute joints"):
        export("ur-yaml", exportable(preset_document("katana450-chapter4"), thesis_katana("katana450-chapter4").truth))


def pose(values: dict[str, float]) -> Floats:
    return pose_from_xyz_rpy(
        np.array([values[k] for k in "xyz"]), np.array([values[k] for k in ("roll", "pitch", "yaw")])
    )


def test_matlab_builds_the_same_arm() -> None:
    file, calibration = calibrated(ERRORS | TILTS, tool={"z_mm": 100.0, "rx_deg": 20.0})
    written = export("matlab", file)
    assert written.name == "ur10_ver_1a.m"
    assert written.text.startswith("function robot = ur10_ver_1a()\n")
    text = written.text
    kinds = re.findall(r"rigidBodyJoint\('[^']+', '(\w+)'\)", text)
    fixed = [
        np.array([[float(v) for v in row.split()] for row in matrix.split(";")])
        for matrix in re.findall(r"setFixedTransform\(joint, \[([^]]+)\]\)", text)
    ]
    parents = re.findall(r"addBody\(robot, body, '([^']+)'\)", text)
    assert parents == ["base", *re.findall(r"rigidBody\('([^']+)'\)", text)[:-1]]
    for q, wanted in zip(joints(6), poses_of(calibration, joints(6)), strict=True):
        T, values = np.eye(4), iter(q)
        for kind, step in zip(kinds, fixed, strict=True):
            turn = next(values) if kind == "revolute" else 0.0
            T = T @ step @ pose_from_xyz_rpy(np.zeros(3), np.array([0, 0, turn]))
        assert np.abs(T - wanted).max() < 1e-9


def test_unknown_formats_are_refused() -> None:
    with pytest.raises(ServiceError, match="dh-csv"):
        export("stone", calibrated({})[0])
