"""A twin laid onto a model that somebody else wrote: settled, its tool is where Kilter predicts it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import kilter.twin
from kilter_client.errors import FileError
from kilter_client.twin.onto import lay_onto
from kilter_core.arm.presets import preset_document
from kilter_core.observations import Observations
from tests.service.exporters.test_mjcf import BACKLASH, GEOMETRY, SAG, WINDUP, poses, twin

Floats = NDArray[np.float64]

NAMES = ("pan", "lift", "elbow", "w1", "w2", "w3")
# where the model stands in its scene, in degrees as its compiler has them
PLACE = np.array([0.4, -0.3, 0.8])
TURN = (10.0, 0.0, 30.0)


def source(folder: Path, zero_of_elbow: float = 0.0) -> Path:
    """The nominal UR10 as another would write it: degrees, classes, two bodies a joint, force limits, a mesh."""
    document = preset_document("ur10")
    inner = '<body name="hand"><site name="ee" euler="0 90 0"/><geom size="0.02" mass="0"/></body>'
    for k in reversed(range(6)):
        row, link = document["rows"][k], document["links"][k]
        com = " ".join(str(v / 1e3) for v in link["com_mm"])
        turn = f'euler="0 0 {zero_of_elbow}"' if k == 2 else ""
        inner = (
            f'<body name="{NAMES[k]}_axis" {turn}><joint class="servo" name="{NAMES[k]}" axis="0 0 1" range="-360 360"/>'
            f'<body pos="{row["a_mm"] / 1e3} 0 {row["d_mm"] / 1e3}" euler="{row["alpha_deg"]} 0 0">'
            f'<inertial pos="{com}" mass="{link["mass_kg"]}" diaginertia="1e-4 1e-4 1e-4"/>{inner}</body></body>'
        )
    drives = "".join(f'<position name="m_{name}" class="servo" joint="{name}"/>' for name in NAMES[:5])
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "parts/cube.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    path = folder / "theirs.xml"
    path.write_text(f"""<mujoco model="theirs"><compiler meshdir="parts"/><asset><mesh name="cube" file="cube.obj"/></asset>
    <default><default class="servo"><joint damping="3" stiffness="50" frictionloss="0.5"/>
    <position kp="40" forcerange="-5 5"/></default></default>
    <worldbody><geom name="cube" type="mesh" mesh="cube" contype="0" conaffinity="0" pos="3 3 0"/>
    <body name="stand" pos="{PLACE[0]} {PLACE[1]} {PLACE[2]}" euler="{TURN[0]} {TURN[1]} {TURN[2]}">{inner}</body></worldbody>
    <actuator>{drives}</actuator></mujoco>""")
    return path


def settled(model: mujoco.MjModel, q: Floats, side: float, step: bool) -> mujoco.MjData:
    data = mujoco.MjData(model)
    start = q - 0.02 * side
    joints = [model.joint(name) for name in NAMES]
    drives = [next(a for a in range(model.nu) if model.actuator_trnid[a, 0] == joint.id) for joint in joints]
    data.qpos[[joint.qposadr[0] for joint in joints]] = data.ctrl[drives] = start
    for k in range(1000):
        data.ctrl[drives] = start + 0.02 * side * min(1.0, k / 500)
        if step and k % 8 == 0:
            kilter.twin.apply(model, data)
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)
    return data


def in_base(point: Floats) -> Floats:
    """A point of the scene in the base frame of the arm that stands in it."""
    return Rotation.from_euler("XYZ", TURN, degrees=True).as_matrix().T @ (point - PLACE)


def tilted_gravity() -> list[float]:
    return (Rotation.from_euler("XYZ", TURN, degrees=True).as_matrix().T @ np.array([0.0, 0.0, -9.80665])).tolist()


def laid_onto(folder: Path, effects: Any, values: Any, **more: Any) -> tuple[str, Any, tuple[str, ...]]:
    exported, calibration = twin(effects, values, gravity_m_s2=tilted_gravity())
    laid = lay_onto(source(folder), str(exported.text), NAMES, **more)
    return laid.text, calibration, laid.notes


@pytest.mark.parametrize("step_s", [2e-3, 5e-3])
def test_the_copy_settles_where_the_version_says(tmp_path: Path, step_s: float) -> None:
    effects = ("axial_compliance", "backlash_load", "friction_windup", "encoder_scale")
    values = GEOMETRY | SAG | BACKLASH | WINDUP | {"encoder_scale_2": 4e-4, "encoder_scale_3": -3e-4}
    before = source(tmp_path).read_text()
    text, calibration, notes = laid_onto(tmp_path, effects, values, site="ee")
    assert (tmp_path / "theirs.xml").read_text() == before
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = step_s
    assert model.mesh("cube").id == 0
    for q in poses(calibration, 3):
        for side in (-1.0, 1.0):
            data = settled(model, q, side, step=True)
            told = calibration.predict(Observations(q[None], direction=np.full((1, 6), side)))
            for site in ("kilter_tool", "ee"):
                assert np.linalg.norm(in_base(data.site(site).xpos) - told.position[0]) * 1e6 < 20.0
            found = Rotation.from_euler("XYZ", TURN, degrees=True).as_matrix().T @ data.site(
                "kilter_tool"
            ).xmat.reshape(3, 3)
            assert np.abs(found - told.rotation[0]).max() < 5e-5
    assert any("Masses and the rest of the source are as they were" in note for note in notes)


def test_geometry_alone_is_exact_to_the_digits_of_the_file(tmp_path: Path) -> None:
    text, calibration, _ = laid_onto(tmp_path, (), GEOMETRY, site="ee")
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for q in np.random.default_rng(4).uniform(-2, 2, (20, 6)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        told = calibration.predict(Observations(q[None])).position[0]
        assert np.linalg.norm(in_base(data.site("kilter_tool").xpos) - told) * 1e6 < 4.0
        assert np.linalg.norm(in_base(data.site("ee").xpos) - told) * 1e6 < 4.0


def test_what_cannot_be_laid_on_is_named(tmp_path: Path) -> None:
    exported, _ = twin(("clearance_tilt",), {"clearance_2": math.radians(0.02)}, gravity_m_s2=tilted_gravity())
    path = source(tmp_path)
    assert any("tilts, bending, hardening" in note for note in lay_onto(path, str(exported.text), NAMES).notes)
    with pytest.raises(FileError, match=r"has no joint 'shoulder_pan'\. It has: pan, lift"):
        lay_onto(path, str(exported.text))
    with pytest.raises(FileError, match=r"has no site 'tip'\. It has: ee"):
        lay_onto(path, str(exported.text), NAMES, "tip")
    with pytest.raises(
        FileError, match=r"joint '\w+' is [\d.]+ mm and [\d.]+ deg from where the robot nominally has it"
    ):
        lay_onto(source(tmp_path, 5.0), str(exported.text), NAMES)
    path = source(tmp_path)
    (tmp_path / "parts/cube.obj").unlink()
    with pytest.raises(FileError, match=r"MuJoCo cannot load it.*cube\.obj"):
        lay_onto(path, str(exported.text), NAMES)


def test_the_copy_names_the_meshes_where_they_are(tmp_path: Path) -> None:
    text, _, _ = laid_onto(tmp_path, (), GEOMETRY)
    root = ElementTree.fromstring(text)
    compiler = root.find("compiler")
    assert compiler is not None
    assert Path(compiler.get("meshdir", "")) == (tmp_path / "parts").resolve()
