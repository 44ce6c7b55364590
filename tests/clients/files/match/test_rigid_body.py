"""Marker sets as rigid bodies, the tool point on them, and long tables of tools; scipy's rotations are the reference."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_client import FileError
from kilter_client.cli import run
from kilter_files.formats.joints.joint_log import read_joint_log
from kilter_files.formats.registry import open_recording
from kilter_files.ground.units import quaternions_from_matrices
from kilter_files.look.drafts import inspect
from kilter_files.match.clock_checks import Checks
from kilter_files.match.matching import frame_rows, match_dwells
from kilter_files.match.rigid_body import Body, find_body, poses, tool_as_markers
from kilter_files.tables.recording import drop_markers
from tests.clients.files.simulated import BODY, arm, stops, write_csv, write_log, write_n3d

POSES = np.random.default_rng(1).uniform(-60, 60, (8, 3))
TIP = np.array([30.0, -40.0, 120.0])


def test_a_pose_is_the_rotation_and_shift_that_moved_the_markers() -> None:
    rng = np.random.default_rng(2)
    shape = rng.normal(0, 80, (5, 3))
    turned, shift = Rotation.random(200, random_state=3), rng.uniform(-900, 900, (200, 3))
    points = np.stack([r.apply(shape) + s for r, s in zip(turned, shift, strict=True)])
    points[rng.random((200, 5)) < 0.3] = np.nan
    found = poses(Body(shape, TIP, ""), points)
    known = (~np.isnan(points[..., 0])).sum(axis=1) >= 3
    assert (~np.isnan(found.rms_mm) == known).all()
    assert np.abs(found.position_mm[known] - (turned.apply(TIP) + shift)[known]).max() < 1e-9
    got = Rotation.from_quat(found.quaternion[known][:, [1, 2, 3, 0]])
    assert (got * turned[known].inv()).magnitude().max() < 1e-12


def test_quaternions_at_half_turns() -> None:
    turns = Rotation.from_rotvec(np.pi * np.vstack([np.eye(3), [[0.6, 0.8, 0]], [[0, 0, 0]]]))
    got = Rotation.from_quat(quaternions_from_matrices(turns.as_matrix())[:, [1, 2, 3, 0]])
    assert (got * turns.inv()).magnitude().max() < 1e-7


def recorded(path: Path, seed: int = 4, markers: np.ndarray | None = None) -> Path:
    rng = np.random.default_rng(seed)
    t = np.arange(0, len(POSES) * 1.8, 1 / 100)
    points = arm(stops(POSES, 1.0, 0.8, t)) + rng.normal(0, 0.02, (len(t), 3, 3))
    fourth = points.mean(axis=1, keepdims=True) + rng.normal(0, 1e-9, (len(t), 1, 3))
    return write_n3d(path, np.concatenate([points, fourth], axis=1) if markers is None else markers, 100.0)


def true_poses(point: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """The point given in the hand's frame, and the hand's turn, by the definition of the simulated arm."""
    a, b, c = np.radians(POSES).T
    turned = Rotation.from_euler("z", a[:, None]) * Rotation.from_euler("y", (b + c)[:, None])
    corner = arm(POSES)[:, 0]
    return corner + turned.apply(point), turned


def test_dwells_as_poses_of_the_mean_and_of_a_digitised_point(tmp_path: Path) -> None:
    recording = open_recording(recorded(tmp_path / "a.n3d"))
    log = read_joint_log(write_log(tmp_path / "log.csv", POSES))
    body = find_body(recording, "mean")
    columns = match_dwells(recording, log, "order", body=body).columns
    position, turned = true_poses(BODY.mean(axis=0))
    assert np.abs(np.stack([columns[f"{a}_mm"] for a in "xyz"], 1) - position).max() < 0.02
    got = Rotation.from_quat(np.stack([columns[f"q{p}"] for p in "xyzw"], 1))
    fixed = turned.inv() * got  # the body's frame on the hand: the same at every pose
    assert (fixed * fixed[0].inv()).magnitude().max() < np.radians(0.05)
    hand = np.vstack([BODY, BODY.mean(axis=0), TIP])
    held = Rotation.from_euler("xyz", [20, -40, 100], degrees=True).apply(hand) + np.array([500, 300, 900])
    noise = np.random.default_rng(6).normal(0, 0.02, (300, 5, 3))
    write_csv(tmp_path / "tip.csv", held + noise, 100.0)
    fewer = find_body(drop_markers(recording, ["Marker_2"]), open_recording(tmp_path / "tip.csv"))
    assert fewer.markers.shape == (3, 3)
    tip = find_body(recording, open_recording(tmp_path / "tip.csv"))
    columns = match_dwells(recording, log, "order", body=tip).columns
    position = true_poses(TIP)[0]
    assert np.abs(np.stack([columns[f"{a}_mm"] for a in "xyz"], 1) - position).max() < 0.05


def test_a_marker_that_was_knocked_is_named_and_the_remedies_work(tmp_path: Path) -> None:
    recording = open_recording(recorded(tmp_path / "a.n3d"))
    points = recording.whole().points_mm
    sides = points[750:, 1:3] - points[750:, :1]  # directions that turn with the body, as a knocked marker does
    points[750:, 0] += 7.0 * (sides / np.linalg.norm(sides, axis=2, keepdims=True)).sum(axis=1)
    bent = open_recording(write_n3d(tmp_path / "b.n3d", points[: 8 * 180], 100.0))
    log = read_joint_log(write_log(tmp_path / "log.csv", POSES))
    for body in (find_body(bent, "mean"), None):
        with pytest.raises(
            FileError, match=r"'Marker_1' moved [89]\..* mm|'Marker_1' moved 1\d\..* mm on the body between"
        ) as refused:
            match_dwells(bent, log, "order", body=body)
    since = float(refused.value.detail.split("--since ")[1].split()[0].rstrip("."))
    later = match_dwells(bent, log, "order", checks=Checks(since_s=since))
    assert (later.columns["t_s"] > since).all()
    assert later.report["dwells"] == 3
    left = drop_markers(bent, ["Marker_1"])
    assert match_dwells(left, log, "order", body=find_body(left, "mean")).report["dwells"] == 8
    said = match_dwells(bent, log, "order", checks=Checks(unchecked=True)).report["warnings"]
    assert any("'Marker_1' moved" in text for text in said)


@pytest.mark.parametrize(
    ("change", "tcp", "words"),
    [
        (lambda p: p[:, :1], "mean", "its markers fix no orientation"),
        (lambda p: np.repeat(p[:, :1], 3, axis=1) + np.arange(3)[None, :, None] * 40.0, "mean", "fix no orientation"),
        (lambda p: p, "1,2", "--tcp 1,2: no point"),
        (lambda p: p, "TIP", "holds 4 markers; the recording has 4"),
    ],
)
def test_bodies_that_cannot_be(tmp_path: Path, change: Any, tcp: str, words: str) -> None:
    recording = open_recording(recorded(tmp_path / "a.n3d"))
    other = open_recording(write_n3d(tmp_path / "b.n3d", change(recording.whole().points_mm), 100.0))
    with pytest.raises(FileError, match=words):
        find_body(other, open_recording(tmp_path / "a.n3d") if tcp == "TIP" else tcp)


def long_table(path: Path, matrix: bool, frames: int = 300, **edit: str) -> tuple[Path, np.ndarray, Rotation]:
    """Two tools, one row each, as scripts around NDI's API write them; the second is hidden now and then."""
    t = np.arange(frames) / 60
    turned = Rotation.from_euler("zyx", np.stack([40 * np.sin(t), 20 * np.cos(t), 30 * np.sin(2 * t)], 1), degrees=True)
    position = np.stack([100 * np.sin(t), 200 * np.cos(t), -900 + 50 * t], axis=1)
    head = "Tool ID,Timestamp,Frame #,Tx,Ty,Tz," + (
        ",".join(f"R{i}{j}" for i in range(3) for j in range(3)) if matrix else "Q0,Qx,Qy,Qz"
    )
    rows = [head + ",Tracking Quality"]
    for k in range(frames):
        turn = turned[k].as_matrix().ravel() if matrix else turned[k].as_quat()[[3, 0, 1, 2]]
        numbers = ",".join(f"{v:.9f}" for v in [*position[k], *turn])
        hidden = ",".join("0" for _ in range(3 + len(turn)))
        for tool in ("8700339", "8700340"):
            gone = tool == "8700340" and k % 50 < 5
            rows.append(f"{tool},{1600000000 + t[k]:.6f},{1000 + k},{hidden if gone else numbers},0.1")
    for old, new in edit.items():
        rows[int(old[1:])] = new
    path.write_text("\n".join(rows) + "\n")
    return path, position, turned


@pytest.mark.parametrize("matrix", [True, False])
def test_long_tables_of_tools(tmp_path: Path, matrix: bool) -> None:
    path, position, turned = long_table(tmp_path / "polaris.csv", matrix)
    recording = open_recording(path)
    assert (recording.markers, recording.frames) == (("tool 8700339", "tool 8700340"), 300)
    assert recording.rate_hz == pytest.approx(60, rel=1e-3)
    block = recording.whole()
    assert np.abs(block.points_mm[:, 0] - position).max() < 1e-6
    assert np.isnan(block.points_mm[:5, 1]).all()
    found = poses(find_body(tool_as_markers(recording), "10,20,30"), tool_as_markers(recording).whole().points_mm)
    assert np.abs(found.position_mm - (turned.apply([10, 20, 30]) + position)).max() < 1e-5
    got = Rotation.from_quat(found.quaternion[:, [1, 2, 3, 0]])
    assert (got * turned.inv()).magnitude().max() < 1e-6
    shown = inspect(path)
    assert shown["kind"] == "tool-long-csv"
    assert shown["markers"][1]["seen"] == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        ({"_9": "8700339,1600000000.1,1004,1,2,3,1,0,0,0,0.1,7"}, "line 10: 12 cells where the first row has 11"),
        (
            {"_9": "8700339,1600000000.1,1004,1,2,3,1,2,0,0,0.1"},
            "line 10: the quaternion of 8700339 does not have length 1",
        ),
        ({"_9": "8700339,1600000000.1,900,1,2,3,1,0,0,0,0.1"}, "line 10: the frame goes back"),
        ({"_10": "8700339,1600000000.1,1004,1,2,3,1,0,0,0,0.1"}, "line 11: tool '8700339' is twice in frame 1004"),
        ({"_9": "8700339,1600000000.1,1004,oops,2,3,1,0,0,0,0.1"}, "line 10, column 'Tx': 'oops' is not a number"),
    ],
)
def test_damaged_long_tables(tmp_path: Path, edit: dict[str, str], words: str) -> None:
    path, _, _ = long_table(tmp_path / "polaris.csv", False, 20, **edit)
    with pytest.raises(FileError, match=words):
        open_recording(path)


def test_frames_as_poses_and_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from kilter_files.match.clock_checks import Checks
    from kilter_files.match.clocks import match_pieces
    from kilter_files.match.dwells import thin

    recording = recorded(tmp_path / "a.n3d")
    log_t = np.arange(-1, 18, 1 / 125)
    log = write_log(tmp_path / "log.csv", stops(POSES, 1.0, 0.8, np.clip(log_t, 0, None)), log_t)
    found, joints = open_recording(recording), read_joint_log(log)
    pieces, _ = match_pieces(recording, thin(found), joints, Checks(None))
    clocks = pieces.parts[0][2]
    rows = next(frame_rows(found, joints, clocks, find_body(found, "mean")))
    assert {"x_mm", "qw", "q1_deg"} <= set(rows)
    assert "m1x_mm" not in rows
    plain = write_log(tmp_path / "plain.csv", POSES)
    assert (
        run(["match", str(recording), str(plain), "--tcp", "mean", "--out", str(tmp_path / "rows.csv"), "--json"]) == 0
    )
    assert "qw" in json.loads(capsys.readouterr().out)["columns"]


def test_a_real_auroras_tools_as_poses(shared_data: Path) -> None:
    recording = open_recording(shared_data / "ndi-formats/aurora_csv/NDIdata_snakeravenTest_2_2_21.csv")
    for name in recording.markers[:2]:
        block, k = recording.whole(), recording.markers.index(name)
        assert block.quaternions is not None
        tool = tool_as_markers(recording, name)
        found = poses(find_body(tool, "mean"), tool.whole().points_mm)
        seen = ~np.isnan(block.points_mm[:, k, 0])
        assert (np.isnan(found.rms_mm) == ~seen).all()
        np.testing.assert_allclose(found.position_mm[seen], block.points_mm[seen, k], atol=1e-9)
        got, wanted = (
            Rotation.from_quat(q[seen][:, [1, 2, 3, 0]]) for q in (found.quaternion, block.quaternions[:, k])
        )
        assert (got * wanted.inv()).magnitude().max() < 1e-9
