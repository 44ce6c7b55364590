"""The printed sheet: true mm in both formats, seen through other programs than the one that draws it."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pypdfium2
import pytest
from scipy.ndimage import center_of_mass, label

from kilter_client.cli import run
from kilter_client.errors import UsageError
from kilter_files.rig.printed import page_pdf, page_svg
from kilter_files.rig.sheet.layout import PAGES_MM, Sheet, largest_radius, save_sheet, sheet_for, sheet_page

SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize(("radius", "page"), [(15.0, "a4"), (80.0, "a4"), (100.0, "a3"), (60.5, "letter")])
def test_marks_of_the_pdf_are_where_the_layout_says(radius: float, page: str) -> None:
    sheet = sheet_for(radius, None if page in ("a4", "a3") else "letter")
    assert sheet.page == page
    dpi = 150
    document = pypdfium2.PdfDocument(page_pdf(sheet_page(sheet)))
    assert document[0].get_size() == pytest.approx(np.array(PAGES_MM[page]) * 72 / 25.4, abs=1e-3)
    grey = document[0].render(scale=dpi / 72, grayscale=True).to_numpy().squeeze()
    document.close()
    labels, count = label(grey < 128)
    middle = np.array(grey.shape) / 2 - 0.5
    centres = (np.array(center_of_mass(grey < 300, labels, range(1, count + 1))) - middle) * 25.4 / dpi
    found = np.stack([centres[:, 1], -centres[:, 0]], axis=1)
    for target in sheet.targets():
        assert np.linalg.norm(found - target, axis=1).min() < 0.1
    height, width = grey.shape
    inside = grey[: round(5 * dpi / 25.4)], grey[-round(5 * dpi / 25.4) :], grey[:, : round(4.8 * dpi / 25.4)]
    assert all((margin > 250).all() for margin in inside), (width, height)


def test_svg_is_in_mm() -> None:
    sheet = sheet_for(80)
    root = ET.fromstring(page_svg(sheet_page(sheet)))
    assert (root.get("width"), root.get("viewBox")) == ("210mm", "0 0 210 297")
    discs = {(float(c.get("cx", "")), -float(c.get("cy", ""))) for c in root.iter(f"{SVG}circle")}
    assert discs == set(sheet.targets())
    dashes = [line.get("points", "") for line in root.iter(f"{SVG}polyline") if line.get("stroke") == "#59bfe0"]
    assert len(dashes) == sheet.dashes == 68
    points = np.array([[float(v) for v in pair.split(",")] for pair in " ".join(dashes).split()])
    assert np.hypot(*points.T) == pytest.approx(80, abs=1e-3)
    longest = max((line.get("points", "").split() for line in root.iter(f"{SVG}polyline")), key=_length)
    assert _length(longest) == pytest.approx(90)
    assert sheet.bar_mm == 90


def _length(points: list[str]) -> float:
    ends = np.array([[float(v) for v in pair.split(",")] for pair in (points[0], points[-1])])
    return float(np.hypot(*(ends[1] - ends[0])))


def test_the_same_sheet_gives_the_same_bytes() -> None:
    assert page_pdf(sheet_page(Sheet(30))) == page_pdf(sheet_page(Sheet(30)))


def test_quarter_points_are_free_of_print() -> None:
    for radius in np.arange(15, 130.5, 0.5):
        sheet = sheet_for(float(radius))
        assert sheet.dashes % 4 == 0
        assert sheet.radius_mm <= largest_radius(sheet.page)
        assert np.hypot(*np.array(list(sheet.markers().values())).T).min() - 7 * np.sqrt(2) > radius


@pytest.mark.parametrize("radius", [14.5, 30.2, 131.0, -5.0, float("inf"), float("nan")])
def test_radii_that_fit_no_page_are_refused(radius: float) -> None:
    with pytest.raises(UsageError, match="radius-mm"):
        sheet_for(radius)


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sheet", "--radius-mm", "40", "-o", str(tmp_path / "s.pdf")]) == 0
    assert "Print it at 100 %" in capsys.readouterr().out
    assert run(["sheet", "--radius-mm", "40", "-o", str(tmp_path / "s.docx")]) == 2
    assert run(["sheet", "--radius-mm", "400", "-o", str(tmp_path / "s.pdf")]) == 2
    assert run(["sheet", "--radius-mm", "40", "-o", str(tmp_path / "none" / "s.svg")]) == 1
    assert "cannot be written" in capsys.readouterr().err


def test_bars_can_be_read_off_the_picture_of_the_manual() -> None:
    """The picture in the documentation is the sheet itself."""
    picture = Path(__file__).resolve().parents[5] / "docs/images/pencil-sheet.svg"
    assert picture.read_text() == page_svg(sheet_page(sheet_for(80)))


def test_save_sheet_returns_its_size(tmp_path: Path) -> None:
    assert save_sheet(Sheet(30), tmp_path / "a.svg") == (tmp_path / "a.svg").stat().st_size
