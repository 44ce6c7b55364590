"""Delimited text, units and Euler angles, the parts every converted file is made of."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_client import FileError
from kilter_files.formats.tables.text import read_text
from kilter_files.ground.cell_numbers import parse_number
from kilter_files.ground.units import column_unit, converter, from_euler
from kilter_files.tables.source import Layout


def write(folder: Path, text: str, name: str = "file.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("sequence", ["XYZ", "xyz", "ZXZ", "zyx", "YXY"])
def test_euler_angles_agree_with_scipy(sequence: str) -> None:
    for angles in ((0.3, -1.1, 2.4), (-3.0, 0.2, 0.01), (0.0, 0.0, 0.0)):
        w, x, y, z = from_euler(angles, sequence)
        turned = Rotation.from_quat([x, y, z, w]) * Rotation.from_euler(sequence, angles).inv()
        assert turned.magnitude() < 1e-12
        assert w >= 0


@pytest.mark.parametrize(
    ("text", "decimal", "value"),
    [("1,5", ",", 1.5), ("-2,78E-05", ",", -2.78e-5), ("1.5", ".", 1.5), (" ", ".", None), ("1_000", ".", None)],
)
def test_numbers(text: str, decimal: str, value: float | None) -> None:
    assert parse_number(text, decimal) == value


@pytest.mark.parametrize(
    ("text", "decimal"), [("1.234,5", ","), ("1,234.5", "."), ("1.5", ","), ("inf", "."), ("x", ".")]
)
def test_a_thousands_separator_is_no_number(text: str, decimal: str) -> None:
    assert parse_number(text, decimal) is None


@pytest.mark.parametrize("text", ["", "NaN", "n/a", "NULL"])
def test_missing_cells(text: str) -> None:
    value = parse_number(text)
    assert value is not None
    assert math.isnan(value)


def test_lines_count_skipped_lines_comments_and_the_header(tmp_path: Path) -> None:
    path = write(tmp_path, "made by X\nunits: m\na;b\n# pause\n1,5;2\n\n3;4\n")
    source = read_text(path, Layout(delimiter=";", decimal=",", skip_rows=2, comment="#"))
    assert source.names == ["a", "b"]
    assert source.lines == [5, 7]
    assert source.numbers("a") == [1.5, 3.0]
    assert source.numbers(1) == [2.0, 4.0]


def test_without_a_header_columns_are_counted(tmp_path: Path) -> None:
    source = read_text(write(tmp_path, "1,2\n3,4\n"), Layout(header=False))
    assert source.numbers(0) == [1.0, 3.0]
    assert source.lines == [1, 2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a,b\n1,2\n3\n", "line 3: 1 cells where the header has 2"),
        ("a,a\n1,2\n", "two columns are called 'a'"),
        ("", "no rows"),
    ],
)
def test_a_damaged_file_is_refused_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(FileError, match=words):
        read_text(write(tmp_path, text), Layout())


def test_a_bad_cell_is_named_by_line_and_column(tmp_path: Path) -> None:
    source = read_text(write(tmp_path, "joint 1,b\n1,2\n1.2.3,4\n"), Layout())
    with pytest.raises(FileError, match=r"line 3, column 'joint 1': '1.2.3' is not a number") as caught:
        source.numbers("joint 1")
    assert caught.value.context["line"] == 3
    assert caught.value.context["column"] == "joint 1"


def test_an_unknown_column_gets_a_suggestion(tmp_path: Path) -> None:
    source = read_text(write(tmp_path, "joint_1,b\n1,2\n"), Layout())
    with pytest.raises(FileError, match="did you mean 'joint_1'"):
        source.numbers("joint1")


def test_another_encoding_is_named(tmp_path: Path) -> None:
    path = tmp_path / "latin.csv"
    path.write_bytes("größe\n1\n".encode("latin-1"))
    with pytest.raises(FileError, match="'encoding'"):
        read_text(path, Layout())
    assert read_text(path, Layout(encoding="latin-1")).names == ["größe"]


@pytest.mark.parametrize(
    ("column", "unit"),
    [("q1_deg", "deg"), ("q12_mm", "mm"), ("m3y_m", "m"), ("qd2_deg_s", "deg/s"), ("qdd2_rad_s2", "rad/s2"),
     ("tau1_nm", "Nm"), ("pose_id", ""), ("temperature_c", "C"), ("q1", None), ("x", None), ("banana", None)],
)  # fmt: skip
def test_the_unit_is_in_the_name(column: str, unit: str | None) -> None:
    assert column_unit(column) == unit


@pytest.mark.parametrize(
    ("source", "target", "value", "expected"),
    [("m", "mm", 1.5, 1500.0), ("rad", "deg", math.pi, 180.0), ("inch", "mm", 1.0, 25.4), ("K", "C", 293.15, 20.0),
     ("turn", "rad", 0.5, math.pi), ("ms", "s", 250.0, 0.25)],
)  # fmt: skip
def test_units_convert(source: str, target: str, value: float, expected: float) -> None:
    convert = converter(source, target)
    assert convert is not None
    assert convert(value) == pytest.approx(expected, rel=1e-14)


def test_a_length_is_no_angle() -> None:
    assert converter("m", "deg") is None
    assert converter("furlong", "mm") is None


def test_contract_columns_agree_with_the_service() -> None:
    from kilter_service.ground.tables.columns import read_columns

    kinds = ["revolute", "prismatic"]
    tail = ["q1_rad", "q2_mm"]
    for names in (["x_m", "y_m", "z_m"], ["m1x_mm", "m1y_mm", "m1z_mm"], ["tau1_nm", "tau2_n"], ["dir1", "dir2"],
                  ["base_tilt_x_deg", "base_tilt_y_rad"], ["load2_kg", "load2_x_mm", "load2_y_mm", "load2_z_mm"],
                  ["load1_fx_n", "load1_fy_n", "load1_fz_n"], ["load2_mx_nm", "load2_my_nm", "load2_mz_nm"],
                  ["t_s", "payload_kg", "temperature_c", "session", "pose_id"], ["qd1_rad_s", "qd2_mm_s"],
                  ["qdd1_deg_s2", "qdd2_m_s2"], ["link1_deg", "link2_m"], ["cmd1_deg", "cmd2_mm"],
                  ["sx_mm", "sy_mm", "sz_mm"]):  # fmt: skip
        read_columns(tail + names, kinds)
        assert all(column_unit(name) is not None for name in names)


def test_quaternions_are_unit(tmp_path: Path) -> None:
    assert np.linalg.norm(from_euler((0.1, 0.2, 0.3), "XYZ")) == pytest.approx(1.0, abs=1e-15)
