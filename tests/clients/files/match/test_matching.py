"""Recordings joined with joint logs, on a simulated arm whose truth is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kilter_client import FileError
from kilter_files.formats.joints.joint_log import read_joint_log
from kilter_files.formats.registry import open_recording
from kilter_files.match.clock_checks import Checks
from kilter_files.match.clocks import match_pieces
from kilter_files.match.dwells import RestOptions, find_dwells, thin
from kilter_files.match.matching import frame_rows, match_dwells
from tests.clients.files.simulated import arm, stops, wander, write_csv, write_log, write_n3d

POSES = np.random.default_rng(1).uniform(-60, 60, (14, 3))
POSES[10:] = POSES[:4]
NOISE = 0.05


def dwelling(path: Path, rate: float, seed: int = 2) -> Path:
    rng = np.random.default_rng(seed)
    t = np.arange(0, len(POSES) * 1.8, 1 / rate)
    points = arm(stops(POSES, 1.0, 0.8, t)) + rng.normal(0, NOISE, (len(t), 3, 3))
    points[rng.random((len(t), 3)) < 0.05] = np.nan
    return (write_n3d if path.suffix == ".n3d" else write_csv)(path, points, rate)


def marker_means(columns: dict[str, np.ndarray]) -> np.ndarray:
    return np.stack([columns[f"m{k}{a}_mm"] for k in (1, 2, 3) for a in "xyz"], 1).reshape(-1, 3, 3)


@pytest.mark.parametrize(("rate", "name"), [(1000.0, "a.n3d"), (100.0, "a.csv"), (21.0, "b.csv")])
def test_dwells_in_order(tmp_path: Path, rate: float, name: str) -> None:
    log = read_joint_log(write_log(tmp_path / "log.csv", POSES))
    matched = match_dwells(open_recording(dwelling(tmp_path / name, rate)), log, "order")
    assert matched.report["dwells"] == 14
    assert matched.report["poses"] == 10
    np.testing.assert_array_equal(matched.columns["pose_id"][10:], matched.columns["pose_id"][:4])
    assert matched.report["scatter_mm"] == pytest.approx([NOISE] * 3, rel=0.1)
    error = marker_means(matched.columns) - arm(POSES)
    sigma = np.stack([matched.columns[f"s{a}_mm"] for a in "xyz"], 1)
    # the stated standard deviation is that of the mean: errors over it have size one
    assert np.sqrt(np.mean((error / sigma[:, None]) ** 2)) == pytest.approx(1.0, abs=0.3)


def test_slow_wander_is_in_the_stated_uncertainty(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0, 4, 1 / 500)
    slow = 0.2 * np.sin(2 * np.pi * t / 3)[:, None, None]
    path = write_n3d(tmp_path / "a.n3d", BODY_AT + slow + rng.normal(0, 0.01, (len(t), 2, 3)), 500.0)
    (dwell,) = find_dwells(open_recording(path), RestOptions())
    assert (dwell.mean_sigma_mm > 3 * dwell.scatter_mm / np.sqrt(dwell.frames)).all()


BODY_AT = np.array([[300.0, 400, 500], [350, 420, 510]])


def test_a_spike_does_not_move_the_mean(tmp_path: Path) -> None:
    points = np.tile(BODY_AT, (500, 1, 1)) + np.random.default_rng(0).normal(0, 0.01, (500, 2, 3))
    points[250, 0] += 400
    (dwell,) = find_dwells(open_recording(write_n3d(tmp_path / "a.n3d", points, 500.0)), RestOptions(settle_s=0))
    assert dwell.outliers == 1
    assert np.abs(dwell.mean_mm - BODY_AT).max() < 0.005


def test_counts_that_differ_are_said(tmp_path: Path) -> None:
    log = read_joint_log(write_log(tmp_path / "log.csv", POSES[:13]))
    with pytest.raises(FileError, match=r"14 dwells, but log.csv has 13 poses. Set --shortest"):
        match_dwells(open_recording(dwelling(tmp_path / "a.n3d", 100.0)), log, "order")


@pytest.mark.parametrize(
    ("rate", "log_rate", "rests"), [(300.0, 125.0, False), (60.0, 250.0, False), (200.0, 100.0, True)]
)
def test_clocks(tmp_path: Path, rate: float, log_rate: float, rests: bool) -> None:
    """An offset of seconds and a drift of 80 ppm come back within their stated uncertainty."""
    rng = np.random.default_rng(7)
    move = (lambda t: stops(POSES, 1.0, 0.8, t)) if rests else wander
    t, log_t = np.arange(0, 25, 1 / rate), np.arange(-2, 33, 1 / log_rate)
    offset, drift = 3.217, 80e-6
    points = arm(move(t)) + rng.normal(0, NOISE, (len(t), 3, 3))
    q = move((log_t - offset) / (1 + drift)) + rng.normal(0, 0.001, (len(log_t), 3))
    path = write_n3d(tmp_path / "a.n3d", points, rate)
    pieces, _ = match_pieces(
        path, thin(open_recording(path)), read_joint_log(write_log(tmp_path / "l.csv", q, log_t)), Checks(None)
    )
    clocks = pieces.parts[0][2]
    assert clocks.offset_sigma_s < 5e-5
    assert abs(clocks.offset_s - offset - drift * clocks.middle_s) < 4 * clocks.offset_sigma_s + 1e-6
    assert abs(clocks.drift - drift) < 4 * clocks.drift_sigma + 1e-7


def test_dwells_by_time_and_frames_by_time(tmp_path: Path) -> None:
    log_t = np.arange(-2, 40, 1 / 100)
    q = stops(POSES, 1.0, 0.8, np.clip(log_t - 5.0, 0, None))
    log = read_joint_log(write_log(tmp_path / "l.csv", q, log_t))
    recording = open_recording(dwelling(tmp_path / "a.n3d", 400.0))
    matched = match_dwells(recording, log, "time")
    assert matched.report["clock"]["offset_s"] == pytest.approx(5.0, abs=1e-3)
    assert (
        np.abs(np.stack([matched.columns[n] for n in log.joints], 1) - POSES[: matched.report["dwells"]]).max() < 1e-3
    )
    pieces, _ = match_pieces(recording.path, thin(recording), log, Checks(None))
    clocks = pieces.parts[0][2]
    rows = list(frame_rows(recording, log, clocks))
    q_rows = np.concatenate([np.stack([block[n] for n in log.joints], 1) for block in rows])
    points = np.concatenate([marker_means(block) for block in rows])
    assert np.nanstd(points - arm(q_rows)) == pytest.approx(NOISE, rel=0.15)


def test_a_log_of_another_motion_is_refused(tmp_path: Path) -> None:
    log_t = np.arange(0, 30, 1 / 50)
    log = read_joint_log(write_log(tmp_path / "l.csv", np.random.default_rng(0).normal(0, 1, (len(log_t), 3)), log_t))
    path = dwelling(tmp_path / "a.n3d", 100.0)
    with pytest.raises(FileError, match=r"its motion is not that of l\.csv"):
        match_pieces(path, thin(open_recording(path)), log, Checks(None))


@pytest.mark.parametrize(
    ("change", "words"),
    [(lambda p: np.concatenate([p[:900], p[900:][:, [1, 0, 2]]]), "frame 901: the markers 'Marker_1' and 'Marker_2' change"),
     (lambda p: np.concatenate([p[:900], np.roll(p[900:].reshape(-1, 9), 1, axis=1).reshape(-1, 3, 3)]),
      "frame 901: all columns moved by 1 here")],
)  # fmt: skip
def test_swapped_markers_and_moved_columns(tmp_path: Path, change, words: str) -> None:
    t = np.arange(0, 14 * 1.8, 1 / 100)
    path = write_n3d(tmp_path / "a.n3d", change(arm(stops(POSES, 1.0, 0.8, t))), 100.0)
    with pytest.raises(FileError, match=words):
        match_dwells(open_recording(path), read_joint_log(write_log(tmp_path / "log.csv", POSES)), "order")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "q1_rad,q2_rad\n0.1,0.2\n90,0.3\n",
            r"line 3, column 'q1_rad': 90 rad is more than two turns: are these degrees",
        ),
        ("q1_deg,t_s\n1,0\n2,1\n3,0.5\n", r"line 4, column 't_s': time goes back or stops"),
        ("q1_deg,speed\n1,0\n", r"column 'speed': is not a contract column"),
        ("q1_deg,q3_deg\n1,0\n", "its joints are q1_deg, q3_deg"),
        ("q1_deg,q2_deg\n1,\n", r"line 2, column 'q2_deg': is empty"),
    ],
)
def test_a_bad_joint_log(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(FileError, match=words):
        read_joint_log(tmp_path / "log.csv")
