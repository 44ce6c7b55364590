"""Every kind of bad file through the commands: exit code 1, file, place and remedy, and nothing stored."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from pyarrow import parquet
from scipy.io import savemat

from kilter_client import FileError, Kilter, KilterError, prepare
from kilter_client.cli import run
from tests.clients.files.formats.test_recordings import c3d_bytes
from tests.clients.files.match.test_rigid_body import long_table
from tests.clients.files.rig.test_rig import write_tdms
from tests.clients.files.simulated import arm, stops, wander, write_csv, write_log, write_n3d
from tests.clients.files.test_fuzz import EDITS, TRACKER, edited
from tests.clients.files.test_sending import three_joints

POSES = np.random.default_rng(1).uniform(-60, 60, (6, 3))
T = np.arange(0, 6 * 1.8, 0.01)
POINTS = arm(stops(POSES, 1.0, 0.8, T)) + np.random.default_rng(0).normal(0, 0.02, (len(T), 3, 3))
MAP = '[columns]\n' + "".join(f'q{i}_deg = {{ from = "rig/q{i}", unit = "deg" }}\n' for i in (1, 2, 3)) + "".join(
    f'{a}_mm = {{ from = "rig/{a}", unit = "mm" }}\n' for a in "xyz"
)  # fmt: skip

Make = Callable[[Path], list[object]]


def recording(change: Callable[[bytes], bytes], kind: str = "n3d") -> Make:
    def make(folder: Path) -> list[object]:
        path = folder / f"r.{kind}"
        if kind == "c3d":
            path.write_bytes(c3d_bytes(POINTS, 100.0, -1.0, "<", "mm"))
        else:
            (write_n3d if kind == "n3d" else write_csv)(path, POINTS, 100.0)
        path.write_bytes(change(path.read_bytes()))
        return ["match", path, write_log(folder / "log.csv", POSES), "--robot"]

    return make


def moved(text: bytes) -> bytes:
    rows = text.decode().splitlines()
    half = len(rows) // 2
    return "\n".join([*rows[:half], *(row.replace(",", ",,", 1).rsplit(",", 1)[0] for row in rows[half:])]).encode()


def with_points(points: np.ndarray, log: Callable[[Path], Path], *more: str) -> Make:
    def make(folder: Path) -> list[object]:
        return ["match", write_n3d(folder / "r.n3d", points, 100.0), log(folder), *more, "--robot"]

    return make


def tdms(change: Callable[[bytes], bytes]) -> Make:
    def make(folder: Path) -> list[object]:
        path = write_tdms(folder / "r.tdms", np.arange(500.0))
        path.write_bytes(change(path.read_bytes()))
        (folder / "map.toml").write_text(MAP)
        return ["upload", "ROBOT", path, "--map", folder / "map.toml"]

    return make


def rows(text: str) -> Make:
    def make(folder: Path) -> list[object]:
        (folder / "r.csv").write_text(text)
        return ["upload", "ROBOT", folder / "r.csv"]

    return make


def stepped(folder: Path) -> Path:
    """A log whose clock was set forward by 3 s in the middle, as a time server does."""
    t = np.arange(-1, 31, 0.01)
    return write_log(folder / "log.csv", wander(t), np.where(t > 14, t + 3.0, t))


HEAD = "q1_deg,q2_deg,q3_deg,x_mm,y_mm,z_mm"
GOOD = "".join(f"{i},{2 * i},{-i},{900 - i},{i},{500 + i}\n" for i in range(1, 9))
SWAPPED = np.concatenate([POINTS[:500], POINTS[500:, [1, 0, 2]]])
WANDER = arm(wander(np.arange(0, 28, 0.01))) + np.random.default_rng(0).normal(0, 0.02, (2800, 3, 3))

CASES: dict[str, tuple[Make, str, set[str]]] = {
    "truncated c3d": (recording(lambda b: b[:-5000], "c3d"), "is cut off: .*Copy or export it again", {"file", "frame"}),
    "truncated n3d": (recording(lambda b: b[:-5000]), "is cut off: the header states 1080 frames", {"file", "frame"}),
    "truncated tdms": (tdms(lambda b: b[:-100]), "is cut off: its last segment states .*Copy it again", {"file", "byte"}),
    "wrong magic": (recording(lambda b: b"\x07\x07" + b[2:]), "is not an NDI floating-point file. Export it", {"file", "byte"}),
    "a zip": (recording(lambda b: b"PK\x03\x04" + b), "ZIP archive or a spreadsheet. Unpack it", {"file"}),
    "10 GB claimed": (
        recording(lambda b: struct.pack("<Bhhif", 32, 3, 3, 280_000_000, 100.0) + b[13:]),
        r"states 280000000 frames of 3 markers \(10080000256 bytes\)", {"file", "frame"}),
    "another device": (tdms(lambda b: b"MATLAB 5.0" + b), "is not a TDMS file", {"file", "byte"}),
    "another header inside": (rows(f"{HEAD}\n{GOOD}q1_deg,q2_deg,t_s\n1,2,3\n"), "Row 9", {"row"}),
    "mixed schemas": (recording(lambda b: b + b"\nFrame,A x,A y,A z\n1,1,2,3\n", "csv"),
                      "has 1082 frames where it states 1080. If two recordings are concatenated, split", {"file", "line"}),
    "columns that shift": (recording(moved, "csv"), "blank where its other coordinates are not|cells where the first row",
                           {"file", "line"}),
    "two glued": (recording(lambda b: b + b), "recordings are concatenated, after frame 1080. Give", {"file", "byte"}),
    "markers swapped": (with_points(SWAPPED, lambda f: write_log(f / "log.csv", POSES)),
                        "'Marker_1' and 'Marker_2' change places here. Label", {"file", "frame"}),
    "clocks apart": (with_points(WANDER, stepped, "--by", "frames"),
                     r"clock and that of log.csv jump against each other by \+3.00 s between 1\d.* --piecewise", {"file"}),
    "degrees called radians": (rows(HEAD.replace("_deg", "_rad") + "\n" + GOOD.replace("8,16", "170,16")),
                               "outside the limits .*'q1_rad' .*row 4, .* name the columns q1_deg, q2_deg, q3_deg if these are",
                               {"row", "column"}),
    "degrees called radians in a log": (
        with_points(POINTS, lambda f: write_log(f / "log.csv", POSES)), "two turns: are these degrees. Name the column",
        {"file", "line", "column"}),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_refused_with_place_and_remedy_and_nothing_is_stored(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    robot = three_joints(kilter, name.replace(" ", "-"))
    make, words, place = CASES[name]
    arguments = make(tmp_path)
    if name == "degrees called radians in a log":
        log = tmp_path / "log.csv"
        log.write_text(log.read_text().replace("_deg", "_rad"))
    arguments = [*arguments, robot] if arguments[-1] == "--robot" else [robot if a == "ROBOT" else a for a in arguments]
    capsys.readouterr()
    assert run([*map(str, arguments), "--json"]) == 1
    error: dict[str, Any] = json.loads(capsys.readouterr().out)
    with pytest.raises(FileError, match=words):
        raise FileError(error["detail"])
    assert place <= set(error["context"]), error
    assert kilter.campaigns.list(robot) == kilter.campaigns.list(robot, staged=True) == []
    kilter.robots.remove(robot)


def mat_bomb(path: Path, claim: int, packed: bool) -> None:
    """A variable that claims a shape far beyond its bytes, or three gigabytes of zeros in three megabytes."""
    flags = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, claim, claim)
    body = flags + struct.pack("<HH4s", 1, 1, b"q") + struct.pack("<II", 9, 8) + bytes(8)
    matrix = struct.pack("<II", 14, len(body)) + body
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x100) + b"IM"
    if packed:
        press = zlib.compressobj()
        start = press.compress(matrix) + press.flush(zlib.Z_FULL_FLUSH)
        zeros = press.compress(bytes(1 << 24)) + press.flush(
            zlib.Z_FULL_FLUSH
        )  # needs nothing before it: may be repeated
        content = start + 129 * zeros + press.flush()
        matrix = struct.pack("<II", 15, len(content)) + content
    path.write_bytes(head + matrix)


@pytest.mark.parametrize(("claim", "packed", "words"), [
    (100_000, False, "claims the shape 100000 x 100000 in .* bytes"), (1, True, "unpacks to more than 2 GB"),
])  # fmt: skip
def test_mat_files_that_claim_too_much(tmp_path: Path, claim: int, packed: bool, words: str) -> None:
    mat_bomb(tmp_path / "a.mat", claim, packed)
    (tmp_path / "map.toml").write_text('[columns]\nq1_deg = { from = "q(:,1)", unit = "deg" }\n')
    with pytest.raises(FileError, match=words):
        prepare(tmp_path / "a.mat", column_map=tmp_path / "map.toml")


def test_a_parquet_file_that_unpacks_to_gigabytes(tmp_path: Path) -> None:
    """A billion equal numbers are a few kilobytes of Parquet."""
    path = tmp_path / "a.parquet"
    column = pa.array(np.zeros(1 << 20))
    with parquet.ParquetWriter(path, pa.schema([("q", pa.float64())]), compression="zstd") as writer:
        for _ in range(40):
            writer.write_table(pa.table({"q": column}))
    assert path.stat().st_size < 1 << 20
    (tmp_path / "map.toml").write_text('[columns]\nq1_deg = { from = "q", unit = "deg" }\n')
    with pytest.raises(FileError, match=r"unpacks to 41943040 rows of 1 columns"):
        prepare(path, column_map=tmp_path / "map.toml")


def seed_of(folder: Path, kind: str) -> bytes:
    path = folder / f"seed.{kind}"
    if kind == "mat":
        savemat(
            path, {"rig": {name: np.arange(9.0) for name in ("q1", "q2", "q3", "x", "y", "z")}}, do_compression=True
        )
    elif kind == "parquet":
        names = [f"rig/{name}" for name in ("q1", "q2", "q3", "x", "y", "z")]
        parquet.write_table(pa.table({name: np.arange(9.0) for name in names}), path)
    elif kind == "tdms":
        write_tdms(path, np.arange(50.0))
    elif kind == "long":
        long_table(path, True, 12)
    elif kind == "points":
        path.write_bytes(TRACKER)
    else:
        path.write_text("rig/q1,rig/q2,rig/q3,rig/x,rig/y,rig/z\n" + GOOD)
    return path.read_bytes()


@pytest.mark.parametrize("kind", ["mat", "parquet", "tdms", "csv", "long", "points"])
def test_damaged_files_of_every_other_importer(tmp_path: Path, kind: str) -> None:
    from kilter_files.formats.registry import open_recording

    seed = seed_of(tmp_path, kind)
    path, column_map = tmp_path / f"damaged.{'csv' if kind in ('long', 'points') else kind}", tmp_path / "map.toml"
    column_map.write_text(MAP.replace("rig/", "rig.") if kind == "mat" else MAP)

    @settings(max_examples=50, deadline=5000, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    @given(EDITS)
    def check(edits: list[tuple[str, int, bytes]]) -> None:
        path.write_bytes(edited(seed, edits))
        said = str(path)
        try:
            if kind == "long":
                open_recording(path).whole()
            elif kind == "points":
                prepare(path, preset="leica")
            else:
                prepare(path, column_map=column_map)
        except KilterError as error:
            said = error.detail
        assert str(path) in said

    check()
