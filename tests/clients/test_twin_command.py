"""`kilter version twin compare` against a real server: models of MuJoCo, one written here, on poses no fit has seen."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

import kilter as library
from kilter_client import Kilter
from kilter_client.twin.settled import distances_after_registration
from tests.clients.test_cli import Command
from tests.core.watch.drifting import DriftingArm, some_arm, some_poses

NOISE = 1e-5


@pytest.fixture(scope="module")
def arm() -> DriftingArm:
    return some_arm(np.random.default_rng(3))


@pytest.fixture
def k(server: Path) -> Iterator[Kilter]:
    with library.connect() as connected:
        yield connected


def written(path: Path, arm: DriftingArm, poses: int, seed: int) -> Path:
    rng = np.random.default_rng(seed)
    q = some_poses(poses, rng)
    seen = arm.measured(q, rng, NOISE).position
    assert seen is not None
    names = [*(f"q{k}_deg" for k in range(1, 7)), "x_mm", "y_mm", "z_mm"]
    np.savetxt(
        path, np.hstack([np.degrees(q), seen * 1e3]), delimiter=",", header=",".join(names), comments="", fmt="%.12g"
    )
    return path


def rigid(arm: DriftingArm, drives: str = "") -> str:
    """The nominal arm as somebody else would write it: a body behind each row of its table, and nothing that drives it."""
    inner = '<site name="flange"/>'
    for k in reversed(range(6)):
        d, a, alpha = arm.rows[k]
        com = " ".join(map(str, arm.centres[k]))
        inner = (
            f'<body name="turn{k + 1}"><joint name="axis{k + 1}" type="hinge" axis="0 0 1"/>'
            f'<body pos="{a} 0 {d}" quat="{np.cos(alpha / 2)} {np.sin(alpha / 2)} 0 0">'
            f'<inertial pos="{com}" mass="{arm.masses[k]}" diaginertia="1e-4 1e-4 1e-4"/>{inner}</body></body>'
        )
    return f'<mujoco><compiler angle="radian"/><worldbody>{inner}</worldbody><actuator>{drives}</actuator></mujoco>'


def stage_of(arm: DriftingArm, path: Path) -> Path:
    """The same as a stage of USD."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.ArticulationRootAPI.Apply(UsdGeom.Xform.Define(stage, "/arm").GetPrim())
    UsdGeom.Xform.Define(stage, "/arm/link0")
    for k, (d, a, alpha) in enumerate([(0.0, 0.0, 0.0), *arm.rows[:5]]):
        UsdGeom.Xform.Define(stage, f"/arm/link{k + 1}")
        joint = UsdPhysics.RevoluteJoint.Define(stage, f"/arm/axis{k + 1}")
        joint.CreateAxisAttr("Z")
        joint.CreateBody0Rel().SetTargets([f"/arm/link{k}"])
        joint.CreateBody1Rel().SetTargets([f"/arm/link{k + 1}"])
        joint.CreateLocalPos0Attr(Gf.Vec3f(a, 0.0, d))
        joint.CreateLocalRot0Attr(Gf.Quatf(np.cos(alpha / 2), np.sin(alpha / 2), 0.0, 0.0))
    stage.GetRootLayer().Save()
    return path


JOINTS = ",".join(f"axis{k}" for k in range(1, 7))


def test_the_twin_is_as_good_as_the_version_and_another_model_as_bad_as_the_nominal_arm(
    k: Kilter, arm: DriftingArm, command: Command, tmp_path: Path
) -> None:
    k.add_robot({**arm.document(), "name": "settling"})
    sent = k.upload("settling", written(tmp_path / "fit.csv", arm, 60, 1), name="fit", progress=False)
    held = k.upload(
        "settling", written(tmp_path / "held.csv", arm, 20, 2), name="held", role="validation", progress=False
    )
    fit = k.identify(
        "settling", sent, validation=held, effects=[{"id": "axial_compliance", "joints": [2, 3]}], masses="as_stated",
        progress=False,
    )  # fmt: skip
    assert fit.version_id is not None
    command("export", fit.version_id, "--format", "mjcf", "-o", tmp_path / "twin.xml")
    stages = k.versions.get(fit.version_id)["metrics"]["validation"]
    said = re.search(r"Held-out measured poses \(20\), .*", (tmp_path / "twin.xml").read_text())
    assert said is not None
    assert "Masses and centres count as exact, as asked" in (tmp_path / "twin.xml").read_text()
    assert f"rigid, calibrated {stages['geometry_fitted']['mean_mm']:.4f} mm, with the effects" in said[0]
    assert stages["geometry_fitted"]["mean_mm"] > 2.0 * stages["identified"]["mean_mm"]
    asked = ("held", "--robot", "settling", "--version", fit.version_id)
    found = command.json("twin", "compare", tmp_path / "twin.xml", *asked)
    errors = found["errors"]
    own = errors[str(tmp_path / "twin.xml")]
    assert own["mean_mm"] == pytest.approx(errors["identified"]["mean_mm"], abs=0.002)
    assert own["mean_mm"] < 0.05 < 0.2 < errors["nominal"]["mean_mm"]

    stiff = re.sub(r'kp="[^"]*"', 'kp="1e9"', (tmp_path / "twin.xml").read_text())
    stiff = re.sub(r'armature="[^"]*"', 'armature="1e5"', stiff)  # a gain comes to rest with the inertia for it
    (tmp_path / "stiff.xml").write_text(stiff)
    without = command.json("twin", "compare", tmp_path / "stiff.xml", *asked)["errors"][str(tmp_path / "stiff.xml")]
    assert without["mean_mm"] == pytest.approx(errors["without_effects"]["mean_mm"], abs=1e-3)
    assert errors["rigid"] == errors["without_effects"]
    assert without["mean_mm"] > 2.0 * own["mean_mm"]

    (tmp_path / "theirs.xml").write_text(rigid(arm))
    refused = command.json("twin", "compare", tmp_path / "theirs.xml", *asked, "--site", "flange", code=1)
    assert "has no joint 'j1'. It has: axis1, axis2" in refused["detail"]
    assert "--joints A,B,C" in refused["detail"]
    theirs = command.json("twin", "compare", tmp_path / "theirs.xml", *asked, "--site", "flange", "--joints", JOINTS)
    other = theirs["errors"][str(tmp_path / "theirs.xml")]
    assert other["mean_mm"] == pytest.approx(errors["nominal"]["mean_mm"], abs=1e-4)
    assert other["max_mm"] == pytest.approx(errors["nominal"]["max_mm"], abs=1e-4)
    text = command(
        "twin", "compare", tmp_path / "theirs.xml", *asked, "--site", "flange", "--joints", JOINTS, "--rows", "8"
    )
    assert "theirs.xml settled at 8 rows of " in text

    copy = tmp_path / "theirs-0042.xml"
    laid = command.json("twin", "onto", tmp_path / "theirs.xml", fit.version_id, "-o", copy, "--joints", JOINTS)
    assert "Masses and the rest of the source are as they were" in laid["notes"][0]
    assert (tmp_path / "theirs.xml").read_text() == rigid(arm)
    found = command.json("twin", "compare", copy, *asked, "--site", "kilter_tool", "--joints", JOINTS)
    assert found["errors"][str(copy)]["mean_mm"] == pytest.approx(own["mean_mm"], abs=0.002)
    same = command.json("twin", "onto", copy, fit.version_id, "-o", copy, code=2)
    assert "is the model itself" in same["detail"]

    stage = stage_of(arm, tmp_path / "theirs.usda")
    layer = tmp_path / "theirs-0042.usda"
    over = ("twin", "onto", stage, fit.version_id, "--joints", JOINTS)
    laid = command.json(*over, "-o", layer)
    assert any("In the stage: axial_compliance, worth" in note for note in laid["notes"])
    opened = Usd.Stage.Open(str(layer))
    stiffness_nm_deg = UsdPhysics.DriveAPI(opened.GetPrimAtPath("/arm/axis2"), "angular").GetStiffnessAttr().Get()
    assert np.radians(1.0) / arm.compliance[1] == pytest.approx(stiffness_nm_deg, rel=0.1)
    assert "--site is of models of MuJoCo" in command.json(*over, "-o", layer, "--site", "flange", code=2)["detail"]
    assert "name it .usda" in command.json(*over, "-o", tmp_path / "arm.xml", code=2)["detail"]


def test_models_that_cannot_be_settled_are_refused_with_the_remedy(
    k: Kilter, arm: DriftingArm, command: Command, tmp_path: Path
) -> None:
    k.add_robot({**arm.document(), "name": "unsettled"})
    k.upload("unsettled", written(tmp_path / "held.csv", arm, 8, 2), name="held", progress=False)
    k.upload("unsettled", written(tmp_path / "few.csv", arm, 4, 3), name="few", progress=False)
    model = tmp_path / "theirs.xml"

    def refusal(text: str, campaign: str = "held", *more: str) -> str:
        model.write_text(text)
        asked = ("twin", "compare", model, campaign, "--robot", "unsettled", "--joints", JOINTS, *more)
        said = command.json(*asked, code=2 if campaign == "few" else 1)
        return f"{said['code']}: {said['detail']}"

    assert "has no site 'tool'. It has: flange." in refusal(rigid(arm))
    assert "base and tool need 6" in refusal(rigid(arm), "few", "--site", "flange")
    loop = rigid(arm).replace("<worldbody>", '<include file="theirs.xml"/><worldbody>')
    assert refusal(loop).startswith(f"model_includes: {model}: MuJoCo cannot load it")
    assert "Take out the <include> that names a file a second time" in refusal(loop)
    (tmp_path / "other.xml").write_text('<mujoco><include file="theirs.xml"/></mujoco>')
    told = refusal(loop.replace('file="theirs.xml"', 'file="other.xml"'))
    assert "'theirs.xml' already included" in told
    assert "Take out the <include> that names a file a second time" in told
    mesh = rigid(arm).replace("<worldbody>", '<asset><mesh name="m" file="gone.stl"/></asset><worldbody>')
    assert "gone.stl" in (told := refusal(mesh))
    assert told.startswith("model_files: ")
    assert refusal(rigid(arm).replace("<worldbody>", "<worlds>", 1)).startswith("model_invalid: ")
    swinging = "".join(f'<position joint="axis{j}" kp="1e7"/>' for j in range(1, 7))
    told = refusal(rigid(arm, swinging), "held", "--site", "flange", "--step-ms", "5")
    assert "does not come to rest at steps of 5 ms" in told
    assert "--step-ms" in told


def test_base_and_tool_are_fitted_whatever_they_are() -> None:
    """Frames and points that another program made, with the tool half a metre off and the base turned about."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(5)
    turns = Rotation.random(30, random_state=1).as_matrix()
    places = rng.normal(0.0, 0.4, (30, 3))
    base, shift, tool = (
        Rotation.from_rotvec([2.0, -1.0, 0.5]).as_matrix(),
        np.array([1.0, -2.0, 0.3]),
        np.array([0.1, 0.4, -0.3]),
    )
    points = (places + turns @ tool) @ base.T + shift
    assert distances_after_registration(places, turns, points).max() < 1e-12
    off = rng.normal(0.0, 1e-3, points.shape)
    left = distances_after_registration(places, turns, points + off)
    assert 0.7 * np.linalg.norm(off, axis=1).mean() < left.mean() < np.linalg.norm(off, axis=1).mean()
