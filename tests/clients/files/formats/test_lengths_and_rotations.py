"""Data sets whose videos are of other lengths than their rows, and servos that count from another rotation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from kilter_files import read_joints
from kilter_files.formats.joints.lerobot.moved import Move, detect_joint_moves, read_episodes
from kilter_files.formats.reader import LogHints
from kilter_files.ground.errors import FileError
from kilter_files.look.drafts import inspect
from tests.clients.files.formats.test_episodes import Floats, steps, task
from tests.clients.files.formats.test_lerobot import CAMERA, FPS, SERVOS, VERSIONS, calibration, dataset, film, hints
from tests.clients.test_cli import Command

WHOLE = 360.0 * 4096 / 4095  # degrees as LeRobot counts them
DEGREES = LogHints(norm_mode="DEGREES")


def filmed(folder: Path, version: str) -> Path:
    """Twelve episodes of other lengths with their videos, in which nothing moved."""
    rng = np.random.default_rng(5)
    return dataset(folder, version, [task(rng, np.zeros(6), 60 + k) for k in range(12)], SERVOS, video=True)


def refused(command: Command, folder: Path) -> str:
    """The same refusal, whatever is asked of the data set."""
    said = command.json("episodes", folder, "--norm-mode", "DEGREES", code=1)
    assert said["code"] == "file_invalid"
    with pytest.raises(FileError) as caught:
        inspect(folder)
    assert caught.value.detail == said["detail"]
    with pytest.raises(FileError) as caught:
        read_joints(folder, hints=hints(calibration(folder)))
    assert caught.value.detail == said["detail"]
    return str(said["detail"])


@pytest.mark.parametrize("version", VERSIONS)
def test_videos_of_another_length_than_their_rows_are_refused(tmp_path: Path, command: Command, version: str) -> None:
    folder = filmed(tmp_path / "set", version)
    assert "No joint moved" in command("episodes", folder, "--norm-mode", "DEGREES")
    video = sorted(folder.glob("videos/**/*.mp4"))[1]
    rows = 61 if version == "v2.1" else 62 + 63
    for pictures in (rows - 20, rows + 1):
        film(video, pictures)
        told = refused(command, folder)
        assert f"{video}: has {pictures} pictures, its rows in the data set are {rows}" in told
        assert "Leave the episode out, or record it again" in told
    film(video, rows, FPS / 2)
    told = refused(command, folder)
    assert f"{video}: runs for {2 * rows / FPS:.6g} s, its {rows} rows at 30 Hz for {rows / FPS:.6g} s" in told
    film(video, rows)
    assert "No joint moved" in command("episodes", folder, "--norm-mode", "DEGREES")
    video.write_bytes(video.read_bytes()[:-300])
    assert f"{video}: is an MP4 file without an index. It was cut off" in refused(command, folder)
    video.unlink()
    assert f"{video}: is missing. It is half written" in refused(command, folder)


@pytest.mark.parametrize("by_s", [-0.5, 1.1 / FPS, float("nan")])
def test_an_episode_whose_pictures_run_for_another_time_by_the_data_set_itself_is_named(
    tmp_path: Path, command: Command, by_s: float
) -> None:
    """Pictures of one episode went to its neighbour: both are in one file, whose length is right."""
    folder = filmed(tmp_path / "set", "v3.0")
    (file,) = folder.glob("meta/episodes/**/*.parquet")
    table, name = parquet.read_table(file), f"videos/{CAMERA}/to_timestamp"
    ends = table.column(name).to_numpy().copy()
    ends[6] += by_s
    parquet.write_table(table.set_column(table.column_names.index(name), name, pa.array(ends)), file)
    told = refused(command, folder)
    assert f"meta/episodes, episode 6: its pictures of {CAMERA} run from 0 to " in told
    assert "its rows are 66. Leave the episode out" in told


@pytest.mark.parametrize("version", VERSIONS)
def test_a_file_with_other_rows_than_its_episodes_is_refused(tmp_path: Path, command: Command, version: str) -> None:
    folder = filmed(tmp_path / "set", version)
    file = sorted(folder.glob("data/**/*.parquet"))[1]
    parquet.write_table(parquet.read_table(file).slice(0, 40), file)
    assert f"{file}: has 40 rows, its episodes have " in refused(command, folder)


def moves(folder: Path, version: str, shifts: list[Floats]) -> list[Move]:
    rng = np.random.default_rng(3)
    return detect_joint_moves(
        read_episodes(dataset(folder, version, [task(rng, shift) for shift in shifts], SERVOS), DEGREES), 2.0
    )


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("joint", [1, 4])
@pytest.mark.parametrize("by", [-WHOLE, WHOLE])
def test_a_servo_that_counts_from_another_rotation_has_kept_its_zero(
    tmp_path: Path, version: str, joint: int, by: float
) -> None:
    (move,) = moves(tmp_path / "set", version, steps(24, 10, joint, by))
    assert (move.joint, move.before, move.after, move.what) == (SERVOS[joint], 9, 10, "rotation")
    assert move.by_deg == pytest.approx(by, abs=15.0)


@pytest.mark.parametrize("version", VERSIONS)
def test_one_episode_in_another_rotation_is_named_at_both_ends(tmp_path: Path, version: str) -> None:
    shifts = [np.zeros(6) for _ in range(20)]
    shifts[7][2] = WHOLE
    found = moves(tmp_path / "set", version, shifts)
    assert [(move.joint, move.before, move.after, move.what) for move in found] == [
        ("elbow_flex", 6, 7, "rotation"), ("elbow_flex", 7, 8, "rotation"),
    ]  # fmt: skip
    assert [np.sign(move.by_deg) for move in found] == [1.0, -1.0]


@pytest.mark.parametrize("version", VERSIONS)
def test_a_zero_that_moved_beside_a_rotation_is_named_too(tmp_path: Path, version: str) -> None:
    both = zip(steps(40, 14, 2, -WHOLE), steps(40, 14, 2, 12.0), steps(40, 30, 3, 9.0), strict=True)
    found = moves(tmp_path / "set", version, [one + two + three for one, two, three in both])
    assert [(move.joint, move.after, move.what) for move in found] == [
        ("elbow_flex", 14, "rotation"), ("elbow_flex", 14, "zero"), ("wrist_flex", 30, "zero"),
    ]  # fmt: skip
    assert found[1].by_deg == pytest.approx(12.0, abs=2.0)


def test_motion_from_one_end_of_the_range_to_the_other_is_no_rotation_of_a_servo(tmp_path: Path) -> None:
    """A roll that goes from -170 to 170 degrees within each episode, and one that is parked at the other end."""
    values = []
    for k in range(20):
        one = np.zeros((80, 6))
        one[:, 4] = np.linspace(-170.0, 170.0, 80) * (1.0 if k % 2 else -1.0)
        values.append(one)
    assert detect_joint_moves(read_episodes(dataset(tmp_path / "set", "v3.0", values, SERVOS), DEGREES), 2.0) == []


@pytest.mark.parametrize("version", VERSIONS)
def test_a_servo_that_wraps_within_an_episode_is_refused_with_its_row(
    tmp_path: Path, command: Command, version: str
) -> None:
    rng = np.random.default_rng(4)
    values = [task(rng, np.zeros(6)) for _ in range(8)]
    values[1][37:, 4] -= WHOLE
    folder = dataset(tmp_path / "set", version, values, SERVOS)
    row = 38 if version == "v2.1" else 60 + 38
    said = command.json("episodes", folder, "--norm-mode", "DEGREES", code=1)
    file = folder / (
        "data/chunk-000/episode_000001.parquet" if version == "v2.1" else "data/chunk-000/file-000.parquet"
    )
    assert said["code"] == "file_invalid"
    assert f"{file}, row {row}, column 'wrist_roll': jumps by 360 degrees" in said["detail"]
    assert "Calibrate the arm in the middle of its range and record again" in said["detail"]


def test_the_command_says_of_a_rotation_what_it_is(tmp_path: Path, command: Command) -> None:
    rng = np.random.default_rng(3)
    folder = dataset(tmp_path / "set", "v3.0", [task(rng, shift) for shift in steps(24, 10, 4, WHOLE)], SERVOS)
    told = " ".join(command("episodes", folder, "--norm-mode", "DEGREES", code=3).split())
    assert "wrist_roll moved by +3" in told
    assert "between episodes 9 and 10 (start, end, lowest, highest; single episodes scatter by " in told
    assert "its servo counts from another rotation: it wraps within its range" in told


def test_rows_that_the_servos_do_not_reach_are_of_another_calibration(tmp_path: Path, command: Command) -> None:
    rng = np.random.default_rng(3)
    folder = dataset(tmp_path / "set", "v3.0", [task(rng, np.zeros(6)) for _ in range(8)], SERVOS)
    narrow = calibration(tmp_path, "narrow.json", elbow_flex={"range_min": 1900, "range_max": 2200})
    asked = ("episodes", folder, "--norm-mode", "DEGREES", "--calibration")
    said = command.json(*asked, narrow, code=1)
    assert said["code"] == "file_invalid"
    assert f"{folder}/data/chunk-000/file-000.parquet, row 1, column 'elbow_flex': " in said["detail"]
    assert "is outside the range of narrow.json (+-13.19 deg)" in said["detail"]
    assert "No joint moved" in command(*asked, calibration(tmp_path))
