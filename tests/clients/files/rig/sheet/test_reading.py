"""Drawn sheets as scanners and cameras see them, read against what was drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from paper import Along, Pencil, View, drawn, drift, save, seen, wobble
from PIL import Image

from kilter_client.cli import run
from kilter_files.rig.sheet.layout import Sheet, sheet_for
from kilter_files.rig.sheet.reading import Options, SheetReading, read_sheet

Paper = tuple[NDArray[np.float64], float]

TARGET_MM = 0.1

QUICK = {
    "photo-jpeg": View(dpi=290, tilt_deg=(15, -10), turn_deg=20, shadow=0.5, noise=0.02, jpeg=70),
    "upside-down-grey": View(turn_deg=180, grey=True, blur_px=1.5),
    "bent-by-a-lens": View(tilt_deg=(4, 3), lens=0.02, skew=0.005),
}
GRID = {
    f"{name}-{dpi}": View(dpi=dpi, **view)  # type: ignore[arg-type]
    for dpi in (200, 300, 600)
    for name, view in {
        "flat": {},
        "tilt15": {"tilt_deg": (15, -10), "turn_deg": 20},
        "tilt30": {"tilt_deg": (30, 10), "turn_deg": 90},
        "lens": {"tilt_deg": (5, -3), "lens": 0.02},
        "barrel": {"tilt_deg": (5, -3), "lens": -0.03},
        "blur": {"blur_px": 2.5},
        "shadow": {"shadow": 0.6},
        "noise": {"noise": 0.06},
        "jpeg30": {"jpeg": 30},
        "grey-skew": {"grey": True, "skew": 0.01, "turn_deg": 3},
        "all": {"tilt_deg": (12, 8), "turn_deg": 10, "lens": 0.015, "shadow": 0.5, "noise": 0.03, "jpeg": 60},
    }.items()
}
PENCILS = {
    "red": Pencil(colour=(0.8, 0.1, 0.1)),
    "blue": Pencil(colour=(0.1, 0.2, 0.8)),
    "pale": Pencil(colour=(0.4, 0.4, 0.4), dark=0.25),
    "thin": Pencil(width_mm=0.25),
    "thick": Pencil(width_mm=0.9, grain=0.5),
}


def errors(reading: SheetReading, out: Along = wobble, along: Along | None = drift) -> tuple[float, float]:
    """Rms errors of the reading out of the circle and along it."""
    turn = np.radians(reading.angle_deg)
    parts = [reading.out_mm - out(turn)]
    if along is not None:
        assert reading.along_mm is not None
        parts.append(reading.along_mm - along(turn))
    return float(np.sqrt(np.nanmean(parts[0] ** 2))), float(np.sqrt(np.nanmean(parts[-1] ** 2)))


@pytest.mark.parametrize("name", QUICK)
def test_line_and_strokes_are_found(name: str, paper: Paper, tmp_path: Path) -> None:
    view = QUICK[name]
    reading = read_sheet(save(seen(*paper, view), tmp_path / ("a.jpg" if view.jpeg else "a.png")))
    assert max(errors(reading)) < 0.04
    assert np.all(np.abs(reading.out_mm - wobble(np.radians(reading.angle_deg))) < 5 * reading.out_sigma_mm)
    assert (abs(reading.placing["lens"]) > 0.01) == (view.lens != 0)
    assert reading.warnings == []


def test_a_line_on_top_of_the_print(tmp_path: Path) -> None:
    def near(turn: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(0.08 * np.cos(3 * np.asarray(turn)))

    paper = drawn(sheet_for(25), near, None, Pencil(colour=(0.1, 0.2, 0.8)))
    reading = read_sheet(save(seen(*paper, View(grey=True)), tmp_path / "a.png"))
    assert errors(reading, near, None)[0] < 0.03
    assert reading.along_mm is None
    assert any("no strokes" in note for note in reading.notes)


def test_quarter_targets_alone_and_a_pdf(sheet: Sheet, paper: Paper, scan: Image.Image, tmp_path: Path) -> None:
    pixels = np.asarray(scan).copy()
    middle, scale = np.array(pixels.shape[1::-1]) / 2, View().dpi / 25.4
    for x, y in sheet.markers().values():
        low = np.maximum(middle + np.array([x, -y]) * scale - 100, 0).astype(int)
        pixels[low[1] : low[1] + 200, low[0] : low[0] + 200] = 250
    cut = Image.fromarray(pixels)
    cut.save(tmp_path / "a.pdf", resolution=View().dpi)
    reading = read_sheet(tmp_path / "a.pdf", Options(radius_mm=25))
    assert reading.placing["by"] == "quarter targets"
    assert max(errors(reading)) < 0.05


def test_a_print_that_shrank_is_measured_by_its_bars(sheet: Sheet, scan: Image.Image, tmp_path: Path) -> None:
    """A scanner that says 3 % less dpi than there are stands for a print at 103 %."""
    path = save(scan, tmp_path / "a.png", dpi=View().dpi / 1.03)
    plain = read_sheet(path)
    assert any("printed at 103" in warning for warning in plain.warnings)
    measured = read_sheet(path, Options(bars_mm=(sheet.bar_mm * 1.03, sheet.bar_mm * 1.03)))
    assert measured.warnings == []
    grown = measured.out_mm - plain.out_mm
    assert grown == pytest.approx(0.03 * (25 + plain.out_mm), abs=1e-6)


def test_command_shows_tabulates_and_draws(
    scan: Image.Image, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(save(scan, tmp_path / "a.png", dpi=View().dpi))
    out, plot = tmp_path / "e.csv", tmp_path / "e.svg"
    assert run(["sheet-read", path, "-o", str(out), "--plot", str(plot)]) == 0
    assert "seen in 20 of 20 gaps" in capsys.readouterr().out
    assert len(out.read_text().splitlines()) == 21
    assert "<svg" in plot.read_text()
    assert run(["sheet-read", path, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["rows"][5]["angle_deg"] == 90
    assert document["line"]["rms_mm"] == pytest.approx(
        float(np.sqrt(np.mean(wobble(np.arange(20) * np.pi / 10) ** 2))), abs=0.02
    )
    assert run(["sheet-read", path, "--bars-mm", "a"]) == 2
    assert run(["sheet-read", path, "--plot", "e.gif"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize("name", GRID)
def test_grid_of_views(name: str, tmp_path_factory: pytest.TempPathFactory, record_property: object) -> None:
    sheet = sheet_for(60)
    cached = tmp_path_factory.getbasetemp() / "grid-paper.npy"
    if not cached.exists():
        np.save(cached, drawn(sheet, dpi=600)[0])
    paper = np.load(cached)
    reading = read_sheet(save(seen(paper, 600 / 25.4, GRID[name]), tmp_path_factory.mktemp(name) / "a.png"))
    out, along = errors(reading)
    scaled = (reading.out_mm - wobble(np.radians(reading.angle_deg))) / reading.out_sigma_mm
    print(f"{name}: out {out:.4f} mm, along {along:.4f} mm, in sigmas {np.sqrt(np.mean(scaled**2)):.2f}")
    assert max(out, along) < TARGET_MM / 2
    assert 0.3 < np.sqrt(np.mean(scaled**2)) < 2.5


@pytest.mark.slow
def test_paper_that_is_not_flat(tmp_path: Path) -> None:
    """A ridge of half a millimetre under a camera half a metre away; the stated sigma must grow with it."""
    paper = drawn(sheet_for(60), dpi=400)
    found = {}
    for bulge in (0.0, 0.5, 1.0):
        view = View(dpi=300, tilt_deg=(10, 5), bulge_mm=bulge)
        reading = read_sheet(save(seen(*paper, view), tmp_path / "a.png"))
        found[bulge] = (*errors(reading), float(np.mean(reading.out_sigma_mm)))
    print(found)
    assert max(found[0.5][:2]) < TARGET_MM / 2
    assert max(found[1.0][:2]) < TARGET_MM
    assert found[1.0][2] > 1.5 * found[0.0][2]


@pytest.mark.slow
@pytest.mark.parametrize("name", PENCILS)
def test_pencils(name: str, tmp_path: Path) -> None:
    paper = drawn(sheet_for(25), pencil=PENCILS[name], dpi=600)
    reading = read_sheet(save(seen(*paper, View(dpi=300, jpeg=80, tilt_deg=(5, 5))), tmp_path / "a.png"))
    print(f"{name}: {errors(reading)}")
    assert max(errors(reading)) < TARGET_MM / 2
