"""Pictures that cannot be read, or not yet: each is refused with file, place and remedy, soon and in little memory."""

from __future__ import annotations

import io
import json
import random
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pypdfium2
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from paper import View, drawn, save, seen, wobble
from PIL import Image
from reportlab.pdfgen.canvas import Canvas

from kilter_client.cli import run
from kilter_client.errors import FileError
from kilter_files.rig.printed import page_pdf
from kilter_files.rig.sheet import camera
from kilter_files.rig.sheet.layout import aruco, sheet_for, sheet_page
from kilter_files.rig.sheet.reading import Options, read_sheet

Paper = tuple[NDArray[np.float64], float]
DPI = 160.0
NONE = Options()


def refused(path: Path, message: str, options: Options = NONE) -> None:
    with pytest.raises(FileError, match=message) as caught:
        read_sheet(path, options)
    detail = caught.value.detail
    assert detail.startswith(str(path))
    assert detail.count(".") >= 2, "what is wrong, and what to do"


def png(width: int, height: int, data: bytes = b"") -> bytes:
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", data or zlib.compress(bytes(1000))) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("empty.png", b"", "is not a PNG, JPEG or PDF"),
        ("text.png", b"angle,radius\n1,2\n", "is not a PNG, JPEG or PDF"),
        ("claims.png", png(100_000, 100_000), "more pixels|100000 x 100000 pixels"),
        ("claims2.png", png(2_000_000_000, 2), "more pixels|pixels"),
        ("long.png", png(40_000, 100), "40000 x 100 pixels"),
        ("short.png", png(4000, 4000), "damaged or cut off"),
        ("none.pdf", b"%PDF-1.4\n1 0 obj<</Type/Catalog/Pages 2 0 R>>endobj\n"
         b"2 0 obj<</Type/Pages/Kids[]/Count 0>>endobj\ntrailer<</Root 1 0 R>>\n%%EOF", "has no pages|not a readable PDF"),
        ("rubbish.pdf", b"%PDF-1.7\n" + bytes(range(256)) * 8, "is not a readable PDF"),
    ],
)  # fmt: skip
def test_files_that_are_no_pictures(name: str, content: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    refused(path, message)


def test_pdfs_of_other_pages(tmp_path: Path) -> None:
    path = tmp_path / "a.pdf"
    path.write_bytes(page_pdf(sheet_page(sheet_for(15))))
    refused(path, "page 3: has 1 pages. Choose a page from 1 to 1", Options(page=3))
    refused(path, "no drawn line within 4.4 mm")
    huge = Canvas(str(path), pagesize=(20_000, 14_000))
    huge.showPage()
    huge.save()
    refused(path, r"page 1: states a page of 7056 x 4939 mm")
    locked = Canvas(str(path), encrypt="secret")
    locked.drawString(10, 10, "x")
    locked.showPage()
    locked.save()
    refused(path, "not a readable PDF.*password")


def test_a_scan_that_is_cut_off(scan: Image.Image, tmp_path: Path) -> None:
    for ending in ("png", "jpg"):
        whole = save(scan, tmp_path / f"whole.{ending}").read_bytes()
        path = tmp_path / f"cut.{ending}"
        path.write_bytes(whole[: len(whole) // 2])
        refused(path, "damaged or cut off")


def test_pictures_without_a_sheet(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (900, 700, 3), dtype=np.uint8)
    refused(save(Image.fromarray(noise), tmp_path / "noise.png"), "no fiducials: in 700 x 900 pixels")
    refused(save(Image.new("RGB", (900, 700), "white"), tmp_path / "white.png"), "no fiducials")
    refused(save(Image.new("L", (3, 2)), tmp_path / "tiny.png"), "no fiducials")


def foreign() -> Image.Image:
    cv2, dictionary = aruco()
    page = np.full((1200, 900), 255, dtype=np.uint8)
    for k, (x, y) in enumerate(((100, 100), (650, 120), (120, 900), (640, 880))):
        page[y : y + 140, x : x + 140] = cv2.aruco.generateImageMarker(dictionary, k, 140)
    return Image.fromarray(page)


def test_markers_of_another_sheet(tmp_path: Path) -> None:
    refused(save(foreign(), tmp_path / "a.png"), "the marker below the circle.*--radius-mm")
    # These markers are mirrored against the sheet's order, so they are no view of one.
    with pytest.raises(FileError):
        read_sheet(tmp_path / "a.png", Options(radius_mm=30))


LINES: dict[str, tuple[dict[str, object], str]] = {
    "part": ({"turns": (0.0, 4.5)}, r"the line is missing from \d+ to \d+ deg.*--allow-gaps"),
    "two": ({"more": (lambda t: 1.7 + 0 * t,)}, "two lines run beside each other, first at"),
    "blank": ({"turns": (0.0, 0.01), "along": None}, "no drawn line within 4.4 mm"),
}
MORE_LINES: dict[str, tuple[dict[str, object], str]] = {
    "crossing": ({"more": (lambda t: -2 * wobble(t),)}, "two lines run beside each other"),
    "away": ({"out": lambda t: 3.2 + 0.7 * np.cos(t)}, "more than 3.5 mm from the circle at"),
}


@pytest.mark.parametrize("name", [*LINES, *(pytest.param(name, marks=pytest.mark.slow) for name in MORE_LINES)])
def test_lines_that_are_no_circle(name: str, tmp_path: Path) -> None:
    how, message = (LINES | MORE_LINES)[name]
    paper = drawn(sheet_for(15), dpi=200, **how)  # type: ignore[arg-type]
    path = save(seen(*paper, View(dpi=DPI)), tmp_path / f"{name}.png")
    refused(path, message)
    if name == "part":
        assert np.isnan(read_sheet(path, Options(allow_gaps=True)).out_mm).sum() >= 3


VIEWS: dict[str, tuple[View, Options, str]] = {
    "mirrored": (View(dpi=130, mirrored=True), Options(), "is mirrored"),
    "small": (View(dpi=70), Options(), "has 70 dpi.*At least 120"),
    "other": (View(dpi=130), Options(radius_mm=40), "is the sheet of radius 25 mm, not 40 mm"),
    "bars": (View(dpi=130), Options(bars_mm=(9.0, 30.0)), "bars of 9 and 30 mm are not the sheet's 30 mm"),
}


@pytest.mark.parametrize("name", VIEWS)
def test_views_that_are_refused(name: str, paper: Paper, tmp_path: Path) -> None:
    view, options, message = VIEWS[name]
    refused(save(seen(*paper, view), tmp_path / f"{name}.png"), message, options)


def test_a_cut_and_a_folded_sheet(paper: Paper, tmp_path: Path) -> None:
    scan = seen(*paper, View(dpi=DPI))
    width, height = scan.size
    cut = scan.crop((0, 0, int(width * 0.72), height))
    with pytest.raises(FileError, match=r"no fiducials|leaves the picture|radius"):
        read_sheet(save(cut, tmp_path / "cut.png"))
    pixels = np.asarray(scan).copy()
    third = pixels[: height // 3]
    pixels[: height // 3] = np.roll(third, 22, axis=1)  # a fold moved the upper third 3.4 mm aside
    refused(save(Image.fromarray(pixels), tmp_path / "fold.png"), "mm from its printed position")


def test_command_says_it_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = save(Image.new("RGB", (400, 300), "white"), tmp_path / "white.png")
    assert run(["sheet-read", str(path), "--json"]) == 1
    problem = json.loads(capsys.readouterr().out)
    assert problem["code"] == "file_invalid"
    assert problem["context"]["file"] == str(path)


def small(form: str) -> bytes:
    """A blank sheet of radius 15 at 30 dpi."""
    out = io.BytesIO()
    if form == "PDF":
        return page_pdf(sheet_page(sheet_for(15)))
    document = pypdfium2.PdfDocument(page_pdf(sheet_page(sheet_for(15))))
    image = document[0].render(scale=30 / 72).to_pil()
    document.close()
    image.save(out, form)
    return out.getvalue()


@pytest.mark.parametrize("form", ["PNG", "JPEG", "PDF"])
def test_damaged_pictures_are_refused_or_read_never_worse(
    form: str, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera, "PDF_DPI", 40.0)
    whole = small(form)
    folder = tmp_path_factory.mktemp("fuzz")
    read: Callable[[Path], object] = read_sheet

    @settings(
        max_examples=15 if form == "PDF" else 40, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(seed=st.integers(0, 1 << 30), edits=st.integers(1, 12), cut=st.integers(0, 5))
    def attempt(seed: int, edits: int, cut: int) -> None:
        rng = random.Random(seed)
        content = bytearray(whole)
        for _ in range(edits):
            at = rng.randrange(min(len(content), 200) if rng.random() < 0.5 else len(content))
            content[at] = rng.randrange(256)
        if cut == 0:
            del content[rng.randrange(len(content)) :]
        path = folder / f"a.{form.lower()}"
        path.write_bytes(bytes(content))
        with pytest.raises(FileError) as caught:  # a sheet nobody drew on is never read
            read(path)
        assert str(path) in str(caught.value)

    attempt()


@pytest.mark.parametrize(("module", "package"), [("cv2", "OpenCV"), ("PIL", "Pillow"), ("reportlab", "reportlab")])
def test_a_package_that_is_not_installed_is_named(
    module: str, package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = save(Image.new("RGB", (40, 30), "white"), tmp_path / "white.png")
    for name in {module, *(name for name in sys.modules if name.partition(".")[0] == module)}:
        monkeypatch.setitem(sys.modules, name, None)
    command = (
        ["sheet", "--radius-mm", "30", "-o", str(tmp_path / "a.pdf")]
        if module == "reportlab"
        else ["sheet-read", str(path)]
    )
    assert run(command) == 1
    said = capsys.readouterr().err
    assert package in said
    assert f"pip install {package.lower().replace('opencv', 'opencv-python-headless')}" in said.lower()
