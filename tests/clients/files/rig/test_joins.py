"""Ball bar and inclinometer logs joined with the joint log through the command, on arms that share no code with core."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_client import Kilter
from kilter_client.cli import run
from tests.clients.files.simulated import stops
from tests.core.campaigns import held, table_errors
from tests.core.truth import ur10

Floats = NDArray[np.float64]

START = np.array([0.2, -1.2, 1.6, -1.9, -1.2, 0.3])
RADIUS_MM = 100.0


def told(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> Any:
    assert run([*map(str, words), "--json"]) == code, capsys.readouterr().out
    return json.loads(capsys.readouterr().out)


class BarTest:
    """Two ways round about one foot: up to it, counterclockwise, back clockwise; the bar reads what the true arm does."""

    def __init__(
        self, folder: Path, radius_mm: float = RADIUS_MM, centre: tuple[float, ...] = (0.5, -0.3, 0.3)
    ) -> None:
        rng, arm = np.random.default_rng(3), ur10()
        self.document = arm.document()
        offsets = {s.name: 4e-3 * rng.normal() for s in arm.steps if s.name and s.joint is not None}
        actual = arm.moved(table_errors(arm, rng, 1e-5, 5e-5) | offsets)
        turn = np.radians(np.concatenate([np.arange(0.0, 361.0, 1.5), np.arange(360.0, -1.0, -1.5)]))
        self.middle = np.array(centre)
        round_it = self.middle + radius_mm / 1e3 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
        way_in = np.linspace(self.middle + np.array([0.03, 0.02, 0.12]), round_it[0], 40)[:-1]
        self.commanded, q, here = np.vstack([way_in, round_it]), [], START
        for point in self.commanded:
            here = held(arm, here[None], lambda p, point=point: (p - point, np.eye(3)))[0]
            q.append(here)
        self.q, self.actual, self.arm = np.array(q), actual, arm
        self.foot = actual.poses(self.q[-1:])[0][0] + (self.middle - round_it[-1])
        length = 1e3 * np.linalg.norm(actual.poses(self.q[len(way_in) :])[0] - self.foot, axis=1)
        self.log = folder / f"joints{radius_mm:g}.csv"
        head = [f"q{k + 1}_deg" for k in range(6)] + ["x_mm", "y_mm", "z_mm", "t_s"]
        t = 0.02 * np.arange(len(self.q))
        table = np.column_stack([np.degrees(self.q), 1e3 * self.commanded, t])
        np.savetxt(self.log, table, delimiter=",", header=",".join(head), comments="", fmt="%.9g")
        self.bar = folder / f"bar{radius_mm:g}.txt"
        half, degrees = len(turn) // 2 + 1, np.degrees(turn)
        self.write(self.bar, radius_mm, [(degrees[:half], length[:half]), (degrees[half:], length[half:])])

    @staticmethod
    def write(path: Path, nominal: float, runs: list[tuple[Floats, Floats]]) -> None:
        lines = [f"Nominal radius (mm): {nominal:.4f}", ""]
        noise = np.random.default_rng(1)
        for k, (angle, length) in enumerate(runs, 1):
            use = slice(1, len(angle) - 1, 3)
            half = angle[use]
            read = 1e3 * (length[use] - nominal) + noise.normal(0, 0.5, len(half))
            lines += [f"Run {k}", "Angle (deg)\tDeviation (um)"]
            lines += [f"{a:.3f}\t{d:.3f}" for a, d in zip(half, read, strict=True)] + [""]
        path.write_text("\n".join(lines))


@pytest.fixture(scope="module")
def bars(tmp_path_factory: pytest.TempPathFactory) -> BarTest:
    return BarTest(tmp_path_factory.mktemp("bars"))


def in_parts(rows: Path) -> list[Path]:
    """Two rows of three, and the third: one placement cannot be held out whole, so other rows of it validate."""
    head, *lines = rows.read_text().splitlines()
    parts = [line for k, line in enumerate(lines) if k % 3], lines[::3]
    paths = [rows.with_suffix(f".{k}.csv") for k in range(2)]
    for path, part in zip(paths, parts, strict=True):
        path.write_text("\n".join([head, *part]) + "\n")
    return paths


def test_a_ball_bar_gets_its_joints_from_the_log_and_calibrates(
    bars: BarTest, server: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = BarTest(tmp_path, 150.0, (0.5, -0.3, 0.35))
    ids = []
    with Kilter() as kilter:
        kilter.robots.add(bars.document | {"name": "bar-arm"})
    for k, test in enumerate((bars, other)):
        rows = tmp_path / f"rows{k}.csv"
        found = told(capsys, "ballbar-join", test.bar, test.log, "-o", rows)
        assert (found["runs"], found["feet"]) == (2, 1)
        table = np.genfromtxt(rows, delimiter=",", names=True)
        assert found["rows"] == len(table)
        q = np.radians(np.stack([table[f"q{j + 1}_deg"] for j in range(6)], axis=1))
        # The joints are those at the reading: the true arm's ball is as far from its foot as the bar says.
        far = 1e3 * np.linalg.norm(test.actual.poses(q)[0] - test.foot, axis=1)
        assert np.abs(far - table["bar_mm"]).max() < 0.005
        ids += [
            told(capsys, "upload", "bar-arm", part, "--device", "ballbar")["campaign_id"] for part in in_parts(rows)
        ]
    ask = ["identify", "bar-arm", "--campaign", ids[0], "--level", 1, "--validation", ids[1]]
    result = told(capsys, *ask)["result"]
    assert "bar_length_doubtful" not in [warning["code"] for warning in result["warnings"]]
    metrics = result["metrics"]["validation"]
    assert metrics["identified"]["rms_mm"] < 0.1 * metrics["nominal"]["rms_mm"]
    assert metrics["identified"]["rms_mm"] < 0.003
    # A log with the joints in it has no circle to be compared with: the robot's model notices the length.
    table = (tmp_path / "rows0.csv").read_text().splitlines()
    longer = [",".join([*line.split(",")[:-1], f"{float(line.split(',')[-1]) + 3.0:.6f}"]) for line in table[1:]]
    (tmp_path / "longer.csv").write_text("\n".join([table[0], *longer]) + "\n")
    wrong = told(capsys, "upload", "bar-arm", tmp_path / "longer.csv", "--device", "ballbar")["campaign_id"]
    warnings = told(capsys, "identify", "bar-arm", "--campaign", wrong, "--level", 1)["result"]["warnings"]
    said = next(warning["message"] for warning in warnings if warning["code"] == "bar_length_doubtful")
    assert "bar 1 reads 10" in said
    assert "mm from the ball at its fixed end (0.97" in said


@pytest.mark.parametrize("stated", [101.0, 150.0])
def test_a_bar_of_another_length_than_stated_is_noticed(
    stated: float, bars: BarTest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "bar.txt"
    wrong.write_text(bars.bar.read_text().replace("100.0000", f"{stated:.4f}"))
    for command, more in (("ballbar-join", []), ("sheet-join", ["--take-command", "1"])):
        ask = [command, wrong, bars.log, "-o", tmp_path / "rows.csv", *more]
        if command == "sheet-join":
            centred = np.genfromtxt(bars.log, delimiter=",", names=True)
            for axis, at in zip("xyz", 1e3 * bars.middle, strict=True):
                centred[f"{axis}_mm"] -= at
            ask[2] = tmp_path / "centred.csv"
            head = ",".join(centred.dtype.names or ())
            np.savetxt(ask[2], centred, delimiter=",", header=head, comments="", fmt="%.9g")
        refused = told(capsys, *ask, code=1)["detail"]
        assert f"nominal length is {stated:g} mm" in refused
        assert "radius of 100.000 mm" in refused
        assert "--radius-mm 100." in refused
        told(capsys, *ask, "--radius-mm", 100)


def test_a_bar_that_is_not_of_this_log_is_refused(
    bars: BarTest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = bars.bar.read_text()
    one, turned = tmp_path / "one.txt", tmp_path / "turned.txt"
    one.write_text(text[: text.index("Run 2")])
    refused = told(capsys, "ballbar-join", one, bars.log, "-o", tmp_path / "r.csv", code=1)["detail"]
    assert "has 1 runs (ccw)" in refused
    assert "goes round 2 times (ccw, cw)" in refused
    rows = [line.split("\t") for line in text.splitlines()]
    moved = [
        "\t".join([f"{float(r[0]) - 90:.3f}", r[1]]) if len(r) == 2 and r[0][0].isdigit() else "\t".join(r)
        for r in rows
    ]
    turned.write_text("\n".join(moved))
    ask = ["ballbar-join", turned, bars.log, "-o", tmp_path / "r.csv"]
    refused = told(capsys, *ask, code=1)["detail"]
    assert "--zero-deg 8" in refused or "--zero-deg 9" in refused
    told(capsys, *ask, "--zero-deg", 90)
    right = told(capsys, "ballbar-join", bars.bar, bars.log, "-o", tmp_path / "s.csv")
    assert right["rows"] > 100
    assert (tmp_path / "r.csv").read_text() == (tmp_path / "s.csv").read_text()


class TiltTest:
    """Joint 2 of a UR10 goes through poses; two inclinometers log the links, their clock starts 3.2 s late."""

    def __init__(self, folder: Path, factor: float = 1.0, shoulder: bool = False) -> None:
        rng = np.random.default_rng(5)
        self.poses = np.zeros((14, 6))
        self.poses[:, 1] = rng.uniform(-80, -10, 14)
        self.poses[:, 0] = rng.uniform(-60, 60, 14) if shoulder else 10.0
        self.poses[:, 2:] = [60, -30, 20, 10]
        t = np.arange(0.0, 14 * 4.0, 0.02)
        q = stops(self.poses, 2.5, 1.5, t)
        self.play = lambda angle: 0.05 * np.sin(np.radians(3 * angle))
        self.log = folder / "joints.csv"
        head = ",".join(["t_s", *(f"q{k + 1}_deg" for k in range(6))])
        np.savetxt(self.log, np.column_stack([t, q]), delimiter=",", header=head, comments="", fmt="%.6f")
        late = np.arange(0.0, 14 * 4.0 - 6.0, 0.01)
        here = stops(self.poses, 2.5, 1.5, late + 3.2)[:, 1]
        level = 0.4 + 0.002 * np.sin(late)
        true = 7.0 - (here + self.play(here)) + level
        self.after, self.before = folder / "after.csv", folder / "before.csv"
        for path, tilt in ((self.after, true), (self.before, level)):
            read = factor * (tilt + rng.normal(0, 5e-4, len(late)))
            np.savetxt(
                path,
                np.column_stack([late, read]),
                delimiter=",",
                header="time [s],tilt [deg]",
                comments="",
                fmt="%.6f",
            )


@pytest.fixture
def lifter(server: Path) -> str:
    with Kilter() as kilter:
        if "lifter" not in [robot["name"] for robot in kilter.robots.list()]:
            kilter.robots.add(ur10().document() | {"name": "lifter"})
        return str(kilter.robots.get("lifter")["joints"][1]["name"])


def test_inclinometers_become_readings(lifter: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    test = TiltTest(tmp_path)
    out = tmp_path / "readings.csv"
    found = told(capsys, "tilt-join", "lifter", test.after, test.log, "--joint", lifter, "-o", out)
    assert found["rows"] >= 11
    assert found["clock"]["offset_s"] == pytest.approx(3.2, abs=0.02)
    from kilter_files.rig.tilt_join import read_readings

    readings = read_readings(out)
    assert {(r["joint"], r["axis"]) for r in readings} == {(lifter, "z")}
    q = np.array([r["q_deg"][1] for r in readings])
    extra = np.array([r["reading_deg"] for r in readings])
    wanted = test.play(q)
    assert np.abs((extra - extra.mean()) - (wanted - wanted.mean())).max() < 0.004
    load = ("--payload-kg", 2, "--payload-com-mm", "0,-10,60")
    told(capsys, "tilt-join", "lifter", test.after, test.log, "--joint", lifter, "-o", out, *load)
    assert {(r["payload_kg"], *r["payload_com_mm"]) for r in read_readings(out)} == {(2.0, 0.0, -10.0, 60.0)}
    ask = ["joint-parameters", "lifter", "--readings", out]
    assert run([*map(str, ask), "--json"]) in (0, 1)
    capsys.readouterr()


@pytest.mark.parametrize(("unit", "factor"), [("mrad", 1000 * np.pi / 180), ("rad", np.pi / 180), ("arcmin", 60.0)])
def test_angles_in_another_unit_are_named_with_the_option_that_mends_it(
    unit: str, factor: float, lifter: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    test = TiltTest(tmp_path, factor)
    ask = ["tilt-join", "lifter", test.after, test.log, "--joint", lifter, "-o", tmp_path / "r.csv"]
    refused = told(capsys, *ask, code=1)["detail"]
    assert f"--unit {unit}" in refused or (unit != "rad" and "--unit mrad" in refused)
    found = told(capsys, *ask, "--unit", unit)
    assert found["rows"] >= 11


def test_a_joint_before_it_needs_the_other_inclinometer(
    lifter: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    test = TiltTest(tmp_path, shoulder=True)
    ask = ["tilt-join", "lifter", test.after, test.log, "--joint", lifter, "--by", "time", "-o", tmp_path / "r.csv"]
    assert "--before" in told(capsys, *ask, code=1)["detail"]
