"""`kilter measure see`: pictures and joints become rows of contract columns, and a description of cameras and boards."""

from __future__ import annotations

import csv
import json
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pyarrow import parquet

from kilter_client.cli import run
from tests.clients.files.rig.see.boards import CHARUCO, SMALL, board, saved, small, taken
from tests.clients.files.rig.see.raycaster import Shot, true_corners

SECOND = (*CHARUCO, "--first-id", "40")
JOINTS = "q1_deg,q2_deg,t_s\n10,20,0.5\n11,21,1.5\n12,22,2.5\n"


def shots() -> list[Shot]:
    return [small(rotation_deg=(10.0 * k, -8.0, 4.0), seed=k) for k in range(3)]


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    greys = {f"pose{k + 9}": taken(CHARUCO, shot) for k, shot in enumerate(shots())}
    return saved(tmp_path_factory.mktemp("see") / "pictures", **greys)


def seen(tmp_path: Path, capsys: pytest.CaptureFixture[str], *given: str, code: int = 0) -> Any:
    capsys.readouterr()
    assert run(["see", *given, "-o", str(tmp_path / "views.csv"), "--json"]) == code
    return json.loads(capsys.readouterr().out)


def rows(tmp_path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((tmp_path / "views.csv").read_text().splitlines()))


def own_board() -> str:
    return str(board(CHARUCO)[0])


def test_pictures_in_order_with_their_joints(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    joints = tmp_path / "joints.csv"
    joints.write_text(JOINTS)
    document = seen(tmp_path, capsys, str(pictures), "--board", own_board(), "--joints", str(joints))
    table = rows(tmp_path)
    head = [f"{s}{axis}{n}_px" for s in ("", "s") for n in range(1, 25) for axis in "uv"]
    assert list(table[0]) == ["q1_deg", "q2_deg", "t_s", *head]
    assert [float(row["q1_deg"]) for row in table] == [10, 11, 12]
    for row, shot in zip(table, shots(), strict=True):  # pose9, pose10, pose11: by number, not by letter
        truth = true_corners(board(CHARUCO)[1], shot)
        there = np.array([[float(row[f"{axis}{n}_px"]) for axis in "uv"] for n in range(1, 25)])
        sigmas = np.array([[float(row[f"s{axis}{n}_px"]) for axis in "uv"] for n in range(1, 25)])
        assert np.abs(there - truth).max() < 0.2
        assert (sigmas > 0).all()
    assert document["rows"] == document["pictures"] == 3
    assert document["refused"] == []
    assert ["intrinsics are missing" in text for text in document["warnings"]] == [True]
    [one] = document["boards"]
    assert one["corners_mm"][0] == [25.0, 25.0, 0.0]
    assert (len(one["corners_mm"]), one["mount"]) == (24, "flange")
    assert json.loads((tmp_path / "views.json").read_text())["boards"] == document["boards"]


def test_pictures_by_name_and_what_lacks_its_counterpart(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    joints = tmp_path / "joints.csv"
    joints.write_text("picture,q1_deg\npose11.png,3\npose9,1\npose77.png,7\n")
    document = seen(tmp_path, capsys, str(pictures), "--board", own_board(), "--joints", str(joints))
    assert [float(row["q1_deg"]) for row in rows(tmp_path)] == [1, 3]
    [missing] = document["refused"]
    assert missing["code"] == "joints_missing"
    assert missing["picture"].endswith("pose10.png")
    assert document["warnings"][0] == f"1 rows of {joints} have no picture: 3"


def test_other_counts_without_names_are_refused(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    joints = tmp_path / "joints.csv"
    joints.write_text(JOINTS + "13,23,3.5\n")
    document = seen(tmp_path, capsys, str(pictures), "--board", own_board(), "--joints", str(joints), code=1)
    assert document["code"] == "joints_missing"
    assert "has 4 rows, and there are 3 pictures. Add a column picture" in document["detail"]
    assert not (tmp_path / "views.csv").exists()


def test_two_boards_in_one_picture_and_a_named_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shot = small(centre_mm=(0.0, 0.0, 400.0))
    both = np.hstack([taken(CHARUCO, shot), taken(SECOND, shot)])
    folder = saved(
        tmp_path / "pictures", both=both, one=np.hstack([taken(CHARUCO, shot), np.full_like(both, 90)[:, :480]])
    )
    second = json.loads(board(SECOND)[0].read_text()) | {"name": "second"}
    path = tmp_path / "second.json"
    path.write_text(json.dumps(second))
    given = [str(folder), "--board", own_board(), "--board", str(path), "--camera-name", "left", "--mount", "flange"]
    document = seen(tmp_path, capsys, *given)
    table = rows(tmp_path)
    assert [(row["pose_id"], row["camera"], row["board"]) for row in table] == [
        ("1", "left", "board"), ("1", "left", "second"), ("2", "left", "board"),
    ]  # fmt: skip
    assert float(table[1]["u1_px"]) - float(table[0]["u1_px"]) == pytest.approx(480, abs=0.2)
    assert document["refused"] == []
    assert [one["mount"] for one in document["boards"]] == ["fixed", "fixed"]


def test_parquet_holds_what_the_csv_file_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small_view = small(centre_mm=(60.0, 0.0, 300.0))  # some corners are outside the picture
    folder = saved(tmp_path / "pictures", whole=taken(CHARUCO, small()), part=taken(CHARUCO, small_view))
    joints = tmp_path / "joints.csv"
    joints.write_text("picture,q1_deg\nwhole,1\npart,2.5\n")
    given = [str(folder), "--board", own_board(), "--joints", str(joints), "--camera-name", "left"]
    document = seen(tmp_path, capsys, *given)
    capsys.readouterr()
    output = tmp_path / "columns.parquet"
    assert run(["see", *given, "-o", str(output), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["views"] == document["views"]
    table = parquet.read_table(output)
    text = rows(tmp_path)
    assert table.column_names == list(text[0])
    for name in table.column_names:
        cells = [row[name] for row in text]
        wanted = cells if name == "camera" else [float(cell) if cell else None for cell in cells]
        assert table[name].to_pylist() == wanted
    assert any(column.null_count for column in table.columns)
    assert json.loads((tmp_path / "columns.json").read_text())["views"] == document["views"]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "columns.json", "columns.parquet", "joints.csv", "pictures", "views.csv", "views.json",
    ]  # fmt: skip


def test_parquet_needs_pyarrow(
    pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    output = tmp_path / "views.parquet"
    assert run(["see", str(pictures), "--board", own_board(), "-o", str(output), "--json"]) != 0
    document = json.loads(capsys.readouterr().out)
    assert document["code"] == "package_missing"
    assert "pip install pyarrow" in document["detail"]
    assert not list(tmp_path.iterdir())


def test_boards_that_cannot_be_told_apart(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    twin = tmp_path / "twin.json"
    twin.write_text(board(CHARUCO)[0].read_text())
    document = seen(tmp_path, capsys, str(pictures), "--board", own_board(), "--board", str(twin), code=2)
    assert "both have marker 0" in document["detail"]


def test_a_camera_and_a_picture_of_another(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    camera = tmp_path / "camera.json"
    numbers = {"width_px": 480, "height_px": 360, "fx_px": 560, "fy_px": 560, "cx_px": 241, "cy_px": 178}
    camera.write_text(json.dumps(numbers | {"distortion_model": "brown", "distortion": [0.1, 0, 0, 0]}))
    other = saved(tmp_path / "other", wide=np.zeros((480, 640), np.uint8))
    given = [str(pictures), str(other), "--board", own_board(), "--camera", str(camera)]
    document = seen(tmp_path, capsys, *given)
    assert document["cameras"] == [
        {"name": "camera"}
        | numbers
        | {"distortion_model": "brown", "distortion": [0.1, 0, 0, 0, 0], "intrinsics": "fixed", "mount": "fixed"}
    ]
    assert [one["code"] for one in document["refused"]] == ["picture_other_camera"]


def test_a_video_by_the_time_of_its_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, joints = tmp_path / "poses.avi", tmp_path / "joints.csv"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (SMALL.width, SMALL.height))
    for shot in shots():
        grey = taken(CHARUCO, shot)
        for _ in range(10):
            video.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    video.release()
    joints.write_text(JOINTS)
    document = seen(tmp_path, capsys, str(path), "--board", own_board(), "--joints", str(joints))
    table = rows(tmp_path)
    assert {float(row["q1_deg"]) for row in table} == {10, 11, 12}
    for row in table:
        truth = true_corners(board(CHARUCO)[1], shots()[int(float(row["q1_deg"])) - 10])
        assert abs(float(row["u1_px"]) - truth[0, 0]) < 0.3
    assert any("rolling shutter" in text for text in document["warnings"])


def test_frames_of_a_moving_arm_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "motion.avi"
    video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (SMALL.width, SMALL.height))
    for x in (0.0, 0.0, 0.0, 2.0, 4.0, 6.0, 6.0, 6.0):
        video.write(cv2.cvtColor(taken(CHARUCO, small(centre_mm=(x, 0.0, 330.0))), cv2.COLOR_GRAY2BGR))
    video.release()
    document = seen(tmp_path, capsys, str(path), "--board", own_board())
    assert [(one["picture"][-1], one["code"]) for one in document["refused"]] == [(k, "arm_moving") for k in "456"]
    assert "has moved by 3." in document["refused"][0]["detail"]
    assert document["rows"] == 5


def test_nothing_can_be_used(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = saved(tmp_path / "pictures", empty=np.full((360, 480), 90, np.uint8))
    document = seen(tmp_path, capsys, str(folder), "--board", own_board(), code=1)
    assert document["code"] == "board_not_found"
    assert "empty.png" in document["detail"]
    assert document["context"]["refused"][0]["remedy"]
    (folder / "empty.png").unlink()
    assert "has no picture" in seen(tmp_path, capsys, str(folder), "--board", own_board(), code=2)["detail"]


def test_the_real_pictures(shared_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = shared_data / "charuco-industrial" / "images"
    if not folder.is_dir():
        pytest.skip("the pictures of the industrial arm are not there")
    sizes = ["--square-mm", "36.195", "--marker-mm", "18.256", "--dictionary", "6x6_250"]
    path = board(("--columns", "5", "--rows", "7", *sizes))[0]
    document = seen(tmp_path, capsys, str(folder), "--board", str(path))
    assert (document["rows"], document["refused"]) == (16, [])
    assert document["corners"] >= 290
    swapped = board(("--columns", "7", "--rows", "5", *sizes))[0]
    refused = seen(tmp_path, capsys, str(folder), "--board", str(swapped), code=1)
    assert refused["code"] == "columns_rows_swapped"


class Bar:
    """What a terminal would show."""

    def __init__(self) -> None:
        self.titles: list[str] = []
        self.done: list[tuple[int, int]] = []

    def add_task(self, title: str, **_: object) -> int:
        self.titles.append(title)
        return 0

    def update(self, _: int, *, completed: int, total: int) -> None:
        self.done.append((completed, total))


def test_the_bar_says_that_pictures_are_looked_through(
    pictures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bar = Bar()
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setattr("kilter_client.cli.terminal.output.bars", lambda **_: nullcontext(bar))
    assert run(["see", str(pictures), "--board", own_board(), "-o", str(tmp_path / "views.csv")]) == 0
    assert bar.titles == ["looking through 3 pictures"]
    assert bar.done == [(1, 3), (2, 3), (3, 3)]
