"""The command line against a real server: what it prints, where, and how it exits."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
import typer
from pyarrow import parquet

from kilter_client import Kilter
from kilter_client.cli import app, run
from kilter_client.cli.catalogue import MOVED

Write = Callable[..., Path]
Capture = pytest.CaptureFixture[str]
EXAMPLES = Path(__file__).resolve().parents[2] / "clients/python/examples"


class Command:
    """Runs ``kilter`` in this process and reads what it printed."""

    def __init__(self, capsys: Capture) -> None:
        self._capsys = capsys

    def __call__(self, *arguments: object, code: int = 0) -> str:
        """Run; return stdout, then stderr."""
        self._capsys.readouterr()
        found = run([str(argument) for argument in arguments])
        printed = self._capsys.readouterr()
        assert found == code, printed.out + printed.err
        return printed.out + printed.err

    def json(self, *arguments: object, code: int | tuple[int, ...] = 0) -> dict[str, Any]:
        """Run with --json: stdout must be one document and stderr empty; ``code`` may be one of several."""
        self._capsys.readouterr()
        found = run([*(str(argument) for argument in arguments), "--json"])
        printed = self._capsys.readouterr()
        assert found in (code if isinstance(code, tuple) else (code,)), printed.out + printed.err
        assert printed.err == ""
        document = json.loads(printed.out)
        assert isinstance(document, dict)
        return document


def leaves(group: Any, name: str = "kilter") -> Iterator[tuple[str, Any]]:
    for child, found in group.commands.items():
        if hasattr(found, "commands"):
            yield from leaves(found, f"{name} {child}")
        else:
            yield f"{name} {child}", found


COMMANDS = dict(leaves(typer.main.get_command(app)))


def test_every_command_of_the_contract_is_there() -> None:
    assert {f"kilter {' '.join((MOVED.get(first, first), *rest))}" for first, *rest in map(str.split, (
        "robot add", "robot torque", "robot check", "robot convert", "robot from-circles", "robot frame", "robot list",
        "robot show", "robot note", "robot compensation", "robot tolerance", "robot retire", "robot restore", "robot purge",
        *(f"{kind} {verb}" for kind in ("campaigns", "versions")
          for verb in ("list", "name", "note", "retire", "restore", "purge")),
        "instrument add", "instrument list", "upload", "inspect", "match",
        "sheet", "filter", "board", "see", "live", "kit", "episodes", "login", "bridge rsi", "bridge egm",
        "bridge fci",
        "sheet-read", "sheet-join", "ballbar-join", "tilt-join",
        "identify", "gap", "evaluate", "plan poses", "plan check", "plan motion", "hand-eye", "check", "drift", "rezero",
        "joint-parameters", "payload", "repair",
        *(f"mesh {verb}" for verb in ("list", "set", "from-urdf", "remove")),
        *(f"fleet {verb}" for verb in ("identify", "list", "show", "watch", "cancel")),
        "jobs list", "jobs show", "jobs watch", "jobs cancel", "server demo", "version show", "activate", "rollback", "diff",
        "residuals", "activations", "export", "correct", "status", "suspicious", "today", "accept", "stream-session",
        "twin compare", "twin onto", "twin read", "homing",
        "effects", "methods", "presets", "formats", "columns", "try",
        "whoami", "audit", "token add", "token list", "token revoke",
    ))} == set(COMMANDS)  # fmt: skip


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_help_has_an_example_and_json(name: str, command: Command) -> None:
    text = command(*name.split()[1:], "--help")
    assert f"Example: {name} " in text or text.rstrip().endswith(f"Example: {name}")
    assert "--json" in text


def test_robot(server: Path, command: Command, tmp_path: Path) -> None:
    assert command.json("robot", "add", "--preset", "ur10", "--name", "ur10-cli")["name"] == "ur10-cli"
    assert "shoulder_pan" in command("robot", "show", "ur10-cli")
    assert "ur10-cli" in [robot["name"] for robot in command.json("robot", "list")["robots"]]
    assert command.json("robot", "add", EXAMPLES / "fanuc-r2000.json")["convention"] == "chain"
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(
        '<robot name="a"><link name="b"/><link name="t"/><joint name="j" type="revolute"><parent link="b"/>'
        '<child link="t"/><axis xyz="0 0 1"/><origin xyz="0.1 0 0.2"/><limit lower="-1" upper="1"/></joint></robot>'
    )
    text = command("robot", "add", urdf, "--name", "arm-cli", "--base-link", "b", "--tip-link", "t")
    assert "-57.2958 to 57.2958 deg" in text


def test_from_measurements_to_a_version(robot: str, command: Command, write_campaign: Write, tmp_path: Path) -> None:
    train, held_out = write_campaign(60, "train.csv"), write_campaign(20, "held-out.csv", 2)
    done = command.json("upload", robot, train, "--device", "leica-at960", "--payload-kg", "0.4")
    assert set(done) >= {"campaign_id", "rows", "sha256"}
    assert done["rows"] == 60
    other = command.json("upload", robot, held_out, "--role", "validation", "--payload-kg", "0.4")
    assert "train.csv" in command("campaigns", robot)
    assert done["campaign_id"] not in command("campaigns", robot)
    identify = ("identify", robot, "--campaign", done["campaign_id"], "--validation", other["campaign_id"])
    job = command.json(*identify, "--level", "1", "--loss", "huber")
    assert job["state"] == "succeeded"
    assert job["options"] == {"level": 1, "loss": "huber"}
    first = job["result"]["version_id"]
    text = command(*identify, "--level", "2", "--fix", "alpha_*,a_3", "--fix", "d_5", "--seed", "3", "--details")
    words = (
        "registration only", "validation (20)", "p95 mm", "nominal", "not identifiable", "cannot be told from",
        "rows left out of these errors: train none, validation none",
    )  # fmt: skip
    for word in words:
        assert word in text
    _versions(robot, first, command, tmp_path)
    _correct(robot, command, tmp_path)
    _jobs(robot, job["id"], done["campaign_id"], command)
    evaluated = command("evaluate", robot, "-c", other["campaign_id"], "--version", first, "--refit", "base")
    assert "registration only" in evaluated
    assert "activate" not in evaluated


def _versions(robot: str, first: str, command: Command, tmp_path: Path) -> None:
    second = next(v["id"] for v in command.json("versions", robot)["versions"] if v["id"] != first)
    assert f"{robot} v1 is active" in command("activate", first)
    assert command.json("activate", second)["active"] is True
    assert f"{robot} v1 is active again" in command("rollback", robot)
    assert "differ by less than their uncertainty" in command("diff", first, second)
    assert "theta_offset_2" in command("diff", "nominal", second)
    assert "unseen" in command("versions", robot)
    assert "train: campaign" in command("version", first)
    assert json.loads(command("version", "export", first))
    written = command.json("export", first, "-o", tmp_path / "version.json")
    assert written["bytes"] == (tmp_path / "version.json").stat().st_size
    assert "name the file" in command.json("export", first, code=2)["detail"]
    command("export", first, "--ranges", "80", "-o", tmp_path / "ranges.yaml")
    assert json.loads((tmp_path / "ranges.yaml").read_text())["arm"]["level"] == 0.8
    assert "a file of its own" in command.json("export", first, "--ranges", "95", "--format", "mjcf", code=2)["detail"]
    table = command.json("export", first, "--format", "dh-csv", "-o", tmp_path / "arm.csv")
    assert {one["where"] for one in table["numbers"]} >= {"base", "tool"}
    offsets = {one["joint"]: one["offset_deg"] for one in table["zero_offsets"]}
    differences = {one["where"]: one["difference"] for one in table["numbers"] if one["name"] == "theta_offset_deg"}
    assert offsets == differences
    printed = command("export", first, "--format", "dh-csv", "-o", tmp_path / "arm.csv")
    assert "zero offset" in printed
    assert "real = reading + offset" in " ".join(printed.split())
    left = command.json("residuals", first, "--out", tmp_path / "left.parquet")
    assert (left["format"], left["bytes"]) == ("parquet", (tmp_path / "left.parquet").stat().st_size)
    assert command("residuals", first).startswith('"campaign","row","dx_mm"')
    assert "name the file" in command.json("residuals", first, code=2)["detail"]


def _correct(robot: str, command: Command, tmp_path: Path) -> None:
    path, output = tmp_path / "path.csv", tmp_path / "corrected.csv"
    joints = ",".join(f"q{i}_deg" for i in range(1, 6))
    path.write_text(f"t_s,{joints}\n" + "".join(f"{0.1 * k},{k},{20 + k},{30 - k},10,5\n" for k in range(5)))
    done = command.json("correct", robot, path, "-o", output)
    assert done["status"] == {"OK": 5}
    head, *rows = csv.reader(output.read_text().splitlines())
    assert ",".join(head) == (
        f"t_s,{joints},dx_mm,dy_mm,dz_mm,left_mm,left_x_mm,left_y_mm,left_z_mm,u95_x_mm,u95_y_mm,u95_z_mm,flags,status"
    )
    assert len(rows) == 5
    assert "5 rows" in command("correct", robot, path, "-o", output)
    assert "name the file" in command.json("correct", robot, path, code=2)["detail"]
    words = ["flags", "status"]
    table, back = tmp_path / "path.parquet", tmp_path / "corrected.parquet"
    parquet.write_table(pa.table({name: [float(x) for x in cells] for name, *cells in _columns(path)}), table)
    command("correct", robot, table, "-o", back)
    as_csv = {name: [float(x) for x in cells] for name, *cells in _columns(output) if name not in words}
    assert parquet.read_table(back).drop_columns(words).to_pydict() == as_csv
    path.write_text(path.read_text() + "0.5,0,0,0,0,9999\n")
    assert command.json("correct", robot, path, "-o", output)["status"]["JOINT_LIMIT"] == 1
    assert "JOINT_LIMIT 1" in command("correct", robot, path, "-o", output)


def test_what_a_correction_leaves_out_is_said(
    robot: str, command: Command, write_campaign: Write, tmp_path: Path
) -> None:
    measured, path = write_campaign(60), tmp_path / "path.csv"
    head, *rows = measured.read_text().splitlines()
    warm = [f"{row},{20 + k % 7}" for k, row in enumerate(rows)]
    measured.write_text("\n".join([f"{head},temperature_c", *warm, ""]))
    campaign = command.json("upload", robot, measured)["campaign_id"]
    job = command.json("identify", robot, "-c", campaign, "--effects", "thermal_growth")
    where = "Corrected only in rows that state temperature_c"
    assert where in command("activate", job["result"]["version_id"])
    program = ("export", job["result"]["version_id"], "--format", "corrector", "-o", tmp_path / "arm.bin")
    assert "Not corrected by this file: thermal_growth." in command(*program)
    assert any(where in note for note in command.json(*program)["notes"])
    path.write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg\n0,20,30,10,5\n")
    said = ("correct", robot, path, "-o", tmp_path / "out.csv")
    assert command.json(*said)["not_corrected"] == ["thermal_growth"]  # no thermometer: KILTER_TEMPERATURE_C is unset
    first = command(*said)
    assert "not corrected is what thermal_growth does" in first
    assert where in first
    assert where not in command(*said)  # once in a session of work


def _columns(path: Path) -> list[tuple[str, ...]]:
    return list(zip(*csv.reader(path.read_text().splitlines()), strict=True))


def _jobs(robot: str, job: str, campaign: str, command: Command) -> None:
    assert job in [known["id"] for known in command.json("jobs", "list", "--robot", robot)["jobs"]]
    name = command.json("jobs", "show", job)["name"]
    assert name == f"identification of {robot} 1"
    assert name in command("jobs", "list", "--robot", robot)
    assert "succeeded" in command("jobs", "show", name)
    assert command.json("jobs", "list", "--state", "failed", "--robot", robot)["jobs"] == []
    queued = command.json("identify", robot, "-c", campaign, "--no-wait", "--level", "1")
    assert queued["state"] in ("queued", "running")
    assert command.json("jobs", "watch", queued["id"])["state"] == "succeeded"
    assert command.json("jobs", "cancel", queued["id"], code=1)["code"] == "job_finished"


def test_upload_twice_changes_nothing(robot: str, command: Command, write_campaign: Write) -> None:
    path = write_campaign()
    first = command.json("upload", robot, path)
    again = command.json("upload", robot, path)
    assert again["campaign_id"] == first["campaign_id"]
    assert again["new"] is False
    assert "there already" in command("upload", robot, path)
    assert command.json("upload", robot, path, "--campaign", first["campaign_id"])["total_rows"] == first["rows"]


def test_a_refused_upload_leaves_no_campaign_behind(robot: str, command: Command, write_campaign: Write) -> None:
    path = write_campaign()
    good = path.read_text()
    path.write_text(good.replace("x_mm", "x"))
    problem = command.json("upload", robot, path, code=1)
    assert problem["code"] == "observations_invalid"
    assert "--map columns.toml" in problem["detail"]
    path.write_text(good)
    command.json("upload", robot, path)
    assert len(command.json("campaigns", robot)["campaigns"]) == 1


def test_a_refused_row_is_named_in_the_persons_own_file(robot: str, command: Command, tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text("# made today\nA;B;C;D;E;x\n0;0;0;0;0;0\n0;0;0;0;0;1\n400;0;0;0;0;0\n")
    joints = "\n".join(f'q{i}_deg = {{ from = "{name}", unit = "deg" }}' for i, name in enumerate("ABCDE", 1))
    (tmp_path / "map.toml").write_text(
        f'[file]\ndelimiter = ";"\nskip_rows = 1\n[columns]\n{joints}\nx_mm = {{ from = "x", unit = "mm" }}\n'
        'y_mm = { value = 0 }\nz_mm = { value = 0 }\n[rows]\nkeep = [{ column = "x", max = 0.5 }]\n'
    )
    arguments = ("upload", robot, tmp_path / "lab.csv", "--map", tmp_path / "map.toml")
    problem = command.json(*arguments, code=1)
    assert "Row 2, column 'q1_deg'" in problem["detail"]
    assert f"line 5 of {tmp_path / 'lab.csv'}" in problem["detail"]
    assert (problem["context"]["row"], problem["context"]["line"]) == (2, 5)
    assert "Error: Row 2" in command(*arguments, code=1)


def test_dry_run_sends_nothing(no_settings: None, command: Command, tmp_path: Path) -> None:
    (tmp_path / "lab.csv").write_text("a\n90\n")
    (tmp_path / "map.toml").write_text('[columns]\nq1_rad = { from = "a", unit = "deg" }\n')
    arguments = ("upload", "nobody", tmp_path / "lab.csv", "--map", tmp_path / "map.toml", "--dry-run")
    assert command.json(*arguments)["rows"] == 1
    assert "q1_rad from 'a' [deg]" in command(*arguments)


def test_a_failed_job_exits_1_with_its_problem(robot: str, command: Command, write_campaign: Write) -> None:
    done = command.json("upload", robot, write_campaign(4))
    problem = command.json("identify", robot, "-c", done["campaign_id"], code=1)
    assert problem["code"] == "too_few_poses"
    assert problem["context"]["state"] == "failed"
    assert "Error: 4 distinct poses" in command("identify", robot, "-c", done["campaign_id"], code=1)
    assert "too_few_poses" in command("jobs", "show", problem["context"]["job_id"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("identify", "ROBOT"),
        ("identify arm", "at least one --campaign"),
        ("identify arm -c a --validation 1.5", "between 0 and 1"),
        ("identify arm -c a --validation folds:1", "folds:K"),
        ("identify arm -c a --validation 0.3,b", "not a mixture"),
        ("identify arm -c a --level 4", "--level"),
        ("identify arm -c a --base loose", "--base"),
        ("identify arm -c a --option seed", "NAME=VALUE"),
        ("identify arm -c a --effects {", "is not a JSON object"),
        ("identify arm -c a --colour red", "--colour"),
        ("robot add", "either a FILE or --preset"),
        ("robot add --preset ur10 --tip-link t", "belong to a .urdf"),
        ("upload arm nowhere.csv", "nowhere.csv"),
        ("correct arm nowhere.csv", "nowhere.csv"),
        ("dance", "dance"),
    ],
)
def test_wrong_usage_exits_2(no_settings: None, command: Command, arguments: str, words: str) -> None:
    assert words in command(*arguments.split(), code=2)
    problem = command.json(*arguments.split(), code=2)
    assert problem["code"] == "usage"
    assert words in problem["detail"]


def test_no_server_exits_1(no_settings: None, command: Command) -> None:
    assert command.json("robot", "list", code=1)["code"] == "server_unreachable"
    assert "kilterd serve" in command("robot", "list", code=1)


def test_options_reach_the_server_as_they_are_written(robot: str, command: Command, write_campaign: Write) -> None:
    done = command.json("upload", robot, write_campaign())
    job = command.json(
        "identify", robot, "-c", done["campaign_id"], "-v", "folds:5", "--method", "least_squares", "--level", 3,
        "--effects", "axial_compliance,backlash_load", "--effect", '{"id": "clearance_tilt"}', "--free", "theta_*",
        "--fix", "theta_offset_1", "--base", "fixed", "--tool", "free", "--loss", "huber", "--noise-mm", "0.01",
        "--seed", 7, "--option", 'limits={"max_joint_deg": 2}', "--no-wait",
    )  # fmt: skip
    assert job["validation"] == {"folds": 5}
    assert job["options"] == {
        "method": "least_squares",
        "level": 3,
        "effects": ["axial_compliance", "backlash_load", {"id": "clearance_tilt"}],
        "free": ["theta_*"],
        "fix": ["theta_offset_1"],
        "base": "fixed",
        "tool": "free",
        "loss": "huber",
        "noise_mm": 0.01,
        "seed": 7,
        "limits": {"max_joint_deg": 2},
    }
    command("jobs", "cancel", job["id"])


def test_status(server: Path, command: Command, kilter: Kilter) -> None:
    assert command.json("status")["url"] == kilter.url
    assert "ready" in command("status")


def test_the_installed_command(server: Path) -> None:
    program = Path(sys.executable).with_name("kilter")
    done = subprocess.run([program, "status", "--json"], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout)["status"] == "ready"
    wrong = subprocess.run([program, "dance"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
