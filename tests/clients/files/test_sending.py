"""`kilter measure inspect` and `match` as a person runs them; long tables in parts, broken off and taken up again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client import ConflictError, Kilter, ObservationError, ServerUnreachableError
from kilter_client.cli import run
from kilter_client.cli.files.parts import cut_parquet_parts, send_whole
from tests.clients.answered import document
from tests.clients.files.simulated import arm, stops, wander, write_log, write_n3d
from tests.service.forked import ForkedPopen

POSES = np.random.default_rng(1).uniform(-60, 60, (6, 3))


def test_inspect_shows_markers_gaps_and_units(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = document(capsys, "inspect", shared_data / "ndi-formats/c3d/Optotrak.c3d")
    assert (found["kind"], found["frames"], found["rate_hz"], len(found["markers"])) == ("c3d", 29, 30.0, 54)
    assert any("never seen: Marker_52, Marker_53" in text for text in found["warnings"])
    assert found["problems"] == []
    assert any("states 1149 frames, the 29 in it" in text for text in found["warnings"])


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


WANTED = {"name": "long", "device": "optotrak", "role": "train"}


def seen(kilter: Kilter, robot: str) -> list[int]:
    """Rows of the campaigns that somebody sees."""
    return [campaign["rows"] for campaign in kilter.campaigns.list(robot)]


def test_a_broken_sending_is_not_seen_and_goes_on_where_it_stopped(kilter: Kilter) -> None:
    robot = three_joints(kilter, "parts-robot")

    def breaks_off() -> Iterator[Any]:
        for number, part in enumerate(cut_parquet_parts(blocks(), 300)):
            if number == 2:
                raise ServerUnreachableError("the cable was pulled.")
            yield part

    with pytest.raises(ServerUnreachableError) as broken:
        send_whole(kilter, robot, WANTED, breaks_off)
    assert broken.value.detail.startswith("the cable was pulled. Nothing of it is visible yet: give the same command")
    assert seen(kilter, robot) == []
    (begun,) = kilter.campaigns.list(robot, staged=True)
    assert begun["rows"] == 600
    with pytest.raises(ConflictError, match="is not whole") as refused:
        kilter.jobs.submit("identify", robot, [begun["id"]], None, {})
    assert refused.value.code == "campaign_incomplete"
    with pytest.raises(ConflictError, match="lacks 1 of 1 parts and has 2 others"):
        kilter.campaigns.commit(begun["id"], ["0" * 64])
    told: list[tuple[int, bool]] = []
    sent = send_whole(
        kilter, robot, WANTED, lambda: cut_parquet_parts(blocks(), 300), lambda n, there: told.append((n, there))
    )
    assert told == [(300, True), (300, True), (300, False), (100, False)]
    assert (sent.campaign_id, sent.rows, sent.there) == (begun["id"], 1000, 600)
    assert seen(kilter, robot) == [1000]
    again = send_whole(kilter, robot, WANTED, lambda: cut_parquet_parts(blocks(), 300))
    assert (again.campaign_id, again.there) == (begun["id"], 1000)
    with pytest.raises(ConflictError, match="measurements are kept"):
        kilter.campaigns.discard(begun["id"])


def test_a_refused_part_takes_the_whole_recording_with_it(kilter: Kilter) -> None:
    robot = three_joints(kilter, "refused-robot")

    def outside() -> Iterator[Any]:
        for number, block in enumerate(blocks()):
            yield block | ({"q2_deg": block["q2_deg"] + 500} if number == 11 else {})

    with pytest.raises(ObservationError, match="outside the limits") as refused:
        send_whole(kilter, robot, WANTED, lambda: cut_parquet_parts(outside(), 300))
    assert refused.value.detail.endswith("Nothing of the recording is stored.")
    assert refused.value.context["column"] == "q2_deg"
    assert seen(kilter, robot) == []
    assert kilter.campaigns.list(robot, staged=True) == []
    kilter.robots.remove(robot)


def test_a_killed_client_leaves_nothing_to_see(kilter: Kilter, server: Path) -> None:
    """The client dies by SIGKILL in the middle; what it began is finished by the next."""
    robot = three_joints(kilter, "killed-robot")
    code = (
        "import os, signal\nfrom kilter_client import Kilter\n"
        "from kilter_client.cli.files.parts import cut_parquet_parts, send_whole\n"
        "from tests.clients.files.test_sending import WANTED, blocks\n"
        "def stop(rows, there, seen=[]):\n    seen.append(rows)\n    len(seen) == 3 and os.kill(os.getpid(), signal.SIGKILL)\n"
        f"send_whole(Kilter(), {robot!r}, WANTED, lambda: cut_parquet_parts(blocks(), 200), stop)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[3], check=False, timeout=120)
    assert done.returncode == -signal.SIGKILL
    assert seen(kilter, robot) == []
    sent = send_whole(kilter, robot, WANTED, lambda: cut_parquet_parts(blocks(), 200))
    assert (sent.rows, sent.there) == (1000, 600)
    assert seen(kilter, robot) == [1000]


@pytest.mark.slow
def test_a_killed_server_leaves_nothing_to_see(
    tmp_path: Path, no_settings: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server dies by SIGKILL between two parts; started again it shows nothing, and the sending goes on."""
    monkeypatch.setenv("KILTER_DATA", str(tmp_path))
    process = start_server(tmp_path)
    with Kilter() as kilter:
        robot = three_joints(kilter, "arm")

        def dies() -> Iterator[Any]:
            for number, part in enumerate(cut_parquet_parts(blocks(), 300)):
                if number == 2:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait(20)
                yield part

        with pytest.raises(ServerUnreachableError, match="does not answer"):
            send_whole(kilter, robot, WANTED, dies)
    (tmp_path / "server.json").unlink(missing_ok=True)
    process = start_server(tmp_path)
    try:
        with Kilter() as kilter:
            assert seen(kilter, robot) == []
            sent = send_whole(kilter, robot, WANTED, lambda: cut_parquet_parts(blocks(), 300))
            assert sent.rows == 1000
            assert sent.there >= 600  # a part that was on its way may have been stored
            assert seen(kilter, robot) == [1000]
    finally:
        process.terminate()
        process.wait(20)


def start_server(data: Path) -> subprocess.Popen[bytes]:
    """A server in a process group of its own, ready."""
    environment = os.environ | {"KILTER_DATA": str(data), "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    with (data / "log").open("ab") as log:
        process = ForkedPopen(
            [sys.executable, "-m", "kilter_service", "serve"], env=environment, stdout=log, stderr=log,
            stdin=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
    deadline = time.monotonic() + 120
    while not (data / "server.json").exists():
        assert process.poll() is None, (data / "log").read_text()
        assert time.monotonic() < deadline, (data / "log").read_text()
        time.sleep(0.05)
    return process


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
