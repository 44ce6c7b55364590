"""`kilter correct`: whose axes the removed error is along, and how a path of which nothing could be corrected ends."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.errors import ConflictError

from .three_joint_arm import LENGTHS_MM, Floats, arm, tip_mm

Capture = pytest.CaptureFixture[str]
Write = Callable[..., Path]
HEAD = "q1_deg,q2_deg,q3_deg"
OFF_DEG = np.array([0.1, 0, 0])


def aside(name: str) -> dict[str, object]:
    """The arm, whose base stands a metre aside and is turned by 90 degrees about z."""
    return arm(name) | {"base": {"x_mm": 1000, "y_mm": 0, "z_mm": 0, "rx_deg": 0, "ry_deg": 0, "rz_deg": 90}}


def test_the_error_is_along_the_axes_of_the_robots_base(kilter: Kilter, tmp_path: Path, capsys: Capture) -> None:
    kilter.robots.add(aside("aside"))
    rng = np.random.default_rng(3)
    q = rng.uniform((-90, 0, -80), (90, 70, 80), (40, 3))
    own = tip_mm(q + OFF_DEG)
    seen = np.stack([1000 - own[:, 1], own[:, 0], own[:, 2]], axis=1) + rng.normal(0, 0.001, own.shape)
    (tmp_path / "measured.csv").write_text(table(f"{HEAD},x_mm,y_mm,z_mm", np.hstack([q, seen])))
    assert run(["upload", "aside", str(tmp_path / "measured.csv"), "--name", "monday"]) == 0
    fit = ["identify", "aside", "-c", "monday", "--level", "1", "--tool", "fixed"]
    assert run([*fit, "--base", "fixed"]) == 0
    assert run(["activate", "latest", "--robot", "aside", "--force"]) == 0
    path = np.array([[0.0, 30.0, 40.0], [50.0, 20.0, -30.0]])
    (tmp_path / "path.csv").write_text(table(HEAD, path))
    capsys.readouterr()
    assert run(["correct", "aside", str(tmp_path / "path.csv"), "-o", str(tmp_path / "out.csv")]) == 0
    assert "dx_mm, dy_mm, dz_mm are along the axes of the robot's base frame." in capsys.readouterr().err
    rows = list(csv.DictReader((tmp_path / "out.csv").read_text().splitlines()))
    removed = np.array([[float(row[f"d{axis}_mm"]) for axis in "xyz"] for row in rows])
    np.testing.assert_allclose(removed, tip_mm(path + OFF_DEG) - tip_mm(path), atol=0.01)
    assert np.abs(removed).max() > 0.5  # along y of the base, which is -x of the measurements
    assert run([*fit, "--fix", "theta_offset_1", "--reference", "registration"]) == 0
    assert run(["activate", "latest", "--robot", "aside", "--force"]) == 0
    assert run(["correct", "aside", str(tmp_path / "path.csv"), "-o", str(tmp_path / "out.csv")]) == 0
    assert "along the axes of the base frame as the registration found it." in capsys.readouterr().err


def table(head: str, rows: Floats) -> str:
    return "\n".join([head, *(",".join(f"{value:.9g}" for value in row) for row in rows), ""])


@pytest.mark.parametrize("ending", ["csv", "parquet", "json"])
def test_a_path_of_which_nothing_is_corrected_exits_1(
    robot: str, kilter: Kilter, write_campaign: Write, tmp_path: Path, capsys: Capture, ending: str
) -> None:
    campaign = kilter.campaigns.add(robot, "monday")["id"]
    kilter.campaigns.upload(campaign, write_campaign(30))
    job = kilter.jobs.run("identify", robot, [campaign], options={"level": 1})
    kilter.versions.activate(job["result"]["version_id"], force=True)
    columns = {f"q{k}_deg": [0.0, 999.0, 999.0] for k in range(1, 6)}
    bad, mixed = {name: values[1:] for name, values in columns.items()}, columns
    for rows, code, refused in ((bad, 1, 2), (mixed, 0, 2)):
        path = tmp_path / f"path-{code}.{ending}"
        if ending == "csv":
            path.write_text(table(",".join(rows), np.array(list(rows.values())).T))
        elif ending == "json":
            path.write_text(json.dumps(rows))
        else:
            parquet.write_table(pa.table(rows), path)
        capsys.readouterr()
        given = ["correct", robot, str(path), "-o", str(tmp_path / f"out.{ending}")]
        assert run(given) == code
        assert ("no row could be corrected" in capsys.readouterr().err) == bool(code)
        assert run([*given, "--json"]) == code
        printed = capsys.readouterr()
        assert printed.err == ""
        assert json.loads(printed.out)["status"].get("JOINT_LIMIT") == refused


def test_what_a_correction_leaves_is_said_and_strict_cares(kilter: Kilter, tmp_path: Path, capsys: Capture) -> None:
    """With the elbow stretched an upper arm that is 0.5 mm too short cannot be corrected: every surface says what is left."""
    kilter.robots.add(aside("short"))
    shorter = (LENGTHS_MM[0], LENGTHS_MM[1] - 0.5, LENGTHS_MM[2])
    rng = np.random.default_rng(4)
    q = rng.uniform((-90, 0, -80), (90, 70, 80), (60, 3))
    own = tip_mm(q, shorter)
    seen = np.stack([1000 - own[:, 1], own[:, 0], own[:, 2]], axis=1) + rng.normal(0, 0.001, own.shape)
    (tmp_path / "measured.csv").write_text(table(f"{HEAD},x_mm,y_mm,z_mm", np.hstack([q, seen])))
    assert run(["upload", "short", str(tmp_path / "measured.csv"), "--name", "monday"]) == 0
    assert run(["identify", "short", "-c", "monday", "--level", "2", "--base", "fixed", "--tool", "fixed"]) == 0
    path = np.array([[10.0, 30.0, 40.0], [10.0, 30.0, 0.0], [50.0, 20.0, -30.0]])
    (tmp_path / "path.csv").write_text(table(HEAD, path))
    out = tmp_path / "out.csv"
    given = ["correct", "short", str(tmp_path / "path.csv"), "-o", str(out), "--version", "latest"]
    capsys.readouterr()
    assert run(given) == 0  # nothing is active: it is corrected with the version that is named
    rows = list(csv.DictReader(out.read_text().splitlines()))
    there = np.array([[float(row[f"q{j}_deg"]) for j in (1, 2, 3)] for row in rows])
    left = np.linalg.norm(tip_mm(there, shorter) - tip_mm(path), axis=1)
    assert left[1] == pytest.approx(0.5, abs=0.05)
    np.testing.assert_allclose([float(row["left_mm"]) for row in rows], left, atol=0.01)
    along = np.array([[float(row[f"left_{axis}_mm"]) for axis in "xyz"] for row in rows])
    np.testing.assert_allclose(along, tip_mm(there, shorter) - tip_mm(path), atol=0.01)
    half = np.array([[float(row[f"u95_{axis}_mm"]) for axis in "xyz"] for row in rows])
    assert (np.abs(along) <= half).all()  # the interval is of where the tool is after this correction
    assert [row["status"] for row in rows] == ["OK", "DAMPED", "OK"]
    assert {"DAMPED", "RESIDUAL"} & set(rows[1]["flags"].split("|"))
    assert rows[0]["flags"] == ""
    assert "1 of 3 rows is damped, at worst 0.5 mm are left (row 2)." in capsys.readouterr().err
    assert run(["version", "latest", "--robot", "short", "--details"]) == 0
    said = capsys.readouterr().out
    assert re.search(
        r"Needs at most [\d.]+ deg and 0\.[45]\d* mm at 99 % of 500 poses .*; limits [\d.]+ deg and 5 mm\.", said
    )
    assert "damped" in said
    wide = ["--option", 'limits={"max_joint_deg": 7.5}']
    assert run(["identify", "short", "-c", "monday", "--level", "2", "--base", "fixed", "--tool", "fixed", *wide]) == 0
    stored = kilter.versions.get("latest", robot="short")
    assert stored["limits"] == {"max_joint_deg": 7.5, "max_position_mm": 5.0, "at_limit": "saturate", "held_joints": []}
    assert stored["details"]["workspace"]["sentence"].endswith("limits 7.5 deg and 5 mm, as asked for.")
    counts = stored["details"]["workspace"]
    assert counts["ok"] + counts["damped"] + counts["limited"] + sum(counts["refused"].values()) == 500
    assert run([*given, "--hold", "2"]) == 0
    held = list(csv.DictReader(out.read_text().splitlines()))
    np.testing.assert_allclose([float(row["q2_deg"]) for row in held], path[:, 1], atol=1e-12)
    assert float(held[0]["left_mm"]) > 0.05 > float(rows[0]["left_mm"])  # two joints do not place a tip
    assert run([*given, "--hold", "4"]) == 1
    assert "joint 4 is to be held, of 3" in capsys.readouterr().err
    out.unlink()
    assert run([*given, "--strict"]) == 1
    said = capsys.readouterr().err
    assert "1 of 3 rows are not corrected to within what is stated (DAMPED 1)" in said
    assert "row 2" in said
    assert not out.exists()
    with pytest.raises(ConflictError) as refused:
        kilter.correct("short", tmp_path / "path.csv", version="latest", strict=True)
    assert refused.value.code == "rows_not_reached"
    assert kilter.correct("short", tmp_path / "path.csv", version="latest", task="position").status == {
        "OK": 2,
        "DAMPED": 1,
    }
    (tmp_path / "timed.csv").write_text(
        table(f"t_s,{HEAD}", np.hstack([np.linspace(0, 0.1, 11)[:, None], np.linspace(path[0], path[1], 11)]))
    )
    text = kilter.correct("short", tmp_path / "timed.csv", version="latest", form="ros2-yaml").decode()
    assert text.startswith("# ")
    assert re.match(r"# \d+ of 11 rows are (damped|limited), at worst 0\.5\d* mm are left \(row 11\)", text)
    assert re.search(r"  # (DAMPED|LIMITED): 0\.\d+ mm left\n", text)
    good = tmp_path / "good.csv"
    good.write_text(table(HEAD, path[[0, 2]]))
    assert run(["correct", "short", str(good), "-o", str(out), "--version", "latest", "--strict"]) == 0
