"""Real measurements through importers and example maps, compared with an independent reading of the files."""

from __future__ import annotations

import io
import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from kilter_client import FileError, prepare
from kilter_files import Prepared

EXAMPLES = Path(__file__).resolve().parents[2] / "clients/python/examples"


def columns(prepared: Prepared) -> dict[str, np.ndarray]:
    table = np.genfromtxt(io.BytesIO(prepared.content), delimiter=",", names=True)
    assert table.dtype.names is not None
    return {name: table[name] for name in table.dtype.names}


def raw(path: Path) -> tuple[list[str], np.ndarray]:
    text = path.read_text().replace(",", ".").splitlines()
    return text[0].split(";"), np.array([[float(cell) for cell in line.split(";")] for line in text[1:]])


def test_ipa_series_b(shared_data: Path) -> None:
    path = shared_data / "ipa-ur10-lasertracker/Series_B/measurements_joint_configurations.csv"
    prepared = prepare(path, device="ipa-lasertracker")
    got, (names, table) = columns(prepared), raw(path)
    assert prepared.rows == len(table) == 1495
    assert "t_s" not in got
    assert any("1495 of 1495 are damaged" in text for text in prepared.warnings)
    assert any("std_rx" in text for text in prepared.warnings)
    np.testing.assert_array_equal(got["q4_rad"], table[:, names.index("wrist_1_joint")])
    np.testing.assert_array_equal(got["z_mm"], table[:, names.index("measurement_z")])
    np.testing.assert_array_equal(got["sy_mm"], table[:, names.index("measurement_std_y")])
    np.testing.assert_array_equal(got["temperature_c"], table[:, names.index("measurement_temperature")])
    euler = table[:, [names.index(f"measurement_r{axis}") for axis in "xyz"]]
    expected = Rotation.from_euler("XYZ", euler, degrees=True)
    turned = Rotation.from_quat(np.stack([got["qx"], got["qy"], got["qz"], got["qw"]], axis=1))
    assert float((turned * expected.inv()).magnitude().max()) < 1e-12


def test_ipa_series_a_has_time(shared_data: Path) -> None:
    path = shared_data / "ipa-ur10-lasertracker/Series_A/measurements_grid.csv"
    prepared = prepare(path, device="ipa-lasertracker")
    got = columns(prepared)
    assert prepared.rows == 11911
    assert prepared.warnings == ()
    assert got["t_s"].min() == datetime(2020, 7, 14, 16, 39, 4, tzinfo=UTC).timestamp()
    # 2020-07-14 16:39:04 to the second row at 16:39:24
    assert got["t_s"][1] - got["t_s"][0] == 20


def test_ipa_hand_eye_file_is_refused(shared_data: Path) -> None:
    path = shared_data / "ipa-ur10-lasertracker/Series_B/calibration_handeye.csv"
    with pytest.raises(FileError, match="hand-eye calibration holds no joint readings"):
        prepare(path, device="ipa-lasertracker")


def test_ipa_rows_with_empty_cells_are_left_out_and_bad_cells_named(shared_data: Path, tmp_path: Path) -> None:
    lines = (shared_data / "ipa-ur10-lasertracker/Series_B/measurements_joint_configurations.csv").read_text()
    head, first, second, third, *_ = lines.splitlines()
    cells = second.split(";")
    path = tmp_path / "series.csv"
    path.write_text("\n".join([head, first, ";".join([*cells[:14], "", *cells[15:]]), third]))
    prepared = prepare(path, device="ipa-lasertracker")
    assert prepared.rows == 2
    assert prepared.lines == (2, 4)
    assert any("1 rows left out because a cell is empty (line 3)" in text for text in prepared.warnings)
    path.write_text("\n".join([head, first, ";".join([*cells[:14], "1.5.3", *cells[15:]])]))
    with pytest.raises(FileError, match="line 3, column 'measurement_x'"):
        prepare(path, device="ipa-lasertracker")


def test_talos_comes_in_through_its_map(shared_data: Path) -> None:
    path = shared_data / "talos-arm/talos_left_arm_02_10_contact.csv"
    prepared = prepare(path, column_map=EXAMPLES / "talos.toml")
    got = columns(prepared)
    table = np.genfromtxt(path, delimiter=",", names=True)
    assert prepared.rows == len(table) == 61
    np.testing.assert_array_equal(got["q1_rad"], table["torso_1_joint"])
    np.testing.assert_array_equal(got["q9_rad"], table["arm_left_7_joint"])
    np.testing.assert_allclose(got["y_mm"], table["y1"] * 1000, rtol=1e-15)
    np.testing.assert_array_equal(got["t_s"], table["t"])


def test_fanuc_comes_in_through_its_map(shared_data: Path) -> None:
    path = shared_data / "fanuc-r2000-3markers/calibration_dataset.mat"
    prepared = prepare(path, column_map=EXAMPLES / "fanuc.toml")
    got, log = columns(prepared), loadmat(path)
    assert prepared.rows == 240
    np.testing.assert_array_equal(np.stack([got[f"q{i}_rad"] for i in range(1, 7)], axis=1), log["q"])
    np.testing.assert_allclose(got["m3z_mm"], log["mC"][:, 2] * 1000, rtol=1e-15)
    poses, counts = np.unique(got["pose_id"], return_counts=True)
    assert len(poses) == 24
    assert set(counts) == {10}
    for pose in poses:
        assert np.ptp(log["q"][got["pose_id"] == pose], axis=0).max() < math.radians(0.001)
