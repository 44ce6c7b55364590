"""Pictures that show no usable board: each has its own code, and the sentence says what was seen."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import ImageFile

from kilter_files.ground.errors import FileError
from kilter_files.rig.see.pictures import REMEDIES, Refusal, RefusedError, read_grey
from kilter_files.rig.see.run import Looker, why_not
from kilter_files.rig.see.target import Target, read_target
from kilter_files.rig.see.views import Finder, Markers, View
from tests.clients.files.rig.see.boards import CHARUCO, EVEN, TAGS, board, legacy_page, saved, small, taken
from tests.clients.files.rig.see.raycaster import picture

REPOSITORY = Path(__file__).resolve().parents[5]


def target_of(*options: str) -> Target:
    return read_target(board(options)[0])


def refusal(grey: Any, *options: str) -> Refusal:
    found = Looker([target_of(*options)]).boards(grey, "picture.png")
    assert len(found) == 1
    assert isinstance(found[0], Refusal)
    return found[0]


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (("--columns", "5", "--rows", "7", *CHARUCO[4:]), "columns_rows_swapped", "7 x 5 squares, columns first"),
        ((*CHARUCO[:-1], "4x4_250"), "dictionary_differs", "markers of 6x6_50 are seen"),
        ((*CHARUCO[:-1], "5x5_1000"), "dictionary_differs", "and board has 5x5_1000"),
        ((*CHARUCO, "--first-id", "100"), "markers_unknown", "markers 0 to 16 are seen, and board has 100 to 116"),
        (TAGS, "dictionary_differs", "apriltag_36h11"),
    ],
)
def test_another_board_than_was_printed(options: tuple[str, ...], code: str, said: str) -> None:
    found = refusal(taken(CHARUCO, small()), *options)
    assert found.code == code
    assert said in found.sentence()
    assert REMEDIES[code] in found.sentence()


@pytest.mark.parametrize(
    ("printed", "size", "code", "said"),
    [
        (TAGS, ("4", "5"), "columns_rows_swapped", "it is a board of 5 x 4 squares, columns first"),
        (TAGS, ("6", "4"), "board_size_differs", "5 columns with at least 4 rows, not 6 x 4"),
        (CHARUCO, ("8", "5"), "board_size_differs", "7 columns with at least 5 rows, not 8 x 5"),
        (CHARUCO, ("6", "5"), "board_size_differs", "7 columns with at least 5 rows, not 6 x 5"),
        (EVEN, ("9", "6"), "board_size_differs", "7 columns with at least 6 rows, not 9 x 6"),
    ],
)
def test_another_number_of_columns(printed: tuple[str, ...], size: tuple[str, str], code: str, said: str) -> None:
    """Tags are all found then, at places that are wrong."""
    at = printed.index("--columns")
    other = (*printed[: at + 1], size[0], "--rows", size[1], *printed[at + 4 :])
    shot = small(centre_mm=(0.0, 0.0, 360.0))
    assert isinstance(Looker([target_of(*printed)]).boards(taken(printed, shot), "p")[0], View)
    found = refusal(taken(printed, shot), *other)
    assert (found.code, said in found.what) == (code, True), found.sentence()


def test_another_dictionary_is_looked_for_first_where_it_was_seen_before() -> None:
    """Twenty pictures of a board with another dictionary took as many searches of all dictionaries."""
    looked: list[str] = []

    class Counted(Finder):
        def markers(self, grey: Any, name: str, *args: Any, **how: Any) -> Markers:
            looked.append(name)
            return super().markers(grey, name, *args, **how)

    finder, grey, target = Counted(), taken(CHARUCO, small()), read_target(board(EVEN)[0])
    for most in (2, 1):
        looked.clear()
        told = why_not(finder, grey, Markers([], np.zeros((0, 4, 2))), target, "a.png")
        assert (told.code, "6x6" in told.what) == ("dictionary_differs", True)
        assert len(looked) <= most


def test_corners_on_one_line_are_no_view() -> None:
    """They say nothing of how the board is tilted; they once ended in an error of NumPy's."""
    grey = taken(CHARUCO, small(rotation_deg=(0.0, 0.0, 0.0))).copy()
    left = 241 - 560 / 330 * 25 * 7 / 2  # of the board, by the lens of the picture
    grey[:, int(left + 560 / 330 * 25 * 1.9) :] = 90
    found = refusal(grey, *CHARUCO)
    assert found.code == "too_few_corners"
    assert "4 on one line" in found.what


def test_columns_and_rows_swapped_is_found_when_corners_would_be_too() -> None:
    looker = Looker([target_of(*CHARUCO)])
    assert isinstance(looker.boards(taken(CHARUCO, small()), "p")[0], View)


def test_the_legacy_pattern_is_named_both_ways() -> None:
    document = board(EVEN)[1]
    grey = picture(legacy_page(document), document, small(centre_mm=(0.0, 0.0, 360.0)))
    found = refusal(grey, *EVEN)
    assert found.code == "legacy_pattern"
    assert "legacy_pattern true" in found.what
    plain = target_of(*EVEN)
    legacy = Target(plain.name, plain.faces, True, plain.numbers, plain.corners_mm)
    assert isinstance(Looker([legacy]).boards(grey, "p")[0], View)
    [other] = Looker([legacy]).boards(taken(EVEN, small(centre_mm=(0.0, 0.0, 360.0))), "p")
    assert isinstance(other, Refusal)
    assert other.code == "legacy_pattern"
    assert "legacy_pattern false" in other.what


@pytest.mark.parametrize("options", [CHARUCO, TAGS], ids=["charuco", "apriltag"])
def test_a_mirrored_print(options: tuple[str, ...]) -> None:
    found = refusal(taken(options, small(), mirrored=True), *options)
    assert found.code == "print_mirrored"


@pytest.mark.parametrize("motion", [(26.0, 0.0), (0.0, 26.0)])
def test_motion_blur(motion: tuple[float, float]) -> None:
    found = refusal(taken(CHARUCO, small(motion_px=motion)), *CHARUCO)
    assert found.code == "picture_blurred"


def test_motion_blur_that_markers_survive() -> None:
    found = refusal(taken(CHARUCO, small(motion_px=(9.0, 0.0), centre_mm=(0.0, 0.0, 190.0))), *CHARUCO)
    assert found.code == "picture_blurred"
    assert "edges of board are blurred over" in found.what


def test_two_boards_with_the_same_numbers() -> None:
    shot = small(centre_mm=(0.0, 0.0, 400.0))
    grey = np.hstack([taken(CHARUCO, shot), taken(CHARUCO, shot)])
    found = refusal(grey, *CHARUCO)
    assert found.code == "board_twice"


def test_no_board_and_too_little_of_one() -> None:
    grey = np.random.default_rng(1).integers(90, 110, (360, 480)).astype(np.uint8)
    assert refusal(grey, *CHARUCO).code == "board_not_found"
    part = taken(CHARUCO, small(centre_mm=(-166.0, -95.0, 330.0)))
    found = refusal(part, *CHARUCO)
    assert found.code == "too_few_corners"


def test_a_board_hidden_in_part_is_a_view_of_what_is_seen() -> None:
    grey = taken(CHARUCO, small(centre_mm=(-90.0, 0.0, 330.0)))
    [view] = Looker([target_of(*CHARUCO)]).boards(grey, "p")
    assert isinstance(view, View)
    assert 4 <= len(view.places) < 24
    assert set(view.places) < set(range(24))


def png(width: int, height: int, data: bytes) -> bytes:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(data, 9)) + chunk(b"IEND", b"")


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (png(60_000, 60_000, b"\0" * 1000), "picture_too_large"),
        (png(8_001, 8_000, b"\0" * 100_000), "picture_too_large"),
        (png(2_000, 2_000, b"\0" * 1000), "picture_unreadable"),  # a header that lies
        (png(8, 8, b"\0" * 72), "picture_unreadable"),
        (b"BM" + struct.pack("<IHHIIiiHHIIiiII", 70, 0, 0, 54, 40, 2_000_000, 2_000_000, 1, 24, 0, 0, 0, 0, 0, 0),
         "picture_too_large"),
        (b"P5 999999999 999999999 255\n", "picture_too_large"),
        (b"%PDF-1.4", "picture_unreadable"),
        (b"", "picture_unreadable"),
    ],
)  # fmt: skip
def test_bombs_and_headers_that_lie(content: bytes, code: str, tmp_path: Path) -> None:
    import tracemalloc

    path = tmp_path / "picture.png"
    path.write_bytes(content)
    tracemalloc.start()
    with pytest.raises(RefusedError) as refused:
        read_grey(path)
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()
    assert refused.value.refusal.code == code
    assert str(path) in refused.value.refusal.sentence()


@pytest.mark.parametrize("lenient", [False, True], ids=["alone", "beside a library that reads cut pictures"])
def test_a_picture_that_is_cut_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lenient: bool) -> None:
    monkeypatch.setattr("PIL.ImageFile.LOAD_TRUNCATED_IMAGES", lenient)
    folder = saved(tmp_path, cut=taken(CHARUCO, small()))
    path = folder / "cut.png"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RefusedError) as refused:
        read_grey(path)
    assert refused.value.refusal.code == "picture_unreadable"
    assert ImageFile.LOAD_TRUNCATED_IMAGES is lenient


def test_a_picture_of_another_size_than_the_camera(tmp_path: Path) -> None:
    folder = saved(tmp_path, one=taken(CHARUCO, small()))
    with pytest.raises(RefusedError) as refused:
        read_grey(folder / "one.png", (640, 480))
    assert refused.value.refusal.code == "picture_other_camera"
    assert "480 x 360 pixels, and the camera 640 x 480" in str(refused.value)


def test_pixels_are_the_sensors_whatever_the_metadata_say(tmp_path: Path) -> None:
    from PIL import Image

    grey = taken(CHARUCO, small())
    exif = Image.Exif()
    exif[0x0112] = 6
    Image.fromarray(grey).save(tmp_path / "rotated.png", exif=exif)
    assert (read_grey(tmp_path / "rotated.png") == grey).all()


def test_twelve_bits_in_sixteen_are_not_dark(tmp_path: Path) -> None:
    from PIL import Image

    grey = taken(CHARUCO, small())
    Image.fromarray(grey.astype(np.uint16) << 4).save(tmp_path / "deep.png")
    assert (read_grey(tmp_path / "deep.png") == grey).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kind": "chess"}, "neither charuco nor apriltag"),
        ({"columns": 7.5}, "columns is 7.5, not a whole number"),
        ({"square_mm": None}, "square_mm is None"),
        ({"dictionary": "9x9_1"}, "is none of"),
        ({"columns": 9}, "has 24 corners, but 9 x 5 squares"),
        ({"square_mm": 30.0, "marker_mm": 20.0}, "from where squares of 30 mm put it"),
        ({"corners": []}, "its corners are missing"),
        ({"corners": [{"id": 0}]}, "has 1 corners"),
        ({"legacy_pattern": "no"}, "legacy_pattern is neither"),
        ({"columns": 10**6, "rows": 10**6}, "too many"),
    ],
)
def test_descriptions_of_boards_that_cannot_be(change: dict[str, Any], said: str, tmp_path: Path) -> None:
    import json

    path = tmp_path / "board.json"
    path.write_text(json.dumps(board(CHARUCO)[1] | change))
    with pytest.raises(FileError, match=said):
        read_target(path)


def test_every_code_is_explained_in_the_how_to() -> None:
    page = (REPOSITORY / "docs/how-to/measure-with-a-camera.md").read_text()
    assert [code for code in REMEDIES if f"`{code}`" not in page] == []
