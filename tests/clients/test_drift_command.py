"""`kilter check` and `k.drift` against a real server, on an arm of a simulator of its own that is moved."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import kilter as library
from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.errors import JobFailedError, KilterError, UsageError
from tests.clients.test_cli import Command
from tests.core.watch.drifting import DriftingArm, some_arm, some_poses

NOISE = 5e-5
STEP = float(np.radians(0.21))


def written(path: Path, arm: DriftingArm, poses: int, seed: int, **columns: float) -> Path:
    """Measure random poses with an arm; further columns have one value in all rows."""
    rng = np.random.default_rng(seed)
    q = some_poses(poses, rng)
    seen = arm.measured(q, rng, NOISE).position
    assert seen is not None
    names = [*(f"q{k}_deg" for k in range(1, 7)), "x_mm", "y_mm", "z_mm", *columns]
    table = np.hstack([np.degrees(q), seen * 1e3, np.tile(list(columns.values()), (poses, 1))])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.12g")
    return path


@pytest.fixture(scope="module")
def arm() -> DriftingArm:
    return some_arm(np.random.default_rng(3))


@pytest.fixture
def k(server: Path) -> Iterator[Kilter]:
    with library.connect() as connected:
        yield connected


@pytest.fixture
def calibrated(k: Kilter, arm: DriftingArm, tmp_path: Path, request: pytest.FixtureRequest) -> str:
    """A robot that is corrected with a version of 60 poses at 22 deg C."""
    name = f"watched-{request.node.name[:40]}"
    k.add_robot({**arm.document(), "name": name})
    sent = k.upload(name, written(tmp_path / "fit.csv", arm, 60, 1), temperature_c=22.0, name="fit", progress=False)
    effects = [{"id": "axial_compliance", "joints": [2, 3]}]
    fit = k.identify(name, sent, effects=effects, noise_mm=0.05, masses="as_stated", progress=False)
    assert fit.version_id is not None
    k.activate(fit.version_id, force=True, reason="a test")
    return name


def test_a_check_says_what_moved_and_its_exit_code_says_so_too(
    calibrated: str, arm: DriftingArm, command: Command, tmp_path: Path
) -> None:
    still = written(tmp_path / "still.csv", arm, 6, 2)
    assert "ok: 6 poses agree" in command("check", calibrated, still)
    crashed = written(tmp_path / "crashed.csv", arm.after("zero_3", STEP), 6, 3)
    said = command("check", calibrated, crashed, "--details", code=3)
    assert "moved: zero of joint 3 by 0.2" in said
    assert "such rows show" in said
    job = command.json("check", calibrated, "--campaign", "crashed.csv", code=3)
    said = command("drift", calibrated)
    assert f"{calibrated}: moved: zero of joint 3" in said
    assert "activated" in said
    told = command.json("drift")["robots"]
    assert [one["state"] for one in told if one["robot"] == calibrated] == ["moved"]
    listed = command("drift")  # of all robots: what happened, not what that rests on
    assert "moved: zero of joint 3 by 0.2" in listed
    assert "false alarm" not in listed
    (cause,) = job["result"]["causes"]
    (number,) = cause["numbers"]
    assert (cause["name"], cause["joint"], number["unit"]) == ("zero_3", 3, "deg")
    assert number["change"] == pytest.approx(0.21, abs=2.0 * number["u95"])
    assert job["result"]["p_value"] < 1e-6
    turned = written(tmp_path / "turned.csv", arm.after("zero_1", STEP), 6, 4)
    said = command("check", calibrated, turned, code=4)
    assert "cannot tell:" in said
    assert "mastering marks of joint 1" in said
    roles = {one["name"]: one["role"] for one in command.json("campaigns", "list", calibrated)["campaigns"]}
    assert roles == {"fit": "train", "still.csv": "validation", "crashed.csv": "validation", "turned.csv": "validation"}


def test_the_library_checks_rows_and_campaigns(k: Kilter, calibrated: str, arm: DriftingArm, tmp_path: Path) -> None:
    found = k.drift(calibrated, written(tmp_path / "sagging.csv", arm.after("sag_2", 4e-5), 6, 5), progress=False)
    assert found.verdict == "moved"
    assert [one.name for one in found.causes] == ["sag_2"]
    assert repr(found).startswith("moved: sag of joint 2 by")
    again = k.drift(calibrated, campaign="sagging.csv", progress=False)
    assert k.drift_history(calibrated).state == "moved"
    assert calibrated in [one.robot for one in k.drift_list().robots]
    assert again.sentence == found.sentence
    moved = arm.after("base", 0.3)
    anew = k.drift(calibrated, written(tmp_path / "anew.csv", moved, 6, 6), new_setup=["base"], progress=False)
    assert anew.verdict == "ok"
    assert "zero of joint 1" in anew.unseen
    with pytest.raises(UsageError, match="campaign="):
        k.drift(calibrated)
    with pytest.raises(UsageError, match="has its own"):
        k.drift(calibrated, campaign="anew.csv", temperature_c=20.0)


def test_what_cannot_be_checked_is_refused_with_place_and_remedy(
    calibrated: str, arm: DriftingArm, command: Command, tmp_path: Path, k: Kilter
) -> None:
    def refused(*arguments: Any, code: str) -> str:
        told = command.json("check", *arguments, code=1)
        assert told["code"] == code, told
        return str(told["detail"])

    two = written(tmp_path / "two.csv", arm, 2, 7)
    assert "needs 3 distinct poses" in refused(calibrated, two, code="too_few_poses")
    head, row, _ = two.read_text().splitlines()
    (tmp_path / "one.csv").write_text("\n".join([head, *[row] * 5]) + "\n")
    assert "the 5 rows repeat one pose" in refused(calibrated, tmp_path / "one.csv", code="too_few_poses")
    assert "Measure some poses again" in refused(calibrated, "--campaign", "fit", code="rows_shared")
    warm = written(tmp_path / "warm.csv", arm, 5, 8, temperature_c=45.0)
    assert "Row 1 was measured at 45 deg C, and the version at 22 deg C" in refused(
        calibrated, warm, code="another_temperature"
    )
    other = some_arm(np.random.default_rng(99))
    foreign = written(tmp_path / "other.csv", other, 6, 9)
    said = refused(calibrated, foreign, code="rows_of_another_arm")
    assert "of another robot" in said
    (gone,) = [one for one in k.campaigns(calibrated, retired=True) if one.name == "other.csv"]
    assert f"Campaign {gone.id} was retired" in said
    assert "other.csv" not in [one.name for one in k.campaigns(calibrated)]
    with pytest.raises(JobFailedError, match="was retired, so that nothing is compared with it"):
        k.drift(calibrated, written(tmp_path / "theirs.csv", other, 6, 10), progress=False)
    assert "theirs.csv" not in [one.name for one in k.campaigns(calibrated)]
    k.restore(gone.id)
    said = refused(calibrated, "--campaign", gone.id, code="rows_of_another_arm")
    assert "still in use, because other jobs or versions name it" in said  # who restored it knows more than the check
    assert "other.csv" in [one.name for one in k.campaigns(calibrated)]
    k.add_robot({**other.document(), "name": f"{calibrated}-other"})
    sent = k.upload(f"{calibrated}-other", foreign, name="theirs", progress=False)
    assert "is not of robot" in refused(calibrated, "--campaign", sent.campaign_id, code="campaigns_invalid")
    assert "no active version" in refused(f"{calibrated}-other", "--campaign", "theirs", code="option_invalid")
    assert "give base, or base and tool" in refused(calibrated, two, "--new-setup", "tool", code="option_invalid")


def test_what_is_stated_of_rows_counts_though_they_were_sent_before(
    calibrated: str, arm: DriftingArm, command: Command, tmp_path: Path, k: Kilter
) -> None:
    """Rows that were sent without a temperature are checked at the one that is stated now; the same again is the same."""
    k.add_instrument("lapsed", "laser_tracker", "7", mpe_um=15.0, valid_until="2026-01-10")
    rows = written(tmp_path / "rows.csv", arm, 6, 11)
    assert "ok: 6 poses agree" in command("check", calibrated, rows)
    hot = command.json("check", calibrated, rows, "--temperature-c", 45, code=1)
    assert hot["code"] == "another_temperature"
    for _ in range(2):
        found = command.json("check", calibrated, rows, "--temperature-c", 23, "--instrument", "lapsed")["result"]
        (warning,) = [one for one in found["warnings"] if one["code"] == "instrument_expired"]
        assert "held until 2026-01-10" in warning["message"]
    assert "held until 2026-01-10" in command("check", calibrated, "--campaign", "rows.csv (2)")
    stored = command.json("campaigns", "list", calibrated)["campaigns"]
    seen = [
        (one["name"], one["conditions"]["temperature_c"], one["instrument"]) for one in stored if one["name"] != "fit"
    ]
    assert seen == [("rows.csv", None, None), ("rows.csv (2)", 23.0, "lapsed")]
    assert 45.0 in [
        one.conditions.temperature_c for one in k.campaigns(calibrated, retired=True)
    ]  # refused, so retired


def test_a_wrong_command_line_is_told_so(calibrated: str, command: Command, tmp_path: Path, arm: DriftingArm) -> None:
    assert "Give the FILE" in command("check", calibrated, code=2)
    file = written(tmp_path / "still.csv", arm, 5, 10)
    assert "Give the FILE" in command("check", calibrated, file, "--campaign", "fit", code=2)
    assert "conditions and date already" in command(
        "check", calibrated, "--campaign", "fit", "--temperature-c", "20", code=2
    )
    assert run(["check", "nobody", str(file)]) == 1


def test_a_job_takes_one_campaign(calibrated: str, kilter: Kilter) -> None:
    used = [str(one["id"]) for one in kilter.campaigns.list(calibrated)]
    with pytest.raises(KilterError, match="2 campaigns"):
        kilter.jobs.submit("drift", calibrated, used * 2)
    assert kilter.jobs.check("drift", calibrated, used)["problems"][0]["code"] == "rows_shared"


def test_a_check_is_planned_and_says_beforehand_what_it_will_show(
    calibrated: str, command: Command, tmp_path: Path, arm: DriftingArm
) -> None:
    file = tmp_path / "check.csv"
    said = command("plan", "check", calibrated, "--poses", "5", "--anywhere", "-o", file)
    assert "5 poses for check" in said
    assert "zero of joint 2" in said
    assert "in 95 % of the checks" in said
    table = np.genfromtxt(file, delimiter=",", names=True)
    q = np.radians(np.stack([table[f"q{k}_deg"] for k in range(1, 7)], axis=1))
    assert q.shape == (5, 6)
    told = command.json("plan", "check", calibrated, "--anywhere", "--keep-out", "100,-2000,-2000,2000,2000,400")
    assert told["result"]["false_alarm"] == pytest.approx(1e-3)
    assert {one["name"] for one in told["result"]["smallest"]} >= {"zero_1", "sag_2", "base", "tool", "scale"}
    faint = told["result"]["faint"]
    lever = 1e3 * float(np.hypot(arm.tool[0, 3], arm.tool[1, 3]))
    assert re.match(
        r"A step of 0\.03 deg of the zero of joint 6 does not alarm in 95 % of the checks: that begins", faint[-1]
    )
    off = re.search(r"at most ([\d.]+) mm off that axis; [\d.]+ mm would show it, or about \d+ such poses", faint[-1])
    assert off is not None
    assert float(off[1]) == pytest.approx(lever, rel=0.05)  # as the fit found the tool
    assert faint[-1][:60] in command("plan", "check", calibrated, "--anywhere")
    said = command("plan", "check", calibrated, "--keep-out", "1,2,3,0,0,0", code=2)
    assert "--keep-out 1,2,3,0,0,0: give the lowest corner first" in said
    said = command("plan", "check", calibrated, "--without-joints", "9", code=1)
    assert "--without-joints has joint 9: the robot has 6" in said
    said = command(
        "plan", calibrated, "--purpose", "identify", "--count", "3", "--option", "without_joints=[1]", code=1
    )
    assert "goes with purpose check" in said


def test_a_reflector_on_an_axis_is_refused_before_anybody_measures(
    k: Kilter, arm: DriftingArm, command: Command
) -> None:
    document = {**arm.document(), "name": "on-the-axis"}
    k.add_robot({**document, "tool": {**document["tool"], "x_mm": 0, "y_mm": 0}})
    told = command.json("plan", "check", "on-the-axis", code=1)
    assert told["code"] == "tool_on_axis"
    assert "off the axis of joint 6" in told["detail"]


def test_what_moved_is_re_zeroed_activated_and_agrees(
    calibrated: str, command: Command, tmp_path: Path, arm: DriftingArm, k: Kilter
) -> None:
    (first,) = command.json("versions", "list", calibrated)["versions"]
    moved = arm.after("zero_3", STEP)
    command("check", calibrated, written(tmp_path / "crashed.csv", moved, 6, 20), code=3)
    said = command("rezero", calibrated, "--campaign", "crashed.csv", "--details")
    assert f"Version {calibrated} v1 re-zeroed: zero of joint 3 by 0.2" in said
    assert "The 6 rows of crashed.csv were used for that" in said
    assert "re-zeroed by (6)" in said
    assert "train" not in said
    found = command.json("rezero", calibrated, "--campaign", "crashed.csv", "--cause", "zero_3")["result"]
    version = command.json("version", found["version_id"])
    assert version["parent_id"] == first["id"]
    before = {row["name"]: row["value"] for row in command.json("version", first["id"])["parameters"]}
    after = {row["name"]: row["value"] for row in version["parameters"]}
    changed = [name for name in after if abs(after[name] - before[name]) > 1e-9]
    assert changed == ["theta_offset_3"] == [row["name"] for row in found["parameters"]]
    assert after["theta_offset_3"] - before["theta_offset_3"] == pytest.approx(0.21, abs=0.03)
    again = written(tmp_path / "again.csv", moved, 8, 21)
    command("check", calibrated, again, code=3)
    done = command.json("activate", found["version_id"])
    assert (done["active"], done["forced"]) == (True, False)
    assert "again.csv" in [k.campaign(c).name for c in done["compared"]["campaigns"]]
    assert "ok:" in command("check", calibrated, "--campaign", "again.csv")
    told = command.json("rezero", calibrated, "--campaign", "again.csv", code=1)
    assert told["code"] == "rezero_not_carried"
    assert "Nothing has moved" in told["detail"]
    told = command.json("rezero", calibrated, "--campaign", "again.csv", "--cause", "elbow", code=1)
    assert told["code"] == "option_invalid"


def test_what_moved_is_re_zeroed_by_rows_of_a_tracker_that_stands_elsewhere(
    calibrated: str, arm: DriftingArm, command: Command, tmp_path: Path
) -> None:
    moved = arm.after("zero_3", STEP)
    elsewhere = written(tmp_path / "elsewhere.csv", moved.after("base", 0.3), 12, 3)
    assert "moved: zero of joint 3" in command("check", calibrated, elsewhere, "--new-setup", "base", code=3)
    found = command.json("rezero", calibrated, "--campaign", "elsewhere.csv", "--new-setup", "base")["result"]
    assert "re-zeroed with base set up anew: zero of joint 3" in found["sentence"]
    assert found["metrics"]["train"]["identified"]["mean_mm"] < 0.2
    command("activate", found["version_id"], "--force", "--reason", "a test")
    assert "ok: 6 poses agree" in command("check", calibrated, written(tmp_path / "back.csv", moved, 6, 8))
    again = written(tmp_path / "again.csv", moved.after("base", -0.2), 6, 9)
    assert "ok: 6 poses agree" in command("check", calibrated, again, "--new-setup", "base")


def test_the_exit_code_is_the_verdicts_where_nobody_reads_on(
    calibrated: str, arm: DriftingArm, tmp_path: Path, server: Path
) -> None:
    """As in ``kilter check ... | head``: the reader is gone before anything is printed."""
    ends = {3: arm.after("zero_3", STEP), 0: arm}
    for code, now in ends.items():
        rows = written(tmp_path / f"ends-{code}.csv", now, 6, 12)
        for more in ([], ["--json"]):
            read, write = os.pipe()
            os.close(read)
            command = [
                sys.executable,
                "-c",
                "from kilter_client.cli import main; main()",
                "check",
                calibrated,
                str(rows),
            ]
            ended = subprocess.run([*command, *more], stdout=write, stderr=subprocess.PIPE, text=True, check=False)
            os.close(write)
            assert ended.returncode == code, ended.stderr
            assert "Broken pipe" not in ended.stderr
