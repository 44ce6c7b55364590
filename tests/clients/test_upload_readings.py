"""`kilter upload` finds out how a file is read, says it in a line, and asks where two readings are possible."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_client import Kilter
from kilter_client.cli import run
from tests.clients.answered import document
from tests.clients.arms_with_play import ArmWithPlay
from tests.clients.files.look.labs import LABS, Measured, write_lab
from tests.clients.files.simulated import arm, stops, write_log, write_n3d
from tests.clients.files.test_sending import three_joints
from tests.clients.test_upload_points import split

Write = Callable[..., Path]
Capture = pytest.CaptureFixture[str]

# What a lab's file leaves open; the tcp_position of "lists" may be what its controller computes.
ASKED = {name: lab.open[0] for name, lab in LABS.items() if lab.open} | {"lists": "controller computes"}


def measured(path: Path) -> Measured:
    table = np.genfromtxt(path, delimiter=",", names=True)
    q, p = (
        np.stack([table[n] for n in names], axis=1)
        for names in ([f"q{k}_deg" for k in range(1, 6)], ["x_mm", "y_mm", "z_mm"])
    )
    return Measured(q, p)


def refused(capsys: Capture, *arguments: object) -> str:
    return str(document(capsys, *arguments, code=2)["detail"])


@pytest.mark.parametrize("name", [name for name in LABS if name not in ASKED])
def test_a_labs_own_file_needs_no_map(
    robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture, name: str
) -> None:
    wanted = measured(write_campaign(30))
    path, _ = write_lab(tmp_path, name, wanted)
    assert run(["upload", robot, str(path), "--dry-run"]) == 0
    shown = capsys.readouterr()
    assert "would be refused: nothing found" in shown.out
    (said,) = [line for line in shown.err.splitlines() if "taken as" in line]
    assert "joints " in said
    assert "position " in said
    done = document(capsys, "upload", robot, path, "--dry-run")
    columns = [c for c in done["ranges"] if re.match(r"q\d_|[xyz]_mm", c["name"])]
    for k, values in enumerate(np.hstack([wanted.q, wanted.p]).T):
        assert (columns[k]["low"], columns[k]["high"]) == pytest.approx((min(values), max(values)), abs=2e-3)
    assert document(capsys, "upload", robot, path)["rows"] == 30


@pytest.mark.parametrize("name", ASKED)
def test_a_file_that_does_not_decide_is_refused_with_the_way_out(
    robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture, name: str
) -> None:
    path, _ = write_lab(tmp_path, name, measured(write_campaign(30)))
    said = refused(capsys, "upload", robot, path)
    assert ASKED[name] in said
    assert "--draft columns.toml" in said


def write_bare(path: Path, q: NDArray[np.float64], p: NDArray[np.float64]) -> Path:
    text = io.StringIO()
    np.savetxt(text, np.hstack([q, p]), delimiter=",", header="A1,A2,A3,A4,A5,X [mm],Y [mm],Z [mm]", comments="")
    path.write_text(text.getvalue())
    return path


def test_radians_are_told_from_degrees_by_the_reach_of_the_arm(
    kilter: Kilter, robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture
) -> None:
    wanted = measured(write_campaign(30))
    path = write_bare(tmp_path / "bare.csv", np.radians(wanted.q), wanted.p)
    done = document(capsys, "upload", robot, path, "--dry-run")
    high = {c["name"][:2]: c["high"] for c in done["ranges"]}
    assert high["q1"] == pytest.approx(wanted.q[:, 0].max(), abs=1e-3)
    # Points that move no further than such degrees let them: the file does not say which it is.
    path = write_bare(tmp_path / "small.csv", np.radians(wanted.q), wanted.p / 50)
    said = refused(capsys, "upload", robot, path, "--dry-run")
    assert "radians (--joint-unit rad) or degrees (--joint-unit deg)" in said
    done = document(capsys, "upload", robot, path, "--dry-run", "--joint-unit", "deg")
    assert {c["name"][:2]: c["high"] for c in done["ranges"]}["q1"] == pytest.approx(
        np.radians(wanted.q[:, 0].max()), abs=1e-3
    )


def test_columns_that_carry_the_joints_names_are_taken_for_them(server: Path, tmp_path: Path, capsys: Capture) -> None:
    arm = ArmWithPlay(7, rail=True)
    (tmp_path / "arm.urdf").write_text(arm.urdf())
    described = ("--name", "named", "--base-link", "link_0", "--tip-link", "ball")
    assert run(["robot", "add", str(tmp_path / "arm.urdf"), *described]) == 0
    names = ["a1 [mm]", *(f"a{k} [deg]" for k in range(2, 8))]
    _, *rows = arm.measured(30, 1).splitlines()
    (tmp_path / "log.csv").write_text("\n".join([",".join([*names, "X [mm],Y [mm],Z [mm]"]), *rows]) + "\n")
    capsys.readouterr()
    done = document(capsys, "upload", "named", tmp_path / "log.csv")
    assert {"q1_mm", "q2_deg", "q7_deg", "x_mm"} <= set(done["columns"])
    assert done["rows"] == len(rows)
    assert "joints a1 [mm] ... a7 [deg]" in done["notes"][0]


def test_an_order_of_angles_is_asked_for(robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture) -> None:
    wanted, rng = measured(write_campaign(30)), np.random.default_rng(1)
    table = np.hstack([wanted.q, wanted.p, rng.uniform(-170, 170, (30, 3))])
    path = tmp_path / "pose.csv"
    head = ",".join([*(f"A{k} [deg]" for k in range(1, 6)), "X [mm],Y [mm],Z [mm],Rx [deg],Ry [deg],Rz [deg]"])
    np.savetxt(path, table, delimiter=",", header=head, comments="")
    said = refused(capsys, "upload", robot, path, "--dry-run")
    assert "about the moving axes (--euler XYZ) or about the fixed axes (--euler xyz)" in said
    done = document(capsys, "upload", robot, path, "--dry-run", "--euler", "XYZ")
    assert {"qw", "qx", "qy", "qz"} <= set(done["columns"])


def test_points_with_a_joint_log_need_no_preset(
    robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture
) -> None:
    export, joints = split(write_campaign(30), tmp_path, "leica")
    done = document(capsys, "upload", robot, export, "--joints", joints)
    assert done["rows"] == 30
    assert done["notes"][0].startswith("taken as points of a tracker")


@pytest.mark.parametrize("way", ["order", "time"])
def test_a_recording_is_joined_with_its_joint_log(kilter: Kilter, tmp_path: Path, capsys: Capture, way: str) -> None:
    name = three_joints(kilter, f"recorded-{way}")
    poses = np.random.default_rng(1).uniform(-60, 60, (6, 3))
    t = np.arange(0, len(poses) * 1.8, 0.005)
    moved = stops(poses, 1.0, 0.8, t)
    recording = write_n3d(
        tmp_path / "a.n3d", arm(moved) + np.random.default_rng(0).normal(0, 0.02, (len(t), 3, 3)), 200.0
    )
    joints = write_log(tmp_path / "log.csv", *((poses,) if way == "order" else (moved[::2], t[::2])))
    assert run(["upload", name, str(recording), "--joints", str(joints)]) == 0
    shown = capsys.readouterr()
    assert f"joined with {joints} by {way}" in " ".join(shown.err.split())
    assert ": 6 rows" in shown.out
    said = str(document(capsys, "upload", name, recording, code=1)["detail"])
    assert "Name the joint log too: --joints FILE" in said


def test_a_position_that_the_controller_computes_is_no_measurement(
    robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture
) -> None:
    wanted = measured(write_campaign(30))
    path = tmp_path / "log.csv"
    head = ",".join([*(f"A{k} [deg]" for k in range(1, 6)), "tcp_x [mm],tcp_y [mm],tcp_z [mm]"])
    np.savetxt(path, np.hstack([wanted.q, wanted.p]), delimiter=",", header=head, comments="")
    assert "controller computes" in refused(capsys, "upload", robot, path)


def test_a_contract_file_with_a_strange_column_is_refused_and_not_read_without_it(
    robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture
) -> None:
    head, *rows = write_campaign(30).read_text().splitlines()
    path = tmp_path / "typed.csv"
    path.write_text("\n".join([f"{head},payload", *(f"{row},2" for row in rows)]) + "\n")
    said = document(capsys, "upload", robot, path, code=1)["detail"]
    assert "payload" in said
