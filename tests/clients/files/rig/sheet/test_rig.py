"""The low-cost rig from end to end: a simulated Katana draws, its sheet is scanned, heights come as TDMS, and it calibrates."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, TdmsWriter
from numpy.typing import NDArray
from paper import View, drawn, save, seen

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.errors import FileError
from kilter_core.evaluate import evaluate
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model.general_inverse import reach
from kilter_core.observations import Observations
from kilter_core.twin import thesis_katana
from kilter_files.rig.drawn_circle import (
    Circle,
    Frame,
    Heights,
    JoinOptions,
    join,
    read_calibration,
    read_heights,
    register,
)
from kilter_files.rig.sheet.layout import sheet_for
from kilter_files.tables.table import JointLog

Floats = NDArray[np.float64]

CENTRE, RATE_HZ, DWELL_S = np.array([0.0, -300.0, 140.0]), 500.0, 0.2
NORMAL = np.array([0.0, -1.0, 1.0]) / np.sqrt(2)
PLANE = np.stack([[1.0, 0, 0], np.cross(NORMAL, [1.0, 0, 0]), NORMAL], axis=1)  # thesis 5.5.1: 45 degrees to the table
START = np.radians([-24.4, -15.6, 74.2, 109.0, 13.3])


def ring(radius: float, count: int) -> Floats:
    turn = 2 * np.pi * np.arange(count) / count
    return radius * np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)


def poses(robot: object, points_mm: Floats) -> Floats:
    """Joints that put the nominal tool on the points, one from the other."""
    q = [START]
    for point in points_mm:
        found, there = reach(robot, point[None] * 1e-3, q[-1][None])  # type: ignore[arg-type]
        assert there.all()
        q.append(found[0])
    return np.array(q[1:])


def laid(sheet: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Axes and origin of the sheet that fits the points best."""
    middle = points.mean(axis=0)
    U, _, V = np.linalg.svd(sheet.T @ (points - middle))
    R = V.T @ np.diag([1, 1, np.linalg.det(V.T @ U.T)]) @ U.T
    return R, middle - R @ sheet.mean(axis=0)


class Drawing:
    """What the true arm does on the sheet that lies where its pencil touched the four quarter points."""

    def __init__(self, radius: float, count: int) -> None:
        twin = thesis_katana()
        self.sheet = ring(radius, count)
        self.commanded = CENTRE + self.sheet @ PLANE.T
        self.q = poses(twin.robot, self.commanded)
        true = twin.truth.predict(Observations(q=self.q)).position * 1e3
        self.quarters = np.arange(4) * (count // 4)
        R, t = laid(self.sheet[self.quarters], true[self.quarters])
        self.error = (true - t) @ R - self.sheet
        turn = 2 * np.pi * np.arange(count) / count
        self.turn = turn
        point = self.sheet + self.error
        self.out = np.hypot(point[:, 0], point[:, 1]) - radius
        self.along = ((np.arctan2(point[:, 1], point[:, 0]) - turn + np.pi) % (2 * np.pi) - np.pi) * (radius + self.out)
        self.height = point[:, 2]

    def rows(self, points: Floats) -> str:
        head = ",".join([*(f"q{k}_deg" for k in range(1, 6)), "x_mm", "y_mm", "z_mm", "t_s"])
        t = 1 + DWELL_S * np.arange(len(self.q))
        body = np.column_stack([np.degrees(self.q), points, t])
        return head + "\n" + "\n".join(",".join(f"{v:.6f}" for v in row) for row in body) + "\n"


def write_tdms(path: Path, height: Floats, starts_s: float) -> None:
    """A potentiometer of 5 V over 45 mm, noise 0.5 mV, that stays at each station for the dwell."""
    t = starts_s + np.arange(0, 2 + DWELL_S * len(height), 1 / RATE_HZ)
    station = np.clip(np.round((t - 1) / DWELL_S), 0, len(height) - 1).astype(int)
    volts = (height[station] + 12.0 + 10.0) / 9.0 + np.random.default_rng(3).normal(0, 5e-4, len(t))
    with TdmsWriter(path) as writer:
        channel = ChannelObject("rig", "poti", volts, properties={"wf_increment": 1 / RATE_HZ, "unit_string": "V"})
        writer.write_segment([channel])


def between(turn: Floats, values: Floats) -> object:
    around = np.concatenate([turn, [2 * np.pi]])
    return lambda at: np.interp(np.asarray(at) % (2 * np.pi), around, np.append(values, values[0]))


def test_a_drawing_calibrates(server: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sheet = sheet_for(60)
    drawing, held = Drawing(60, sheet.dashes), Drawing(45, 36)
    paper = drawn(sheet, between(drawing.turn, drawing.out), between(drawing.turn, drawing.along))  # type: ignore[arg-type]
    scan = save(seen(*paper, View(tilt_deg=(3, -2), jpeg=90)), tmp_path / "scan.jpg")
    write_tdms(tmp_path / "rig.tdms", drawing.height, 0.5)
    (tmp_path / "joints.csv").write_text(drawing.rows(drawing.commanded))
    (tmp_path / "points.csv").write_text(
        "x_mm,y_mm,z_mm\n" + "\n".join(",".join(f"{v:.4f}" for v in p) for p in drawing.commanded[drawing.quarters])
    )
    rows = tmp_path / "rows.csv"
    given = ["--points", tmp_path / "points.csv", "--height", tmp_path / "rig.tdms", "--calibration", "0:-10,5:35"]
    given += ["--height-starts-s", "0.5", "-o", rows]
    assert run(["sheet-join", str(scan), str(tmp_path / "joints.csv"), *map(str, given), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["rows"] == sheet.dashes
    assert report["warnings"] == []
    table = np.genfromtxt(rows, delimiter=",", names=True)
    found = np.stack([table[f"{axis}_mm"] for axis in "xyz"], axis=1)
    truth = CENTRE + (drawing.sheet + drawing.error) @ PLANE.T
    assert np.sqrt(np.mean(np.sum((found - truth) ** 2, axis=1))) < 0.05
    with Kilter() as kilter:
        kilter.robots.add({"convention": "preset", "preset": "katana450-chapter5", "name": "pencil-arm"})
    assert run(["upload", "pencil-arm", str(rows), "--device", "pencil", "--json"]) == 0
    train = json.loads(capsys.readouterr().out)["campaign_id"]
    (tmp_path / "held.csv").write_text(held.rows(CENTRE + (held.sheet + held.error) @ PLANE.T))
    assert run(["upload", "pencil-arm", str(tmp_path / "held.csv"), "--role", "validation", "--json"]) == 0
    other = json.loads(capsys.readouterr().out)["campaign_id"]
    command = ["identify", "pencil-arm", "--campaign", train, "--validation", other, "--level", "1", "--json"]
    assert run(command) == 0
    result = json.loads(capsys.readouterr().out)["result"]["metrics"]["validation"]
    print({name: result[name]["mean_mm"] for name in ("nominal", "registration_only", "identified")})
    assert result["identified"]["mean_mm"] < 0.5 * result["nominal"]["mean_mm"]
    assert result["identified"]["mean_mm"] < 0.8 * result["registration_only"]["mean_mm"]


def identified(drawing: Drawing, held: Drawing, taken_mm: float) -> tuple[float, float]:
    """Mean errors in mm on the held drawing, registered and identified, of a bare line with the command along it."""
    bare = Circle(Path("a"), 60.0, drawing.turn, drawing.out, np.full(len(drawing.turn), 0.01), None, None)
    t = np.arange(len(drawing.q), dtype=float)
    columns = {f"{axis}_mm": drawing.commanded[:, k] for k, axis in enumerate("xyz")} | {"q1_deg": t, "t_s": t}
    heights = Heights(Path("h"), t, drawing.height, "heights")
    frame = register(Path("p"), drawing.commanded[drawing.quarters], 60.0)
    table = join(bare, JointLog(Path("j"), ("q1_deg",), columns), heights, frame, JoinOptions(taken_mm=taken_mm)).table
    position, sigma = (np.stack([table.columns[f"{name}{a}_mm"] for a in "xyz"], axis=1) * 1e-3 for name in ("", "s"))
    rows = np.array(table.columns["q1_deg"], dtype=int)
    options = IdentifyOptions(level=1)
    found = identify(thesis_katana().robot, Observations(drawing.q[rows], position, sigma=sigma), None, options)
    truth = (CENTRE + (held.sheet + held.error) @ PLANE.T) * 1e-3
    metrics = evaluate(found.calibration, Observations(held.q, truth), refit=("base",))
    return metrics["registration_only"]["mean_mm"], metrics["identified"]["mean_mm"]


def test_a_bare_line_tells_offsets_if_the_command_along_it_is_taken_as_uncertain() -> None:
    drawing, held = Drawing(60, 52), Drawing(45, 36)
    registered, careful = identified(drawing, held, 1.0)
    trusting = identified(drawing, held, 0.001)[1]
    print(registered, careful, trusting)
    assert careful < 0.8 * registered
    assert careful < 0.8 * trusting


def circle(count: int = 24, along: bool = True) -> Circle:
    turn = 2 * np.pi * np.arange(count) / count
    return Circle(
        Path("scan.png"), 30.0, turn, 0.1 * np.cos(turn), np.full(count, 0.02),
        0.2 * np.sin(turn) if along else None, np.full(count, 0.03) if along else None,
    )  # fmt: skip


def log(points: Floats, name: str = "mm") -> JointLog:
    columns = {f"{axis}_{name}": points[:, k] for k, axis in enumerate("xyz")}
    columns |= {"q1_deg": np.arange(len(points), dtype=float), "t_s": np.arange(len(points), dtype=float)}
    return JointLog(Path("joints.csv"), ("q1_deg",), columns)


def test_sigmas_follow_the_frame() -> None:
    joined = join(circle(), log(ring(30, 24)), None, Frame.sheet_frame(), JoinOptions(taken_mm=1.0))
    sx, sy, sz = (np.array(joined.table.columns[f"s{axis}_mm"]) for axis in "xyz")
    assert (sx[0], sy[0], sz[0]) == pytest.approx((0.02, 0.03, 1.0), abs=1e-6)
    assert (sx[6], sy[6]) == pytest.approx((0.03, 0.02), abs=1e-6)
    assert joined.table.columns["x_mm"][0] == pytest.approx(30.1)


def test_a_turned_sheet_is_found_through_its_points() -> None:
    R, t = PLANE, CENTRE
    points = t + ring(30, 4) @ R.T
    frame = register(Path("points.csv"), points + np.outer([1, 0, -1, 0], [0.1, 0, 0]), 30.0)
    joined = join(circle(), log(t + ring(30, 24) @ R.T), None, frame, JoinOptions(taken_mm=0.5))
    found = np.array([joined.table.columns[f"{axis}_mm"] for axis in "xyz"]).T
    back = (found - t) @ R
    assert np.hypot(back[:, 0], back[:, 1]) == pytest.approx(30 + 0.1 * np.cos(circle().turn), abs=0.01)


def test_what_was_not_measured_is_not_made_up() -> None:
    with pytest.raises(FileError, match="no strokes across the line"):
        join(circle(along=False), log(ring(30, 24)), None, Frame.sheet_frame(), JoinOptions())
    joined = join(circle(along=False), log(ring(30, 24)), None, Frame.sheet_frame(), JoinOptions(taken_mm=1.0))
    assert any("with an uncertainty of 1 mm. Identify joint offsets at most" in text for text in joined.table.warnings)
    with pytest.raises(FileError, match="shows no height"):
        join(circle(), log(ring(30, 24)), None, Frame.sheet_frame(), JoinOptions())


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (ring(30, 24) + np.array([100, 0, 0]), "only 0 places"),
        (ring(30, 24) + np.array([0, 0, 20]), "only 0 places"),
        (ring(20, 24), "only 0 places"),
    ],
)
def test_logs_of_another_path_are_refused(points: Floats, message: str) -> None:
    with pytest.raises(FileError, match=message):
        join(circle(), log(points), None, Frame.sheet_frame(), JoinOptions(taken_mm=1.0))


def test_points_that_are_no_quarters_are_refused(tmp_path: Path) -> None:
    swapped = ring(30, 4)[[0, 2, 1, 3]]
    with pytest.raises(FileError, match=r"points\.csv: point \d is .* off a circle of 30 mm"):
        register(Path("points.csv"), swapped, 30.0)
    with pytest.raises(FileError, match="off a circle"):
        register(Path("points.csv"), ring(30, 4) / 1000, 30.0)


@pytest.mark.parametrize("text", ["", "1:2", "a:b,c:d", "0:1,0:2", "0:0,1:5,2:3", "0:0,1:nan", "0:1:2,3:4"])
def test_calibrations_that_are_none_are_refused(text: str) -> None:
    with pytest.raises(FileError, match="calibration"):
        read_calibration(text)


def test_heights_of_text_and_what_is_wrong_with_them(tmp_path: Path) -> None:
    path = tmp_path / "h.csv"
    path.write_text("t_s,poti_v\n" + "\n".join(f"{k / 100},{k / 100}" for k in range(100)))
    with pytest.raises(FileError, match=r"not in mm.*calibration"):
        read_heights(path)
    with pytest.raises(FileError, match="V, is far outside the calibration"):
        read_heights(path, "poti_v", read_calibration("0:0,0.001:10"))
    found = read_heights(path, "poti_v", read_calibration("0:-10,5:35"))
    mean, scatter = found.around(np.array([0.5, 3.0]), 0.1)
    assert mean[0] == pytest.approx(-5.5, abs=1e-6)
    assert scatter[0] == pytest.approx(9 * 0.0316, rel=0.1)
    assert np.isnan(mean[1])
    with pytest.raises(FileError, match=r"no channel 'pot_v'.*did you mean 'poti_v'"):
        read_heights(path, "pot_v")
    path.write_text("t_s,h_mm\n0,1\n1,2\n1,3\n2,4\n")
    with pytest.raises(FileError, match="stops at value 3"):
        read_heights(path)
    path.write_text("a_mm,h_mm\n0,1\n1,2\n1,3\n2,4\n")
    with pytest.raises(FileError, match="no time among"):
        read_heights(path)


@settings(max_examples=60, deadline=None, database=None, suppress_health_check=list(HealthCheck))
@given(at=st.integers(0, 900), junk=st.binary(max_size=12), cut=st.integers(0, 900))
def test_damaged_heights_are_refused_or_read_never_worse(tmp_path: Path, at: int, junk: bytes, cut: int) -> None:
    text = b"t_s;poti [V]\n" + b"".join(b"%d,25;1,%d\n" % (k, k) for k in range(80))
    path = tmp_path / "h.csv"
    path.write_bytes((text[:at] + junk + text[at + len(junk) :])[: max(1, len(text) - cut)])
    try:
        found = read_heights(path, None, read_calibration("0:-10,5:35"))
    except FileError as error:
        said = str(error)
    else:
        said = str(found.path)
        assert np.isfinite(found.mm).all()
        assert np.all(np.diff(found.t_s) > 0)
    assert str(path) in said
