"""Recordings of markers: real files against independent readers, and gaps that never become coordinates."""

from __future__ import annotations

import csv
import struct
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from kilter_client import FileError
from kilter_files.formats.registry import open_recording
from kilter_files.tables.recording import without_gaps
from tests.clients.files.simulated import write_csv, write_n3d


def by_ezc3d(path: Path) -> np.ndarray:
    return np.moveaxis(ezc3d.c3d(str(path))["data"]["points"][:3], 2, 0).swapaxes(1, 2)


def test_qualisys_c3d(shared_data: Path) -> None:
    path = shared_data / "ndi-formats/c3d/Qualisys.c3d"
    found = open_recording(path)
    assert (found.kind, found.frames, found.rate_hz, len(found.markers)) == ("c3d", 340, 200.0, 55)
    assert found.markers[:2] == ("L_IAS", "L_IPS")
    block = found.whole()
    np.testing.assert_array_equal(block.points_mm, by_ezc3d(path))
    np.testing.assert_allclose(block.t_s[:2], [0, 0.005])


def test_optotrak_c3d_that_stopped_early_is_taken_and_said_to_be_so(shared_data: Path, tmp_path: Path) -> None:
    path = shared_data / "ndi-formats/c3d/Optotrak.c3d"
    broken = tmp_path / "broken.c3d"
    broken.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(FileError, match=r"frame 29: is cut off: POINT:FRAMES states 1149 frames .* 28 are there"):
        open_recording(broken)
    found = open_recording(path)
    points = found.whole().points_mm
    np.testing.assert_array_equal(points, by_ezc3d(path))
    assert points.shape == (29, 54, 3)
    assert np.isnan(points).mean() == pytest.approx(0.038, abs=0.001)
    assert "POINT:FRAMES states 1149 frames, the 29 in it are complete" in found.warnings[0]


def test_n3d(shared_data: Path) -> None:
    paths = sorted((shared_data / "ndi-formats/n3d").glob("*.n3d"))
    assert paths
    for path in paths:
        raw = np.frombuffer(path.read_bytes()[256:], "<f4").reshape(-1, 41, 3)
        found = open_recording(path)
        points = found.whole().points_mm
        assert (found.kind, found.rate_hz, found.frames) == ("n3d", 70.0, len(raw))
        missing = (raw < -1e28).any(axis=2)
        assert np.isnan(points).all(axis=2)[missing].all()
        np.testing.assert_array_equal(points[~missing], raw[~missing].astype(float))


def test_aurora(shared_data: Path) -> None:
    path = shared_data / "ndi-formats/aurora_csv/NDIdata_snakeravenTest_2_2_21.csv"
    found = open_recording(path)
    assert "line 164, the last, is cut off (5 of 33 cells) and left out" in found.warnings
    block = found.whole()
    with path.open() as stream:
        rows = [[float(c) for c in row if c.strip()] for row in list(csv.reader(stream))[5:-1]]
    raw = np.array(rows)
    tools = raw[:, 5:].reshape(-1, 4, 7)
    assert found.markers == ("a", "b", "c", "d")
    assert block.quaternions is not None
    hidden = (tools == 0).all(axis=2)
    assert 0 < hidden.sum() < hidden.size
    assert np.isnan(block.points_mm[hidden]).all()
    assert np.isnan(block.quaternions[hidden]).all()
    np.testing.assert_array_equal(block.points_mm[~hidden], tools[~hidden][:, :3])
    turned = tools[~hidden][:, 3:]
    np.testing.assert_allclose(block.quaternions[~hidden], turned / np.linalg.norm(turned, axis=1)[:, None])
    seconds = raw[:, 1:5] @ [3600, 60, 1, 0.001]
    np.testing.assert_allclose(block.t_s, seconds - seconds[0], atol=1e-9)


def test_what_is_not_seen_is_a_gap() -> None:
    points = np.array([[[1.0, 2, 3], [0, 0, 0], [-3.7e28, 1, 1], [np.nan, 1, 1], [5, 0, 0], [7, 7, 7]]])
    got = without_gaps(points, np.array([[0.0, 0, 0, 0, 0, -1]]))
    np.testing.assert_array_equal(np.isnan(got[0]).all(axis=1), [False, True, True, True, False, True])


@pytest.mark.parametrize("scale", [-1.0, 0.05])
@pytest.mark.parametrize("order", ["<", ">"])
def test_c3d_of_reals_and_of_scaled_integers_in_both_orders(tmp_path: Path, scale: float, order: str) -> None:
    points = np.round(np.random.default_rng(0).uniform(-1000, 1000, (50, 4, 3)) / 0.05) * 0.05
    points[3, 1] = np.nan
    path = tmp_path / "made.c3d"
    path.write_bytes(c3d_bytes(points, 120.0, scale, order, "m"))
    found = open_recording(path)
    got = found.whole().points_mm
    assert (found.frames, found.rate_hz) == (50, 120.0)
    assert np.isnan(got[3, 1]).all()
    np.testing.assert_allclose(got, points * 1000, rtol=1e-6, atol=1e-3)


def c3d_bytes(points: np.ndarray, rate: float, scale: float, order: str, unit: str) -> bytes:
    """A C3D file written from the published layout, by hand."""
    frames, count, _ = points.shape
    entries = b""

    def entry(group: int, name: bytes, data: bytes) -> bytes:
        return struct.pack("bb", len(name), group) + name + struct.pack(f"{order}H", len(data) + 2) + data

    entries += entry(-1, b"POINT", b"\0")
    entries += entry(1, b"UNITS", struct.pack("bBBB", -1, 2, len(unit), 1) + unit.encode() + b"\0")
    entries += entry(1, b"FRAMES", struct.pack(f"{order}bBHB", 2, 0, frames, 0))
    parameters = (b"\0\0\1" + bytes([84 if order == "<" else 86]) + entries + b"\0\0").ljust(512, b"\0")
    head = bytes([2, 0x50]) + struct.pack(f"{order}5HfHHf", count, 0, 1, frames, 10, scale, 3, 0, rate)
    four = np.concatenate([np.nan_to_num(points), np.where(np.isnan(points[..., :1]), -1.0, 0.0)], axis=2)
    if scale > 0:
        four[..., :3] /= scale
        data = np.round(four).astype(f"{order}i2").tobytes()
    else:
        data = four.astype(f"{order}f4").tobytes()
    return head.ljust(512, b"\0") + parameters + data + b"\0" * (-len(data) % 512)


@pytest.mark.parametrize(
    ("labels", "groups", "left"),
    [
        (["M1", "M2", "LKneeAngles", "Top"], {"ANGLES": ["LKneeAngles"]}, ["LKneeAngles of POINT:ANGLES"]),
        (
            ["Ann:M1", "Ann:LHipMoment", "Ann:LHipPower", "Ann:M2"],
            {"MOMENTS": ["LHipMoment"], "POWERS": ["Ann:LHipPower"]},
            ["Ann:LHipMoment of POINT:MOMENTS", "Ann:LHipPower of POINT:POWERS"],
        ),
        (["Force", "M1", "M2", "M3"], {"FORCES": ["GRF1"], "SCALARS2": ["Force"]}, ["Force of POINT:SCALARS"]),
        (["M1", "M2", "M3", "Centre"], {"MODELED_MARKERS": ["Centre"], "ANGLES": [""]}, []),
    ],
)
def test_c3d_points_that_are_angles_or_forces_are_no_markers(
    tmp_path: Path, labels: list[str], groups: dict[str, list[str]], left: list[str]
) -> None:
    made = ezc3d.c3d()
    points = np.ones((4, 4, 10)) * np.arange(1.0, 5)[None, :, None]
    made["parameters"]["POINT"]["LABELS"]["value"] = labels
    made["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    made["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    for name, listed in groups.items():
        made.add_parameter("POINT", name, listed)
    made["data"]["points"] = points
    made.write(str(tmp_path / "made.c3d"))
    found = open_recording(tmp_path / "made.c3d")
    out = {text.split(" of ")[0] for text in left}
    kept = [k for k, label in enumerate(labels) if label not in out]
    assert found.markers == tuple(labels[k] for k in kept)
    np.testing.assert_array_equal(found.whole().points_mm[0, :, 0], np.array([1.0, 2, 3, 4])[kept])
    assert [w for w in found.warnings if "not markers" in w] == (
        [f"{'; '.join(left)}: left out, for these are not markers"] if left else []
    )


def test_c3d_of_nothing_but_angles_is_refused(tmp_path: Path) -> None:
    made = ezc3d.c3d()
    made["parameters"]["POINT"]["LABELS"]["value"] = ["LKneeAngles"]
    made["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    made.add_parameter("POINT", "ANGLES", ["LKneeAngles"])
    made["data"]["points"] = np.ones((4, 1, 10))
    made.write(str(tmp_path / "angles.c3d"))
    with pytest.raises(FileError, match=r"holds only LKneeAngles of POINT:ANGLES and no markers. Export the traject"):
        open_recording(tmp_path / "angles.c3d")


def test_more_than_65535_frames_written_by_a_library(tmp_path: Path) -> None:
    made = ezc3d.c3d()
    points = np.ones((4, 1, 66_000))
    points[0, 0] = np.arange(66_000)
    made["parameters"]["POINT"]["RATE"]["value"] = [4600.0]
    made["parameters"]["POINT"]["LABELS"]["value"] = ["A"]
    made["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    made["data"]["points"] = points
    made.write(str(tmp_path / "long.c3d"))
    found = open_recording(tmp_path / "long.c3d")
    block = found.whole()
    assert np.isfinite(block.points_mm[:66_000]).all()
    assert block.points_mm[65_999, 0, 0] == 65_999
    assert np.isnan(block.points_mm[66_000:]).all()
    assert any("65535" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("Frequency;100\nFrame;M1 x;M1 y;M1 z\n1;1,5;2;3\n2;;;\n3;1,5;2;4\n", ("M1",)),
        (
            "Rate (Hz)\t100\n\tA\t\t\tB\t\t\nFrame\tX\tY\tZ\tX\tY\tZ\n1\t1.5\t2\t3\t4\t5\t6\n2\t\t\t\t4\t5\t6\n",
            ("A", "B"),
        ),
        ("rate 100\nsample x1 y1 z1\n1 1.5 2 3\n2 0 0 0\n", ("1",)),
    ],
)
def test_dialects_of_text(tmp_path: Path, text: str, names: tuple[str, ...]) -> None:
    path = tmp_path / "frames.csv"
    path.write_text(text, encoding="latin-1")
    found = open_recording(path)
    points = found.whole().points_mm
    assert found.markers == names
    assert found.rate_hz == 100
    np.testing.assert_array_equal(points[0, 0], [1.5, 2, 3])
    assert np.isnan(points[1, 0]).all()


def test_the_frame_counter_is_the_time(tmp_path: Path) -> None:
    path = tmp_path / "skips.csv"
    path.write_text("Frequency,10\nFrame,m x,m y,m z\n5,1,2,3\n6,1,2,3\n9,1,2,3\n")
    np.testing.assert_allclose(open_recording(path).whole().t_s, [0, 0.1, 0.4])


def test_csv_and_n3d_say_the_same(tmp_path: Path) -> None:
    points = np.random.default_rng(1).normal(0, 500, (700, 3, 3))
    points[::7, 1] = np.nan
    a = open_recording(write_n3d(tmp_path / "a.n3d", points, 250.0)).whole()
    b = open_recording(write_csv(tmp_path / "a.csv", points, 250.0)).whole()
    np.testing.assert_allclose(a.points_mm, b.points_mm, atol=2e-4)
    np.testing.assert_allclose(a.t_s, b.t_s)
