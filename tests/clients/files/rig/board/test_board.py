"""The printed board: found by OpenCV in the PDF as pdfium draws it, where its JSON says, in true mm."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pypdfium2
import pytest

from kilter_client.cli import run
from kilter_files.ground.errors import MissingPackageError
from kilter_files.rig.board_layout import check_release

# pdfium puts edges on whole pixels: a page is drawn finer, and cells of 4 x 4 pixels are averaged.
DPI, FINER = 200, 4
PIXEL_MM = 25.4 / DPI / FINER
BOARDS = {
    "charuco": ["--columns", "7", "--rows", "5", "--square-mm", "25", "--dictionary", "6x6_250"],
    "charuco-even-rows": ["--columns", "5", "--rows", "8", "--square-mm", "21.5", "--marker-mm", "15"],
    "second-board": ["--columns", "9", "--rows", "12", "--square-mm", "20", "--first-id", "100"],
    "apriltag": ["--kind", "apriltag", "--columns", "5", "--rows", "4", "--square-mm", "40", "--marker-mm", "30"],
    "apriltag-letter": ["--kind", "apriltag", "--columns", "3", "--rows", "4", "--square-mm", "50", "--page", "letter"],
}
CV_NAMES = {"6x6_250": "DICT_6X6_250", "5x5_1000": "DICT_5X5_1000", "apriltag_36h11": "DICT_APRILTAG_36h11"}


def drawn(path: Path, page: dict[str, float]) -> tuple[Any, float]:
    """Grey pixels of the only page, and pixels per mm."""
    document = pypdfium2.PdfDocument(path)
    assert len(document) == 1
    size = np.array([page["width_mm"], page["height_mm"]])
    assert document[0].get_size() == pytest.approx(size * 72 / 25.4, abs=1e-3)
    fine = document[0].render(scale=FINER * DPI / 72, grayscale=True).to_numpy().squeeze()
    rows, columns = (n // FINER for n in fine.shape)
    cells = fine[: rows * FINER, : columns * FINER].reshape(rows, FINER, columns, FINER)
    grey = cells.mean(axis=(1, 3)).round().astype(np.uint8)
    document.close()
    return grey, DPI / 25.4


def seen(grey: Any, document: dict[str, Any]) -> dict[int, Any]:
    """Corners by number, with OpenCV's own idea of the board."""
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, CV_NAMES[document["dictionary"]]))
    if document["kind"] == "charuco":
        numbers = np.array([marker["id"] for marker in document["markers"]])
        size = (document["columns"], document["rows"])
        board = cv2.aruco.CharucoBoard(size, document["square_mm"], document["marker_mm"], known, numbers)
        corners, found, _, markers = cv2.aruco.CharucoDetector(board).detectBoard(grey)
        assert sorted(markers.ravel()) == sorted(numbers)
        told = np.array([(*corner.values(),) for corner in document["corners"]])
        assert np.allclose(board.getChessboardCorners()[:, :2], told[:, 1:], atol=1e-4)
        return dict(zip(found.ravel().tolist(), corners.reshape(-1, 2), strict=True))
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    quads, found, _ = cv2.aruco.ArucoDetector(known, parameters).detectMarkers(grey)
    pairs = zip(found.ravel().tolist(), quads, strict=True)
    return {4 * number + k: corner for number, quad in pairs for k, corner in enumerate(quad.reshape(4, 2))}


@pytest.mark.parametrize("name", BOARDS)
def test_all_corners_are_found_where_the_json_says(name: str, tmp_path: Path) -> None:
    path = tmp_path / "board.pdf"
    assert run(["board", *BOARDS[name], "-o", str(path)]) == 0
    document = json.loads(path.with_suffix(".json").read_text())
    page = document["page"]
    grey, px_per_mm = drawn(path, page)
    found = seen(grey, document)
    assert sorted(found) == sorted(corner["id"] for corner in document["corners"])
    mm = np.array([[corner["x_mm"], corner["y_mm"]] for corner in document["corners"]])
    pixels = np.array([found[corner["id"]] for corner in document["corners"]])
    measured = (pixels + 0.5) / px_per_mm - [page["left_mm"], page["top_mm"]]
    off = measured - mm
    print(f"{name}: mean {off.mean(axis=0)} mm, largest {np.abs(off).max():.4f} mm")
    assert np.abs(off.mean(axis=0)).max() < PIXEL_MM / 2
    for k in range(2):
        grown = np.polyfit(mm[:, k], measured[:, k], 1)[0] - 1
        assert abs(grown * np.ptp(mm[:, k])) < PIXEL_MM
    assert np.abs(off).max() < 2 * PIXEL_MM


def test_the_squares_of_the_pdf_are_where_the_json_says(tmp_path: Path) -> None:
    path = tmp_path / "board.pdf"
    assert run(["board", *BOARDS["charuco"], "-o", str(path)]) == 0
    document = json.loads(path.with_suffix(".json").read_text())
    pdf = pypdfium2.PdfDocument(path)
    bounds = np.array([part.get_bounds() for part in pdf[0].get_objects()]) * 25.4 / 72
    pdf.close()
    square = document["square_mm"]
    squares = bounds[np.abs(bounds[:, 2] - bounds[:, 0] - square) < 1e-3]
    assert len(squares) == 7 * 5 - len(document["markers"])
    page = document["page"]
    left = (squares[:, 0] - page["left_mm"]) / square
    top = (page["height_mm"] - page["top_mm"] - squares[:, 3]) / square
    assert np.abs([left - left.round(), top - top.round()]).max() * square < 1e-3
    assert set(zip(left.round().astype(int), top.round().astype(int), strict=True)) <= {
        (column, row) for column in range(7) for row in range(5)
    }


def test_the_rulers_are_as_long_as_stated(tmp_path: Path) -> None:
    path = tmp_path / "board.svg"
    assert run(["board", *BOARDS["charuco"], "-o", str(path)]) == 0
    document = json.loads(path.with_suffix(".json").read_text())
    root = ET.fromstring(path.read_text())
    assert root.get("width") == f"{document['page']['width_mm']:g}mm"
    lines = [line.get("points", "").split() for line in root.iter("{http://www.w3.org/2000/svg}polyline")]
    spans = np.array([np.ptp([[float(v) for v in point.split(",")] for point in line], axis=0) for line in lines])
    assert spans.max(axis=0) == pytest.approx([170, 120])
    assert document["rulers_mm"] == {"across": 170, "upright": 120}
    assert len(root.findall(".//{http://www.w3.org/2000/svg}image")) == 0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["--columns", "2"], "at least 3"),
        (["--square-mm", "nan"], "square-mm"),
        (["--marker-mm", "29"], "marker-mm"),
        (["--dictionary", "9x9_1"], "is none of"),
        (["--dictionary", "4x4_50", "--first-id", "40"], "0 to 49"),
        (["--first-id", "-1"], "first-id"),
        (["--square-mm", "200"], "fits no page"),
        (["--page", "letter", "--square-mm", "40"], "not on letter"),
        (["-o", "board.png"], ".pdf or .svg"),
    ],
)
def test_boards_that_cannot_be_printed(
    wrong: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["board", "--columns", "7", "--rows", "5", "--square-mm", "30", "-o", str(tmp_path / "b.pdf"), *wrong]
    assert run(given) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("version", ["4.11.0", "4.12.0", "4.13.0"])
def test_releases_that_are_half_a_pixel_off_are_refused(version: str) -> None:
    with pytest.raises(MissingPackageError, match="half a pixel"):
        check_release(version)
    check_release("4.14.0")
    check_release("5.0.0-dev")
