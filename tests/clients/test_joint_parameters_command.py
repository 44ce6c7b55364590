"""``kilter measure joint-parameters`` against a real server: planned readings, read, sent; and a real arm's two encoders."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
import pytest

from kilter_client.errors import FileError
from kilter_files.rig.tilt_join import read_readings
from tests.clients.test_cli import Command

EXAMPLES = Path(__file__).resolve().parents[2] / "clients/python/examples"
HEAD = "joint,axis,q1_deg,q2_deg,payload_kg,series,reading_deg\n"


@pytest.fixture
def shell(server: Path, command: Command) -> Command:
    return command


def test_a_proposal_is_filled_in_and_gives_the_joint(shell: Command, tmp_path: Path) -> None:
    shell("robot", "add", "--preset", "katana450-chapter5", "--name", "inclined")
    asked, filled = tmp_path / "asked.csv", tmp_path / "filled.csv"
    plan = ("--propose", "j3", "--count", 12, "--payload-kg", 0, "--payload-kg", 0.5)
    assert "joint values" in shell("joint-parameters", "inclined", *plan, "-o", asked)
    rows = list(csv.DictReader(io.StringIO(asked.read_text())))
    assert len(rows) == 12
    assert {row["payload_kg"] for row in rows} == {"0", "0.5"}
    with filled.open("w", newline="") as stream:
        out = csv.DictWriter(stream, [*[*rows[0]][:-1], "reading_mrad"])
        out.writeheader()
        for row in rows:  # nothing gives way: every reading is the mounting error of its axis
            row.pop("reading_deg")
            out.writerow({**row, "reading_mrad": 2.0 + "xyz".index(row["axis"])})
    job = shell.json("joint-parameters", "inclined", "--readings", filled)
    assert job["result"]["measured_by"] == "inclinometer"
    assert {p["name"] for p in job["result"]["parameters"]} == {"clearance_3", "backlash_load_3", "compliance_3"}
    assert all(abs(p["value"]) < 3 * p["sigma"] for p in job["result"]["parameters"])
    printed = shell("jobs", "show", job["id"])
    assert "clearance_3" in printed
    assert "measure tool positions" in printed  # what to do about joint 1
    assert "not --readings and --propose" in shell(
        "joint-parameters", "inclined", "--readings", filled, "--propose", "j3", code=2
    )


def test_payloads_of_a_proposal_hang_where_they_were_said_to(shell: Command, tmp_path: Path) -> None:
    shell("robot", "add", "--preset", "katana450-chapter5", "--name", "off-the-tool")
    asked, filled = tmp_path / "asked.csv", tmp_path / "filled.csv"
    plan = ("--propose", "j3", "--count", 12, "--payload-kg", 0.5, "--payload-com-mm", "10,0,40")
    result = shell.json("joint-parameters", "off-the-tool", *plan, "-o", asked)["result"]
    assert {tuple(one["payload_com_mm"]) for one in result["configurations"]} == {(10.0, 0.0, 40.0)}
    filled.write_text(asked.read_text().replace(",0,\n", ",0,0.1\n"))
    job = shell.json("joint-parameters", "off-the-tool", "--readings", filled)
    assert [reading["payload_com_mm"] for reading in job["options"]["readings"]] == 12 * [[10.0, 0.0, 40.0]]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (HEAD + "j1,x,1,2,0,0,\n", "line 2, column 'reading_deg': there is no reading"),
        (HEAD + "j1,x,1,two,0,0,0.1\n", "line 2, column 'q2_deg': 'two' is not a number"),
        (HEAD + "# a note\n\nj1,x,1,2,0,0\n", "line 4: 6 cells under 7 columns"),
        (HEAD.replace("axis", "side") + "j1,x,1,2,0,0,0.1\n", "column 'side': an unknown column"),
        (HEAD.replace("q1_deg,", "") + "j1,x,2,0,0,0.1\n", "joint values are not q1 to qn"),
        (HEAD.replace("reading_deg", "series_2") + "j1,x,1,2,0,0,0.1\n", "unknown column"),
        (HEAD, "it holds no readings"),
    ],
)
def test_a_file_of_readings_is_refused_by_line_and_column(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "readings.csv"
    file.write_text(text)
    with pytest.raises(FileError) as refused:
        read_readings(file)
    assert says in str(refused.value)


def test_units_of_readings(tmp_path: Path) -> None:
    file = tmp_path / "readings.csv"
    for unit, value in (("deg", 0.5), ("mrad", math.radians(0.5) * 1e3), ("arcmin", 30.0)):
        file.write_text(HEAD.replace("reading_deg", f"reading_{unit}") + f"j1,X,1,2,0.5,3,{value}\n")
        (row,) = read_readings(file)
        assert row.pop("reading_deg") == pytest.approx(0.5)
        assert row == {"joint": "j1", "axis": "x", "q_deg": [1.0, 2.0], "payload_kg": 0.5, "series": 3}


def test_the_kr300_by_its_second_encoders(shell: Command, shared_data: Path) -> None:
    folder = shared_data / "kuka-kr300-secondary-encoder"
    shell("robot", "add", EXAMPLES / "kr300.json", "--name", "two-encoders")
    ids = {
        k: shell.json("upload", "two-encoders", folder / f"traj_{k}.mat", "--map", EXAMPLES / "kr300.toml")[
            "campaign_id"
        ]
        for k in "ABC"
    }
    job = shell.json("joint-parameters", "two-encoders", "-c", ids["A"], "-v", ids["B"], "-v", ids["C"])
    found = {p["name"]: p for p in job["result"]["parameters"]}
    motions = {j["joint"]: [m for m in j["motions"] if m["use"] == "predicted"] for j in job["result"]["joints"]}
    for axis in ("a1", "a2", "a3"):
        assert [m["campaign"] for m in motions[axis]] == [ids["B"], ids["C"]]
        assert all(m["left_deg"] < 0.2 * m["raw_deg"] for m in motions[axis])  # the target is a half
    for axis in (2, 3):
        assert found[f"compliance_{axis}"]["value"] > 5 * found[f"compliance_{axis}"]["sigma"]
    assert all(0.0025 < found[f"encoder_delay_{k}"]["value"] < 0.0035 for k in (1, 2, 3))
    assert np.all([found[f"backlash_{k}"]["identifiable"] is False for k in (4, 5, 6)])
    dead = [w["joint"] for w in job["result"]["warnings"] if w["code"] == "dead_encoder"]
    assert dead == ["a4", "a5", "a6"]
    printed = shell("jobs", "show", job["id"])
    assert "left of it" in printed
    assert "dead channel" in printed
    refused = shell("joint-parameters", "two-encoders", "-c", ids["A"], "-v", "0.3", code=1)
    assert "held out whole" in refused
