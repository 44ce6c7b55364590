"""A soft mount under a soft gear, both about one axis: MuJoCo settles the arm, of which only the sum of both can be known."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.observations import Observations

Floats = NDArray[np.float64]

MOUNT, GEAR = 2.0e5, 1.2e5  # N m/rad
AXES, PLACES = ("y", "y", "x"), ((0.0, 0.0, 0.0), (0.0, 0.0, 0.6), (0.0, 0.0, 0.4))
MASSES, CENTRES = (22.0, 11.0, 6.0), ((0.02, 0.01, 0.3), (0.0, 0.03, 0.2), (0.05, 0.02, 0.1))
TOOL = (0.12, 0.1, 0.25)
NOISE_M = 1e-5


def settled(q: Floats) -> Floats:
    """Tool points (N, 3) m of the arm at rest on both springs."""
    arm = '<body><joint name="mount" type="hinge" axis="0 1 0"/><geom type="sphere" size="0.01" mass="1e-6"/>'
    for k, (axis, place) in enumerate(zip(AXES, PLACES, strict=True)):
        along = " ".join("1" if axis == one else "0" for one in "xyz")
        arm += f'<body pos="{" ".join(map(str, place))}"><joint name="q{k}" type="hinge" axis="{along}"/>'
        arm += '<joint name="gear" type="hinge" axis="0 1 0"/>' if k == 0 else ""
        arm += f'<geom type="sphere" size="0.03" mass="{MASSES[k]}" pos="{" ".join(map(str, CENTRES[k]))}"/>'
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody>' + arm
        + f'<site name="tool" pos="{" ".join(map(str, TOOL))}"/>' + "</body>" * 4 + "</worldbody></mujoco>"
    )  # fmt: skip
    data, out = mujoco.MjData(model), np.empty((len(q), 3))
    driven = [model.joint(f"q{k}").id for k in range(len(AXES))]
    soft, stiffness = [model.joint(name).id for name in ("mount", "gear")], np.array([MOUNT, GEAR])
    for k, pose in enumerate(q):
        data.qpos[:] = 0.0
        data.qpos[driven] = pose
        for _ in range(20):
            mujoco.mj_forward(model, data)
            data.qpos[soft] = -data.qfrc_bias[soft] / stiffness
        mujoco.mj_forward(model, data)
        out[k] = data.site("tool").xpos
    return out


def robot() -> Robot:
    elements: list[dict[str, Any]] = []
    links = []
    for k, (axis, place) in enumerate(zip(AXES, PLACES, strict=True)):
        elements += [{"axis": f"T{c}", "value": 1e3 * v} for c, v in zip("xyz", place, strict=True)]
        elements.append({"axis": f"R{axis}", "joint": f"j{k + 1}", "name": f"zero_{k + 1}"})
        links.append({"joint": f"j{k + 1}", "mass_kg": MASSES[k], "com_mm": [1e3 * c for c in CENTRES[k]]})
    none = {f"r{k}_deg": 0 for k in "xyz"}
    return robot_from_document({
        "name": "mounted", "convention": "chain", "elements": elements, "links": links,
        "joints": [{"name": f"j{k + 1}", "limits_deg": [-180, 180]} for k in range(len(AXES))],
        "base": {f"{k}_mm": 0 for k in "xyz"} | none,
        "tool": {f"{k}_mm": 1e3 * v for k, v in zip("xyz", TOOL, strict=True)} | none,
    })  # fmt: skip


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_compliances_about_one_axis_are_known_by_their_sum(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.6, 1.6, (60, len(AXES)))
    rows = Observations(q, position=settled(q) + rng.normal(0.0, NOISE_M, (60, 3)))
    effects = ({"id": "axial_compliance", "joints": [1]}, "base_compliance")
    options = IdentifyOptions(effects=effects, noise_mm=1e3 * NOISE_M, masses="as_stated")
    told = identify(robot(), rows, options=options).to_document()["null_directions"]
    (found,) = [
        one for direction in told for one in direction["sums"]
        if {"compliance_1", "base_compliance_y"} == {p["name"] for p in one["parameters"]}
    ]  # fmt: skip
    assert [p["coefficient"] for p in found["parameters"]] == pytest.approx([1.0, 1.0], rel=1e-3)
    true = np.degrees(1.0 / MOUNT + 1.0 / GEAR)
    assert found["unit"] == "deg/(N m)"
    assert found["sigma"] < 0.05 * true
    assert abs(found["value"] - true) < 3.0 * found["sigma"]
    assert "Together they are known: " in found["sentence"]
