"""Documents of every convention describe the same arm: poses against Pinocchio, completeness by counting and by fitting."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from kilter_core.arm.conversions import robot_document
from kilter_core.arm.conversions.tables import screws_of_chain
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_wrenches import axial_loads, joint_loads
from kilter_core.arm.presets import preset_document
from kilter_core.errors import OptionError, RobotError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured
from tests.core.truth import Arm, Step, some_arm, some_pose, ur10, with_bodies, with_hidden_errors

Floats = NDArray[np.float64]
ANY_AXES = ("chain", "poe")
COMPLETE = ("poe", "cpc", "mcpc")
ONE_AXIS = ("cpc", "mcpc", "dh", "mdh", "s_model")


def poses(document: dict[str, Any], q: Floats) -> tuple[Floats, Floats]:
    model = RobotModel(robot_from_document(document))
    found = model.predict(Observations(q), model.values0())
    return found.position, found.rotation


def assert_same(arm: Arm, document: dict[str, Any], q: Floats, atol: float) -> None:
    position, rotation = arm.poses(q)
    found = poses(document, q)
    np.testing.assert_allclose(found[0], position, atol=atol, rtol=0)
    np.testing.assert_allclose(found[1], rotation, atol=atol, rtol=0)


def nearly_parallel(arm: Arm) -> bool:
    """Axes between parallel and ten degrees apart: their common normal is far away, and rounding grows with it."""
    z = screws_of_chain(robot_from_document(arm.document()).chain).direction
    sines = np.linalg.norm(np.cross(z[:-1], z[1:]), axis=1)
    return bool(np.any((sines > 1e-9) & (sines < 0.17)))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 7), slides=st.booleans(), coupled=st.booleans())
def test_chain_and_product_of_exponentials_keep_any_arm(seed: int, n: int, slides: bool, coupled: bool) -> None:
    rng = np.random.default_rng(seed)
    arm = some_arm(rng, n, prismatic=slides, coupled=coupled)
    robot, q = robot_from_document(arm.document()), rng.uniform(-2.0, 2.0, (6, n))
    for convention in ANY_AXES:
        assert_same(arm, robot_document(robot, convention), q, 1e-12)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 7), slides=st.booleans())
def test_every_convention_keeps_an_arm_with_one_axis_per_joint(seed: int, n: int, slides: bool) -> None:
    rng = np.random.default_rng(seed)
    arm = some_arm(rng, n, prismatic=slides)
    robot, q = robot_from_document(arm.document()), rng.uniform(-2.0, 2.0, (6, n))
    for convention in ONE_AXIS:
        if convention in COMPLETE or not nearly_parallel(arm):
            assert_same(arm, robot_document(robot, convention), q, 1e-12 if convention in COMPLETE else 1e-11)


@pytest.mark.parametrize("there", [*ANY_AXES, *ONE_AXIS])
@pytest.mark.parametrize("back", ["poe", "mcpc", "mdh"])
def test_there_and_back_is_the_published_ur10(there: str, back: str) -> None:
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (10, 6))
    away = robot_from_document(robot_document(robot_from_document(preset_document("ur10")), there))
    assert_same(ur10(), robot_document(away, back), q, 1e-12)


@pytest.mark.parametrize("convention", [*ANY_AXES, *ONE_AXIS])
def test_masses_stay_where_they_are(convention: str) -> None:
    rng = np.random.default_rng(3)
    arm = with_bodies(some_arm(rng, 6, prismatic=True), rng)
    assert not nearly_parallel(arm)
    document = robot_document(robot_from_document(arm.document()), convention)
    robot, q, qd, qdd = robot_from_document(document), *(rng.uniform(-2, 2, (5, 6)) for _ in range(3))
    found = axial_loads(robot, joint_loads(robot, q, qd=qd, qdd=qdd))
    # Gravity stands in the base frame of the nominal chain, which is the arm's own root here.
    root = replace(arm, base=type(arm.base).Identity())
    expected = [-root.reactions(*row)[0] for row in zip(q, qd, qdd, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-9, rtol=0)


def pose_jacobian(document: dict[str, Any], seed: int) -> tuple[Floats, list[str]]:
    robot = robot_from_document(document)
    model = RobotModel(robot)
    free = IdentifyOptions(base="fixed", tool="fixed").free_parameters(model, observes_orientation=True)
    q = np.random.default_rng(seed).uniform(-2.0, 2.0, (60, robot.n_joints))
    _, J = model.jacobian(Observations(q), model.values0(), free)
    return J.reshape(-1, len(free)), [model.names[k] for k in free]


@pytest.mark.parametrize("convention", COMPLETE)
@pytest.mark.parametrize(("n", "slides", "seed"), [(6, False, 0), (7, False, 1), (6, True, 2), (4, True, 4)])
def test_complete_models_have_4_r_2_p_6_parameters_and_none_too_many(
    convention: str, n: int, slides: bool, seed: int
) -> None:
    robot = robot_from_document(some_arm(np.random.default_rng(seed), n, prismatic=slides).document())
    turning = sum(joint.kind == "revolute" for joint in robot.joints)
    J, names = pose_jacobian(robot_document(robot, convention), seed)
    assert len(names) == 4 * turning + 2 * (n - turning) + 6
    assert np.linalg.matrix_rank(J) == len(names)


@pytest.mark.parametrize("convention", COMPLETE)
def test_parallel_axes_need_nothing_special_in_a_complete_model(convention: str) -> None:
    J, names = pose_jacobian(robot_document(robot_from_document(preset_document("ur10")), convention), 0)
    assert np.linalg.matrix_rank(J) == len(names) == 30
    s = np.linalg.svd(J, compute_uv=False)
    assert s[0] / s[-1] < 300.0


def test_zero_offsets_are_identified_at_level_1_or_when_asked_for() -> None:
    model = RobotModel(robot_from_document(robot_document(robot_from_document(preset_document("ur10")), "mcpc")))

    def chosen(**options: Any) -> list[str]:
        free = IdentifyOptions(base="fixed", tool="fixed", **options).free_parameters(model, observes_orientation=True)
        return [model.names[k] for k in free]

    offsets = [f"theta_offset_{k}" for k in range(1, 7)]
    assert chosen(level=1) == offsets
    assert not set(offsets) & set(chosen(level=2))
    assert chosen(free=("theta_offset_*",)) == offsets


@pytest.mark.parametrize("convention", ["poe", "cpc", "mcpc", "s_model"])
def test_an_arm_with_six_hidden_errors_at_every_joint_is_found_to_a_micrometre(convention: str) -> None:
    rng = np.random.default_rng(11)
    arm = with_hidden_errors(ur10(base=some_pose(rng, 3.0)), rng)
    robot = robot_from_document(robot_document(robot_from_document(preset_document("ur10")), convention))
    found = identify(
        robot,
        measured(arm, joints(arm, 80, rng), rng, see="pose"),
        measured(arm, joints(arm, 40, rng), rng, see="pose"),
    )
    held = found.metrics["validation"]
    assert held["registration_only"]["rms_mm"] > 1.0
    assert held["identified"]["max_mm"] < 1e-3


def test_a_mirrored_direction_and_odd_ends_are_read() -> None:
    """CPC and MCPC by their published formulas, multiplied out by hand."""
    rng = np.random.default_rng(5)
    b = np.array([0.3, -0.2, -0.7])
    b /= np.linalg.norm(b)
    # Zhuang, Roth and Hamano's R(b), written as in the paper.
    R = np.array([
        [1 - b[0] ** 2 / (1 + b[2]), -b[0] * b[1] / (1 + b[2]), b[0]],
        [-b[0] * b[1] / (1 + b[2]), 1 - b[1] ** 2 / (1 + b[2]), b[1]],
        [-b[0], -b[1], b[2]],
    ])  # fmt: skip
    document = {
        "convention": "cpc",
        "rows": [{"b": [0, 0, 1]}, {"b": list(b), "x_mm": 100, "y_mm": -50, "type": "prismatic"}],
        "flange": {"b": list(b), "beta_deg": 20, "x_mm": 1, "y_mm": 2, "z_mm": 3},
    }
    q = rng.uniform(-1, 1, (4, 2))
    position, rotation = poses(document, q)
    for row, p, found in zip(q, position, rotation, strict=True):
        c, s = np.cos(row[0]), np.sin(row[0])
        first = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        c, s = np.cos(np.radians(20)), np.sin(np.radians(20))
        last = R @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        along = R @ np.array([0.1, -0.05, row[1]]) + R @ last @ np.array([0.001, 0.002, 0.003])
        np.testing.assert_allclose(p, first @ along, atol=1e-15)
        np.testing.assert_allclose(found, first @ R @ last, atol=1e-15)
    upside_down = poses({"convention": "cpc", "rows": [{"b": [0, 0, -1]}], "flange": {"z_mm": 10}}, q[:, :1])[0]
    np.testing.assert_allclose(upside_down, np.tile([0, 0, -0.01], (4, 1)), atol=1e-15)


def test_the_product_of_exponentials_is_scipy_s_matrix_exponential() -> None:
    from scipy.linalg import expm

    rng = np.random.default_rng(6)
    z, p = rng.normal(size=(3, 3)), rng.normal(size=(3, 3))
    z /= np.linalg.norm(z, axis=1)[:, None]
    axes = [{"direction": list(z[k]), "point_mm": list(1e3 * p[k])} for k in range(3)]
    axes[1]["type"] = "prismatic"
    document = {"convention": "poe", "axes": axes, "home": {"x_mm": 100, "rz_deg": 30}}
    home = np.eye(4)
    home[:3, 3], home[:2, :2] = (0.1, 0, 0), [[np.sqrt(0.75), -0.5], [0.5, np.sqrt(0.75)]]
    q = rng.uniform(-2, 2, (5, 3))
    position, rotation = poses(document, q)
    for row, found, turn in zip(q, position, rotation, strict=True):
        T = np.eye(4)
        for k in range(3):
            screw = np.zeros((4, 4))
            screw[:3, 3] = z[k]
            if k != 1:
                screw[:3, :3] = np.array([[0, -z[k, 2], z[k, 1]], [z[k, 2], 0, -z[k, 0]], [-z[k, 1], z[k, 0], 0]])
                screw[:3, 3] = np.cross(p[k], z[k])
            T = T @ expm(screw * row[k])
        np.testing.assert_allclose(found, (T @ home)[:3, 3], atol=1e-13)
        np.testing.assert_allclose(turn, (T @ home)[:3, :3], atol=1e-13)


def test_what_a_convention_cannot_say_is_refused() -> None:
    coupled = robot_from_document(some_arm(np.random.default_rng(0), 3, coupled=True).document())
    with pytest.raises(RobotError, match="one axis per joint"):
        robot_document(coupled, "mcpc")
    steps = (Step("rz", 0.0, 0), Step("tx", 0.5), Step("rx", 0.002), Step("rz", 0.0, 1), Step("tx", 0.3))
    almost = Arm(tuple(replace(step, name=f"p{k}") for k, step in enumerate(steps)), 2)
    robot = robot_from_document(almost.document())
    with pytest.raises(RobotError, match="mdh"):
        robot_document(robot, "dh")
    q = np.random.default_rng(0).uniform(-2, 2, (4, 2))
    for convention in ("mdh", *COMPLETE):
        assert_same(almost, robot_document(robot, convention), q, 1e-12)
    with pytest.raises(OptionError, match="s_model"):
        robot_document(robot, "euler")
    for document, where in (
        ({"convention": "poe", "axes": [{"direction": [0, 0, 0]}]}, r"axes\[0\].direction"),
        ({"convention": "poe"}, "needs axes"),
        ({"convention": "poe", "joints": [{"name": "a"}], "axes": [{"direction": [0, 0, 1], "joint": "b"}]}, "'b'"),
        ({"convention": "cpc"}, "needs rows"),
        ({"convention": "mcpc", "rows": [{}, {}], "joints": [{"name": "a"}]}, "2 rows but 1 joints"),
    ):
        with pytest.raises(RobotError, match=where):
            robot_from_document(document)
