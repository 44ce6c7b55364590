"""A twin laid over a stage of USD that somebody else wrote: its joints and drives are calibrated, all else is the source's."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics
from scipy.spatial.transform import Rotation

from kilter_client.errors import FileError, MissingPackageError
from kilter_client.twin.onto import Laid
from kilter_client.twin.usd import lay_over
from kilter_core.arm.presets import preset_document
from kilter_core.observations import Observations
from tests.service.exporters.test_mjcf import ALL, EVERYTHING, GEOMETRY, SAG
from tests.service.exporters.test_usd import Read, poses, twin

Floats = NDArray[np.float64]
NAMES = ("pan", "lift", "elbow", "w1", "w2", "w3")
CM = 0.01
# Where the arm stands in the stage, whose up is y, and by which its gravity is along -z of the base again.
PLACE = np.eye(4)
PLACE[:3, :3], PLACE[:3, 3] = Rotation.from_euler("x", -90, degrees=True).as_matrix(), (0.4, -0.3, 0.8)


def screw(theta: float, d: float, a: float, alpha: float) -> Floats:
    T = np.eye(4)
    T[:3, :3] = (Rotation.from_euler("z", theta) * Rotation.from_euler("x", alpha)).as_matrix()
    T[:3, 3] = (a * np.cos(theta), a * np.sin(theta), d)
    return T


def some_frame(k: int) -> Floats:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec([0.3 * k, -0.2, 0.5]).as_matrix(), (0.02, -0.03 * k, 0.01)
    return T


def set_pose(prim: Usd.Prim, T: Floats) -> None:
    x, y, z, w = (float(v) for v in Rotation.from_matrix(T[:3, :3]).as_quat())
    form = UsdGeom.Xformable(prim)
    form.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Vec3d(*(T[:3, 3] / CM).tolist()))
    form.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(w, x, y, z))


def set_local(joint: Any, k: int, T: Floats) -> None:
    x, y, z, w = (float(v) for v in Rotation.from_matrix(T[:3, :3]).as_quat())
    getattr(joint, f"CreateLocalPos{k}Attr")(Gf.Vec3f(*(T[:3, 3] / CM).tolist()))
    getattr(joint, f"CreateLocalRot{k}Attr")(Gf.Quatf(w, x, y, z))


def source(folder: Path, zero_of_elbow: float = 0.0, scale: float = 1.0) -> Path:
    """The nominal UR10 as another would write it: cm, y up, axes along x, body frames anywhere, a mesh by reference."""
    document = preset_document("ur10")
    (folder / "part.usda").write_text(
        '#usda 1.0\n(\n defaultPrim = "part"\n)\ndef Mesh "part"\n{\n point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\n'
        " int[] faceVertexCounts = [3]\n int[] faceVertexIndices = [0, 1, 2]\n}\n"
    )
    path = folder / "theirs.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, CM)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    scene = UsdPhysics.Scene.Define(stage, "/scene")
    scene.CreateGravityDirectionAttr(Gf.Vec3f(0, -1, 0))
    scene.CreateGravityMagnitudeAttr(9.80665 / CM)
    root = UsdGeom.Xform.Define(stage, "/robot").GetPrim()
    UsdPhysics.ArticulationRootAPI.Apply(root)
    stage.SetDefaultPrim(root)
    turn = np.eye(4)  # their axis is x
    turn[:3, :3] = Rotation.from_euler("y", -90, degrees=True).as_matrix()
    body, at = UsdGeom.Xform.Define(stage, "/robot/stand"), PLACE.copy()
    set_pose(body.GetPrim(), PLACE)
    here = PLACE
    fixed = UsdPhysics.FixedJoint.Define(stage, "/robot/joints/stand")
    fixed.CreateBody1Rel().SetTargets(["/robot/stand"])
    set_local(fixed, 0, PLACE)
    set_local(fixed, 1, np.eye(4))
    for k, (row, link) in enumerate(zip(document["rows"], document["links"], strict=True)):
        if k == 2:
            at = at @ screw(zero_of_elbow, 0.0, 0.0, 0.0)
        behind = at @ screw(0.0, row["d_mm"] / 1e3, row["a_mm"] / 1e3, np.radians(row["alpha_deg"]))
        pose = behind @ some_frame(k)
        new = UsdGeom.Xform.Define(stage, f"/robot/part{k}")
        set_pose(new.GetPrim(), pose)
        if k == 3 and scale != 1.0:
            new.AddScaleOp().Set(Gf.Vec3f(scale))
        UsdPhysics.RigidBodyAPI.Apply(new.GetPrim())
        mass = UsdPhysics.MassAPI.Apply(new.GetPrim())
        mass.CreateMassAttr(link["mass_kg"])
        com = np.linalg.inv(some_frame(k)) @ np.array([*(np.array(link["com_mm"]) / 1e3), 1.0])
        mass.CreateCenterOfMassAttr(Gf.Vec3f(*(com[:3] / CM).tolist()))
        stage.DefinePrim(f"/robot/part{k}/mesh").GetReferences().AddReference("./part.usda")
        joint = UsdPhysics.RevoluteJoint.Define(stage, f"/robot/joints/{NAMES[k]}")
        joint.CreateAxisAttr("X")
        joint.CreateBody0Rel().SetTargets([body.GetPath()])
        joint.CreateBody1Rel().SetTargets([new.GetPath()])
        set_local(joint, 0, np.linalg.inv(here) @ at @ turn)
        set_local(joint, 1, np.linalg.inv(pose) @ at @ turn)
        drive = UsdPhysics.DriveAPI.Apply(joint.GetPrim(), "angular")
        drive.CreateStiffnessAttr(3.0)
        drive.CreateMaxForceAttr(5.0)
        body, here, at = new, pose, behind
    finger = UsdGeom.Xform.Define(stage, "/robot/finger")
    set_pose(finger.GetPrim(), at)
    stage.GetRootLayer().Save()
    return path


def laid(
    folder: Path, effects: Any = (), values: Any = GEOMETRY, path: Path | None = None, **more: Any
) -> tuple[Laid, Any]:
    exported, calibration = twin(effects, values)
    path = path or source(folder)
    return lay_over(path, str(exported.text), folder / "out" / "arm-0042.usda", more.get("joints", NAMES)), calibration


def opened(folder: Path, found: Laid) -> Usd.Stage:
    (folder / "out").mkdir()
    (folder / "out/arm-0042.usda").write_text(found.text)
    stage = Usd.Stage.Open(str(folder / "out/arm-0042.usda"))
    assert not stage.GetCompositionErrors()
    return stage


def apart_mm(tool: Any, told: Floats, q: Floats) -> float:
    seen = np.array([(np.linalg.inv(PLACE) @ tool(row))[:3, 3] for row in q])
    return float(np.linalg.norm(seen - told, axis=1).max() * 1e3)


def test_the_joints_of_the_layer_are_those_of_the_version(tmp_path: Path) -> None:
    found, calibration = laid(tmp_path)
    before = (tmp_path / "theirs.usda").read_bytes()
    read, q = Read(opened(tmp_path, found)), poses(calibration, 200)
    apart = apart_mm(read.tool, calibration.predict(Observations(q)).position, q)
    assert apart < 1e-3  # body frames of their own, in single precision
    assert (tmp_path / "theirs.usda").read_bytes() == before


def test_the_layer_sags_as_the_version_says(tmp_path: Path) -> None:
    found, calibration = laid(tmp_path, ("axial_compliance",), GEOMETRY | SAG)
    read, q = Read(opened(tmp_path, found)), poses(calibration, 10)
    gains = read.gains() * CM**2  # kg cm²/s² per rad in theirs
    energy = read.energy
    read.gains, read.energy = lambda: gains, lambda at: energy(at) * CM  # type: ignore[method-assign]  # gravity in cm/s²
    told = calibration.predict(Observations(q)).position
    assert apart_mm(read.tool, told, q) > 0.2
    assert apart_mm(lambda row: read.tool(read.hanging(row)), told, q) < 0.01


def test_the_layer_holds_joints_only(tmp_path: Path) -> None:
    """Bodies and meshes have no opinion in it; units and up are the source's, limits of force are off."""
    found, _ = laid(tmp_path, ALL, EVERYTHING)
    stage = opened(tmp_path, found)
    layer = stage.GetRootLayer()
    assert list(layer.subLayerPaths) == ["../theirs.usda"]
    assert (UsdGeom.GetStageMetersPerUnit(stage), UsdGeom.GetStageUpAxis(stage)) == (CM, "Y")
    assert stage.GetDefaultPrim().GetName() == "robot"
    written: list[Sdf.Path] = []
    layer.Traverse("/", lambda path: written.append(path) if path.IsPropertyPath() else None)
    assert written
    assert all("/joints/" in str(path) or "/part5/kilter_tool" in str(path) for path in written)
    assert not any("physics:body" in str(path) or "axis" in str(path) for path in written)
    lift = stage.GetPrimAtPath("/robot/joints/lift")
    assert lift.GetAttribute("kilter:halfBacklashRad").Get() == pytest.approx(5e-4)
    assert UsdPhysics.DriveAPI(lift, "angular").GetMaxForceAttr().Get() == float("inf")
    assert UsdGeom.Mesh(stage.GetPrimAtPath("/robot/part2/mesh")).GetPointsAttr().Get()
    assert any(note.startswith("In attributes only") and "backlash_load, worth" in note for note in found.notes)


def test_a_model_of_another_zero_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"'\w+' is .* deg from where the robot nominally has it"):
        laid(tmp_path, path=source(tmp_path, zero_of_elbow=0.2))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("PhysicsArticulationRootAPI", "PhysicsFilteredPairsAPI"), "has no articulation"),
        (("./part.usda", "./lost.usda"), r"cannot be composed: .*lost\.usda"),
        (
            ('def PhysicsRevoluteJoint "elbow"', 'def PhysicsRevoluteJoint "knee"'),
            "has no joint 'elbow'. It has: pan, lift, knee",
        ),
        (('def PhysicsRevoluteJoint "elbow"', 'def PhysicsPrismaticJoint "elbow"'), "is a PhysicsPrismaticJoint"),
        (("#usda 1.0", "#usda one"), "is not a stage of USD"),
        (("</robot/part1>", "</robot/lost>"), "/robot/lost"),
    ],
    ids=["articulation", "reference", "name", "kind", "syntax", "body"],
)
def test_bad_sources_are_refused(tmp_path: Path, change: tuple[str, str], said: str) -> None:
    path = source(tmp_path)
    text = path.read_text()
    assert change[0] in text
    broken = tmp_path / "broken.usda"
    broken.write_text(text.replace(*change))
    with pytest.raises(FileError, match=said) as caught:
        laid(tmp_path, path=broken)
    assert "broken.usda" in caught.value.detail


def test_joints_inside_an_instance_are_refused_until_it_is_none(tmp_path: Path) -> None:
    source(tmp_path)
    path = tmp_path / "cell.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, CM)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    arm = UsdGeom.Xform.Define(stage, "/arm").GetPrim()
    arm.GetReferences().AddReference("./theirs.usda")
    arm.SetInstanceable(True)
    stage.GetRootLayer().Save()
    with pytest.raises(FileError, match=r"joint /arm/joints/pan is inside an instance") as caught:
        laid(tmp_path, path=path)
    assert "cell.usda" in caught.value.detail
    assert "Set instanceable to false" in caught.value.detail
    arm.SetInstanceable(False)
    stage.GetRootLayer().Save()
    laid(tmp_path, path=path)


def test_a_client_without_the_package_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = source(tmp_path)
    for name in [name for name in sys.modules if name.partition(".")[0] == "pxr"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(MissingPackageError, match="pip install usd-core") as caught:
        lay_over(path, "#usda 1.0", tmp_path / "ours.usda")
    assert caught.value.code == "package_missing"
    assert not (tmp_path / "ours.usda").exists()


def test_cycles_are_refused(tmp_path: Path) -> None:
    path = source(tmp_path)
    cyclic = tmp_path / "cyclic.usda"
    cyclic.write_text("#usda 1.0\n(\n    subLayers = [@./theirs.usda@, @./cyclic.usda@]\n)\n")
    with pytest.raises(FileError, match=r"cyclic\.usda: cannot be composed"):
        laid(tmp_path, path=cyclic)
    assert path.exists()


def test_scaled_bodies_and_other_orders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="/robot/part3 is scaled by 2"):
        laid(tmp_path, path=source(tmp_path, scale=2.0))
    (tmp_path / "again").mkdir()
    with pytest.raises(FileError, match="does not carry"):
        laid(tmp_path / "again", joints=("lift", "pan", *NAMES[2:]))
    (tmp_path / "fewer").mkdir()
    with pytest.raises(FileError, match="--joints names 5 joints, the version has 6"):
        laid(tmp_path / "fewer", joints=NAMES[:5])
