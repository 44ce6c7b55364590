"""Conversions keep the poses: random arms against Pinocchio, tables against matrices multiplied here."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from kilter_core.arm.chain import Axis, Chain, Element
from kilter_core.arm.conventions import Row
from kilter_core.arm.conversions import Screws, joint_frames, link_table, screws_of_chain
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.errors import RobotError
from kilter_core.model import Calibration
from kilter_core.model.geometry import flange_screws
from kilter_core.model.table_fit import closest_table
from kilter_core.observations import Observations
from kilter_core.transforms import xyz_rpy_from_pose
from kilter_core.twin import Twin, thesis_katana

Floats = NDArray[np.float64]


def homogeneous(R: Floats, p: Floats) -> Floats:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def random_arm(seed: int, special: bool) -> tuple[pinocchio.Model, Screws]:
    """An arm in Pinocchio, and its axes found by Pinocchio at zero; special: axes parallel, meeting, or the same."""
    rng = np.random.default_rng(seed)
    model = pinocchio.Model()
    parent = 0
    n = int(rng.integers(2, 8))
    joint: Any
    prismatic = []
    for k in range(n):
        R = pinocchio.utils.rotate("x", rng.uniform(-3, 3)) @ pinocchio.utils.rotate("z", rng.uniform(-3, 3))
        p = rng.normal(0, 0.3, 3)
        if special:
            R = pinocchio.utils.rotate("x", rng.choice([0.0, math.pi / 2, -math.pi / 2, math.pi]))
            p = rng.choice([0.0, 0.2, -0.3], 3)
        slides = bool(rng.random() < 0.2)
        joint = pinocchio.JointModelPZ() if slides else pinocchio.JointModelRZ()
        parent = model.addJoint(parent, joint, pinocchio.SE3(R, p), f"j{k}")
        prismatic.append(slides)
    end = pinocchio.SE3(pinocchio.utils.rotate("y", rng.uniform(-3, 3) * (not special)), rng.normal(0, 0.1, 3))
    model.addFrame(pinocchio.Frame("tip", parent, 0, end, pinocchio.FrameType.OP_FRAME))
    data = model.createData()
    pinocchio.framesForwardKinematics(model, data, np.zeros(n))
    at = [data.oMi[k + 1] for k in range(n)]
    screws = Screws(
        np.array([T.rotation[:, 2] for T in at]),
        np.array([T.translation for T in at]),
        np.array(prismatic),
        np.arange(n),
        np.ones(n),
        data.oMf[model.getFrameId("tip")].homogeneous,
    )
    return model, screws


def pinocchio_poses(model: pinocchio.Model, q: Floats) -> Floats:
    data = model.createData()
    out = []
    for row in q:
        pinocchio.framesForwardKinematics(model, data, row)
        out.append(data.oMf[model.getFrameId("tip")].homogeneous)
    return np.array(out)


def rz(a: float) -> Floats:
    return homogeneous(pinocchio.utils.rotate("z", a), np.zeros(3))


def rx(a: float) -> Floats:
    return homogeneous(pinocchio.utils.rotate("x", a), np.zeros(3))


def ry(a: float) -> Floats:
    return homogeneous(pinocchio.utils.rotate("y", a), np.zeros(3))


def shift(x: float = 0.0, z: float = 0.0) -> Floats:
    return homogeneous(np.eye(3), np.array([x, 0.0, z]))


def table_pose(rows: tuple[Row, ...], dh: bool, q: Floats, base: Floats, tool: Floats) -> Floats:
    """The tables' definitions, multiplied out."""
    T = base
    for row, value in zip(rows, q, strict=True):
        theta = row.theta_offset + (0.0 if row.prismatic else value)
        d = (row.d or 0.0) + (value if row.prismatic else 0.0)
        joint = rz(theta) @ shift(z=d)
        link = rx(row.alpha) @ ry(row.beta or 0.0) @ shift(x=row.a)
        T = T @ (joint @ link if dh else link @ joint)
    return T @ tool


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), special=st.booleans())
def test_axes_frames_and_tables_are_the_same_arm(seed: int, special: bool) -> None:
    model, screws = random_arm(seed, special)
    q = np.random.default_rng(seed).uniform(-2, 2, (5, model.nv))
    expected = pinocchio_poses(model, q)
    assert np.abs(screws.poses(q) - expected).max() < 1e-12

    frames = joint_frames(screws)
    for row, wanted in zip(q, expected, strict=True):
        T = np.eye(4)
        for k, value in enumerate(row):
            T = T @ frames.origin[k] @ (shift(z=value) if screws.prismatic[k] else rz(value))
        assert np.abs(T @ frames.end - wanted).max() < 1e-9

    sines = np.linalg.norm(np.cross(screws.direction[:-1], screws.direction[1:]), axis=1)
    assume(not np.any((sines > 1e-9) & (sines < math.sin(math.radians(1.0)))))  # tables without beta drop such a tilt
    dh, hayati = link_table(screws, hayati=False), link_table(screws, hayati=True)
    for row, wanted in zip(q, expected, strict=True):
        assert np.abs(table_pose(dh.dh_rows(), True, row, dh.base, dh.tool) - wanted).max() < 1e-9
        assert np.abs(table_pose(dh.mdh_rows(), False, row, dh.base, dh.mdh_tool()) - wanted).max() < 1e-9
        assert np.abs(table_pose(hayati.mdh_rows(), False, row, hayati.base, hayati.mdh_tool()) - wanted).max() < 1e-9


@pytest.mark.parametrize("tilt_deg", [1e-6, 1e-3, 0.05, 0.9, 179.95])
@pytest.mark.parametrize("seed", range(6))
def test_hayati_rows_are_exact_for_almost_parallel_axes(tilt_deg: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    direction, point = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    lines = [(direction, point)]
    for _ in range(3):
        lean = pinocchio.exp3(math.radians(tilt_deg) * np.append(rng.normal(size=2), 0) / 1.2)
        direction, point = lean @ direction, point + rng.normal(0, 0.3, 3)
        lines.append((direction, point))
    home = homogeneous(pinocchio.exp3(rng.normal(size=3)), rng.normal(size=3))
    screws = Screws(
        np.array([z for z, _ in lines]), np.array([p for _, p in lines]),
        np.zeros(4, dtype=bool), np.arange(4), np.ones(4), home,
    )  # fmt: skip
    table = link_table(screws, hayati=True)
    for row in rng.uniform(-3, 3, (5, 4)):
        found = table_pose(table.mdh_rows(), False, row, table.base, table.mdh_tool())
        assert np.abs(found - screws.poses(row[None])[0]).max() < 1e-12
    assert np.abs([link.a for link in table.links]).max() < 10


def test_the_manufacturers_table_comes_back() -> None:
    robot = robot_from_document(preset_document("ur10"))
    rows = link_table(screws_of_chain(robot.chain), hayati=False).dh_rows()
    for row, written in zip(rows, preset_document("ur10")["rows"], strict=True):
        found = [math.degrees(row.theta_offset), (row.d or 0.0) * 1e3, row.a * 1e3, math.degrees(row.alpha)]
        assert found == pytest.approx([written[k] for k in ("theta_offset_deg", "d_mm", "a_mm", "alpha_deg")], abs=1e-9)


def test_what_a_table_cannot_say_is_measured_and_kept_small() -> None:
    robot = robot_from_document(preset_document("ur10"))
    tilted = Twin(robot, {"beta_2": math.radians(0.05), "beta_3": math.radians(-0.03), "a_2": 1e-4}).truth
    dh, mdh = closest_table(tilted, "dh"), closest_table(tilted, "mdh")
    assert mdh.loss.max_m < 1e-9
    assert 1e-5 < dh.loss.rms_m < 1e-3
    # The parameters left: a fit of the same table by another way of counting may not come closer.
    q = np.random.default_rng(3).uniform(-3, 3, (200, 6))
    exact = tilted.predict(Observations(q)).position
    found = np.array([table_pose(dh.rows, True, row, dh.base, dh.tool)[:3, 3] for row in q])
    assert np.sqrt(np.mean(np.sum((found - exact) ** 2, axis=1))) == pytest.approx(dh.loss.rms_m, rel=0.3)
    assert max(abs(row.d or 0.0) for row in dh.rows) < 0.3


def test_effects_are_lost_and_said() -> None:
    twin = thesis_katana()
    errors = {name: value for name, value in twin.errors.items() if name in Calibration.nominal(twin.robot).names}
    assert closest_table(Twin(twin.robot, errors).truth, "mdh").loss.max_m < 1e-9
    table = closest_table(twin.truth, "mdh")
    assert 5e-5 < table.loss.rms_m < 2e-3


@pytest.mark.parametrize("short_of_90", [0.0, 1e-15, 1e-9, 1e-8, 1e-6, 0.1])
def test_roll_pitch_yaw_give_the_rotation_back_near_pitch_90(short_of_90: float) -> None:
    for yaw, side in ((0.4, 1.0), (-2.0, -1.0)):
        R = rz(yaw) @ ry(side * (math.pi / 2 - short_of_90)) @ rx(1.1)
        _, rpy = xyz_rpy_from_pose(R)
        assert np.abs(rz(rpy[2]) @ ry(rpy[1]) @ rx(rpy[0]) - R).max() < 1e-14


def test_coupled_joints_are_axes_but_no_table() -> None:
    elements = (
        Element(Axis.RZ, 0.1, "theta_1", joint=0), Element(Axis.TX, 0.3, "a_1"),
        Element(Axis.RZ, 0.0, "theta_2", joint=1), Element(Axis.RZ, joint=0, ratio=-1.0),
        Element(Axis.TX, 0.2, "a_2"),
    )  # fmt: skip
    chain = Chain(elements, 2)
    screws = screws_of_chain(chain)
    q = np.random.default_rng(0).uniform(-2, 2, (4, 2))
    heading = 0.1 + q[:, 0]
    expected = 0.3 * np.cos(heading) + 0.2 * np.cos(heading + q[:, 1] - q[:, 0])
    assert np.allclose(screws.poses(q)[:, 0, 3], expected)
    with pytest.raises(RobotError, match="Joint 1 moves 2 axes"):
        link_table(screws, hayati=True)


def test_the_flange_of_a_nominal_robot_is_its_chain() -> None:
    for name in ("katana450-chapter4", "ur10"):
        robot = robot_from_document(preset_document(name))
        q = np.random.default_rng(1).uniform(-1, 1, (5, robot.n_joints))
        found = flange_screws(Calibration.nominal(robot)).poses(q)
        assert np.allclose(found, screws_of_chain(robot.chain).poses(q), atol=1e-14)
