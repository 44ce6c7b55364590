"""No wrong row goes in silence: clocks that jump, orders that are not the log's, markers and bodies that were knocked."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kilter_client import FileError, Kilter
from kilter_client.cli import run
from kilter_files import prepare
from kilter_files.match.clock_checks import Checks
from kilter_files.match.matching import match_dwells
from kilter_files.match.uploaded_markers import checked_markers
from kilter_files.tables.table import JointLog
from tests.clients.files.match.campaign_generator import (
    Jump,
    Knock,
    Made,
    Plan,
    document,
    joints_at,
    make,
    measured,
    schedule,
)
from tests.clients.files.match.silent_rows import SIZE_S, files, judged, listed, matched, model, planned, wrong_rows
from tests.clients.files.simulated import write_log, write_n3d

BATCH = 25


def checks(plan: Plan, **more: object) -> Checks:
    return replace(Checks(model(plan.arm)), **more)  # type: ignore[arg-type]


def not_silent(kind: str, seeds: range) -> None:
    """What kilter promises of a kind of recording."""
    silent, alarms, unnamed = [], [], []
    for seed in seeds:
        plan, by = planned(seed, kind)
        found = judged(plan, by)
        silent += [(seed, found)] if found.silent else []
        alarms += [(seed, found)] if kind == "clean" and (found.refused or found.said or found.wrong_rows) else []
        unnamed += [(seed, found)] if kind != "clean" and found.refused and not found.named else []
    assert not silent
    assert not alarms
    # a jump at the very end, or a knock that splits a dwell, is refused by what it does to the rows, without its time
    assert len(unnamed) <= len(seeds) // 8, unnamed


@pytest.mark.parametrize(("kind", "first", "count"), [("jump", 5000, 3), ("knock", 5000, 3), ("clean", 5000, 2)])
def test_no_wrong_row_in_silence(kind: str, first: int, count: int) -> None:
    not_silent(kind, range(first, first + count))


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("batch", range(24))
def test_no_wrong_row_in_silence_of_600(batch: int) -> None:
    """300 jumps, 200 knocks, 100 clean recordings."""
    kind, first = ("jump", batch) if batch < 12 else ("knock", batch - 12) if batch < 20 else ("clean", batch - 20)
    not_silent(kind, range(first * BATCH, (first + 1) * BATCH))


@pytest.mark.parametrize(("size", "by"), [(-6.2, "time"), (0.2, "time"), (2.5, "time"), (3.1, "time"), (3.0, "frames")])
def test_jumps_near_the_cadence_are_named_and_piecewise_works(size: float, by: str) -> None:
    """Poses every 3.1 s: a jump by about that pairs every dwell with its neighbour's joints."""
    plan = Plan(11, poses=22, jumps=(Jump(33.3, size, "log"),))
    refused = judged(plan, by)
    assert refused.refused
    assert refused.named
    assert refused.exact
    assert "--piecewise" in refused.said
    made = make(plan)
    columns, warnings = matched(made, by, checks(plan, piecewise=True))
    assert not wrong_rows(made, by, columns).any()
    assert len(columns["t_s"]) > (17 if by == "time" else 0.75 * len(made.t_s))
    assert any("matched part by part" in text for text in warnings)


def test_two_jumps_are_both_named() -> None:
    plan = Plan(12, poses=30, cadence="irregular", jumps=(Jump(30, 3.1, "log"), Jump(60, -1.0, "log")))
    said = judged(plan, "time").said
    assert "by +3.10 s" in said
    assert "by -1.00 s" in said


@pytest.mark.parametrize(("factor", "words"), [(1.004, r"drift apart by \+\d{4} ppm .*500 is the limit"), (1.0001, "")])
def test_a_drift_no_clock_has(factor: float, words: str) -> None:
    plan = Plan(13, poses=22)
    made = make(plan)
    recording, log = files(made)
    other = replace(log, columns=log.columns | {"t_s": made.log_t * factor})
    if words:
        with pytest.raises(FileError, match=words):
            match_dwells(recording, other, "time", checks=checks(plan))
    else:
        drift = match_dwells(recording, other, "time", checks=checks(plan)).report["clock"]["drift_ppm"]
        assert drift == pytest.approx(100, abs=120)


def test_without_a_model_the_speeds_speak_and_the_pairing_is_called_unchecked() -> None:
    plan = Plan(14, poses=30, cadence="irregular")
    made = make(plan)
    assert any("not checked against the robot's model" in text for text in matched(made, "time", Checks())[1])
    jumped = make(replace(plan, jumps=(Jump(50, 2.5, "log"),)))
    with pytest.raises(FileError, match=r"jump against each other by \+2\.\d\d s .*by the speeds alone"):
        matched(jumped, "time", Checks())


def ordered(made: Made, rows: np.ndarray) -> JointLog:
    log = listed(made)
    return replace(log, columns={name: values[rows] for name, values in log.columns.items()})


SHIFTED = np.concatenate([np.arange(12), np.arange(13, 30), [12]])


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (np.arange(30)[::-1], "come in the reverse order of the dwells"),
        (np.random.default_rng(3).permutation(30), "explains no stretch of the pairs|of 30 pairs with"),
        (SHIFTED, r"18 of 30 pairs .* dwell 13 at .*; they fit the pose 1 earlier"),
        (np.roll(np.arange(30), 10), r"of 30 pairs|explains no stretch"),
    ],
)
def test_poses_in_another_order(rows: np.ndarray, words: str) -> None:
    plan = Plan(15, poses=30)
    made = make(plan)
    recording, _ = files(made)
    with pytest.raises(FileError, match=words):
        match_dwells(recording, ordered(made, rows), "order", checks=checks(plan))
    said = match_dwells(recording, ordered(made, rows), "order", checks=checks(plan, unchecked=True)).report["warnings"]
    assert len(said) == 1


def test_two_exchanged_poses_are_left_out_and_named() -> None:
    plan = Plan(16, poses=30)
    made = make(plan)
    rows = np.arange(30)
    rows[[7, 8]] = [8, 7]
    found = match_dwells(files(made)[0], ordered(made, rows), "order", checks=checks(plan))
    assert found.report["dwells"] == 28
    assert sum("left out: its markers are" in text for text in found.report["warnings"]) == 2


def test_another_robot_is_refused() -> None:
    made = make(Plan(17, poses=24, arm="industrial"))
    with pytest.raises(FileError, match="the model of cobot explains no"):
        match_dwells(files(made)[0], listed(made), "order", checks=Checks(model("cobot")))
    with pytest.raises(FileError, match="the model of cobot explains no"):
        match_dwells(*files(made), "time", checks=Checks(model("cobot")))


def test_a_knocked_body_is_seen_by_the_model_and_one_part_can_be_sent() -> None:
    plan = Plan(18, poses=40, knock=Knock(60.0, -1, np.array([0.4, -0.3, 0.5])))
    made = make(plan)
    with pytest.raises(FileError, match=r"the markers as a whole moved 0.\d\d mm on the tool between 5\d") as refused:
        match_dwells(files(made)[0], listed(made), "order", checks=checks(plan))
    until = float(refused.value.detail.split("--until ")[1].split()[0])
    found = match_dwells(files(made)[0], listed(made), "order", checks=checks(plan, until_s=until))
    assert found.report["warnings"] == []
    assert found.columns["t_s"].max() < 60.0


def marker_csv(path: Path, plan: Plan) -> Path:
    rests, poses = schedule(plan)
    middle = rests.mean(axis=1)
    points = measured(plan, middle, joints_at(middle, rests, poses))
    points += np.random.default_rng(0).normal(0, 0.01, points.shape)
    head = [f"q{i}_deg" for i in range(1, 7)] + [f"m{k + 1}{a}_mm" for k in range(plan.markers) for a in "xyz"]
    table = np.column_stack([poses, points.reshape(len(poses), -1)])
    np.savetxt(path, table, delimiter=",", header=",".join(head), comments="", fmt="%.6f")
    return path


def test_a_knock_among_uploaded_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = Plan(19, poses=40, knock=Knock(63.5, 2, np.array([0.0, 0.5, 0.3])))  # in the move to pose 22
    path = marker_csv(tmp_path / "rows.csv", plan)
    with pytest.raises(FileError, match=r"marker 'm3' moved 0.5\d mm on the body between rows 2\d and 2\d"):
        checked_markers(path, prepare(path), False)
    clean = marker_csv(tmp_path / "clean.csv", replace(plan, knock=None))
    assert checked_markers(clean, prepare(clean), False).warnings == ()
    assert run(["upload", "any", str(path), "--dry-run"]) == 1
    assert "'m3' moved" in capsys.readouterr().err
    assert run(["upload", "any", str(path), "--dry-run", "--unchecked"]) == 0
    assert "Warning: marker 'm3' moved" in capsys.readouterr().err


def written(folder: Path, plan: Plan) -> tuple[Made, list[str]]:
    made = make(plan)
    recording = write_n3d(folder / "r.n3d", made.points, plan.rate_hz)
    return made, [str(recording), str(write_log(folder / "log.csv", made.log_q, made.log_t))]


def test_match_as_a_person_runs_it(kilter: Kilter, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refused with the robot of the server, and sent part by part with the option that the refusal names."""
    kilter.robots.add(document("cobot", "clocks-arm"))
    plan = Plan(20, poses=22, jumps=(Jump(33.3, 3.1, "log"),))
    made, paths = written(tmp_path, plan)
    command = ["match", *paths, "--by", "time", "--robot", "clocks-arm", "--json"]
    assert run(command) == 1
    refused = json.loads(capsys.readouterr().out)
    assert refused["code"] == "file_invalid"
    assert "jump against each other by +3.10 s" in refused["detail"]
    assert kilter.campaigns.list("clocks-arm") == []
    assert run([*command, "--piecewise"]) == 0
    sent = json.loads(capsys.readouterr().out)
    parts = sent["clock"]["parts"]
    assert parts[1]["offset_s"] - parts[0]["offset_s"] == pytest.approx(3.1, abs=SIZE_S)
    assert kilter.campaigns.get(sent["campaign_id"])["rows"] == sent["rows"] >= 19
    out = tmp_path / "before.csv"
    assert (
        run(["match", *paths, "--by", "time", "--model", "clocks-arm", "--until", "31", "--out", str(out), "--json"])
        == 0
    )
    assert json.loads(capsys.readouterr().out)["warnings"] == []
    table = np.genfromtxt(out, delimiter=",", names=True)
    columns = {name: table[name] for name in table.dtype.names or ()}
    assert not wrong_rows(made, "time", columns).any()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--piecewise"], "needs the robot's model"),
        (["--since", "5", "--until", "4"], "must be earlier"),
        (["--without", "M1"], "has no marker 'M1'"),
        (["--since", "500"], "has no frames from 500"),
    ],
)
def test_options_that_cannot_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], words: str
) -> None:
    _, paths = written(tmp_path, Plan(21, poses=6))
    assert run(["match", *paths, "--by", "time", *options]) in (1, 2)
    assert words in " ".join(capsys.readouterr().err.split())
