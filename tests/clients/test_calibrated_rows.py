"""Campaigns of an arm of servos against a real server: those of another calibration are those of another arm."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from kilter_client import Kilter
from kilter_client.errors import ConflictError
from kilter_files import prepare
from tests.clients.files.formats.test_lerobot import calibration, dataset, recorded, ticks_of
from tests.clients.test_cli import Command

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
    folder = dataset(tmp_path / "set", "v3.0", [recorded(ticks_of([20])[0], "DEGREES")])
    refused = command.json("upload", robot, rows, "--calibration", folder / "meta/info.json", code=1)
    assert "servo 'codebase_version' does not have whole numbers" in refused["detail"]
