"""A shaft that twists: MuJoCo settles an arm whose elbow is drawn beside it, as data sheets of arms with parallel axes do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.effects import make_effect
from kilter_core.errors import OptionError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations

Floats = NDArray[np.float64]

STIFF = 2.5e4  # of the upper arm, Nm/rad
AXES = ("z", "y", "y", "x", "z")
PLACES = (
    (0.0, 0.0, 0.3),
    (0.0, 0.14, 0.1),
    (0.0, -0.12, 0.61),
    (0.0, 0.05, 0.3),
    (0.1, 0.0, 0.25),
)  # each in the link before
MASSES = (6.0, 12.0, 6.0, 3.0, 2.0)
CENTRES = ((0.03, 0.02, 0.1), (0.0, 0.0, 0.3), *((0.03, 0.02, 0.1),) * 3)  # that of the shaft is on its axis
TOOL = (0.12, 0.15, 0.1)


def settled(q: Floats) -> Floats:
    """Tool points (N, 3) m of an arm whose upper arm twists about its own length, z of its joint."""
    arm = ""
    for k, (axis, place, kg) in enumerate(zip(AXES, PLACES, MASSES, strict=True)):
        along = " ".join("1" if axis == one else "0" for one in "xyz")
        arm += f'<body pos="{" ".join(map(str, place))}"><joint name="q{k}" type="hinge" axis="{along}"/>'
        arm += f'<geom type="sphere" size="0.03" mass="{kg}" pos="{" ".join(map(str, CENTRES[k]))}"/>'
        if k == 1:
            arm += f'<joint name="twist" type="hinge" axis="0 0 1" stiffness="{STIFF}"/>'
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody>'
        + arm + f'<site name="tool" pos="{" ".join(map(str, TOOL))}"/>' + "</body>" * len(AXES) + "</worldbody></mujoco>"
    )  # fmt: skip
    data, twist, out = mujoco.MjData(model), model.joint("twist").id, np.empty((len(q), 3))
    driven = [model.joint(f"q{k}").id for k in range(len(AXES))]
    for k, pose in enumerate(q):
        data.qpos[:] = 0.0
        data.qpos[driven] = pose
        for _ in range(20):
            mujoco.mj_forward(model, data)
            data.qpos[twist] = -data.qfrc_bias[twist] / STIFF
        mujoco.mj_forward(model, data)
        out[k] = data.site("tool").xpos
    return out


@dataclass(frozen=True)
class Drawn:
    """An arm as it is drawn: axis, place in the link before, mass and its centre of each joint; and its tool."""

    axes: Sequence[str]
    places: Sequence[tuple[float, ...]]
    masses: Sequence[float]
    centres: Sequence[tuple[float, ...]]
    tool: tuple[float, ...]


def robot(shift: float = 0.0, drawn: Drawn = Drawn(AXES, PLACES, MASSES, CENTRES, TOOL)) -> Robot:
    """The arm as it is drawn; ``shift`` m moves the origins of elbow and forearm along the elbow's axis, to nobody's notice."""
    elements: list[dict[str, Any]] = []
    links = []
    for k, (axis, place, kg) in enumerate(zip(drawn.axes, drawn.places, drawn.masses, strict=True)):
        moved = np.array(place)
        moved[1] += {2: shift, 3: -shift}.get(k, 0.0)
        elements += [{"axis": f"T{c}", "value": 1e3 * v} for c, v in zip("xyz", moved.tolist(), strict=True)]
        elements.append({"axis": f"R{axis}", "joint": f"j{k + 1}", "name": f"zero_{k + 1}"})
        centre = np.array(drawn.centres[k]) - [0.0, shift if k == 2 else 0.0, 0.0]
        links.append({"joint": f"j{k + 1}", "mass_kg": kg, "com_mm": (1e3 * centre).tolist()})
    document = {
        "name": "beside", "convention": "chain", "elements": elements, "links": links,
        "joints": [{"name": f"j{k + 1}", "limits_deg": [-180, 180]} for k in range(len(drawn.axes))],
        "base": {f"{k}_mm": 0 for k in "xyz"} | {f"r{k}_deg": 0 for k in "xyz"},
        "tool": {f"{k}_mm": 1e3 * v for k, v in zip("xyz", drawn.tool, strict=True)} | {f"r{k}_deg": 0 for k in "xyz"},
    }  # fmt: skip
    return robot_from_document(document)


@pytest.mark.parametrize("shift", [0.0, 0.12, 0.5])
def test_an_offset_along_parallel_axes_is_not_the_way_of_the_shaft(shift: float) -> None:
    """Wherever along the axis of the elbow its origin is drawn, the same twist is found."""
    rng = np.random.default_rng(4)
    q = rng.uniform(-2.0, 2.0, (90, len(AXES)))
    position = settled(q) + rng.normal(0.0, 1e-5, (90, 3))
    rows = Observations(q, position=position)
    arm = robot(shift)
    twist = {"id": "link_torsion", "joints": [2]}
    options = IdentifyOptions(effects=(twist,), noise_mm=0.01, masses="as_stated")
    found = identify(arm, rows.select(slice(0, 60)), options=options).calibration
    value = dict(zip(found.names, found.values, strict=True))["torsion_2"]
    assert value == pytest.approx(1.0 / STIFF, rel=0.02)
    rest = rows.select(slice(60, 90))
    assert rest.position is not None
    predicted = found.predict(rest).position
    assert predicted is not None
    assert np.sqrt(np.mean((predicted - rest.position) ** 2)) < 1.5e-5


def test_a_version_from_before_keeps_its_line_and_a_shaft_may_be_stated() -> None:
    """Its document says nothing of directions: it was fitted with shafts that lead to the next joint."""
    arm = robot()
    line = arm.chain.link_vectors[1] / np.linalg.norm(arm.chain.link_vectors[1])
    rows = Observations(np.random.default_rng(1).uniform(-2.0, 2.0, (9, len(AXES))))

    def points(**stated: Any) -> Floats:
        made = RobotModel(arm, (make_effect("link_torsion", joints=(1,)),))
        document = Calibration(made, made.values0()).to_document()
        (effect,) = document["effects"]
        assert effect["directions"] == [pytest.approx([1.0, 0.0, 0.0])]  # z of the link is x of the joint frame
        document["effects"] = [{name: effect[name] for name in ("id", "joints")} | stated]
        document["values"]["torsion_2"] = 1e-4
        found = Calibration.from_document(arm, document).predict(rows).position
        assert found is not None
        return found

    assert points() == pytest.approx(points(directions=[(2.0 * line).tolist()]), abs=1e-12)
    across = np.abs(points() - points(directions=[[1.0, 0.0, 0.0]]))
    assert across.max() > 1e-5
    for wrong in ([[0.0, 0.0, 0.0]], [[1.0, 0.0]], [[1.0, 0.0, 0.0]] * 2):
        with pytest.raises(OptionError, match="one of directions"):
            points(directions=wrong)
