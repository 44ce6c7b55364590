"""Exported tables move with the version and no further: what measurements do not tell stays nominal. Pinocchio builds them."""

from __future__ import annotations

import csv
import io
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.model import Calibration
from kilter_service.robots.exporters.registry import export
from tests.service.exporters.test_exporters import exportable, poses_of

Floats = NDArray[np.float64]
PRESETS = ("ur10", "irb120", "panda", "kr6-r900", "katana450-chapter4")
TABLES = {"dh-csv": "dh", "mdh-csv": "mdh"}


def scara() -> dict[str, Any]:
    """Four parallel axes, one of them prismatic."""
    rows = [(0, 400, 325, 0), (0, 0, 275, 180), (0, None, 0, 0), (0, 50, 0, 0)]
    return _arm("scara", rows, prismatic=(2,))


def five_axes() -> dict[str, Any]:
    return _arm("five", [(0, 300, 0, 90), (90, 0, 250, 0), (0, 0, 200, 0), (90, 0, 0, 90), (0, 120, 0, 0)])


def seven_axes() -> dict[str, Any]:
    """Shoulder and wrist of intersecting axes, elbow without offset."""
    heights = [340, 0, 400, 0, 400, 0, 126]
    return _arm("seven", [(0, d, 0, alpha) for d, alpha in zip(heights, (-90, 90, 90, -90, -90, 90, 0), strict=True)])


def _arm(name: str, rows: list[Any], prismatic: tuple[int, ...] = ()) -> dict[str, Any]:
    keys = ("theta_offset_deg", "d_mm", "a_mm", "alpha_deg")
    table = [dict(zip(keys, row, strict=True)) for row in rows]
    for k in prismatic:
        table[k] |= {"type": "prismatic", "d_mm": 0.0}
    kinds = ["mm" if k in prismatic else "deg" for k in range(len(rows))]
    joints = [{"name": f"j{k + 1}", f"limits_{kind}": [-150, 150]} for k, kind in enumerate(kinds)]
    return {"name": name, "convention": "dh", "rows": table, "joints": joints}


def arms() -> dict[str, dict[str, Any]]:
    own = {document["name"]: document for document in (scara(), five_axes(), seven_axes())}
    return own | {name: preset_document(name) for name in PRESETS}


def version(document: dict[str, Any], moved: float, seed: int = 0, betas: bool = True) -> tuple[Any, Calibration]:
    """A version whose geometric numbers are all off by about so many rad and m."""
    nominal = Calibration.nominal(robot_from_document(document))
    rng = np.random.default_rng(seed)
    values = nominal.values + moved * rng.standard_normal(len(nominal.values))
    if not betas:
        values = np.where([name.startswith("beta") for name in nominal.names], nominal.values, values)
    found = Calibration(nominal.model, values)
    return exportable(document, found), found


def numbers(text: str) -> Floats:
    """All numbers of base, rows and tool of a written table."""
    head = [line for line in text.splitlines() if re.match(r"# (base|tool) ", line)]
    frames = [float(value) for line in head for value in re.findall(r"=(\S+)", line)]
    rows = csv.DictReader(io.StringIO("".join(line for line in text.splitlines(True) if not line.startswith("#"))))
    wanted = ("theta_offset_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg")
    return np.array([*frames, *(float(row[key]) for row in rows for key in wanted if row.get(key))])


def by_pinocchio(text: str, convention: str, q: Floats) -> Floats:
    """Poses (N, 4, 4) of a written table, read and multiplied here."""
    frames = {}
    for line in text.splitlines():
        if found := re.match(r"# (base|tool) (.*)", line):
            x = {name: float(value) for name, value in re.findall(r"(\w+)=(\S+)", found[2])}
            turn = pin.rpy.rpyToMatrix(*(math.radians(x[f"r{k}_deg"]) for k in "xyz"))
            frames[found[1]] = pin.SE3(turn, np.array([x[f"{k}_mm"] for k in "xyz"]) * 1e-3)
    rows = list(csv.DictReader(io.StringIO("".join(s for s in text.splitlines(True) if not s.startswith("#")))))
    out = np.empty((len(q), 4, 4))
    for n, joints in enumerate(q):
        T = frames["base"]
        for row, value in zip(rows, joints, strict=True):
            cell = {
                key: float(row.get(key) or 0.0) for key in ("theta_offset_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg")
            }
            slides = row["type"] == "prismatic"
            theta = math.radians(cell["theta_offset_deg"]) + (0.0 if slides else value)
            along = pin.SE3(
                pin.utils.rotate("z", theta), np.array([0, 0, cell["d_mm"] * 1e-3 + (value if slides else 0.0)])
            )
            alpha, beta = (
                pin.SE3(pin.utils.rotate(a, math.radians(cell[key])), np.zeros(3))
                for a, key in (("x", "alpha_deg"), ("y", "beta_deg"))
            )
            link = pin.SE3(np.eye(3), np.array([cell["a_mm"] * 1e-3, 0, 0]))
            T = T * (along * link * alpha if convention == "dh" else alpha * beta * link * along)
        out[n] = (T * frames["tool"]).homogeneous
    return out


@pytest.mark.parametrize("name", arms())
@pytest.mark.parametrize("form", TABLES)
def test_a_table_is_the_version_and_near_the_nominal_rows(name: str, form: str) -> None:
    document = arms()[name]
    file, found = version(document, 1e-4, betas=form == "mdh-csv")
    text = export(form, file).text
    q = np.random.default_rng(1).uniform(-1.2, 1.2, (6, found.robot.n_joints))
    lost = "Nothing is lost" not in text
    seen = np.abs(poses_of(found, q) - by_pinocchio(text, TABLES[form], q)).max()
    # Standard DH drops tilts of parallel axes and says so; all else is exact.
    assert seen < (5e-4 if form == "dh-csv" and lost else 1e-8)
    assert form == "dh-csv" or not lost
    nominal = numbers(export(form, version(document, 0.0)[0]).text)
    assert np.abs(numbers(text) - nominal).max() < 0.6  # mm and degrees; 1e-4 m and 1e-4 rad were moved


@pytest.mark.parametrize("name", arms())
@pytest.mark.parametrize("form", TABLES)
def test_rounding_of_a_version_is_rounding_of_its_table(name: str, form: str) -> None:
    """Offsets of two thousandths of a millimetre have a direction, and no table rotates its axes to it."""
    document = arms()[name]
    nominal = numbers(export(form, version(document, 0.0)[0]).text)
    for moved, most in ((2e-6, 0.01), (1e-12, 1e-7)):
        for seed in (1, 2):
            found = numbers(export(form, version(document, moved, seed)[0]).text)
            assert np.abs(found - nominal).max() < most


def test_freedoms_that_no_position_tells_stay_where_the_version_has_them() -> None:
    """Positions of a tool point on axis 6: its zero and the tool's rotation are nobody's, and the table leaves them."""
    document = preset_document("ur10")
    nominal = Calibration.nominal(robot_from_document(document))
    errors = {"a_5": 2e-6, "d_5": 3e-6, "a_6": -1e-6, "theta_offset_3": 1e-4}
    values = nominal.values + np.array([errors.get(name, 0.0) for name in nominal.names])
    text = export("dh-csv", exportable(document, Calibration(nominal.model, values))).text
    told = {m[1]: float(m[3]) for m in re.finditer(r"# zero_offset (\S+) (deg|mm)=(\S+)", text)}
    names = [joint.name for joint in nominal.robot.joints]
    assert list(told) == names
    assert [told[name] for name in names] == pytest.approx([0, 0, math.degrees(1e-4), 0, 0, 0], abs=2e-6)
    rows = re.findall(r"# number (\S+) (\S+) nominal=(\S+) exported=(\S+) difference=(\S+)", text)
    assert {row[0] for row in rows} == {"base", "tool", *names}
    for _, _, before, now, apart in rows:
        assert float(now) - float(before) == pytest.approx(float(apart), abs=2e-6)
    changed = {(where, number): float(apart) for where, number, _, _, apart in rows if abs(float(apart)) > 1e-6}
    expected = {("a_mm", 5): 2e-3, ("d_mm", 5): 3e-3, ("a_mm", 6): -1e-3, ("theta_offset_deg", 3): math.degrees(1e-4)}
    wanted = {(names[joint - 1], number): size for (number, joint), size in expected.items()}
    assert changed == pytest.approx(wanted, abs=2e-6)


SCARA = {
    "name": "scara", "convention": "dh", "joints": [{"name": f"j{k}"} for k in (1, 2, 3, 4)],
    "rows": [
        {"theta_offset_deg": 0, "d_mm": 350, "a_mm": 325, "alpha_deg": 0},
        {"theta_offset_deg": 0, "d_mm": 0, "a_mm": 275, "alpha_deg": 180},
        {"theta_offset_deg": 0, "d_mm": 0, "a_mm": 0, "alpha_deg": 0, "type": "prismatic"},
        {"theta_offset_deg": 0, "d_mm": 20, "a_mm": 0, "alpha_deg": 0},
    ],
    "tool": {"x_mm": 30, "y_mm": 0, "z_mm": 60},
}  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_a_zero_that_other_numbers_take_back_is_not_offered_to_a_controller(seed: int) -> None:
    """Axes 0.05 degrees from parallel: the rows' common normals rotate by tens of degrees, and zeros and tool rotate back.

    Zeros of -35 degrees were listed for a controller, of an arm whose zeros were right but for the one of joint 1.
    """
    nominal, rng = Calibration.nominal(robot_from_document(SCARA)), np.random.default_rng(seed)
    size = {"alpha": 8e-4, "beta": 8e-4, "a": 4e-4}
    moved = [size.get(name.rpartition("_")[0], 0.0) * rng.standard_normal() for name in nominal.names]
    moved[nominal.names.index("theta_offset_1")] = 0.01
    text = export("dh-csv", exportable(SCARA, Calibration(nominal.model, nominal.values + np.array(moved)))).text
    zeros = {
        m[1]: (float(m[2]), m[3]) for m in re.finditer(r"# zero_offset (\S+) (?:deg|mm)=(\S+).* state=(\S+)", text)
    }
    assert len(zeros) == 4
    assert any(abs(value) > 3.0 for value, _ in zeros.values())
    assert all(state == "shared" for value, state in zeros.values() if abs(value) > 3.0)
    assert zeros["j1"] == (pytest.approx(math.degrees(0.01), abs=0.1), "unstated")
    assert "take the table as it is" in text


@pytest.mark.parametrize("form", TABLES)
def test_the_nominal_numbers_are_those_of_the_frames_that_corrections_work_in(form: str) -> None:
    """A tracker two metres away: the nominal base was told as 1838 mm from the exported one, joint 1 as 62.8 degrees off."""
    document = SCARA | {"name": "measured-from-afar"}
    nominal, far = Calibration.nominal(robot_from_document(document)), np.eye(4)
    far[:3, :3], far[:3, 3] = pin.rpy.rpyToMatrix(0.2, -0.1, 1.1), (2.0, -1.5, 0.7)
    values = nominal.values + np.where([name == "theta_offset_2" for name in nominal.names], 2e-3, 0.0)
    seen = Calibration(replace(nominal.model, T_base=far), values, wanted_base=far)
    text = export(form, exportable(document, seen)).text
    apart = {(m[1], m[2]): float(m[3]) for m in re.finditer(r"# number (\S+) (\S+) .*difference=(\S+)", text)}
    changed = {key: size for key, size in apart.items() if abs(size) > 1e-5}
    assert changed == {("j2", "theta_offset_deg"): pytest.approx(math.degrees(2e-3), abs=1e-5)}
    here = Calibration(nominal.model, nominal.values)
    twins = [export("mjcf", exportable(document, one)).text for one in (seen, here)]
    at = [np.array(re.findall(r'"kilter_nominal" data="([^"]*)"', twin)[0].split(), dtype=float) for twin in twins]
    np.testing.assert_allclose(*at, atol=1e-9)


LYING = {
    "name": "lying", "convention": "chain", "joints": [{"name": f"j{k}"} for k in (1, 2, 3, 4)],
    "elements": [
        {"joint": "j1", "axis": "Rx"}, {"name": "a_1", "axis": "Tx", "value": 300},
        {"joint": "j2", "axis": "Ry"}, {"name": "a_2", "axis": "Tx", "value": 400},
        {"joint": "j3", "axis": "Ry"}, {"name": "a_3", "axis": "Tx", "value": 250}, {"joint": "j4", "axis": "Rx"},
    ],
}  # fmt: skip


@pytest.mark.parametrize("turn", [(0.12, -0.1, 0.13), (-0.2, 0.3, -0.01), (0.0, 0.2, 0.0), (0.1, -0.2, 0.0)])
def test_a_base_near_pitch_90_degrees_differs_by_one_rotation(turn: tuple[float, float, float]) -> None:
    """Joint 1 is about x: the table's base has pitch 90 degrees. Turned by 0.2 it differed by -171.6 in one angle."""
    nominal = Calibration.nominal(robot_from_document(LYING))
    small = pin.SE3(pin.exp3(np.radians(turn)), np.zeros(3)).homogeneous
    moved = Calibration(replace(nominal.model, T_base=small), nominal.values, wanted_base=np.eye(4))
    text = export("dh-csv", exportable(LYING, moved)).text
    rows = re.findall(r"^# number base (r\S+) nominal=(\S+) exported=(\S+)(?: difference=(\S+))?$", text, re.MULTILINE)
    found = {name: tuple(float(value) for value in numbers if value) for name, *numbers in rows}
    angle = found.pop("rotation_deg")[2]
    angles = np.array([found[name] for name in ("rx_deg", "ry_deg", "rz_deg")])  # nominal and exported, no difference
    before, now = (pin.rpy.rpyToMatrix(*np.radians(column)) for column in angles.T)
    assert abs(angles[1, 0]) == pytest.approx(90.0)
    assert angle == pytest.approx(np.degrees(np.linalg.norm(pin.log3(before.T @ now))), abs=1e-5)
    assert 0.05 < angle < 0.4
    other = np.array([angles[0, 1] + 180.0, 180.0 - angles[1, 1], angles[2, 1] + 180.0]) - angles[:, 0]
    beside = other - 360.0 * np.round(other / 360.0)
    assert np.linalg.norm(angles[:, 1] - angles[:, 0]) <= np.linalg.norm(beside) + 1e-6


def placed(text: str) -> Floats:
    """Numbers of a MATLAB function, or poses of a URDF's origins: at pitch 90 degrees other angles say the same pose."""
    if text.startswith("function"):
        return np.array([float(x) for x in re.findall(r"(?<=[\[ ;])-?\d+\.\d*(?:e-?\d+)?", text)])
    origins = re.findall(r'<origin xyz="([^"]*)" rpy="([^"]*)"', text)
    turns = [pin.rpy.rpyToMatrix(*map(float, rpy.split())) for _, rpy in origins]
    return np.concatenate([np.ravel(turns), *(np.array(xyz.split(), dtype=float) for xyz, _ in origins)])


@pytest.mark.parametrize("name", ["ur10", "irb120", "panda"])
@pytest.mark.parametrize("form", ["urdf", "matlab"])
def test_other_formats_move_by_rounding_too(name: str, form: str) -> None:
    document = preset_document(name)
    nominal, near = (placed(export(form, version(document, moved)[0]).text) for moved in (0.0, 1e-9))
    assert len(nominal) == len(near) > 6 * 9
    assert np.abs(nominal - near).max() < 1e-7
