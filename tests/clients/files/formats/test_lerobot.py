"""Data sets and calibrations of LeRobot, written here with pyarrow as the public format says, and damaged."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray
from pyarrow import parquet

from kilter_files import read_joints
from kilter_files.formats.joints.lerobot.calibration import read_calibration
from kilter_files.formats.joints.lerobot.log import blocks, open_recorded_joints
from kilter_files.formats.reader import Hints, LogHints
from kilter_files.ground.errors import FileError
from kilter_files.look.drafts import inspect
from tests.clients.test_cli import Command

Floats = NDArray[np.float64]

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
SERVOS = (*JOINTS, "gripper")
RANGES = ((740, 3420), (822, 3264), (900, 3110), (850, 3200), (0, 4095), (2030, 3480))
FPS, CAMERA = 30, "observation.images.front"
VERSIONS = ("v2.1", "v3.0")


def calibration(folder: Path, name: str = "my_arm.json", **changes: dict[str, int]) -> Path:
    """The JSON that lerobot-calibrate writes, with changes of servos."""
    servos = {
        name: {"id": k + 1, "drive_mode": 0, "homing_offset": 100 * k - 200, "range_min": low, "range_max": high}
        for k, (name, (low, high)) in enumerate(zip(SERVOS, RANGES, strict=True))
    }
    for name_of, change in changes.items():
        servos[name_of] |= change
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / name
    path.write_text(json.dumps(servos, indent=4))
    return path


def ticks_of(lengths: Sequence[int], seed: int = 0) -> list[NDArray[np.int64]]:
    """Whole ticks of six servos within their ranges, moving slowly."""
    rng = np.random.default_rng(seed)
    out = []
    for length in lengths:
        u = 0.5 + 0.4 * np.sin(np.linspace(0, 3, length)[:, None] + rng.uniform(0, 6, 6))
        out.append(
            np.array([low + u[:, k] * (high - low) for k, (low, high) in enumerate(RANGES)]).T.round().astype(int)
        )
    return out


def recorded(ticks: NDArray[np.int64], mode: str) -> Floats:
    """The formulas of LeRobot's bus: parts of the range, or degrees from its middle; the gripper from 0 to 100."""
    out = np.empty(ticks.shape)
    for k, (low, high) in enumerate(RANGES):
        if k == 5:
            out[:, k] = (ticks[:, k] - low) / (high - low) * 100.0
        elif mode == "DEGREES":
            out[:, k] = (ticks[:, k] - (low + high) / 2) * 360.0 / 4095.0
        else:
            out[:, k] = (ticks[:, k] - low) / (high - low) * 200.0 - 100.0
    return out


def film(path: Path, pictures: int, fps: float = FPS) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, (32, 32))
    for k in range(pictures):
        writer.write(np.full((32, 32, 3), k % 250, dtype=np.uint8))
    writer.release()


def table(values: Floats, episode: int, first: int, actions: Floats) -> pa.Table:
    n = len(values)
    state, action = (
        pa.FixedSizeListArray.from_arrays(pa.array(one.ravel().astype(np.float32)), one.shape[1])
        for one in (values, actions)
    )
    return pa.table({
        "action": action, "observation.state": state, "timestamp": pa.array((np.arange(n) / FPS).astype(np.float32)),
        "frame_index": np.arange(n), "episode_index": np.full(n, episode), "index": np.arange(first, first + n),
        "task_index": np.zeros(n, dtype=np.int64),
    })  # fmt: skip


def dataset(
    folder: Path, version: str, episodes: Sequence[Floats], names: Sequence[str] = SERVOS, *, video: bool = False,
    robot: str = "so101_follower", suffix: str = ".pos", actions: Sequence[Floats] | None = None,
) -> Path:  # fmt: skip
    """A data set in the layout of its version; v3.0 keeps two episodes in each file."""
    lengths = [len(values) for values in episodes]
    v2 = version == "v2.1"
    state = {"dtype": "float32", "shape": [len(names)], "names": [name + suffix for name in names]}
    info: dict[str, Any] = {
        "codebase_version": version, "robot_type": robot, "total_episodes": len(episodes), "total_frames": sum(lengths),
        "fps": FPS, "chunks_size": 1000, "features": {"action": state, "observation.state": state},
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet" if v2
        else "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    }  # fmt: skip
    if video:
        info["features"][CAMERA] = {"dtype": "video", "shape": [32, 32, 3]}
        info["video_path"] = (
            "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4" if v2
            else "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
        )  # fmt: skip
    (folder / "meta").mkdir(parents=True)
    (folder / "data/chunk-000").mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info))
    firsts = np.cumsum([0, *lengths])
    told = episodes if actions is None else actions
    tables = [table(values, k, int(firsts[k]), told[k]) for k, values in enumerate(episodes)]
    if v2:
        lines = [json.dumps({"episode_index": k, "tasks": ["a"], "length": n}) for k, n in enumerate(lengths)]
        (folder / "meta/episodes.jsonl").write_text("\n".join(lines) + "\n")
        for k, one in enumerate(tables):
            parquet.write_table(one, folder / f"data/chunk-000/episode_{k:06d}.parquet")
            if video:
                film(folder / f"videos/chunk-000/{CAMERA}/episode_{k:06d}.mp4", lengths[k])
        return folder
    files = [k // 2 for k in range(len(episodes))]
    for file in sorted(set(files)):
        mine = [k for k in range(len(episodes)) if files[k] == file]
        parquet.write_table(
            pa.concat_tables([tables[k] for k in mine]), folder / f"data/chunk-000/file-{file:03d}.parquet"
        )
        if video:
            film(folder / f"videos/{CAMERA}/chunk-000/file-{file:03d}.mp4", sum(lengths[k] for k in mine))
    rows = {
        "episode_index": list(range(len(episodes))), "length": lengths, "data/chunk_index": [0] * len(episodes),
        "data/file_index": files, "dataset_from_index": firsts[:-1].tolist(), "dataset_to_index": firsts[1:].tolist(),
    }  # fmt: skip
    if video:
        begins = [
            sum(lengths[other] for other in range(k) if files[other] == files[k]) / FPS for k in range(len(episodes))
        ]
        ends = [begin + length / FPS for begin, length in zip(begins, lengths, strict=True)]
        rows |= {f"videos/{CAMERA}/chunk_index": [0] * len(episodes), f"videos/{CAMERA}/file_index": files,
                 f"videos/{CAMERA}/from_timestamp": begins, f"videos/{CAMERA}/to_timestamp": ends}  # fmt: skip
    (folder / "meta/episodes/chunk-000").mkdir(parents=True)
    parquet.write_table(pa.table(rows), folder / "meta/episodes/chunk-000/file-000.parquet")
    return folder


def hints(path: Path | None, mode: str | None = "DEGREES", **more: Any) -> LogHints:
    return LogHints(calibration=path, norm_mode=mode, **more)


def refusal(path: Path, told: LogHints) -> str:
    with pytest.raises(FileError) as caught:
        read_joints(path, hints=told)
    assert caught.value.code == "file_invalid"
    return caught.value.detail


@pytest.mark.parametrize("mode", ["DEGREES", "RANGE_M100_100"])
@pytest.mark.parametrize("version", VERSIONS)
def test_a_data_set_is_a_joint_log_in_degrees_from_the_middle_of_each_range(
    tmp_path: Path, version: str, mode: str
) -> None:
    ticks = ticks_of([40, 25, 30])
    folder = dataset(tmp_path / "set", version, [recorded(one, mode) for one in ticks], video=True)
    json_file = calibration(tmp_path)
    log = read_joints(folder, hints=hints(json_file, mode))
    whole = np.vstack(ticks)[:, :5]
    middle = np.array([(low + high) / 2 for low, high in RANGES[:5]])
    assert log.joints == ("q1_deg", "q2_deg", "q3_deg", "q4_deg", "q5_deg")
    assert np.abs(log.q() - (whole - middle) * 360.0 / 4095.0).max() < 1e-4
    t = log.t_s
    assert t is not None
    assert np.all(np.diff(t) > 0)
    assert t[40] - t[39] == pytest.approx(1.0 + 1.0 / FPS, abs=1e-6)
    assert log.calibration_sha256 == hashlib.sha256(json_file.read_bytes()).hexdigest()
    assert "zero: new, the middle of each range" in log.notes
    assert f"q1 to q5 are {', '.join(JOINTS)}" in log.notes
    assert read_joints(folder / "meta/info.json", hints=hints(json_file, mode)).q().tolist() == log.q().tolist()


@pytest.mark.parametrize("version", VERSIONS)
def test_actions_are_the_commands_of_the_joints(tmp_path: Path, version: str) -> None:
    ticks = ticks_of([40, 50])
    told = [np.roll(one, -3, axis=0) for one in ticks]
    values, actions = ([recorded(one, "RANGE_M100_100") for one in each] for each in (ticks, told))
    path = dataset(tmp_path / "set", version, values, actions=actions)
    log = read_joints(path, hints=hints(calibration(tmp_path), "RANGE_M100_100"))
    for k, (low, high) in enumerate(RANGES[:5]):
        wanted = (np.concatenate(told)[:, k] - (low + high) / 2) * 360.0 / 4095.0
        assert log.columns[f"cmd{k + 1}_deg"] == pytest.approx(wanted, abs=1e-3)


def test_a_reversed_servo_counts_the_other_way_by_range_only(tmp_path: Path) -> None:
    values = recorded(ticks_of([20])[0], "RANGE_M100_100")
    reversed_ = values.copy()
    reversed_[:, 1] *= -1.0
    plain = read_joints(dataset(tmp_path / "a", "v3.0", [values]), hints=hints(calibration(tmp_path), "RANGE_M100_100"))
    other = read_joints(
        dataset(tmp_path / "b", "v3.0", [reversed_]),
        hints=hints(calibration(tmp_path, "other.json", shoulder_lift={"drive_mode": 1}), "RANGE_M100_100"),
    )
    assert np.abs(plain.q() - other.q()).max() < 1e-9


def test_what_nobody_stated_is_refused_with_what_to_state(tmp_path: Path) -> None:
    folder = dataset(tmp_path / "set", "v3.0", [recorded(ticks_of([20])[0], "DEGREES")])
    json_file = calibration(tmp_path)
    assert "does not say what its numbers mean. Give the JSON" in refusal(folder, hints(None))
    assert "Give --norm-mode: RANGE_M100_100 or DEGREES" in refusal(folder, hints(json_file, None))
    assert "an action is what the leader commanded" in refusal(folder, hints(json_file, topic="action"))
    leader = calibration(tmp_path / "calibration/teleoperators/so101_leader")
    assert "is of a leader, the data set of so101_follower" in refusal(folder, hints(leader))
    taught = dataset(tmp_path / "taught", "v3.0", [recorded(ticks_of([20])[0], "DEGREES")], robot="so101_leader")
    assert f"is of a leader, so101_leader, and nothing says that {json_file} is" in refusal(taught, hints(json_file))
    assert len(read_joints(taught, hints=hints(leader))) == 20
    other = calibration(tmp_path, "koch.json")
    other.write_text(other.read_text().replace("wrist_flex", "wrist_bend"))
    told = refusal(folder, hints(other))
    assert "koch.json: has no servo 'wrist_flex'" in told
    assert "it is of another arm. It has shoulder_pan, shoulder_lift, elbow_flex, wrist_bend" in told
    narrow = calibration(tmp_path, "narrow.json", elbow_flex={"range_min": 1900, "range_max": 2200})
    told = refusal(folder, hints(narrow))
    assert "column 'elbow_flex'" in told
    assert "outside the range of narrow.json" in told


def test_the_old_zero_is_another_frame_and_must_be_stated(tmp_path: Path) -> None:
    names = [f"main_{name}" for name in SERVOS]
    values = recorded(ticks_of([20])[0], "DEGREES")
    folder = dataset(tmp_path / "set", "v2.1", [values], names, suffix="")
    assert "recorded with the old zero" in refusal(folder, hints(calibration(tmp_path)))
    log = read_joints(folder, hints=LogHints(zero="old"))
    assert np.abs(log.q() - values[:, :5]).max() < 1e-5
    assert "zero: old, the arm stretched out" in log.notes
    old = tmp_path / "main_follower.json"
    old.write_text(json.dumps({"homing_offset": [1], "drive_mode": [0], "start_pos": [1], "calib_mode": ["DEGREE"]}))
    with pytest.raises(FileError, match="of the old zero"):
        read_calibration(old)


def test_one_arm_of_two_is_named(tmp_path: Path) -> None:
    names = [f"{side}_{name}" for side in ("left", "right") for name in SERVOS]
    values = [recorded(ticks_of([20], seed)[0], "DEGREES") for seed in (1, 2)]
    folder = dataset(tmp_path / "set", "v3.0", [np.hstack(values)], names, robot="bi_so101_follower")
    told = refusal(folder, hints(calibration(tmp_path)))
    assert "holds two arms. Name the joints of one: --joint-order left_shoulder_pan,left_shoulder_lift" in told
    order = [f"right_{name}" for name in JOINTS]
    assert "holds two arms. Name the joints of one: --joint-order left_" in inspect(folder)["warnings"][1]
    assert len(inspect(folder, Hints(log=LogHints(order=order)))["warnings"]) == 1
    log = read_joints(folder, hints=hints(calibration(tmp_path), order=order))
    assert np.abs(log.q() - values[1][:, :5]).max() < 1e-5


def test_the_arm_of_a_lekiwi_is_named_among_what_its_base_does(tmp_path: Path) -> None:
    names = [*(f"arm_{name}.pos" for name in SERVOS), "x.vel", "y.vel", "theta.vel"]
    values = recorded(ticks_of([20])[0], "DEGREES")
    folder = dataset(
        tmp_path / "set", "v3.0", [np.hstack([values, np.zeros((20, 3))])], names, suffix="", robot="lekiwi_client"
    )
    wheels = {f"base_{side}_wheel": {"id": 7 + k, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
              for k, side in enumerate(("left", "back", "right"))}  # fmt: skip
    servos = {f"arm_{name}": servo for name, servo in json.loads(calibration(tmp_path).read_text()).items()}
    path = tmp_path / "lekiwi.json"
    path.write_text(json.dumps(servos | wheels))
    for order in ((), [f"arm_{name}" for name in JOINTS]):
        log = read_joints(folder, hints=hints(path, order=order))
        assert np.abs(log.q() - values[:, :5]).max() < 1e-5


@pytest.mark.parametrize(
    ("servo", "change", "said"),
    [
        ("elbow_flex", {"range_min": 3900, "range_max": 4200}, "it wraps within the range"),
        ("elbow_flex", {"range_min": 3500, "range_max": 600}, "it wraps within the range"),
        ("elbow_flex", {"range_min": 2000, "range_max": 2001}, "was not moved"),
        ("wrist_roll", {"homing_offset": 2048}, "a servo holds 2047 ticks either way"),
        ("gripper", {"id": 1}, "calibrations of two arms in one file"),
        ("gripper", {"drive_mode": 2}, "drive_mode is 2"),
        ("gripper", {"range_min": 1.5}, "does not have whole numbers"),
    ],
)
def test_calibrations_that_cannot_be_are_refused(tmp_path: Path, servo: str, change: dict[str, Any], said: str) -> None:
    path = calibration(tmp_path, **{servo: change})
    with pytest.raises(FileError, match=said) as caught:
        read_calibration(path)
    assert str(path) in caught.value.detail


def test_a_servo_that_wraps_is_seen_in_its_rows(tmp_path: Path) -> None:
    values = recorded(ticks_of([30])[0], "DEGREES")
    values[:, 4] = np.linspace(150.0, 179.0, 30)
    values[20:, 4] -= 355.0
    told = refusal(dataset(tmp_path / "set", "v2.1", [values]), hints(calibration(tmp_path)))
    assert "row 21, column 'wrist_roll': jumps by 360 degrees" in told


@pytest.mark.parametrize("version", VERSIONS)
def test_half_written_data_sets_are_refused(tmp_path: Path, version: str) -> None:
    whole = dataset(tmp_path / "set", version, [recorded(one, "DEGREES") for one in ticks_of([12, 9, 7])], video=True)
    asked = hints(calibration(tmp_path))
    read_joints(whole, hints=asked)

    def damaged(name: str) -> Path:
        return Path(shutil.copytree(whole, tmp_path / name))

    cut = damaged("cut")
    file = sorted(cut.glob("data/**/*.parquet"))[-1]
    file.write_bytes(file.read_bytes()[:-100])
    told = refusal(cut, asked)
    assert "is not a whole Parquet file. It is half written" in told
    assert file.name in told
    with pytest.raises(FileError, match="is not a whole Parquet file"):
        inspect(cut)
    file.unlink()
    assert "is missing. It is half written" in refusal(cut, asked)

    short = damaged("short")
    file = sorted(short.glob("data/**/*.parquet"))[0]
    parquet.write_table(parquet.read_table(file).slice(0, 5), file)
    assert "has 5 rows, its episodes have" in refusal(short, asked)
    with pytest.raises(FileError, match="has 5 rows, its episodes have"):
        inspect(short)

    info = damaged("info")
    text = (info / "meta/info.json").read_text()
    (info / "meta/info.json").write_text(text.replace('"total_frames": 28', '"total_frames": 30'))
    assert "says total_frames 30, its episodes are 28" in refusal(info, asked)
    (info / "meta/info.json").write_text(text[:-20])
    assert "is not JSON" in refusal(info, asked)
    (info / "meta/info.json").write_text(text.replace(version, "v1.6"))
    assert "is of version 'v1.6'" in refusal(info, asked)

    dark = damaged("dark")
    video = sorted(dark.glob("videos/**/*.mp4"))[-1]
    film(video, 4)
    assert "has 4 pictures, its rows in the data set are 7" in refusal(dark, asked)
    with pytest.raises(FileError, match="has 4 pictures, its rows in the data set are 7"):
        inspect(dark)
    video.write_bytes(video.read_bytes()[:200])
    assert "an MP4 file without an index" in refusal(dark, asked)
    video.unlink()
    assert f"{video.name}: is missing" in refusal(dark, asked)


def test_a_zipped_data_set_is_told_to_be_unpacked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By whatever is asked of it; another archive says what it holds."""
    dataset(tmp_path / "up/my-set", "v3.0", [recorded(ticks_of([12])[0], "DEGREES")])
    archive = Path(shutil.make_archive(str(tmp_path / "my-set"), "zip", tmp_path / "up"))
    said = f"{archive}: is a ZIP archive of a LeRobot data set. Unpack it, and match its folder with a recording"
    command = Command(capsys)
    for asked in (("inspect", archive), ("episodes", archive, "--norm-mode", "DEGREES"), ("upload", "nobody", archive)):
        refused = command.json(*asked, code=1)
        assert (refused["code"], refused["detail"][: len(said)]) == ("file_invalid", said)
    photos = tmp_path / "photos"
    photos.mkdir()
    for k in range(3):
        (photos / f"{k}.png").write_bytes(b"")
    archive = Path(shutil.make_archive(str(tmp_path / "photos"), "zip", photos))
    assert (
        "is a ZIP archive of 3 pictures. Unpack it: kilter measure see"
        in command.json("inspect", archive, code=1)["detail"]
    )
    (tmp_path / "rows.csv").write_text("a\n")
    refused = command.json("episodes", tmp_path / "rows.csv", "--norm-mode", "DEGREES", code=1)
    assert "rows.csv: is not a LeRobot data set. Give the folder" in refused["detail"]


def test_memory_is_that_of_a_block_however_long_the_data_set(tmp_path: Path) -> None:
    """Rows are counted and dropped: of five times the rows no more is held at once."""
    values = recorded(ticks_of([200_000])[0], "DEGREES")
    asked = hints(calibration(tmp_path))
    peaks = []
    for name, episodes in (("one", [values]), ("five", [values] * 5)):
        found = open_recorded_joints(dataset(tmp_path / name, "v2.1", episodes), asked)
        before, peak, rows = pa.total_allocated_bytes(), 0, 0
        for block in blocks(found):
            rows += len(block.angles)
            peak = max(peak, pa.total_allocated_bytes() - before)
            assert block.angles.nbytes <= 65_536 * 5 * 8
        assert rows == 200_000 * len(episodes)
        peaks.append(peak)
    assert peaks[1] < 1.5 * peaks[0]


def test_what_a_leader_recorded_is_refused_unless_its_own_calibration_says_that_it_is_meant(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    taught = dataset(tmp_path / "taught", "v3.0", [recorded(ticks_of([20])[0], "DEGREES")], robot="so101_leader")
    leader = calibration(tmp_path / "calibration/teleoperators/so101_leader")
    command, degrees = Command(capsys), ("--norm-mode", "DEGREES")
    document = command.json("inspect", taught, code=1)
    (problem,) = document["problems"]
    assert problem["what"].startswith(
        "is of a leader, so101_leader. Give the data set of the follower, or the calibration"
    )
    assert document["rows"] == 20
    for asked in (("episodes", taught, *degrees), ("episodes", taught), ("inspect", taught, "--zero", "old")):
        refused = command.json(*asked, code=1)
        assert refused["code"] == "file_invalid"
        assert refused["detail"].startswith(
            f"{taught}: is of a leader, so101_leader. Give the data set of the follower"
        )
    for verb in ("inspect", "episodes"):
        command(verb, taught, "--calibration", leader, *degrees)


def test_inspect_says_what_they_are(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = dataset(tmp_path / "set", "v3.0", [recorded(ticks_of([40])[0], "DEGREES")])
    path = calibration(tmp_path / "calibration/robots/so101_follower")
    found = inspect(folder)
    assert (found["kind"], found["rows"], found["rate_hz"]) == ("joint-log", 40, FPS)
    assert found["duration_s"] == pytest.approx(40 / FPS)
    assert "30 Hz, 1.333 s" in Command(capsys)("inspect", folder)
    assert "give --calibration JSON and --norm-mode RANGE_M100_100 or DEGREES" in found["warnings"][0]
    read = inspect(folder, Hints(log=hints(path)))
    assert [one["name"] for one in read["columns"]][:2] == ["q1_deg", "q2_deg"]
    servos = inspect(path)
    assert servos["kind"] == "lerobot-calibration"
    assert "servo 1 shoulder_pan: homing offset -200 ticks, range 740 to 3420 (+-117.8 deg)" in servos["notes"]


@pytest.mark.parametrize(
    ("servo", "change", "warned"),
    [
        ("shoulder_lift", {"range_min": 0, "range_max": 4095}, True),
        ("shoulder_lift", {"range_min": 1, "range_max": 2300, "homing_offset": -2040}, True),
        ("elbow_flex", {"range_min": 1900, "range_max": 4093}, True),
        ("elbow_flex", {"range_min": 60, "range_max": 2300}, False),
        ("wrist_roll", {"range_min": 0, "range_max": 4095}, False),
    ],
)
def test_a_range_that_ends_at_the_seam_of_the_encoder_is_doubted(
    tmp_path: Path, servo: str, change: dict[str, int], warned: bool
) -> None:
    path = calibration(tmp_path / "calibration/robots/so101_follower", **{servo: change})
    warnings = inspect(path)["warnings"]
    assert len(warnings) == warned
    assert all(servo in text and "seam of the encoder" in text for text in warnings)
    folder = dataset(tmp_path / "set", "v3.0", [recorded(ticks_of([40])[0], "DEGREES")])
    assert [*read_joints(folder, hints=hints(path)).warnings] == warnings
    assert inspect(folder, Hints(log=hints(path)))["warnings"][: len(warnings)] == warnings
