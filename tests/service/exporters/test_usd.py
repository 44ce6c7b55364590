"""An exported stage of USD, read back with Pixar's package alone: its arm is that of the version, and sags as it does."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdPhysics

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.effects import make_effect
from kilter_core.errors import RobotError
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.twin import Twin
from kilter_service.ground.errors import ServiceError
from kilter_service.robots.exporters.exportable import Exportable
from kilter_service.robots.exporters.registry import FORMATS, Exported, export
from kilter_service.robots.exporters.usd_file import stage_text, usd
from tests.service.exporters.test_exporters import exportable
from tests.service.exporters.test_mjcf import ALL, BACKLASH, EVERYTHING, GEOMETRY, MOUNT, SAG, WINDUP

Floats = NDArray[np.float64]
EXACT_MM, SETTLED_MM = 1e-6, 0.01
DEGREES = 180.0 / np.pi
# A slide and two hinges, so that linear drives and mixed units are seen.
SLIDES: dict[str, Any] = {
    "name": "slide", "convention": "chain",
    "elements": [
        {"axis": "Tz", "joint": "lift 1", "name": "zero_z"}, {"axis": "Ty", "value": 120.0, "name": "y"},
        {"axis": "Rz", "joint": "turn", "name": "zero_turn"}, {"axis": "Tx", "value": 300.0, "name": "arm"},
        {"axis": "Rx", "joint": "wrist", "name": "zero_wrist", "ratio": -1},
    ],
    "joints": [{"name": "lift 1", "type": "prismatic", "limits_mm": [-200, 300]},
               {"name": "turn", "limits_deg": [-170, 170]}, {"name": "wrist", "limits_deg": [-170, 170]}],
    "links": [{"mass_kg": 8.0, "com_mm": [0, 40, 0]}, {"mass_kg": 3.0, "com_mm": [120, 0, 30]},
              {"mass_kg": 1.0, "com_mm": [20, 10, 30]}],
}  # fmt: skip
MIMIC: dict[str, Any] = {
    "name": "mimic", "convention": "chain",
    "elements": [{"axis": "Rz", "joint": "a"}, {"axis": "Tx", "value": 100.0, "name": "l"},
                 {"axis": "Rz", "joint": "a", "ratio": 0.5}],
    "joints": [{"name": "a", "limits_deg": [-90, 90]}],
}  # fmt: skip
TOOL = {"x_mm": 3.3, "y_mm": -12.7, "z_mm": 81.9, "rx_deg": 3.0, "ry_deg": 20.0, "rz_deg": 50.0}


def twin(
    effects: Sequence[str], values: Mapping[str, float], document: dict[str, Any] | None = None, **changes: Any
) -> tuple[Exported, Calibration]:
    document = (document or preset_document("ur10")) | changes
    calibration = Twin(robot_from_document(document), values, tuple(make_effect(e) for e in effects)).truth
    return make_stage_here(exportable(document, calibration)), calibration


def make_stage_here(version: Exportable) -> Exported:
    """Return what the server exports, made in this process: a process of its own imports for 3 s before it begins."""
    written = usd(version)
    assert isinstance(written.text, partial)
    return Exported(stage_text(*written.text.args), FORMATS["usd"].media_type, "arm.usda", written.notes)


def test_the_process_of_its_own_makes_the_same_stage() -> None:
    document = preset_document("ur10")
    effects = tuple(make_effect(name) for name in ALL)
    version = exportable(document, Twin(robot_from_document(document), EVERYTHING, effects).truth)
    exported, here = export("usd", version), make_stage_here(version)
    assert (exported.text, exported.media_type, exported.notes) == (here.text, here.media_type, here.notes)


def opened(exported: Exported) -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory("read.usda")
    assert stage.GetRootLayer().ImportFromString(str(exported.text))
    return stage


def frame(place: Any, turn: Any) -> Floats:
    """A pose (4, 4), its quaternion normalised in double precision."""
    q = np.array([turn.GetReal(), *turn.GetImaginary()], dtype=np.float64)
    w, v = q[0] / np.linalg.norm(q), q[1:] / np.linalg.norm(q)
    K = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.eye(3) + 2 * w * K + 2 * K @ K, np.array(place, dtype=np.float64)
    return T


class Read:
    """The articulation of a stage: poses by its joints' local poses, drives, and masses; SI inside."""

    def __init__(self, stage: Usd.Stage, rounded: bool = False) -> None:
        self.stage = stage
        self.unit = UsdGeom.GetStageMetersPerUnit(stage)
        joints = [UsdPhysics.Joint(p) for p in stage.Traverse() if p.IsA(UsdPhysics.Joint)]
        self.moving = [j for j in joints if not j.GetPrim().IsA(UsdPhysics.FixedJoint)]
        self.order: list[tuple[Any, str | None, str, Floats, Floats]] = []
        reached: set[str | None] = {None}
        while len(self.order) < len(joints):
            for j in joints:
                before, behind = (
                    str(t[0]) if (t := rel.GetTargets()) else None for rel in (j.GetBody0Rel(), j.GetBody1Rel())
                )
                if before in reached and behind not in reached:
                    poses = [
                        frame(j.GetLocalPos0Attr().Get(), j.GetLocalRot0Attr().Get()),
                        frame(j.GetLocalPos1Attr().Get(), j.GetLocalRot1Attr().Get()),
                    ]
                    for T in poses:
                        T[:3, 3] *= self.unit
                    self.order.append((j, before, str(behind), poses[0], np.eye(4) if rounded else poses[1]))
                    reached.add(behind)

    def bodies(self, q: Floats) -> dict[str | None, Floats]:
        """Pose (4, 4) of every body in the world at joints (n,) in rad and m."""
        out: dict[str | None, Floats] = {None: np.eye(4)}
        at = {str(j.GetPath()): value for j, value in zip(self.moving, q, strict=True)}
        for j, before, behind, T0, T1 in self.order:
            motion, value = np.eye(4), at.get(str(j.GetPath()), 0.0)
            if j.GetPrim().IsA(UsdPhysics.PrismaticJoint):
                motion["XYZ".index(UsdPhysics.PrismaticJoint(j).GetAxisAttr().Get()), 3] = value
            elif value:
                k = "XYZ".index(UsdPhysics.RevoluteJoint(j).GetAxisAttr().Get())
                a, b, c, s = (k + 1) % 3, (k + 2) % 3, np.cos(value), np.sin(value)
                motion[a, a], motion[b, b], motion[a, b], motion[b, a] = c, c, -s, s
            out[behind] = out[before] @ T0 @ motion @ np.linalg.inv(T1)
        return out

    def tool(self, q: Floats) -> Floats:
        prim = next(p for p in self.stage.Traverse() if p.GetName() == "kilter_tool")
        local = np.array(UsdGeom.Xformable(prim).GetLocalTransformation()).T.copy()
        local[:3, 3] *= self.unit
        return self.bodies(q)[str(prim.GetParent().GetPath())] @ local

    def gains(self) -> Floats:
        """Stiffness (n,) of the drives, N m/rad or N/m."""
        out = []
        for j in self.moving:
            slides = j.GetPrim().IsA(UsdPhysics.PrismaticJoint)
            drive = UsdPhysics.DriveAPI(j.GetPrim(), "linear" if slides else "angular")
            assert drive.GetTypeAttr().Get() == "force"
            out.append(drive.GetStiffnessAttr().Get() * (1.0 if slides else DEGREES))
        return np.array(out)

    def energy(self, q: Floats) -> float:
        """Of weight, J."""
        scene = next(UsdPhysics.Scene(p) for p in self.stage.Traverse() if p.IsA(UsdPhysics.Scene))
        g = np.array(scene.GetGravityDirectionAttr().Get()) * scene.GetGravityMagnitudeAttr().Get()
        total = 0.0
        for path, T in self.bodies(q).items():
            if path is not None and self.stage.GetPrimAtPath(path).HasAPI(UsdPhysics.MassAPI):
                mass = UsdPhysics.MassAPI(self.stage.GetPrimAtPath(path))
                com = T[:3, :3] @ (self.unit * np.array(mass.GetCenterOfMassAttr().Get(), dtype=np.float64)) + T[:3, 3]
                total -= mass.GetMassAttr().Get() * float(g @ com)
        return total

    def hanging(self, q: Floats) -> Floats:
        """Joints (n,) at which drives and weight are in balance, with the targets ``q``."""
        gains, at, h = self.gains(), q.copy(), 1e-4
        for _ in range(6):
            turned = [(self.energy(at + h * e) - self.energy(at - h * e)) / (2 * h) for e in np.eye(len(q))]
            at = q - np.array(turned) / gains
        return at


def poses(calibration: Calibration, count: int) -> Floats:
    rng, joints = np.random.default_rng(5), calibration.robot.joints
    lower, upper = (np.array([getattr(j, side) for j in joints]) for side in ("lower", "upper"))
    return rng.uniform(np.maximum(lower, -3.0), np.minimum(upper, 3.0), (count, len(joints)))


def farthest_mm(found: Callable[[Floats], Floats], told: Floats, q: Floats) -> float:
    return float(1e3 * max(np.linalg.norm(found(row)[:3, 3] - p) for row, p in zip(q, told, strict=True)))


@pytest.mark.parametrize("document", [None, SLIDES], ids=["ur10", "slide"])
def test_the_joints_are_those_of_the_version(document: dict[str, Any] | None) -> None:
    """Exactly, though local poses are in single precision: without what the other local pose takes they are not."""
    values = GEOMETRY if document is None else {"arm": 1.234567e-3, "y": 2e-3, "base_ry": 1e-3, "tool_y": 1e-3}
    exported, calibration = twin((), values, document, tool=TOOL)
    read, q = Read(opened(exported)), poses(calibration, 200)
    told = calibration.predict(Observations(q))
    assert farthest_mm(read.tool, told.position, q) <= EXACT_MM
    apart = max(np.abs(read.tool(row)[:3, :3] - R).max() for row, R in zip(q, told.rotation, strict=True))
    assert apart < 1e-9
    rounded = farthest_mm(Read(opened(exported), rounded=True).tool, told.position, q)
    assert EXACT_MM < rounded < 1e-3


@pytest.mark.parametrize("name", ["ur10", "so101"])
def test_the_stage_has_the_numbers_of_the_model_of_mujoco(name: str) -> None:
    """Joint frames, drives, and masses by the moments of their weight: one version, two files, two programs that read them."""
    document = preset_document(name)
    robot = robot_from_document(document)
    soft = {"compliance_2": 1e-5 if name == "ur10" else 1 / 33, "compliance_3": 2e-5 if name == "ur10" else 1 / 28}
    arm = Twin(robot, soft, (make_effect("axial_compliance", joints=(1, 2)),)).truth
    model = mujoco.MjModel.from_xml_string(str(export("mjcf", exportable(document, arm)).text))
    data, read = mujoco.MjData(model), Read(opened(export("usd", exportable(document, arm))))
    driven = [model.joint(int(j)) for j in model.actuator_trnid[:, 0]]
    gains = read.gains()
    assert gains[1:3] == pytest.approx([1.0 / soft["compliance_2"], 1.0 / soft["compliance_3"]], rel=1e-5)
    assert gains == pytest.approx(-model.actuator_biasprm[:, 1], rel=1e-5)
    for q in poses(arm, 20):
        for joint, value in zip(driven, q, strict=True):
            data.qpos[joint.qposadr[0]] = value
        mujoco.mj_forward(model, data)
        assert 1e3 * np.abs(read.tool(q)[:3, 3] - data.site("tool").xpos).max() < EXACT_MM
        weight = [(read.energy(q + h) - read.energy(q - h)) / 2e-4 for h in 1e-4 * np.eye(len(q))]
        bias = [data.qfrc_bias[joint.dofadr[0]] for joint in driven]
        assert weight == pytest.approx(bias, rel=1e-4, abs=1e-4 * float(np.abs(bias).max()))


def test_bodies_stand_where_their_joints_are_at_zero() -> None:
    read = Read(opened(twin((), GEOMETRY)[0]))
    cache = UsdGeom.XformCache()
    for path, T in read.bodies(np.zeros(6)).items():
        if path is not None:
            seen = np.array(cache.GetLocalToWorldTransform(read.stage.GetPrimAtPath(path))).T
            np.testing.assert_allclose(seen, T, atol=1e-11)


@pytest.mark.parametrize("payload_kg", [0.0, 4.0])
def test_the_drives_sag_as_the_version_says(payload_kg: float) -> None:
    load = {"load": {"payload_kg": payload_kg, "payload_com_mm": [10.0, 0.0, 60.0]}} if payload_kg else {}
    exported, calibration = twin(("axial_compliance",), GEOMETRY | SAG, **load)
    read, q = Read(opened(exported)), poses(calibration, 20)
    rows = Observations(q).carrying(payload_kg, (0.01, 0.0, 0.06))
    told = calibration.predict(rows).position
    assert farthest_mm(read.tool, told, q) > 0.2
    assert farthest_mm(lambda row: read.tool(read.hanging(row)), told, q) <= SETTLED_MM / 10.0


def test_slides_sag_by_linear_drives() -> None:
    exported, calibration = twin(("axial_compliance",), {"compliance_1": 1e-5, "compliance_3": 1e-4}, SLIDES, tool=TOOL)
    read, q = Read(opened(exported)), poses(calibration, 20)
    told = calibration.predict(Observations(q)).position
    assert farthest_mm(read.tool, told, q) > 0.2
    assert farthest_mm(lambda row: read.tool(read.hanging(row)), told, q) <= SETTLED_MM


def test_units_limits_and_names_are_stated() -> None:
    stage = opened(twin((), {}, SLIDES)[0])
    assert UsdGeom.GetStageMetersPerUnit(stage) == UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetDefaultPrim().HasAPI(UsdPhysics.ArticulationRootAPI)
    lift, turn, _ = Read(stage).moving
    assert lift.GetPrim().GetAttribute("kilter:joint").Get() == "lift 1"
    lift, turn = UsdPhysics.PrismaticJoint(lift), UsdPhysics.RevoluteJoint(turn)
    assert (lift.GetLowerLimitAttr().Get(), turn.GetUpperLimitAttr().Get()) == pytest.approx((-0.2, 170.0))


def test_what_usd_has_no_element_for_is_said_with_its_size() -> None:
    exported, _ = twin(ALL, EVERYTHING)
    for effect in ("backlash_load", "friction_windup", "base_compliance"):
        note = next(note for note in exported.notes if effect in note)
        assert note.startswith("In attributes only")
        assert "um rms" in note
    assert next(n for n in exported.notes if "axial_compliance" in n).startswith(
        "In the stage: axial_compliance, worth "
    )
    stage = opened(exported)
    assert all(note in stage.GetRootLayer().documentation for note in exported.notes)
    lift = Read(stage).moving[1].GetPrim()
    assert lift.GetAttribute("kilter:halfBacklashRad").Get() == pytest.approx(BACKLASH["backlash_load_2"])
    windup = -WINDUP["windup_2"] / SAG["compliance_2"]
    assert lift.GetAttribute("kilter:frictionNm").Get() == pytest.approx(windup)
    base = stage.GetDefaultPrim().GetAttribute("kilter:baseComplianceRadPerNm").Get()
    assert tuple(base) == pytest.approx(tuple(MOUNT.values()))


def test_a_server_without_the_package_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "pxr"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(ServiceError, match="pip install usd-core") as caught:
        twin((), {})
    assert caught.value.code == "usd_unavailable"


def test_joints_that_drive_several_axes_are_refused() -> None:
    with pytest.raises(RobotError, match="one axis per joint"):
        twin((), {}, MIMIC)
