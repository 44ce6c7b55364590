"""Data sets in which a joint moved, or did not: what can be told of it from readings and goals alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pyarrow import parquet

from kilter_files.formats.joints.lerobot.moved import Move, detect_joint_moves, read_episodes
from kilter_files.formats.reader import LogHints
from kilter_files.ground.errors import FileError
from tests.clients.files.formats.test_lerobot import JOINTS, SERVOS, VERSIONS, calibration, dataset, hints
from tests.clients.test_cli import Command

Floats = NDArray[np.float64]
TICK = 360.0 / 4095.0
REST = np.array([0.0, -90.0, 85.0, 60.0, 0.0, 5.0])
LEAST = 2.0


def task(rng: np.random.Generator, shift: Floats, rows: int = 60) -> Floats:
    """An episode (rows, 6) degrees as a person moves it: from near rest to an object somewhere and back, in whole ticks."""
    object_at = REST + np.array([0, 60, -50, -30, 20, 30]) + rng.normal(0, 8, 6)
    s = np.sin(np.linspace(0, np.pi, rows))[:, None] ** 2
    start, end = REST + rng.normal(0, 0.7, 6), REST + rng.normal(0, 0.7, 6)
    path = np.linspace(0, 1, rows)[:, None] * (end - start) + start + s * (object_at - REST)
    path[:12], path[-12:] = path[0], path[-1]
    return np.round((path + shift) / TICK) * TICK


def recorded(
    folder: Path, shifts: list[Floats], lags: list[Floats] | None = None, version: str = "v3.0", seed: int = 0
) -> Path:
    """A data set whose readings are shifted by episode, and whose goals are ahead of them by a lag."""
    rng = np.random.default_rng(seed)
    made = dataset(folder, version, [task(rng, shift) for shift in shifts], SERVOS)
    for file in sorted(made.glob("data/**/*.parquet")):
        table = parquet.read_table(file)
        state = np.array(table.column("observation.state").to_pylist())
        episode = table.column("episode_index").to_numpy()
        ahead = np.array([np.zeros(6) if lags is None else lags[int(k)] for k in episode])
        goals = (state + ahead).astype(np.float32)
        parquet.write_table(table.set_column(table.column_names.index("action"), "action", [goals.tolist()]), file)
    return made


def steps(episodes: int, at: int, joint: int, by: float) -> list[Floats]:
    return [np.eye(6)[joint] * by * (k >= at) for k in range(episodes)]


def found(folder: Path) -> list[Move]:
    return detect_joint_moves(read_episodes(folder, LogHints(norm_mode="DEGREES")), LEAST)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_joint_whose_zero_moved_is_named_with_its_episodes(tmp_path: Path, version: str) -> None:
    (move,) = found(recorded(tmp_path / "set", steps(60, 42, 2, 17.0), version=version))
    assert (move.joint, move.before, move.after, move.what) == ("elbow_flex", 41, 42, "zero")
    assert move.by_deg == pytest.approx(17.0, abs=1.0)
    assert {"start", "end"} <= set(move.signals)


def test_forty_data_sets_in_which_nothing_moved_name_nothing(tmp_path: Path) -> None:
    said = [found(recorded(tmp_path / str(seed), steps(30, 99, 0, 0.0), seed=seed)) for seed in range(40)]
    assert sum(map(bool, said)) == 0


@pytest.mark.parametrize("joint", range(5))
@pytest.mark.parametrize("by", [-6.0, 10.0])
def test_every_joint_either_way(tmp_path: Path, joint: int, by: float) -> None:
    (move,) = found(recorded(tmp_path / "set", steps(24, 10, joint, by), seed=joint))
    assert (move.joint, move.before, move.after, move.what) == (JOINTS[joint], 9, 10, "zero")
    assert move.by_deg == pytest.approx(by, abs=1.5)


def test_an_arm_that_is_parked_elsewhere_has_kept_its_zeros(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "set", [np.zeros(6)] * 30)
    for file in sorted(folder.glob("data/**/*.parquet")):
        table = parquet.read_table(file)
        state = np.array(table.column("observation.state").to_pylist())
        frame, episode = table.column("frame_index").to_numpy(), table.column("episode_index").to_numpy()
        state[(frame < 12) & (episode >= 15), 0] += 12.0
        column = table.column_names.index("observation.state")
        parquet.write_table(table.set_column(column, "observation.state", [state.astype(np.float32).tolist()]), file)
    (move,) = found(folder)
    assert (move.joint, move.before, move.after, move.what) == ("shoulder_pan", 14, 15, "posture")
    assert "start" in move.signals
    assert "end" not in move.signals


def test_a_servo_that_stays_further_behind_its_goal_has_kept_its_zero(tmp_path: Path) -> None:
    lags = [np.array([0.2, 1.5 + 3.0 * (k >= 12), 1.0, 0.5, 0.0, 0.0]) for k in range(24)]
    (move,) = found(recorded(tmp_path / "set", [np.zeros(6)] * 24, lags))
    assert (move.joint, move.before, move.after, move.what) == ("shoulder_lift", 11, 12, "lag")
    assert move.by_deg == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_heavier_load_is_no_move_of_a_zero(tmp_path: Path, version: str) -> None:
    """Goals go on as before and three joints hang lower by degrees: readings jump alike, and so does what goals are ahead."""
    sag = np.array([0.0, 9.0, 6.0, 4.0, 0.0, 0.0])
    lags = [sag * (k >= 12) for k in range(24)]
    moves = found(recorded(tmp_path / "set", [-lag for lag in lags], lags, version))
    assert [(move.joint, move.before, move.after, move.what) for move in moves] == [
        (joint, 11, 12, "lag") for joint in ("elbow_flex", "shoulder_lift", "wrist_flex")
    ]
    assert [move.by_deg for move in moves] == pytest.approx([6.0, 9.0, 4.0], abs=0.2)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(("first", "second"), [(20, 20), (18, 21), (12, 27)])
def test_two_joints_are_named_each_with_its_episodes(tmp_path: Path, version: str, first: int, second: int) -> None:
    """Calibrated anew together, one soon after the other, or long after it."""
    both = zip(steps(40, first, 1, 9.0), steps(40, second, 3, -7.0), strict=True)
    moves = found(recorded(tmp_path / "set", [one + other for one, other in both], version=version))
    assert [(move.joint, move.before, move.after, move.what) for move in moves] == [
        ("shoulder_lift", first - 1, first, "zero"), ("wrist_flex", second - 1, second, "zero"),
    ]  # fmt: skip
    assert [move.by_deg for move in moves] == pytest.approx([9.0, -7.0], abs=1.0)


def test_what_the_numbers_mean_is_stated_or_refused(tmp_path: Path) -> None:
    folder = recorded(tmp_path / "set", steps(20, 10, 1, 9.0))
    with pytest.raises(FileError, match="does not say what its numbers mean"):
        read_episodes(folder, LogHints())
    servos = calibration(tmp_path)
    by_json = detect_joint_moves(read_episodes(folder, hints(servos)), LEAST)
    assert by_json == found(folder)


def test_the_command_says_it_in_words(tmp_path: Path, command: Command) -> None:
    folder = recorded(tmp_path / "set", steps(60, 42, 2, 17.0))
    told = command("episodes", folder, "--norm-mode", "DEGREES", code=3)
    assert "elbow_flex moved by +1" in told
    assert "deg between episodes 41 and 42" in told
    assert "a zero that was off from the first episode on" in told.replace("\n", " ")
    document = command.json("episodes", folder, "--norm-mode", "DEGREES", code=3)
    assert [move["joint"] for move in document["moves"]] == ["elbow_flex"]
    quiet = command("episodes", recorded(tmp_path / "quiet", steps(20, 99, 0, 0.0)), "--norm-mode", "DEGREES")
    assert "No joint moved by 2 deg or more over 20 episodes." in quiet
