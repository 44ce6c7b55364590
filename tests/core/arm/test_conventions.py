"""Conventions and presets against products of 4x4 matrices written by hand."""

from __future__ import annotations

import math
from functools import reduce
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document, preset_names
from kilter_core.arm.robot import Robot
from kilter_core.model import RobotModel
from kilter_core.observations import Observations

Floats = NDArray[np.float64]
RIGHT = math.pi / 2.0


def rx(a: float) -> Floats:
    c, s = math.cos(a), math.sin(a)
    return np.array([[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1.0]])


def ry(a: float) -> Floats:
    c, s = math.cos(a), math.sin(a)
    return np.array([[c, 0, s, 0], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])


def rz(a: float) -> Floats:
    c, s = math.cos(a), math.sin(a)
    return np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def shift(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Floats:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def product(*matrices: Floats) -> Floats:
    return reduce(np.matmul, matrices)


def poses(robot: Robot, q: Floats) -> Floats:
    model = RobotModel(robot)
    prediction = model.predict(Observations(q), model.values0())
    out = np.tile(np.eye(4), (len(q), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = prediction.rotation, prediction.position
    return out


def assert_same(robot: Robot, by_hand: Any, seed: int = 0) -> None:
    q = np.random.default_rng(seed).uniform(-2.0, 2.0, (20, robot.n_joints))
    np.testing.assert_allclose(poses(robot, q), [by_hand(*row) for row in q], atol=1e-13)


ROWS: list[dict[str, Any]] = [
    {"theta_offset_deg": 10, "d_mm": 120, "a_mm": 30, "alpha_deg": 80},
    {"theta_offset_deg": -20, "d_mm": -40, "a_mm": 250, "alpha_deg": 0},
    {"type": "prismatic", "theta_offset_deg": 30, "d_mm": 60, "a_mm": -15, "alpha_deg": -75},
]


def test_dh_is_tz_rz_tx_rx() -> None:
    def by_hand(q1: float, q2: float, q3: float) -> Floats:
        T = np.eye(4)
        for row, q in zip(ROWS, (q1, q2, q3), strict=True):
            slides = row.get("type") == "prismatic"
            theta = math.radians(row["theta_offset_deg"]) + (0.0 if slides else q)
            d = row["d_mm"] * 1e-3 + (q if slides else 0.0)
            T = T @ product(shift(z=d), rz(theta), shift(x=row["a_mm"] * 1e-3), rx(math.radians(row["alpha_deg"])))
        return T

    assert_same(robot_from_document({"convention": "dh", "rows": ROWS}), by_hand)


def test_mdh_is_rx_tx_rz_tz_and_hayati_puts_ry_after_rx() -> None:
    rows = [ROWS[0], {**ROWS[1], "beta_deg": 7.0}, ROWS[2]]

    def by_hand(q1: float, q2: float, q3: float) -> Floats:
        T = np.eye(4)
        for row, q in zip(rows, (q1, q2, q3), strict=True):
            slides = row.get("type") == "prismatic"
            theta = math.radians(row["theta_offset_deg"]) + (0.0 if slides else q)
            d = row["d_mm"] * 1e-3 + (q if slides else 0.0)
            tilt = ry(math.radians(row.get("beta_deg", 0.0)))
            T = T @ product(
                rx(math.radians(row["alpha_deg"])), tilt, shift(x=row["a_mm"] * 1e-3), rz(theta), shift(z=d)
            )
        return T

    assert_same(robot_from_document({"convention": "mdh", "rows": rows}), by_hand)


def test_a_hayati_row_has_beta_and_no_d() -> None:
    robot = robot_from_document({"convention": "mdh", "rows": [{}, {"a_mm": 190, "beta_deg": 0, "d_mm": None}]})
    names = RobotModel(robot).names[6:-6]
    assert names == ("alpha_1", "a_1", "theta_offset_1", "d_1", "alpha_2", "beta_2", "a_2", "theta_offset_2")


@pytest.mark.parametrize("convention", ["dh", "mdh"])
def test_almost_parallel_axes_get_hayati_s_rotation(convention: str) -> None:
    rows = [{"alpha_deg": 90}, {"alpha_deg": 0.5, "a_mm": 200}, {"alpha_deg": 90}]
    names = RobotModel(robot_from_document({"convention": convention, "rows": rows})).names
    assert [n for n in names if n.startswith("beta")] == ["beta_2"]


NOMINAL_BASE = shift(0.055, 0.055, 0.2015)  # eq. 4.7; chapter 3 works in the nominal base itself


def katana_chapter_4(q1: float, q2: float, q3: float, q4: float, q5: float) -> Floats:
    """Thesis eq. 4.2 to 4.5 at nominal values, from the nominal base of eq. 4.7."""
    return product(
        NOMINAL_BASE,
        rz(q1), rx(RIGHT), rz(q2), shift(x=0.190),
        rx(0.0), ry(0.0), rz(q3), shift(x=0.139),
        rz(q4), ry(0.0), rx(-RIGHT), shift(z=0.1473),
        rz(q5), ry(0.0), rx(RIGHT), shift(z=0.200),
    )  # fmt: skip


def test_the_katana_of_chapter_4_is_the_product_of_its_equations() -> None:
    robot = robot_from_document(preset_document("katana450-chapter4"))
    assert_same(robot, katana_chapter_4)


def test_the_katana_of_chapter_5_carries_the_attachment() -> None:
    robot = robot_from_document(preset_document("katana450-chapter5"))
    assert_same(robot, lambda *q: katana_chapter_4(*q) @ shift(z=0.130))


def test_the_katana_of_chapter_3_has_the_same_poses() -> None:
    three, four = (robot_from_document(preset_document(f"katana450-chapter{k}")) for k in (3, 4))
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (50, 5))
    np.testing.assert_allclose(NOMINAL_BASE @ poses(three, q), poses(four, q), atol=1e-13)


def test_the_katana_of_chapter_3_is_the_product_of_table_3_1() -> None:
    table = ((0.0, 0.0, 0.0), (90.0, 0.0, 0.0), (0.0, 190.0, 0.0), (0.0, 139.0, 0.0), (-90.0, 0.0, 147.3))

    def by_hand(*q: float) -> Floats:
        T = np.eye(4)
        for (alpha, a, d), angle in zip(table, q, strict=True):
            T = product(T, rx(math.radians(alpha)), shift(x=a * 1e-3), rz(angle), shift(z=d * 1e-3))
        return product(T, rx(RIGHT), shift(z=0.200))

    assert_same(robot_from_document(preset_document("katana450-chapter3")), by_hand)


def test_the_ur10_is_the_product_of_its_published_table() -> None:
    table = (
        (0.1273, 0.0, RIGHT), (0.0, -0.612, 0.0), (0.0, -0.5723, 0.0),
        (0.163941, 0.0, RIGHT), (0.1157, 0.0, -RIGHT), (0.0922, 0.0, 0.0),
    )  # fmt: skip

    def by_hand(*q: float) -> Floats:
        T = np.eye(4)
        for (d, a, alpha), angle in zip(table, q, strict=True):
            T = product(T, rz(angle), shift(z=d), shift(x=a), rx(alpha))
        return T

    assert_same(robot_from_document(preset_document("ur10")), by_hand)


def test_base_and_tool_are_xyz_then_rz_ry_rx() -> None:
    document = {
        "convention": "dh", "rows": [{"d_mm": 100}],
        "base": {"x_mm": 1, "y_mm": 2, "z_mm": 3, "rx_deg": 10, "ry_deg": 20, "rz_deg": 30},
        "tool": {"x_mm": 4, "ry_deg": 50},
    }  # fmt: skip

    def by_hand(q: float) -> Floats:
        a, b, c = np.radians([10, 20, 30])
        base = product(shift(1e-3, 2e-3, 3e-3), rz(c), ry(b), rx(a))
        return product(base, rz(q), shift(z=0.1), shift(4e-3), ry(math.radians(50)))

    assert_same(robot_from_document(document), by_hand)


WITHOUT_MASSES = {"iiwa14", "irb120", "kr6-r900"}  # their makers publish none


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_stands_by_itself(name: str) -> None:
    robot = robot_from_document({"convention": "preset", "preset": name, "name": "mine", "tool": {"z_mm": 10}})
    assert robot.name == "mine"
    assert robot.T_tool[2, 3] == pytest.approx(0.010)
    assert robot.has_masses == (name not in WITHOUT_MASSES)
    assert np.isfinite(robot.limits).all()
    assert preset_document(name)["source"]
