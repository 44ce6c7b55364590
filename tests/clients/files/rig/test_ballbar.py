"""Ball bar logs in the shapes labs have them, against numbers worked out here; and ones that are wrong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kilter_client.cli import run
from kilter_client.errors import FileError
from kilter_files import prepare
from kilter_files.formats.instrument_logs import circle_fit_by_run, read_ballbar

ANGLES = np.arange(0.0, 361.0, 2.0)


def deviation(angle: np.ndarray, backlash: float = 0.0) -> np.ndarray:  # type: ignore[type-arg]
    """um: a centre off by (40, -20), an oval of 6 peak to peak."""
    t = np.radians(angle)
    return 5 + 40 * np.cos(t) - 20 * np.sin(t) + 3 * np.cos(2 * t) + backlash


def two_runs(end: str = "\n") -> str:
    head = ["Ballbar test", "Machine: rig", "Nominal radius (mm): 100.0000", "Feed rate: 1000 mm/min", ""]
    body = []
    for name, angles, gap in (("Run 1 (CCW)", ANGLES, 1.0), ("Run 2 (CW)", ANGLES[::-1], -1.0)):
        body += [name, "Angle (deg)\tDeviation (um)"]
        body += [f"{a:.1f}\t{d:.2f}" for a, d in zip(angles, deviation(angles, gap), strict=True)] + [""]
    return end.join(head + body)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_two_runs_under_titles(end: str, tmp_path: Path) -> None:
    path = tmp_path / "bar.txt"
    path.write_bytes(two_runs(end).encode())
    found = read_ballbar(path)
    assert (found.nominal_mm, len(found.radius_mm)) == (100.0, 2 * len(ANGLES))
    first, second = circle_fit_by_run(found)
    assert [first["direction"], second["direction"]] == ["ccw", "cw"]
    assert first["centre_mm"] == pytest.approx([0.040, -0.020], abs=2e-4)
    assert first["circularity_mm"] == pytest.approx(0.006, abs=2e-4)
    assert first["mean_radius_mm"] - second["mean_radius_mm"] == pytest.approx(0.002, abs=1e-5)
    assert found.line[0] == 8


def test_radius_with_decimal_commas_and_a_bar_that_turns_back(tmp_path: Path) -> None:
    path = tmp_path / "bar.csv"
    angles = np.concatenate([ANGLES, ANGLES[::-1]])
    rows = [f"{a:.1f};{150 + d / 1000:.4f}".replace(".", ",") for a, d in zip(angles, deviation(angles), strict=True)]
    path.write_text("\n".join(["Winkel_deg;Radius_mm", *rows]), encoding="latin-1")
    found = read_ballbar(path)
    assert [r["direction"] for r in circle_fit_by_run(found)] == ["ccw", "cw"]
    assert found.radius_mm == pytest.approx(150 + deviation(angles) / 1000, abs=1e-4)
    assert "the median" in found.notes[0]


def test_inspect_and_upload(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bar.txt"
    path.write_text(two_runs())
    assert run(["inspect", str(path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["kind"], document["rows"], len(document["runs"])) == ("ballbar", 362, 2)
    with pytest.raises(FileError, match=r"no joints.*kilter measure sheet-join"):
        prepare(path, "ballbar")
    rows = [f"{a},{100 + deviation(a) / 1000:.5f},{a / 10},5" for a in ANGLES]
    path.write_text("\n".join(["angle_deg,radius_mm,q1_deg,q2_deg", *rows]))
    prepared = prepare(path, "ballbar")
    table = np.genfromtxt(prepared.content.decode().splitlines(), delimiter=",", names=True)
    assert table["bar_mm"] == pytest.approx(100 + deviation(ANGLES) / 1000, abs=1e-5)
    assert set(table["bar_id"]) == {1}
    assert (table["q1_deg"][10], table["q2_deg"][10]) == (2.0, 5.0)
    assert any("runs about one centre mount" in text for text in prepared.notes)


def test_an_inclinometer_makes_no_campaign(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="kilter measure joint-parameters"):
        prepare(tmp_path / "tilt.csv", "inclinometer")


GOOD = [f"{a},100.0" for a in ANGLES]


@pytest.mark.parametrize(
    ("head", "rows", "message"),
    [
        ("angle_deg,radius", GOOD, r"column 'radius': is in no stated unit"),
        ("angle,radius_mm", [f"{np.radians(a):.5f},100" for a in ANGLES], "are these radians"),
        ("angle_deg,deviation_um", GOOD, "without the nominal radius"),
        ("angle_deg,radius_mm", [*GOOD[:9], "18,0.1", *GOOD[10:]], r"line 11, column 'radius': a radius of 0.1 mm"),
        ("angle_deg,radius_mm", [*GOOD[:9], "18,abc", *GOOD[10:]], r"line 11: '18,abc' is not a row of 2 numbers"),
        ("angle_deg,radius_mm", GOOD[:4], "has 4 readings"),
        ("angle_deg,temperature_c", GOOD, "no angle and radius among"),
        ("Nominal radius (mm): 0\nangle_deg,deviation_um", GOOD, "nominal radius.*cannot be"),
        ("angle_deg,radius_mm,q1_x", [f"{row},1" for row in GOOD], "no angle|q1"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(head: str, rows: list[str], message: str, tmp_path: Path) -> None:
    path = tmp_path / "bar.csv"
    path.write_text("\n".join([head, *rows]))
    if "q1_x" in head:
        assert read_ballbar(path).joints == {}
        return
    with pytest.raises(FileError, match=message):
        read_ballbar(path)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    at=st.integers(0, 4000),
    junk=st.one_of(
        st.binary(max_size=40), st.sampled_from([b"1e999", b"nan", b"\n" * 30, b"\t" * 40, b"\0", b"9" * 400])
    ),
    cut=st.integers(0, 6000),
)
def test_damaged_logs_are_refused_or_read_never_worse(tmp_path: Path, at: int, junk: bytes, cut: int) -> None:
    text = two_runs().encode()
    path = tmp_path / "bar.txt"
    path.write_bytes((text[:at] + junk + text[at + len(junk) :])[: max(1, len(text) - cut)])
    try:
        found = read_ballbar(path)
    except FileError as error:
        said = str(error)
    else:
        said = str(found.path)
        assert np.isfinite(found.radius_mm).all()
        json.dumps(circle_fit_by_run(found), allow_nan=False)
    assert str(path) in said


def test_a_run_of_one_reading_has_no_circle(tmp_path: Path) -> None:
    path = tmp_path / "bar.txt"
    text = two_runs().encode()
    path.write_bytes(text[: len(text) - 2160])
    found = read_ballbar(path)
    assert np.bincount(found.run)[-1] == 1
    assert len(circle_fit_by_run(found)) == len(np.unique(found.run)) - 1


def test_joined_with_a_joint_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bar, log, rows = tmp_path / "bar.txt", tmp_path / "joints.csv", tmp_path / "rows.csv"
    angles = ANGLES[:-1]
    bar.write_text("\n".join(["angle_deg,radius_mm", *(f"{a},{100 + deviation(a) / 1000:.5f}" for a in angles)]))
    t = np.radians(angles)
    body = [f"{a},{100 * c:.5f},{100 * s:.5f},0" for a, c, s in zip(angles / 4, np.cos(t), np.sin(t), strict=True)]
    log.write_text("\n".join(["q1_deg,x_mm,y_mm,z_mm", *body]))
    command = ["sheet-join", str(bar), str(log), "-o", str(rows), "--radius-mm", "100"]
    assert run(command) == 1
    assert "--take-command 1" in capsys.readouterr().err
    assert run([*command, "--take-command", "0.5", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["rows"] == len(angles)
    table = np.genfromtxt(rows, delimiter=",", names=True)
    assert np.hypot(table["x_mm"], table["y_mm"]) == pytest.approx(100 + deviation(angles) / 1000, abs=2e-5)
    assert (table["sx_mm"][0], table["sy_mm"][0], table["sz_mm"][0]) == pytest.approx((0.005, 0.5, 0.5))
