"""An arm on a column that gives way: MuJoCo says where the tool is and what an inclinometer on top of the column reads."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.robot import Robot
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_core.correct.walker import MOST_STATED, correct_trajectory
from kilter_core.effects import make_effect
from kilter_core.errors import ObservationError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations

Floats = NDArray[np.float64]

HEIGHT, STIFF = 1.2, 4.0e4  # of the column m; of its foot N m/rad
TOOL = (0.05, 0.02, 0.1)
LINKS = ((0.30, 14.0), (0.5, 11.0), (0.4, 7.0), (0.1, 3.0))  # m, kg
NOISE_M, NOISE_RAD = 2e-5, 2e-6
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0")


def world() -> mujoco.MjModel:
    """A column on two hinges with springs, the arm on top of it; every link along z of its joint."""
    arm = ""
    for k, (axis, (length, kg)) in enumerate(zip(AXES, LINKS, strict=True)):
        below = 0.0 if k == 0 else LINKS[k - 1][0]
        arm += (
            f'<body pos="0 0 {below}"><joint name="q{k}" type="hinge" axis="{axis}"/>'
            f'<geom type="sphere" size="0.03" mass="{kg}" pos="0 0 {0.5 * length}"/>'
        )
    tip = f'<site name="tool" pos="{TOOL[0]} {TOOL[1]} {LINKS[-1][0] + TOOL[2]}"/>' + "</body>" * len(LINKS)
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian"/><worldbody><body><joint name="x" type="hinge" axis="1 0 0"/>
        <joint name="y" type="hinge" axis="0 1 0"/><geom type="sphere" size="0.1" mass="60" pos="0 0 {HEIGHT / 2}"/>
        <body pos="0 0 {HEIGHT}"><site name="plate"/>{arm}{tip}</body></body></worldbody></mujoco>"""
    )


def settled(q: Floats, floor: Floats) -> tuple[Floats, Floats]:
    """Tool points (N, 3) m and tilts (N, 2) rad of the plate, on a floor that leans by ``floor (N, 2)``."""
    model = world()
    data = mujoco.MjData(model)
    position, tilt = np.empty((len(q), 3)), np.empty((len(q), 2))
    for k in range(len(q)):
        data.qpos[:] = [*floor[k], *q[k]]
        for _ in range(20):
            mujoco.mj_forward(model, data)
            data.qpos[:2] = floor[k] - data.qfrc_bias[:2] / STIFF
        mujoco.mj_forward(model, data)
        position[k] = data.site("tool").xpos
        R = data.site("plate").xmat.reshape(3, 3)
        tilt[k] = np.arcsin(R[2, 1]), np.arcsin(-R[2, 0])  # from the vertical in the axes of the plate
    return position, tilt


def document() -> dict[str, Any]:
    """The arm as it is drawn, on a column that stands."""
    names = ("j1", "j2", "j3", "j4")
    elements: list[dict[str, Any]] = []
    for name, axis, (length, _) in zip(names, ("Rz", "Ry", "Ry", "Rx"), LINKS, strict=True):
        elements += [
            {"axis": axis, "joint": name, "name": f"zero_{name}"},
            {"axis": "Tz", "value": 1e3 * length, "name": name},
        ]
    return {
        "name": "column", "convention": "chain", "elements": elements,
        "joints": [{"name": name, "limits_deg": [-180, 180]} for name in names],
        "base": {"x_mm": 0, "y_mm": 0, "z_mm": 1e3 * HEIGHT, "rx_deg": 0, "ry_deg": 0, "rz_deg": 0},
        "tool": {f"{k}_mm": 1e3 * v for k, v in zip("xyz", TOOL, strict=True)} | {f"r{k}_deg": 0 for k in "xyz"},
    }  # fmt: skip


def robot() -> Robot:
    return robot_from_document(document())


@cache
def campaign(as_column: bool = True) -> Observations:
    rng = np.random.default_rng(12)
    q = rng.uniform(-2.2, 2.2, (120, 4))
    floor = np.column_stack([3e-4 * np.sin(np.arange(120) / 19.0), rng.normal(0.0, 2e-4, 120)])
    position, tilt = settled(q, floor)
    position = position + NOISE_M * rng.standard_normal(position.shape)
    tilt = tilt + 4e-3 + NOISE_RAD * rng.standard_normal(tilt.shape)  # its zero is anywhere
    rows = Observations(q, position=position)
    if as_column:
        return replace(rows, base_tilt_x=tilt[:, 0], base_tilt_y=tilt[:, 1])
    read = np.full((120, 5, 3), np.nan)
    read[:, 4, :2] = tilt
    return replace(rows, tilt=read)


def fitted(rows: Observations, *effects: str) -> tuple[Calibration, float]:
    """Identified on 80 rows; rms error (m) on the 40 others."""
    found = identify(
        robot(), rows.select(slice(0, 80)), options=IdentifyOptions(effects=effects, noise_mm=0.02)
    ).calibration
    rest = rows.select(slice(80, 120))
    left = found.predict(rest).position - rest.position
    return found, float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


@pytest.mark.parametrize("as_column", [True, False])
def test_the_tilt_as_an_input_predicts_rows_that_were_not_fitted(as_column: bool) -> None:
    rows = campaign(as_column)
    _, before = fitted(rows)
    found, after = fitted(rows, "measured_tilt")
    assert before > 1e-3
    assert after < 5e-5
    values = dict(zip(found.names, found.values.tolist(), strict=True))
    for k in "xy":
        assert values[f"tilt_gain_{k}"] == pytest.approx(1.0, abs=0.01)
        assert values[f"tilt_cross_{k}"] == pytest.approx(0.0, abs=0.02)
    assert values["tilt_lever_z"] == pytest.approx(HEIGHT, abs=0.02)


def test_a_search_names_it_and_holds_what_it_says() -> None:
    names = ("measured_tilt", "axial_compliance", "eccentricity", "drift", "unknown_field")
    report = find_gap(
        robot(), campaign(), GapOptions(effects=names, noise_mm=0.02, resamples=10, permutations=5)
    ).to_document()
    assert [e["id"] for e in report["effects"]] == ["measured_tilt"]
    assert report["effects"][0]["physical_class"]["id"] == "station"
    read = find_gap(
        robot(), campaign(False), GapOptions(effects=names[:1], noise_mm=0.02, resamples=10, permutations=5)
    )
    assert [e["id"] for e in read.to_document()["effects"]] == ["measured_tilt"]


def test_a_row_that_states_its_tilt_is_corrected_for_it() -> None:
    """The corrected arm, on a floor that leans as stated, is where the drawn arm would be on one that does not."""
    found, _ = fitted(campaign(), "measured_tilt")
    rng = np.random.default_rng(4)
    q, floor = rng.uniform(-1.2, 1.2, (25, 4)) + np.array([0.0, 0.4, 1.0, 0.0]), rng.normal(0.0, 6e-4, (25, 2))
    wanted = found.nominal_in_wanted_frames().predict(Observations(q)).position
    uncorrected, tilt = settled(q, floor)
    stated = Observations(q, base_tilt_x=tilt[:, 0] + 4e-3, base_tilt_y=tilt[:, 1] + 4e-3)
    options = CorrectionOptions(largest_rad=0.1, farthest_m=0.05)
    done = correct_trajectory(found, stated, options)
    assert done.not_corrected == ()
    good = np.linalg.norm(done.left, axis=1) < 1e-5
    assert good.sum() >= 20
    reached, _ = settled(done.q[good], floor[good])
    assert np.median(np.linalg.norm(uncorrected - wanted, axis=1)) > 1e-3
    assert np.linalg.norm(reached - wanted[good], axis=1).max() < 1e-4
    unstated = correct_trajectory(found, Observations(q), options)
    assert unstated.not_corrected == ("measured_tilt",)


def test_the_tilt_changes_as_often_as_is_said_and_only_where_it_is_read() -> None:
    made = RobotModel(robot(), (make_effect("measured_tilt", zero_x_rad=0.0, zero_y_rad=0.0),))
    q = np.zeros((MOST_STATED + 1, 4))
    rows = Observations(q, base_tilt_x=np.arange(len(q)) * 1e-7, base_tilt_y=np.zeros(len(q)))
    with pytest.raises(ObservationError, match="tilt of the base or masses on links changes"):
        correct_trajectory(Calibration(made, made.values0()), rows)
    plain = RobotModel(robot())
    assert (correct_trajectory(Calibration(plain, plain.values0()), rows).status == 0).all()
    values = made.values0()
    values[made.names.index("tilt_lever_z")] = 2.0
    moved = compile_program(Calibration(made, values), CorrectionOptions(base_tilt=(0.0, 1e-3)))
    shift = moved.correct_rows(np.array([[0.3, 0.5, 1.0, 0.2]])).error_removed[0]
    np.testing.assert_allclose(shift, [2e-3, 0.0, 0.0], atol=1e-12)
