"""`kilter upload` of tracker exports by preset, with the joints of another file, and of TDMS channels through a map."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from nptdms import ChannelObject, TdmsWriter

from kilter_client import FileError, Kilter, prepare
from tests.clients.answered import document
from tests.clients.files.formats.test_joint_logs import RAPID, write_bag

Write = Callable[..., Path]
Capture = pytest.CaptureFixture[str]

DIALECTS: dict[str, Callable[[np.ndarray], bytes]] = {
    "leica": lambda p: (
        "\ufeffMeßpunkt;X;Y;Z\n;[mm];[mm];[mm]\n" + "".join(
            f"P{i};{x:.4f};{y:.4f};{z:.4f}\n".replace(".", ",") for i, (x, y, z) in enumerate(p))
    ).encode(),
    "spatialanalyzer": lambda p: (
        "// Frame: WORLD\n// Units: mm\n" + "".join(f"A, G, P{i}, {x:.4f}, {y:.4f}, {z:.4f}\n" for i, (x, y, z) in enumerate(p))
    ).encode(),
    "polyworks": lambda p: (
        "Name\tMeas X\tMeas Y\tMeas Z\tU95 [µm]\n" + "".join(
            f"P{i}\t{x:.4f}\t{y:.4f}\t{z:.4f}\t40\n" for i, (x, y, z) in enumerate(p))
    ).encode("latin-1"),
    "faro": lambda p: (
        "Name,X [m],Y [m],Z [m]\n" + "".join(
            f"P{i},{x / 1e3:.7f},{y / 1e3:.7f},{z / 1e3:.7f}\n" for i, (x, y, z) in enumerate(p))
    ).encode("utf-16"),
}  # fmt: skip


def split(measured: Path, folder: Path, dialect: str) -> tuple[Path, Path]:
    """Write the points of a campaign as an export and its joints as a log of their own."""
    table = np.genfromtxt(measured, delimiter=",", names=True)
    export, joints = folder / "points.txt", folder / "joints.csv"
    export.write_bytes(DIALECTS[dialect](np.stack([table[f"{a}_mm"] for a in "xyz"], axis=1)))
    names = [name for name in table.dtype.names or () if name.startswith("q")]
    rows = np.stack([table[name] for name in names], axis=1)
    np.savetxt(joints, rows, delimiter=",", header=",".join(names), comments="", fmt="%.9f")
    return export, joints


@pytest.mark.parametrize("dialect", DIALECTS)
def test_an_export_with_its_joints(
    kilter: Kilter, robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture, dialect: str
) -> None:
    export, joints = split(write_campaign(30), tmp_path, dialect)
    seen = document(capsys, "inspect", export, "--preset", dialect)
    assert (seen["kind"], seen["rows"]) == ("tracker-text", 30)
    done = document(capsys, "upload", robot, export, "--preset", dialect, "--joints", joints)
    assert done["rows"] == 30
    campaign = kilter.campaigns.get(done["campaign_id"])
    assert campaign["device"] == dialect
    wanted = {*(f"q{i}_deg" for i in range(1, 6)), "x_mm", "y_mm", "z_mm", "pose_id"}
    assert wanted <= set(campaign["uploads"][0]["columns"])
    job = kilter.jobs.run("identify", robot, [done["campaign_id"]], options={"level": 1})
    assert job["result"]["metrics"]["train"]["identified"]["mean_mm"] < 0.1


def test_what_does_not_fit_is_said_and_nothing_is_stored(
    kilter: Kilter, robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture
) -> None:
    export, joints = split(write_campaign(12), tmp_path, "leica")
    none = document(capsys, "upload", robot, export, "--device", "leica", code=1)
    assert "holds points, but no joints with a unit. Name the file that holds them (--joints)" in none["detail"]
    joints.write_text("\n".join(joints.read_text().splitlines()[:-1]) + "\n")
    few = document(capsys, "upload", robot, export, "--preset", "leica", "--joints", joints, code=1)
    assert "12 points, but 11 poses of joints" in few["detail"]
    assert "belong to a text export" in document(capsys, "upload", robot, export, "--euler", "XYZ", code=2)["detail"]
    assert "is not one of" in document(capsys, "upload", robot, export, "--preset", "lieca", code=2)["detail"]
    assert kilter.campaigns.list(robot) == []


def test_contract_columns_of_a_device_that_is_a_preset_stay_as_they_are(
    robot: str, write_campaign: Write, capsys: Capture
) -> None:
    path = write_campaign(10)
    found = document(capsys, "upload", robot, path, "--device", "leica", "--dry-run")
    assert found["notes"] == ["its columns are sent as they are"]


def test_columns_that_are_not_the_contracts_are_not_called_so(
    robot: str, write_campaign: Write, capsys: Capture
) -> None:
    path = write_campaign(10)
    path.write_text(path.read_text().replace("x_mm", "east_mm", 1))
    refused = document(capsys, "upload", robot, path, code=1)
    assert "east_mm" in refused["detail"]
    assert not [note for note in prepare(path).notes if "contract" in note]


def test_a_row_that_is_left_out_takes_its_joints_with_it(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("// Alignment: base of robot\nid,x,y,z\nA,1,2,3\nB,0,0,0\nC,7,8,9\n")
    (tmp_path / "p.mod").write_text(RAPID)
    found = prepare(tmp_path / "p.csv", joined=tmp_path / "p.mod", preset="generic")
    rows = np.genfromtxt(found.content.decode().splitlines(), delimiter=",", names=True)
    np.testing.assert_allclose(rows["q3_deg"], [20, -3])
    np.testing.assert_allclose(rows["x_mm"], [1, 7])
    assert found.lines == (3, 5)
    assert "coordinate frame: base of robot" in found.notes
    (tmp_path / "p.mod").write_text(RAPID.replace("jointtarget jHome:=", "jointtarget_ jHome:="))
    with pytest.raises(FileError, match="3 points, but 2 poses"):
        prepare(tmp_path / "p.csv", joined=tmp_path / "p.mod", preset="generic")


def test_joints_of_a_bag_in_the_order_that_is_named(
    robot: str, write_campaign: Write, tmp_path: Path, capsys: Capture
) -> None:
    export, joints = split(write_campaign(6), tmp_path, "faro")
    table = np.radians(np.genfromtxt(joints, delimiter=",", skip_header=1))
    names = ["waist", "shoulder", "elbow", "pitch", "roll"]
    messages = [("/js", float(k), dict(sorted(zip(names, row.tolist(), strict=True)))) for k, row in enumerate(table)]
    bag = write_bag(tmp_path / "bag", messages)
    arguments = ("upload", robot, export, "--preset", "faro", "--joints", bag, "--dry-run")
    assert "which of its joints is the first" in document(capsys, *arguments, code=1)["detail"]
    found = document(capsys, *arguments, "--joint-order", ",".join(names))
    assert found["rows"] == 6
    assert "q1 to q5 are waist, shoulder, elbow, pitch, roll" in found["notes"]


def test_tdms_through_a_map(robot: str, tmp_path: Path, capsys: Capture) -> None:
    volts = np.linspace(0.0, 5.0, 12)
    with TdmsWriter(str(tmp_path / "rig.tdms")) as writer:
        channels = [ChannelObject("rig", f"j{i}", 10 * np.sin(volts + i)) for i in range(1, 6)]
        channels += [ChannelObject("rig", a, volts, properties={"unit_string": "V"}) for a in "xyz"]
        writer.write_segment(channels)
    lines = [f'q{i}_deg = {{ from = "rig/j{i}", unit = "deg" }}' for i in range(1, 6)]
    lines += [f'{a}_mm = {{ from = "rig/{a}", unit = "mm", scale = 9.0, offset = 100.0 }}' for a in "xyz"]
    (tmp_path / "map.toml").write_text("[columns]\n" + "\n".join(lines) + "\n")
    found = document(capsys, "upload", robot, tmp_path / "rig.tdms", "--map", tmp_path / "map.toml", "--dry-run")
    assert found["rows"] == 12
    assert "x_mm from 'rig/x' x 9 +100 [mm]" in found["notes"]
    lines[0] = lines[0].replace("rig/j1", "rig/j9")
    (tmp_path / "map.toml").write_text("[columns]\n" + "\n".join(lines) + "\n")
    wrong = document(capsys, "upload", robot, tmp_path / "rig.tdms", "--map", tmp_path / "map.toml", code=1)
    assert "no channel 'rig/j9' (did you mean 'rig/j" in wrong["detail"]
