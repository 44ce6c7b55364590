"""Drafts of files whose orientation no name tells: quaternions and matrices by their numbers, poses in lists of records."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from kilter_files import draft, inspect, prepare
from kilter_files.ground.errors import FileError

Floats = NDArray[np.float64]
ROWS = 12
QUATERNION = ("qw", "qx", "qy", "qz")


@pytest.fixture(scope="module")
def poses() -> tuple[Floats, Floats, Rotation]:
    """Joints deg (n, 6), points mm (n, 3), orientations."""
    rng = np.random.default_rng(3)
    return rng.uniform(-120, 120, (ROWS, 6)), rng.uniform(200, 900, (ROWS, 3)), Rotation.random(ROWS, random_state=4)


def matrices(points: Floats, turns: Rotation) -> Floats:
    T = np.tile(np.eye(4), (len(points), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = turns.as_matrix(), points
    return T


def drafted(path: Path, folder: Path, *filled: tuple[str, str]) -> tuple[str, list[dict[str, float]]]:
    """The draft's text and the rows that come in by it, after filling in what is open."""
    found = draft(path)
    assert [f"not told: {one}" for one in found.open] == [n for n in inspect(path)["notes"] if n.startswith("not told")]
    text = found.text
    for old, new in filled:
        assert old in text, text
        text = text.replace(old, new)
    (folder / "map.toml").write_text(text)
    done = prepare(path, column_map=folder / "map.toml")
    rows = [
        {name: float(cell) for name, cell in row.items()} for row in csv.DictReader(io.StringIO(done.content.decode()))
    ]
    return found.text, rows


def agree(rows: list[dict[str, float]], q: Floats | None, points: Floats, turns: Rotation) -> None:
    assert len(rows) == len(points)
    for k, row in enumerate(rows):
        if q is not None:
            assert [row[f"q{j}_deg"] for j in range(1, 7)] == pytest.approx(list(q[k]), abs=1e-6)
        assert [row[f"{a}_mm"] for a in "xyz"] == pytest.approx(list(points[k]), abs=1e-6)
        other = Rotation.from_quat([row[name] for name in QUATERNION[1:]] + [row["qw"]])
        assert (other * turns[k].inv()).magnitude() < 1e-6


def write(path: Path, table: Floats, sep: str = " ") -> Path:
    path.write_text("\n".join(sep.join(f"{v:.12g}" for v in row) for row in table) + "\n")
    return path


def test_a_quaternion_of_a_table_without_a_header(tmp_path: Path, poses: tuple[Floats, Floats, Rotation]) -> None:
    q, p, turns = poses
    path = write(tmp_path / "a.txt", np.hstack([q, p, turns.as_quat()]))
    text, rows = drafted(path, tmp_path, ('quaternion = "?"', 'quaternion = "xyzw"'))
    assert 'order of its parts: "wxyz", or "xyzw" as ROS and scipy have it' in text
    agree(rows, q, p, turns)


@pytest.mark.parametrize(("order", "filled"), [("quat", True), ("quat_wxyz", False)])
def test_a_quaternion_of_a_matlab_file(
    tmp_path: Path, poses: tuple[Floats, Floats, Rotation], order: str, filled: bool
) -> None:
    q, p, turns = poses
    savemat(tmp_path / "a.mat", {"joints_deg": q, "tcp_pos_mm": p, order: turns.as_quat()[:, [3, 0, 1, 2]]})
    fill = [('quaternion = "?"', 'quaternion = "wxyz"')] if filled else []
    _, rows = drafted(tmp_path / "a.mat", tmp_path, *fill)
    agree(rows, q, p, turns)


@pytest.mark.parametrize("last", [True, False])
def test_matrices_of_a_matlab_file(tmp_path: Path, poses: tuple[Floats, Floats, Rotation], last: bool) -> None:
    q, p, turns = poses
    T = matrices(p, turns)
    savemat(tmp_path / "a.mat", {"joints_deg": q, "T": T.transpose(1, 2, 0) if last else T})
    _, rows = drafted(tmp_path / "a.mat", tmp_path)
    agree(rows, q, p, turns)


@pytest.mark.parametrize("by", ["rows", "columns", "twelve"])
@pytest.mark.parametrize("joints", [True, False])
def test_one_matrix_a_line(tmp_path: Path, poses: tuple[Floats, Floats, Rotation], by: str, joints: bool) -> None:
    q, p, turns = poses
    T = matrices(p, turns)
    flat = {
        "rows": T.reshape(ROWS, 16),
        "columns": T.transpose(0, 2, 1).reshape(ROWS, 16),
        "twelve": T[:, :3].reshape(ROWS, 12),
    }
    path = write(tmp_path / "a.csv", np.hstack([q, flat[by]]) if joints else flat[by], ",")
    fill = [] if joints else [('"q*" = { from = "?", unit = "?" }', "q1_deg = { value = 0 }")]
    _, rows = drafted(path, tmp_path, *fill)
    agree(rows, q if joints else None, p, turns)


def test_matrices_in_blocks_of_four_lines(tmp_path: Path, poses: tuple[Floats, Floats, Rotation]) -> None:
    _, p, turns = poses
    blocks = ["\n".join("\t".join(f"{v:.12g}" for v in row) for row in T) for T in matrices(p, turns)]
    path = tmp_path / "a.txt"
    path.write_text("\n\n".join(blocks) + "\n")
    text, rows = drafted(path, tmp_path, ('"q*" = { from = "?", unit = "?" }', "q1_deg = { value = 0 }"))
    assert "rows_per_pose = 4" in text
    agree(rows, None, p, turns)
    path.write_text("\n\n".join(blocks) + "\n0 0 0 1\n".replace(" ", "\t"))
    with pytest.raises(FileError, match="49 rows are not whole poses of 4"):
        prepare(path, column_map=tmp_path / "map.toml")


@pytest.mark.parametrize("ending", [".json", ".yaml"])
@pytest.mark.parametrize("nested", [True, False])
def test_poses_in_a_list_of_records(
    tmp_path: Path, poses: tuple[Floats, Floats, Rotation], ending: str, nested: bool
) -> None:
    q, p, turns = poses
    records = [
        {"pose_id": f"P{k // 2}", "joint_positions": np.radians(q[k]).tolist(), "tcp": {"position": p[k].tolist(),
         "orientation_xyzw": turns[k].as_quat().tolist()}}
        for k in range(ROWS)
    ]  # fmt: skip
    content = {"robot": "arm", "date": "2026-11-29", "poses": records} if nested else records
    path = tmp_path / f"a{ending}"
    path.write_text(json.dumps(content) if ending == ".json" else yaml.safe_dump(content))
    text, rows = drafted(path, tmp_path)
    with pytest.raises(FileError, match=r"column map .*kilter measure inspect .* --draft columns.toml"):
        prepare(path)
    assert 'pose_id = { from = "pose_id" }' in text
    for row in rows:
        row |= {f"q{j}_deg": float(np.degrees(row[f"q{j}_rad"])) for j in range(1, 7)}
    agree(rows, q, p, turns)
    first, again, second, last = (row["pose_id"] for row in rows[:4])
    assert first == again != second == last


def test_a_list_for_each_quantity(tmp_path: Path, poses: tuple[Floats, Floats, Rotation]) -> None:
    q, p, turns = poses
    content = {"joints_deg": q.tolist(), "positions": p.tolist(), "quat_xyzw": turns.as_quat().tolist(), "unit": "mm"}
    (tmp_path / "a.json").write_text(json.dumps(content))
    _, rows = drafted(tmp_path / "a.json", tmp_path)
    agree(rows, q, p, turns)


def test_parts_of_a_pose_by_their_letters(tmp_path: Path, poses: tuple[Floats, Floats, Rotation]) -> None:
    """As ROS writes a pose."""
    q, p, turns = poses
    records = [
        {"joints_deg": q[k].tolist(), "pose": {"position": dict(zip("xyz", p[k].tolist(), strict=True)),
         "orientation": dict(zip("xyzw", turns[k].as_quat().tolist(), strict=True))}}
        for k in range(ROWS)
    ]  # fmt: skip
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(records))
    _, rows = drafted(tmp_path / "a.yaml", tmp_path)
    agree(rows, q, p, turns)


def test_a_document_without_records_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"a": 1}')
    (tmp_path / "a.yaml").write_text("a: [1, 2")
    with pytest.raises(FileError, match="holds no list of records"):
        draft(tmp_path / "a.json")
    with pytest.raises(FileError, match="is not YAML"):
        draft(tmp_path / "a.yaml")


def test_names_of_poses_become_numbers(tmp_path: Path, poses: tuple[Floats, Floats, Rotation]) -> None:
    q, p, _ = poses
    lines = [f"Pose {'AB'[k % 2]};" + ";".join(f"{v:.6f}" for v in (*q[k], *p[k])) for k in range(ROWS)]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(["Pose;A1;A2;A3;A4;A5;A6;X [mm];Y [mm];Z [mm]", *lines]) + "\n")
    (tmp_path / "map.toml").write_text(draft(path).text)
    done = prepare(path, column_map=tmp_path / "map.toml")
    rows = [*csv.DictReader(io.StringIO(done.content.decode()))]
    found = [float(row["pose_id"]) for row in rows]
    assert found == found[:2] * (ROWS // 2)
    assert found[0] != found[1]
    assert any(f"{found[0]:.0f} is 'Pose A', {found[1]:.0f} is 'Pose B'" in note for note in done.notes)
