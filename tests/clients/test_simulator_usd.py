"""A copy as USD, read by Pixar's package: bodies stand where MuJoCo has them, drives and friction are the servos'."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from kilter_client.twin.servo_gap import Patched, render_copy
from kilter_client.twin.simulators import ExportedServo
from tests.clients.servo_arm import Floats, Hidden, Servos, arm_xml

PER_DEG = np.pi / 180.0
PLAY = Hidden("backlash", 1, 0.02)


def copy_of(hidden: Hidden | None) -> Patched:
    text = arm_xml(Servos(payload_kg=0.3), hidden)
    delay = (0.03, 0.029, 0.031)
    servos = tuple(
        ExportedServo(
            f"j{k + 1}", 0.01 * (k + 1), 0.1 * (k + 1), 0.5, 0.2, 20.0 + k, 1.5, delay, {"load_friction_1": 0.1}, None
        )
        for k in range(3)
    )
    return Patched(mujoco.MjModel.from_xml_string(text), text, (), servos)


def stage_of(hidden: Hidden | None) -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory()
    assert stage.GetRootLayer().ImportFromString(render_copy("usd", "my arm", copy_of(hidden)).text)
    return stage


def matrix(place: Gf.Vec3f, turn: Gf.Quatf) -> Floats:
    T = np.eye(4)
    T[:3, :3] = np.array(Gf.Matrix3d(Gf.Quatd(turn))).T
    T[:3, 3] = place
    return T


@pytest.mark.parametrize("hidden", [None, PLAY], ids=["rigid", "backlash"])
def test_bodies_stand_where_mujoco_has_them(hidden: Hidden | None) -> None:
    stage, model = stage_of(hidden), copy_of(hidden).model
    angles = np.linspace(-0.7, 0.9, model.njnt)
    data = mujoco.MjData(model)
    data.qpos[:] = angles
    mujoco.mj_kinematics(model, data)
    by_joint = {model.joint(j).name: angles[j] for j in range(model.njnt)}
    poses: dict[str, Floats] = {}
    for prim in stage.Traverse():
        joint = UsdPhysics.Joint(prim)
        if not joint:
            continue
        before = joint.GetBody0Rel().GetTargets()
        start = poses[before[0].name] if before else np.eye(4)
        ends = [
            matrix(place.Get(), turn.Get())
            for place, turn in (
                (joint.GetLocalPos0Attr(), joint.GetLocalRot0Attr()), (joint.GetLocalPos1Attr(), joint.GetLocalRot1Attr())
            )
        ]  # fmt: skip
        swing = np.eye(4)
        angle = by_joint.get(prim.GetName(), 0.0)
        swing[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        poses[joint.GetBody1Rel().GetTargets()[0].name] = start @ ends[0] @ swing @ np.linalg.inv(ends[1])
    for body in range(1, model.nbody):
        own = poses[model.body(body).name]
        assert own[:3, 3] == pytest.approx(data.xpos[body], abs=1e-6)
        assert own[:3, :3].ravel() == pytest.approx(data.xmat[body], abs=1e-6)
    masses = [UsdPhysics.MassAPI(p).GetMassAttr().Get() for p in stage.Traverse() if p.HasAPI(UsdPhysics.MassAPI)]
    assert sum(masses) == pytest.approx(float(model.body_mass.sum()), abs=1e-3)


def test_drives_friction_and_delay_are_those_of_the_servos() -> None:
    stage, copy = stage_of(None), copy_of(None)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    for servo in copy.servos:
        prim = stage.GetPrimAtPath(f"/my_arm/{servo.joint}")
        drive = UsdPhysics.DriveAPI.Get(prim, "angular")
        assert drive.GetTypeAttr().Get() == "force"
        assert drive.GetStiffnessAttr().Get() == pytest.approx(servo.gain * PER_DEG)
        assert drive.GetDampingAttr().Get() == pytest.approx(servo.servo_damping * PER_DEG)
        assert drive.GetMaxForceAttr().Get() == pytest.approx(servo.effort)
        assert "PhysxJointAxisAPI:angular" in prim.GetMetadata("apiSchemas").GetAddedOrExplicitItems()
        read = {key: prim.GetAttribute(f"physxJointAxis:angular:{key}").Get() for key in (
            "armature", "staticFrictionEffort", "dynamicFrictionEffort", "viscousFrictionCoefficient"
        )}  # fmt: skip
        assert list(read.values()) == pytest.approx([servo.armature, servo.friction, servo.friction, 0.3 * PER_DEG])
        assert prim.GetAttribute("kilter:command_delay_s").Get() == 0.03
    rendered = render_copy("usd", "my arm", copy)
    assert any("command_delay_s of j1 (0.03)" in note for note in rendered.notes)
    assert "command_delay_s" in stage.GetRootLayer().documentation


def test_backlash_is_a_joint_with_limits_in_degrees() -> None:
    stage = stage_of(PLAY)
    play = UsdPhysics.RevoluteJoint(stage.GetPrimAtPath("/my_arm/play"))
    assert play.GetUpperLimitAttr().Get() == pytest.approx(0.01 / PER_DEG)
    assert play.GetLowerLimitAttr().Get() == pytest.approx(-0.01 / PER_DEG)
