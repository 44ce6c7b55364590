"""Errors of joints that slide: carriages moved by hand, and booms that MuJoCo bends."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.effects import make_effect
from kilter_core.errors import OptionError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.observations import Observations
from tests.core.effects.by_hand import G, effect_on, inserted, robot_of, tool_with
from tests.core.truth import Arm, Body, Step

Floats = NDArray[np.float64]
RNG = np.random.default_rng(61)
# A carriage along the floor, and an arm of two joints on it.
GANTRY = Arm(
    (
        Step("tz", 0.5, name="up"), Step("tx", 0.0, 0, name="x"), Step("rx", name="square_x"), Step("ry", name="square_y"),
        Step("rz", 0.0, 1, name="one"), Step("tx", 0.6, name="a"), Step("rx", name="twist"), Step("ry", 0.0, 2, name="two"),
        Step("tx", 0.5, name="b"),
    ), 3, tool=pin.SE3(np.eye(3), np.array([0.1, 0.05, -0.1])),
)  # fmt: skip
TRAVEL = (-1.0, 1.6)


def gantry_rows(count: int) -> Floats:
    return np.column_stack([RNG.uniform(*TRAVEL, count), RNG.uniform(-2.5, 2.5, (count, 2))])


def over(q: Floats) -> Floats:
    """Reading of the carriage as -1 to 1 over the travel."""
    return np.asarray((q - np.mean(TRAVEL)) / (0.5 * np.ptp(TRAVEL)))


def carried(q: Floats, twists: Floats) -> list[pin.SE3]:
    """Tool poses with twists (N, 6) of the carriage in its joint frame."""
    return [inserted(GANTRY, row, joints={0: twist}) for row, twist in zip(q, twists, strict=True)]


def test_a_carriage_leaves_its_line_and_rotates() -> None:
    q = gantry_rows(6)
    q[:2, 0] = TRAVEL
    u = over(q[:, 0])
    twists = np.zeros((6, 6))
    twists[:, 0] = 3e-4 * (3 * u**2 - 1) / 2  # x of the joint frame is y of the base: the joint's z is its axis
    twists[:, 4] = -2e-4 * u + 1e-4 * (5 * u**3 - 3 * u) / 2
    rows = Observations(q)
    shift, turn = effect_on(GANTRY, "straightness", rows), effect_on(GANTRY, "guide_rotation", rows)
    assert shift.joints == turn.joints == (0,)
    for k, pose in enumerate(carried(q, np.hstack([twists[:, :3], np.zeros((6, 3))]))):
        found = tool_with(GANTRY, shift, {"straight2_x_1": 3e-4}, rows)
        np.testing.assert_allclose(found.position[k], pose.translation, atol=1e-12)
    for k, pose in enumerate(carried(q, np.hstack([np.zeros((6, 3)), twists[:, 3:]]))):
        found = tool_with(GANTRY, turn, {"guide1_ry_1": -2e-4, "guide3_ry_1": 1e-4}, rows)
        np.testing.assert_allclose(found.position[k], pose.translation, atol=1e-12)
        np.testing.assert_allclose(found.rotation[k], pose.rotation, atol=1e-12)


def test_they_act_at_prismatic_joints_that_moved_and_straightness_begins_at_two() -> None:
    rows = Observations(gantry_rows(5))
    for name in ("straightness", "guide_rotation", "telescope_bending"):
        with pytest.raises(OptionError, match=r"joint 2: .*revolute"):
            effect_on(GANTRY, name, rows, joints=[1])
    still = Observations(np.column_stack([np.full(4, 0.2), RNG.uniform(-1, 1, (4, 2))]))
    with pytest.raises(OptionError, match="did not move"):
        effect_on(GANTRY, "straightness", still)
    with pytest.raises(OptionError, match="from 2 to 12"):
        make_effect("straightness", orders=(1, 2))


def test_a_fit_and_a_search_find_how_the_carriage_runs() -> None:
    """Truth is a bump of no polynomial; the residual of rows not fitted falls to the noise."""
    q = gantry_rows(140)
    q[0, 0], q[1, 0] = TRAVEL
    u = over(q[:, 0])
    twists = np.zeros((140, 6))
    twists[:, 1] = 2.5e-4 * np.sin(2.2 * u + 0.3)
    twists[:, 3] = 3e-4 * u - 1e-4 * u**2
    rng = np.random.default_rng(5)
    measured = np.array([pose.translation for pose in carried(q, twists)]) + 1e-5 * rng.standard_normal((140, 3))
    rows = Observations(q, position=measured)
    robot = robot_of(GANTRY)
    fit, rest = rows.select(slice(0, 100)), rows.select(slice(100, 140))
    left = {}
    for effects in ((), ("straightness", "guide_rotation")):
        found = identify(robot, fit, options=IdentifyOptions(effects=effects, noise_mm=0.01)).calibration
        left[effects] = float(np.sqrt(np.mean((found.predict(rest).position - rest.position) ** 2)))
    assert left[()] > 5e-5
    assert left["straightness", "guide_rotation"] < 1.5e-5
    options = GapOptions(
        effects=("straightness", "guide_rotation", "encoder_scale", "unknown_smooth_curve"), noise_mm=0.01
    )
    names = {(e["id"], tuple(e["joints"])) for e in find_gap(robot, fit, options).to_document()["effects"]}
    assert {("straightness", (1,)), ("guide_rotation", (1,))} <= names


SEGMENTS = 60
EI = 5e4  # N m²
LOAD_KG, LEVER = 11.0, np.array([0.12, -0.07, 0.25])  # what hangs on the end of the boom, off its axis


def boom(turn: float, lean: float, length: float, kg: float) -> tuple[Floats, Floats]:
    """Where a boom of many hinges with springs comes to rest: position and rotation of its end.

    It stands on a joint about the vertical and leans by a second one; MuJoCo gives the torques of the load on the hinges.
    """
    piece = length / SEGMENTS
    hinges = "".join(
        f'<body pos="0 0 {0.5 * piece if k == 0 else piece}"><joint name="x{k}" type="hinge" axis="1 0 0"/>'
        f'<joint name="y{k}" type="hinge" axis="0 1 0"/><geom type="sphere" size="0.001" mass="1e-6"/>'
        for k in range(SEGMENTS)
    )
    x, y, z = LEVER + np.array([0.0, 0.0, 0.5 * piece])
    weight = f'<body pos="{x} {y} {z}"><geom type="sphere" size="0.01" mass="{kg}"/></body>'
    xml = f"""<mujoco><compiler angle="radian"/><option gravity="0 0 -{G}"/><worldbody>
        <body euler="0 0 {turn}"><body euler="0 {lean} 0">
        {hinges}<site name="end" pos="0 0 {0.5 * piece}"/>{weight}{"</body>" * (SEGMENTS + 2)}
        </worldbody></mujoco>"""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    for _ in range(12):
        mujoco.mj_forward(model, data)  # at rest the bias is what gravity needs to be held
        data.qpos[:] = -data.qfrc_bias * piece / EI
    mujoco.mj_forward(model, data)
    return data.site("end").xpos.copy(), data.site("end").xmat.reshape(3, 3).copy()


def test_the_flexibility_of_an_extended_boom_is_found_from_where_mujoco_lets_it_rest() -> None:
    arm = Arm(
        (Step("rz", 0.0, 0, name="turn"), Step("ry", 0.0, 1, name="lean"), Step("tz", 0.0, 2, name="out")), 3,
        tool=pin.SE3(np.eye(3), LEVER), bodies=(Body(2, 1e-9, np.zeros(3)),),
    )  # fmt: skip
    rng = np.random.default_rng(9)
    count = 50
    q = np.column_stack([rng.uniform(-2, 2, count), rng.uniform(-1.7, 1.7, count), rng.uniform(0.3, 1.8, count)])
    kg = rng.choice([0.5, LOAD_KG], count)
    ends = [boom(*row, load) for row, load in zip(q, kg, strict=True)]
    position = np.array([p + R @ LEVER for p, R in ends])
    rows = Observations(q, position=position, payload_kg=kg, payload_com=np.zeros((count, 3)))
    straight = arm.poses(q)[0]
    assert np.linalg.norm(position - straight, axis=1).max() > 2e-3
    robot = robot_of(arm)
    effect = {"id": "telescope_bending", "roots_m": [0.0]}
    held = {"base": "fixed", "tool": "fixed", "masses": "as_stated", "fix": ("turn", "lean", "out"), "noise_mm": 0.005}
    found = identify(robot, rows, options=IdentifyOptions(effects=(effect,), **held)).calibration
    value = found.values[found.names.index("telescope_3")]
    assert value == pytest.approx(1.0 / EI, rel=0.01)
    left = np.linalg.norm(found.predict(rows).position - position, axis=1)
    assert left.max() < 0.02 * np.linalg.norm(position - straight, axis=1).max()


def test_a_telescope_needs_the_reading_at_which_nothing_stands_out() -> None:
    free = Arm((Step("tz", 0.0, 0), Step("tx", 0.1)), 1, limits=(-np.inf, np.inf))
    with pytest.raises(OptionError, match="roots_m"):
        effect_on(free, "telescope_bending")
    with pytest.raises(OptionError, match="one of roots_m"):
        effect_on(GANTRY, "telescope_bending", roots_m=(0.0, 1.0))


def test_a_carriage_on_a_bent_rail_is_where_mujoco_says() -> None:
    """Straightness, pitch, yaw and roll of one rail, of no polynomial: rows that were not fitted come out at the noise."""
    axes = [f'<joint name="{a}{n}" type="{kind}" axis="{way}"/>' for kind, a in (("slide", "t"), ("hinge", "r"))
            for n, way in enumerate(("1 0 0", "0 1 0", "0 0 1"))]  # fmt: skip
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><compiler angle="radian"/><worldbody><body pos="0 0 0.5"><joint name="q0" type="slide" axis="1 0 0"/>'
        + '<geom type="sphere" size="0.01" mass="1"/><body>' + "".join(axes[1:])
        + '<geom type="sphere" size="0.01" mass="1"/><body><joint name="q1" type="hinge" axis="0 0 1"/>'
        '<geom type="sphere" size="0.01" mass="1"/><body pos="0.6 0 0"><joint name="q2" type="hinge" axis="0 1 0"/>'
        '<geom type="sphere" size="0.01" mass="1"/><site name="tool" pos="0.6 0.05 -0.1"/></body></body></body></body>'
        "</worldbody></mujoco>"
    )  # fmt: skip
    arm = Arm(
        (Step("tz", 0.5, name="up"), Step("tx", 0.0, 0, name="x"), Step("rx", name="square_x"), Step("ry", name="square_y"),
         Step("rz", 0.0, 1, name="one"), Step("tx", 0.6, name="a"), Step("rx", name="twist"), Step("ry", 0.0, 2, name="two"),
         Step("tx", 0.5, name="b")), 3, tool=pin.SE3(np.eye(3), np.array([0.1, 0.05, -0.1])),
    )  # fmt: skip
    rng = np.random.default_rng(12)
    q = np.column_stack([rng.uniform(*TRAVEL, 160), rng.uniform(-2.5, 2.5, (160, 2))])
    q[0, 0], q[1, 0] = TRAVEL
    u, data, points = over(q[:, 0]), mujoco.MjData(model), np.empty((160, 3))
    errors = {
        "t1": 2e-4 * np.cos(1.8 * u), "t2": -2.5e-4 * np.sin(2.1 * u + 0.4),
        "r0": 1.5e-4 * np.sin(1.4 * u), "r1": 2e-4 * np.cos(1.9 * u + 0.5), "r2": -2e-4 * np.sin(1.6 * u),
    }  # fmt: skip
    for k, row in enumerate(q):
        data.qpos[[model.joint(f"q{j}").id for j in range(3)]] = row
        data.qpos[[model.joint(name).id for name in errors]] = [error[k] for error in errors.values()]
        mujoco.mj_forward(model, data)
        points[k] = data.site("tool").xpos
    rows = Observations(q, position=points + 1e-5 * rng.standard_normal(points.shape))
    left = {}
    for effects in (("straightness",), ("straightness", "guide_rotation")):
        options = IdentifyOptions(effects=effects, noise_mm=0.01)
        found = identify(robot_of(arm), rows.select(slice(0, 120)), options=options).calibration
        rest = rows.select(slice(120, 160))
        left[effects] = float(np.sqrt(np.mean((found.predict(rest).position - rest.position) ** 2)))
    assert left["straightness", "guide_rotation"] < 1.5e-5 < 3e-5 < left["straightness",]
