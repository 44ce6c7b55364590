"""`kilter inspect` and `kilter match` as a person runs them; long tables in parts, broken off and taken up again."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kilter_client import Kilter, ServerUnreachableError
from kilter_client.cli import run
from kilter_client.files.parts import find_campaign, parts, send_parts

from tests.clients.files.simulated import arm, stops, wander, write_log, write_n3d

POSES = np.random.default_rng(1).uniform(-60, 60, (6, 3))


def document(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> dict[str, Any]:
    assert run([*map(str, arguments), "--json"]) == code
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_inspect_shows_markers_gaps_and_units(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = document(capsys, "inspect", shared_data / "ndi-formats/c3d/Optotrak.c3d", "--allow-cut")
    assert (found["kind"], found["frames"], found["rate_hz"], len(found["markers"])) == ("c3d", 29, 30.0, 54)
    assert any("never seen: Marker_52, Marker_53" in text for text in found["warnings"])
    assert found["problems"] == []
    found = document(capsys, "inspect", shared_data / "ndi-formats/c3d/Optotrak.c3d", code=1)
    assert found["code"] == "file_invalid"
    assert found["context"]["frame"] == 30


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("fanuc-r2000-3markers/calibration_dataset.mat", "mat"),
        ("tdms-samples/raw1.tdms", "tdms"),
        ("ipa-ur10-lasertracker/Series_B/measurements_joint_configurations.csv", "tracker-text"),
    ],
)
def test_inspect_knows_a_file_by_its_content(
    shared_data: Path, capsys: pytest.CaptureFixture[str], name: str, kind: str
) -> None:
    assert document(capsys, "inspect", shared_data / name, "--preset", "leica")["kind"] == kind


def test_inspect_names_swapped_markers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    points = arm(stops(POSES, 1.0, 0.8, np.arange(0, 8, 0.01)))
    points[300:] = points[300:][:, [1, 0, 2]]
    assert run(["inspect", str(write_n3d(tmp_path / "a.n3d", points, 100.0))]) == 1
    shown = capsys.readouterr().out
    assert "Problem: frame 301: the markers 'Marker_1' and 'Marker_2' change places here." in shown


def test_match_reports_and_sends_nothing_without_a_robot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(0, len(POSES) * 1.8, 0.005)
    points = arm(stops(POSES, 1.0, 0.8, t)) + np.random.default_rng(0).normal(0, 0.02, (len(t), 3, 3))
    recording = write_n3d(tmp_path / "a.n3d", points, 200.0)
    found = document(capsys, "match", recording, write_log(tmp_path / "log.csv", POSES), "--out", tmp_path / "rows.csv")
    assert (found["dwells"], found["rows"]) == (6, 6)
    assert "campaign_id" not in found
    table = np.genfromtxt(tmp_path / "rows.csv", delimiter=",", names=True)
    np.testing.assert_allclose(table["q2_deg"], POSES[:, 1], atol=1e-5)


def three_joints(kilter: Kilter, name: str) -> str:
    elements = [
        {"joint": "j1", "axis": "Rz"}, {"name": "h", "axis": "Tz", "value": 500}, {"joint": "j2", "axis": "Ry"},
        {"name": "a", "axis": "Tx", "value": 400}, {"joint": "j3", "axis": "Ry"}, {"name": "b", "axis": "Tx", "value": 300},
    ]  # fmt: skip
    joints = [{"name": f"j{i}", "limits_deg": [-180, 180]} for i in (1, 2, 3)]
    kilter.robots.add({"name": name, "convention": "chain", "joints": joints, "elements": elements})
    return name


def blocks() -> Iterator[dict[str, np.ndarray]]:
    for first in range(0, 1000, 70):
        t = np.arange(first, min(first + 70, 1000)) / 100
        points = arm(wander(t))
        points[::9, 1] = np.nan
        columns = {"t_s": t} | {f"q{i + 1}_deg": q for i, q in enumerate(wander(t).T)}
        yield columns | {f"m{k + 1}{a}_mm": points[:, k, i] for k in range(3) for i, a in enumerate("xyz")}


def test_a_broken_sending_goes_on_where_it_stopped(kilter: Kilter) -> None:
    robot = three_joints(kilter, "parts-robot")
    wanted = {"name": "long", "device": "optotrak", "role": "train"}
    campaign = find_campaign(kilter, robot, wanted, next(parts(blocks(), 300)))

    def breaks_off() -> Iterator[Any]:
        for number, part in enumerate(parts(blocks(), 300)):
            if number == 2:
                raise ServerUnreachableError("the cable was pulled")
            yield part

    with pytest.raises(ServerUnreachableError):
        send_parts(kilter, campaign, breaks_off())
    assert kilter.campaigns.get(campaign)["rows"] == 600
    again = find_campaign(kilter, robot, wanted, next(parts(blocks(), 300)))
    assert again == campaign
    told: list[tuple[int, bool]] = []
    assert send_parts(kilter, again, parts(blocks(), 300), lambda rows, there: told.append((rows, there))) == 1000
    assert told == [(300, True), (300, True), (300, False), (100, False)]
    assert kilter.campaigns.get(campaign)["rows"] == 1000


def test_match_sends_every_frame_and_again_sends_nothing(
    kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    robot = three_joints(kilter, "frames-robot")
    t, log_t = np.arange(0, 12, 1 / 100), np.arange(-1, 16, 1 / 100)
    points = arm(wander(t)) + np.random.default_rng(0).normal(0, 0.02, (len(t), 3, 3))
    recording = write_n3d(tmp_path / "a.n3d", points, 100.0)
    log = write_log(tmp_path / "log.csv", wander(log_t - 2.5), log_t)
    arguments = ("match", recording, log, "--by", "frames", "--robot", robot)
    found = document(capsys, *arguments)
    assert found["rows"] == 1200
    assert found["clock"]["offset_s"] == pytest.approx(2.5, abs=1e-4)
    again = document(capsys, *arguments)
    assert (again["campaign_id"], again["rows_there_already"]) == (found["campaign_id"], 1200)
    assert kilter.campaigns.get(found["campaign_id"])["rows"] == 1200
