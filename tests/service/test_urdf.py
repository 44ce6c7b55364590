"""The URDF importer against Pinocchio, on random trees."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.load_wrenches import axial_loads, joint_loads
from kilter_core.errors import RobotError
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_service.robots.importers.urdf import UrdfImport, chain_document

Floats = NDArray[np.float64]

LINK = """<link name="{name}"><inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{mass}"/>
<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="-0.002" iyz="0.003"/></inertial></link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
<limit lower="-2" upper="2.5" effort="1" velocity="1"/>{mimic}</joint>"""
AXES = ["1 0 0", "0 1 0", "0 0 1", "-1 0 0", "0 0 -1", "0.3 -0.7 0.64", "1 1 0"]


def numbers(values: Floats) -> str:
    return " ".join(repr(float(value)) for value in values)


def random_urdf(seed: int, mimic: bool = False) -> str:
    """A chain base - l1 - ... - tip with fixed and moving branches hanging on every link."""
    rng = np.random.default_rng(seed)
    parts = [LINK.format(name="base", xyz="0 0 0", rpy="0 0 0", mass=3.0)]

    def attach(parent: str, child: str, joint: str, kind: str, follows: str = "") -> None:
        parts.append(
            LINK.format(
                name=child,
                xyz=numbers(rng.normal(0, 0.1, 3)),
                rpy=numbers(rng.normal(0, 1, 3)),
                mass=rng.uniform(0.1, 3),
            )
        )
        axis = AXES[rng.integers(len(AXES))]
        origin = {"xyz": numbers(rng.normal(0, 0.3, 3)), "rpy": numbers(rng.normal(0, 1.5, 3))}
        parts.append(
            JOINT.format(name=joint, kind=kind, parent=parent, child=child, axis=axis, mimic=follows, **origin)
        )

    kinds = ["revolute", "fixed", "prismatic", "revolute", "fixed", "revolute", "revolute", "fixed"]
    for k, kind in enumerate(kinds):
        child = "tip" if k == len(kinds) - 1 else f"l{k + 1}"
        follows = '<mimic joint="joint0" multiplier="-0.4" offset="0.15"/>' if mimic and k == 5 else ""
        attach("base" if k == 0 else f"l{k}", child, f"joint{k}", kind, follows)
        attach(child, f"side{k}", f"side_joint{k}", ["fixed", "revolute"][k % 2])
    return f'<robot name="random">{"".join(parts)}</robot>'


def pose(result: UrdfImport, q: Floats) -> Floats:
    prediction = Calibration.nominal(robot_from_document(result.document)).predict(Observations(q=q[None]))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = prediction.rotation[0], prediction.position[0]
    return T


def reference(text: str, angles: dict[str, float]) -> Floats:
    model = pinocchio.buildModelFromXML(text)
    q = pinocchio.neutral(model)
    for name, angle in angles.items():
        q[model.joints[model.getJointId(name)].idx_q] = angle
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, q)
    return np.asarray(data.oMf[model.getFrameId("tip")].homogeneous)


@pytest.mark.parametrize("seed", range(25))
def test_random_trees_have_pinocchios_forward_kinematics(seed: int) -> None:
    text = random_urdf(seed)
    result = chain_document(text, "base", "tip", "random")
    names = [joint["name"] for joint in result.document["joints"]]
    q = np.random.default_rng(seed).uniform(-2, 2, len(names))
    assert np.abs(pose(result, q) - reference(text, dict(zip(names, q, strict=True)))).max() < 1e-12
    assert result.held_joints == ("side_joint1", "side_joint3", "side_joint5", "side_joint7")


@pytest.mark.parametrize("seed", range(10))
def test_a_mimic_joint_follows_its_leader(seed: int) -> None:
    text = random_urdf(seed, mimic=True)
    result = chain_document(text, "base", "tip", "random")
    names = [joint["name"] for joint in result.document["joints"]]
    assert "joint5" not in names
    q = np.random.default_rng(seed).uniform(-2, 2, len(names))
    angles = dict(zip(names, q, strict=True))
    angles["joint5"] = -0.4 * angles["joint0"] + 0.15
    assert np.abs(pose(result, q) - reference(text, angles)).max() < 1e-12
    assert [link["on_axis"] for link in result.document["links"] if "on_axis" in link] == [4]


@pytest.mark.parametrize("seed", range(10))
def test_masses_behind_a_mimic_joint_load_the_joints_as_pinocchio_says(seed: int) -> None:
    text = random_urdf(seed, mimic=True)
    robot = robot_from_document(chain_document(text, "base", "tip", "random").document)
    names, rng = [joint.name for joint in robot.joints], np.random.default_rng(seed)
    q, qd, qdd = rng.uniform(-2, 2, (3, len(names)))
    for motion in ({}, {"qd": qd[None], "qdd": qdd[None]}):
        ours = axial_loads(robot, joint_loads(robot, q[None], **motion))[0]
        model = pinocchio.buildModelFromXML(text)
        model.gravity.linear = robot.gravity
        index = {name: model.joints[model.getJointId(name)].idx_q for name in [*names, "joint5"]}
        full, speed, rate = pinocchio.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        for to, of in ((full, q), (speed, qd * bool(motion)), (rate, qdd * bool(motion))):
            for name, value in zip(names, of, strict=True):
                to[index[name]] = value
            to[index["joint5"]] = -0.4 * of[names.index("joint0")] + 0.15 * (to is full)
        torque = pinocchio.rnea(model, model.createData(), full, speed, rate)
        np.testing.assert_allclose(ours, [-torque[index[name]] for name in names], atol=1e-9, rtol=0)


@pytest.mark.parametrize("seed", range(10))
def test_merged_masses_load_the_joints_as_pinocchio_says(seed: int) -> None:
    text = random_urdf(seed)
    result = chain_document(text, "base", "tip", "random")
    robot = robot_from_document(result.document)
    names = [joint.name for joint in robot.joints]
    q = np.random.default_rng(seed).uniform(-2, 2, len(names))
    wrench = joint_loads(robot, q[None]).joints[0]
    ours = [w[5] if joint.kind == "revolute" else w[2] for w, joint in zip(wrench, robot.joints, strict=True)]
    model = pinocchio.buildModelFromXML(text)
    full = pinocchio.neutral(model)
    indices = [model.joints[model.getJointId(name)] for name in names]
    for joint, angle in zip(indices, q, strict=True):
        full[joint.idx_q] = angle
    torque = pinocchio.computeGeneralizedGravity(model, model.createData(), full)
    theirs = np.array([torque[joint.idx_v] for joint in indices]) * robot.gravity[2] / -9.81
    # Gravity's load is the opposite of the torque that holds it.
    assert np.allclose(ours, -theirs, atol=1e-9)


def test_elements_of_a_joint_are_six_named_constants() -> None:
    document = chain_document(random_urdf(1), "base", "tip", "random").document
    named = [element["name"] for element in document["elements"] if element.get("name", "").startswith("joint0_")]
    assert named == [f"joint0_{suffix}" for suffix in ("x", "y", "z", "rz", "ry", "rx")]
    assert document["joints"][0]["limits_deg"] == pytest.approx([-114.591559, 143.239449])
    assert document["joints"][1]["limits_mm"] == [-2000, 2500]


def seen(result: UrdfImport, *, spare: bool) -> Floats:
    """How poses move with the constants of the chain, by differences of the predictions: columns of metres and radians."""
    model = RobotModel(robot_from_document(result.document))
    values, rows = model.values0(), []
    low, high = np.clip(model.robot.limits, -2.0, 2.0).T
    batch = Observations(q=np.random.default_rng(1).uniform(low, high, (40, len(low))))
    dependent = {e.name for e in model.robot.chain.elements if e.dependent}
    for k, name in list(enumerate(model.names))[6 : model.n_geometric - 6]:
        if spare or name not in dependent:
            ends = [model.predict(batch, values + step * (np.arange(len(values)) == k)) for step in (-1e-5, 1e-5)]
            moved = [one.position for one in ends] + [one.rotation for one in ends]
            rows.append(np.concatenate([(moved[1] - moved[0]).ravel(), (moved[3] - moved[2]).ravel()]) / 2e-5)
    return np.array(rows).T


def rank(columns: Floats) -> int:
    size = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), compute_uv=False)
    return int(np.sum(size > 1e-6 * size[0]))


@pytest.mark.parametrize(("seed", "mimic"), [*((k, False) for k in range(10)), *((k, True) for k in range(5))])
def test_what_is_identified_of_an_arm_says_all_and_nothing_twice(seed: int, mimic: bool) -> None:
    result = chain_document(random_urdf(seed, mimic), "base", "tip", "random")
    kept = seen(result, spare=False)
    assert rank(kept) == kept.shape[1] == rank(seen(result, spare=True))


@pytest.mark.parametrize("pitch", [None, np.pi / 2, -np.pi / 2, np.radians(89.9), 1.57])
def test_an_arm_of_revolute_joints_has_four_numbers_each_and_two_more(pitch: float | None) -> None:
    """Six of the flange are the tool's: 4 R + 6 less what only those say (Mooring, Roth and Driels 1991)."""
    rng = np.random.default_rng(3)
    parts = [LINK.format(name="l0", xyz="0 0 0", rpy="0 0 0", mass=1.0)]
    for k in range(6):
        rpy = rng.uniform(-1.5, 1.5, 3)
        rpy[1] = rpy[1] if pitch is None else pitch
        parts.append(
            JOINT.format(
                name=f"j{k}", kind="revolute", parent=f"l{k}", child=f"l{k + 1}", xyz=numbers(rng.uniform(-0.4, 0.4, 3)),
                rpy=numbers(rpy), axis=str(rng.choice(AXES)), mimic="",
            )
        )  # fmt: skip
        parts.append(LINK.format(name=f"l{k + 1}", xyz="0 0 0", rpy="0 0 0", mass=1.0))
    result = chain_document(f'<robot name="six">{"".join(parts)}</robot>', "l0", "l6", "six")
    kept = seen(result, spare=False)
    assert rank(kept) == kept.shape[1] == 4 * 6 + 2


ROWS = {
    # kinds, axes, and how many numbers there are beside base and flange
    "gantry with a wrist": ("pppr", ("1 0 0", "0 1 0", "0 0 1", "0 0 1"), 12),
    "three guides": ("ppp", ("1 0 0", "0 1 0", "0 0 1"), 10),
    "guide behind a joint of the same axis": ("rpr", ("0 0 1", "0 0 1", "0 1 0"), 12),
    "two joints of one axis": ("rrr", ("0 0 1", "0 0 1", "0 1 0"), 14),
}


@pytest.mark.parametrize("name", ROWS)
def test_axes_in_a_row_lose_no_rotation(name: str) -> None:
    """Zero offsets that say the same shift twice were counted twice: a gantry lost three of its rotations."""
    kinds, axes, numbers_of_arm = ROWS[name]
    parts = [LINK.format(name="l0", xyz="0 0 0", rpy="0 0 0", mass=1.0)]
    for k, (kind, axis) in enumerate(zip(kinds, axes, strict=True)):
        made = {"kind": "revolute" if kind == "r" else "prismatic", "axis": axis, "xyz": "0 0 0.3", "rpy": "0 0 0"}
        parts.append(JOINT.format(name=f"j{k}", parent=f"l{k}", child=f"l{k + 1}", mimic="", **made))
        parts.append(LINK.format(name=f"l{k + 1}", xyz="0 0 0", rpy="0 0 0", mass=1.0))
    result = chain_document(f'<robot name="row">{"".join(parts)}</robot>', "l0", f"l{len(kinds)}", "row")
    assert rank(seen(result, spare=False)) == rank(seen(result, spare=True)) == numbers_of_arm


def bad() -> Iterator[tuple[str, str, str, str]]:
    good = random_urdf(0)
    yield "not xml at all", "base", "tip", "not XML"
    yield '<robot xmlns:xacro="x"><xacro:include filename="a"/></robot>', "base", "tip", "run `xacro"
    yield '<!DOCTYPE r [<!ENTITY a "b">]><robot/>', "base", "tip", "entities"
    yield "<model/>", "base", "tip", "<robot>"
    yield good, "bse", "tip", "Near it: base"
    yield good, "l3", "side0", "does not hang on"
    yield good, "l1", "l2", "No joint moves"
    yield good.replace('type="prismatic"', 'type="planar"'), "base", "tip", "joint joint2 is 'planar' and lies between"
    yield good.replace('xyz="0.3 -0.7 0.64"', 'xyz="0.3 x 0"'), "base", "tip", "is not 3 numbers"


@pytest.mark.parametrize(("text", "base", "tip", "message"), list(bad()))
def test_what_is_no_arm_is_refused_with_the_cause(text: str, base: str, tip: str, message: str) -> None:
    with pytest.raises(RobotError, match=message):
        chain_document(text, base, tip, "random")


@settings(max_examples=120, deadline=5000, derandomize=True, database=None)
@given(
    st.lists(
        st.tuples(st.sampled_from(["set", "cut", "insert", "double"]), st.integers(0, 1 << 16), st.text(max_size=8)),
        min_size=1,
        max_size=4,
    )
)
def test_a_damaged_urdf_is_refused_or_an_arm(edits: list[tuple[str, int, str]]) -> None:
    """Whatever is in the text: a RobotError or a chain, and no other exception."""
    text = random_urdf(3, mimic=True)
    for kind, place, piece in edits:
        at = place % max(1, len(text))
        if kind == "cut":
            text = text[:at]
        elif kind == "double":
            text += text[at:]
        else:
            text = text[:at] + piece + text[at + (len(piece) if kind == "set" else 0) :]
    with suppress(RobotError):
        robot_from_document(chain_document(text, "base", "tip", "arm").document)
