"""Campaigns of an arm of servos against a real server: those of another calibration are those of another arm."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from kilter_client import Kilter
from kilter_client.errors import ConflictError, FileError, PayloadError
from kilter_files import prepare
from tests.clients.files.formats.test_lerobot import calibration, dataset, recorded, ticks_of
from tests.clients.test_cli import Command
from tests.clients.test_homing_command import calibration as servos
from tests.clients.test_homing_command import measured

FIRST, SECOND = "a1" * 32, "b2" * 32


@pytest.fixture
def kilter(server: Path) -> Iterator[Kilter]:
    with Kilter() as connected:
        yield connected


def of(sha256: str) -> dict[str, str]:
    return {"calibration_sha256": sha256}


def test_a_new_calibration_is_refused_until_the_old_campaign_is_out_of_use(kilter: Kilter, robot: str) -> None:
    kilter.campaigns.add(robot, "by hand")
    old = kilter.campaigns.add(robot, "before", conditions=of(FIRST))
    kilter.campaigns.add(robot, "as before", conditions=of(FIRST))
    with pytest.raises(ConflictError) as caught:
        kilter.campaigns.add(robot, "after", conditions=of(SECOND))
    assert caught.value.code == "calibration_differs"
    assert "'after' was measured with servo calibration b2b2b2b2b2b2, campaign 'before' of" in caught.value.detail
    assert "Add a robot for it" in caught.value.detail
    for name in ("before", "as before"):
        kilter.retire(name, robot=robot, kind="campaign")
    kilter.campaigns.add(robot, "after", conditions=of(SECOND))
    with pytest.raises(ConflictError, match="'before' was measured with servo calibration a1a1a1a1a1a1"):
        kilter.restore(old["id"], kind="campaign")


def rows_of(kilter: Kilter, robot: str, path: Path) -> Path:
    joints = len(kilter.robots.get(robot)["joints"])
    head = ",".join([*(f"q{k}_deg" for k in range(1, joints + 1)), "x_mm", "y_mm", "z_mm"])
    path.write_text(head + "\n" + ",".join(["10"] * joints + ["1", "2", "3"]) + "\n")
    return path


def test_parts_that_come_late_are_compared_with_what_came_into_use_meanwhile(
    kilter: Kilter, robot: str, tmp_path: Path
) -> None:
    part = prepare(rows_of(kilter, robot, tmp_path / "part.csv"))
    late = kilter.campaigns.add(robot, "late", conditions=of(FIRST), staged=True)
    kilter.campaigns.upload(late["id"], part)
    kilter.campaigns.add(robot, "first", conditions=of(SECOND))
    with pytest.raises(ConflictError) as caught:
        kilter.campaigns.commit(late["id"], [part.sha256])
    assert caught.value.code == "calibration_differs"
    kilter.campaigns.discard(late["id"])


def test_views_and_points_state_the_calibration_of_the_servos_that_read_their_joints(
    kilter: Kilter, robot: str, command: Command, tmp_path: Path
) -> None:
    rows = rows_of(kilter, robot, tmp_path / "rows.csv")
    servos = calibration(tmp_path)
    sent = command.json("upload", robot, rows, "--name", "servos", "--calibration", servos)
    stated = kilter.campaigns.get(sent["campaign_id"])["conditions"]["calibration_sha256"]
    assert stated == hashlib.sha256(servos.read_bytes()).hexdigest()
    other = calibration(tmp_path / "other", elbow_flex={"homing_offset": 7})
    refused = command.json("upload", robot, rows, "--name", "again", "--calibration", other, code=1)
    assert refused["code"] == "calibration_differs"
    assert "no servo of" in " ".join(sent["warnings"])  # its joints are called j1 ..., so nothing was compared
    folder = dataset(tmp_path / "set", "v3.0", [recorded(ticks_of([20])[0], "DEGREES")])
    refused = command.json("upload", robot, rows, "--calibration", folder / "meta/info.json", code=1)
    assert "servo 'codebase_version' does not have whole numbers" in refused["detail"]


@pytest.mark.parametrize("stated", ["", "AB" * 32, "ab" * 31, "my_arm.json"])
def test_a_hash_that_is_none_is_refused_with_what_to_send(kilter: Kilter, robot: str, stated: str) -> None:
    with pytest.raises(PayloadError) as caught:
        kilter.campaigns.add(robot, "malformed", conditions=of(stated))
    assert caught.value.code == "payload_invalid"
    told = caught.value.detail
    assert "body.conditions.calibration_sha256: Is not the SHA-256 of a file" in told
    assert "Give what `sha256sum my_arm.json` prints first, or null where it is unknown" in told
    kilter.campaigns.add(robot, "malformed", conditions=of(FIRST))


LEADERS = (
    "calibration/teleoperators/so101_leader/my_arm.json", "so101_leader/my_arm.json", "backup/my_awesome_leader_arm.json",
)  # fmt: skip
FOLLOWERS = (
    "calibration/robots/so101_follower/leader_of_the_pack.json", "my_arm.json", "leader_and_follower/my_arm.json",
    "backup/my_follower.json",
)  # fmt: skip


@pytest.fixture
def so101(kilter: Kilter, request: pytest.FixtureRequest) -> str:
    """An SO-101 of this test's own."""
    name = f"so101-{request.node.name[:40]}"
    kilter.robots.add({"name": name, "convention": "preset", "preset": "so101"})
    return name


def points(folder: Path, column: str = "q3_deg", value: str = "30") -> Path:
    path = folder / "points.csv"
    names = [*(f"q{k}_deg" for k in range(1, 6)), "x_mm", "y_mm", "z_mm"]
    cells = dict(zip(names, ["10", "-20", "30", "15", "5", "1", "2", "3"], strict=True))
    rows = [cells, cells | {"x_mm": "7"}, {name: value if name == column else cell for name, cell in cells.items()}]
    path.write_text("\n".join([",".join(names), *(",".join(row.values()) for row in rows)]) + "\n")
    return path


def at(folder: Path, place: str, **changes: dict[str, int]) -> Path:
    path = folder / place
    return calibration(path.parent, path.name, **changes)


@pytest.mark.parametrize("place", LEADERS)
def test_the_calibration_of_a_leader_is_refused_beside_rows_of_a_follower(
    kilter: Kilter, so101: str, command: Command, tmp_path: Path, place: str
) -> None:
    rows, leader = points(tmp_path), at(tmp_path, place)
    for more in ((), ("--dry-run",)):
        refused = command.json("upload", so101, rows, "--calibration", leader, *more, code=1)
        assert refused["code"] == "file_invalid"
        assert f"{leader}: is of a leader by its folder or its name" in refused["detail"]
        assert "Give the calibration of the follower, in .../calibration/robots/." in refused["detail"]
    for verb in (kilter.upload, kilter.dry_run):
        with pytest.raises(FileError, match="is of a leader") as caught:
            verb(so101, rows, calibration=leader)
        assert caught.value.detail == refused["detail"]
    refused = command.json(
        "homing", leader, "ver_1", "-o", tmp_path / "copy.json", "--servos", "feetech", "--norm-mode", "DEGREES", code=1
    )
    assert "is of a leader" in refused["detail"]
    assert not kilter.campaigns.list(so101)


@pytest.mark.parametrize("place", FOLLOWERS)
def test_a_calibration_whose_folder_is_that_of_followers_is_taken_whatever_it_is_called(
    kilter: Kilter, so101: str, tmp_path: Path, place: str
) -> None:
    stored = kilter.upload(so101, points(tmp_path), calibration=at(tmp_path, place), progress=False)
    assert not stored.warnings
    stated = kilter.campaign(stored.campaign_id).conditions.calibration_sha256
    assert stated == hashlib.sha256((tmp_path / place).read_bytes()).hexdigest()


def test_the_calibration_of_another_arm_is_refused_beside_rows(
    kilter: Kilter, so101: str, command: Command, tmp_path: Path
) -> None:
    rows, whole = points(tmp_path), json.loads(at(tmp_path, "my_arm.json").read_text())
    lekiwi, small = tmp_path / "lekiwi.json", tmp_path / "small.json"
    lekiwi.write_text(json.dumps({f"arm_{name}": servo for name, servo in whole.items()}))
    small.write_text(json.dumps({name: whole[name] for name in ("shoulder_pan", "elbow_flex")}))
    for other, said in (
        (lekiwi, "lekiwi.json: has no servo 'shoulder_pan'"), (small, "small.json: has 2 servos, the robot 5 joints"),
    ):  # fmt: skip
        refused = command.json("upload", so101, rows, "--calibration", other, code=1)
        assert refused["code"] == "file_invalid"
        assert said in refused["detail"]
        assert "it is of another arm" in refused["detail"]
        with pytest.raises(FileError, match="it is of another arm"):
            kilter.upload(so101, rows, calibration=other, progress=False)
    assert not kilter.campaigns.list(so101)


def test_readings_that_the_servos_do_not_reach_are_of_another_calibration(
    kilter: Kilter, so101: str, command: Command, tmp_path: Path
) -> None:
    narrow = at(tmp_path, "narrow.json", elbow_flex={"range_min": 1600, "range_max": 2400})  # +-35 degrees
    rows = points(tmp_path, "q3_deg", "40")
    refused = command.json("upload", so101, rows, "--calibration", narrow, code=1)
    assert refused["code"] == "file_invalid"
    assert (
        f"{rows}, row 3, column 'q3_deg': 40 deg is outside the range of narrow.json (+-35.16 deg)" in refused["detail"]
    )
    assert "give those they were recorded with" in refused["detail"]
    by_radians = {f"q{k}_rad": [0.1, 0.7 if k == 3 else 0.1] for k in range(1, 6)}
    data = by_radians | {"x_mm": [1, 2], "y_mm": [1, 2], "z_mm": [1, 2]}
    with pytest.raises(FileError, match=r"arrays, row 2, column 'q3_deg': 40\.107 deg is outside the range"):
        kilter.upload(so101, data, calibration=narrow, progress=False)
    assert not kilter.campaigns.list(so101)
    kilter.upload(so101, points(tmp_path, "q3_deg", "35"), calibration=narrow, progress=False)


def test_homing_takes_the_calibration_with_which_the_version_was_measured(
    kilter: Kilter, command: Command, tmp_path: Path
) -> None:
    own = servos(tmp_path)
    version = measured(kilter, tmp_path, "homed", 40, calibration=own)
    asked = ("-o", tmp_path / "trued.json", "--servos", "feetech", "--norm-mode", "DEGREES")
    other = servos(tmp_path / "other", j2={"homing_offset": 400})
    refused = command.json("homing", other, version, *asked, code=1)
    assert refused["code"] == "calibration_differs"
    assert f"{other}: its SHA-256 is " in refused["detail"]
    assert "Give the calibration with which it was measured." in refused["detail"]
    assert command.json("homing", own, version, *asked)["calibration_compared"] is True
    assert "nobody compared" not in command("homing", own, version, *asked)
