"""Where everything on a board is, in mm: origin at the outer corner of its upper left square, x right, y down.

z so points into the board, as in OpenCV. A ChArUco board is a chessboard whose upper left square is black, with a
marker in every white square; its corners are those between four squares. An AprilTag board has a tag in the middle of
every square; its corners are those of the tags' black borders.

OpenCV, of a release whose corners are where they should be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from kilter_files.ground.errors import MissingPackageError, UsageError
from kilter_files.ground.later import need
from kilter_files.rig.printed import PAPER_MM

Kind = Literal["charuco", "apriltag"]
Point = tuple[float, float]

DICTIONARIES: dict[str, tuple[int, int]] = {
    **{f"{n}x{n}_{count}": (n, count) for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "apriltag_16h5": (4, 30),
    "apriltag_25h9": (5, 35),
    "apriltag_36h10": (6, 2320),
    "apriltag_36h11": (6, 587),
}  # bits along a side, and how many markers there are
USUAL = {"charuco": "5x5_1000", "apriltag": "apriltag_36h11"}
AROUND_MM = 18.0  # for rulers, words and the printer's margin
LARGEST_MARKER = 0.9  # of a square; nearer ones touch the corners that are to be found


@dataclass(frozen=True)
class Board:
    """A board of ``columns`` x ``rows`` squares; its first marker has the number ``first_id``."""

    kind: Kind
    columns: int
    rows: int
    square_mm: float
    marker_mm: float
    dictionary: str
    first_id: int = 0

    @property
    def size_mm(self) -> Point:
        """Width and height of all squares."""
        return self.columns * self.square_mm, self.rows * self.square_mm

    @property
    def cells(self) -> int:
        """Cells along the side of a marker, its black border included."""
        return DICTIONARIES[self.dictionary][0] + 2

    def black_squares(self) -> list[Point]:
        """Upper left corners of the black squares; an AprilTag board has none."""
        if self.kind == "apriltag":
            return []
        return [self._square(column, row) for column, row in self._squares() if (column + row) % 2 == 0]

    def markers(self) -> dict[int, tuple[Point, ...]]:
        """Corners of every marker by its number, clockwise from its upper left."""
        wanted = [(c, r) for c, r in self._squares() if self.kind == "apriltag" or (c + r) % 2 == 1]
        edge, side = (self.square_mm - self.marker_mm) / 2, self.marker_mm
        found: dict[int, tuple[Point, ...]] = {}
        for number, place in enumerate(wanted, self.first_id):
            x, y = (value + edge for value in self._square(*place))
            found[number] = ((x, y), (x + side, y), (x + side, y + side), (x, y + side))
        return found

    def corners(self) -> dict[int, Point]:
        """Corners to be found, by number: row by row on a ChArUco board, four times the tag's number plus 0 to 3."""
        if self.kind == "apriltag":
            return {4 * number + k: corner for number, four in self.markers().items() for k, corner in enumerate(four)}
        inner = [(column, row) for row in range(1, self.rows) for column in range(1, self.columns)]
        return {number: self._square(*place) for number, place in enumerate(inner)}

    def first_corner(self, face: int) -> int:
        """Return what is added to the numbers of a face's corners on a cube; those of tags are apart already."""
        return 0 if self.kind == "apriltag" else face * len(self.corners())

    def to_document(self) -> dict[str, Any]:
        """Return the board as its JSON file holds it."""
        return {
            "kind": self.kind,
            "dictionary": self.dictionary,
            "columns": self.columns,
            "rows": self.rows,
            "square_mm": self.square_mm,
            "marker_mm": self.marker_mm,
            "first_id": self.first_id,
            "legacy_pattern": False,
            "frame": "origin at the outer corner of the upper left square, x right, y down, z into the board; mm",
            "pixels": "the centre of the upper left pixel is (0, 0)",
            "markers": [
                {"id": number, "corners_mm": [_rounded_point(corner) for corner in four]}
                for number, four in self.markers().items()
            ],
            "corners": [
                {"id": number, "x_mm": round(x, 6), "y_mm": round(y, 6)} for number, (x, y) in self.corners().items()
            ],
        }

    def _squares(self) -> list[tuple[int, int]]:
        return [(column, row) for row in range(self.rows) for column in range(self.columns)]

    def _square(self, column: int, row: int) -> Point:
        return column * self.square_mm, row * self.square_mm


def _rounded_point(point: Point) -> list[float]:
    return [round(value, 6) for value in point]


def marker_family(name: str) -> str:
    """Return the pattern of a dictionary's markers: one of 250 begins with the 50 of the smaller one."""
    return name if name.startswith("apriltag") else name.partition("_")[0]


def check_board(board: Board) -> Board:
    """Return the board if it can be printed and found.

    Raises:
        UsageError: too few squares, sizes that do not go together, more markers than the dictionary has.

    """
    least = 3 if board.kind == "charuco" else 1
    if min(board.columns, board.rows) < least:
        raise UsageError(f"A {board.kind} board needs at least {least} columns and rows (--columns, --rows).")
    if not (math.isfinite(board.square_mm) and 2 <= board.square_mm <= 1000):
        raise UsageError(f"--square-mm {board.square_mm:g}: give 2 to 1000 mm.")
    if not 0.3 * board.square_mm <= board.marker_mm <= LARGEST_MARKER * board.square_mm:
        low, high = 0.3 * board.square_mm, LARGEST_MARKER * board.square_mm
        raise UsageError(f"--marker-mm {board.marker_mm:g}: give {low:g} to {high:g} mm in squares of this size.")
    if board.dictionary not in DICTIONARIES:
        raise UsageError(f"--dictionary {board.dictionary}: is none of {', '.join(DICTIONARIES)}.")
    count, held = board.columns * board.rows, DICTIONARIES[board.dictionary][1]
    if board.first_id < 0 or board.first_id + (count if board.kind == "apriltag" else count // 2) > held:
        remedy = "Take fewer squares, a smaller --first-id or a larger dictionary."
        raise UsageError(f"--dictionary {board.dictionary} has the markers 0 to {held - 1}, too few. {remedy}")
    return board


def page_for(board: Board, page: str | None = None) -> tuple[str, tuple[float, float]]:
    """Return name and size in mm, on its side where that fits better, of ``page`` or of the smallest A page.

    Raises:
        UsageError: the board does not fit.

    """
    width, height = (side + 2 * AROUND_MM for side in board.size_mm)
    return smallest_page(width, height, page)


def smallest_page(
    width: float, height: float, page: str | None = None, upright: bool = False
) -> tuple[str, tuple[float, float]]:
    """Return name and size in mm of the page that holds this; ``upright`` never lays it on its side.

    Raises:
        UsageError: it does not fit.

    """
    for name in [page] if page else [name for name in PAPER_MM if name != "letter"]:
        short, long = PAPER_MM[name]
        for size in ((short, long),) if upright else ((short, long), (long, short)):
            if width <= size[0] and height <= size[1]:
                return name, size
    what = f"With rulers and margins it needs {width:g} x {height:g} mm"
    raise UsageError(f"{what}, which fits {'no page' if page is None else 'not on ' + page}. Take smaller squares.")


OLDEST = (4, 14)
INSTALL = "'opencv-python-headless>=4.14.0.94'"


def opencv() -> Any:
    """Return OpenCV.

    Raises:
        MissingPackageError: it is not installed, or too old.

    """
    cv2 = need("Boards need", "OpenCV", "cv2", install=INSTALL)
    check_release(cv2.__version__)
    return cv2


def dictionary(name: str) -> tuple[Any, Any]:
    """Return OpenCV and the dictionary of a name such as ``5x5_1000``.

    Raises:
        MissingPackageError: OpenCV is not installed, or too old.

    """
    cv2 = opencv()
    spelled = name.removeprefix("apriltag_") if name.startswith("apriltag_") else name.upper()
    prefix = "DICT_APRILTAG_" if name.startswith("apriltag_") else "DICT_"
    return cv2, cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, prefix + spelled))


def check_release(version: str) -> None:
    """Refuse the releases whose ChArUco corners are half a pixel off.

    Raises:
        MissingPackageError: the release is older than 4.14.

    """
    if tuple(int(part) for part in version.split(".")[:2]) < OLDEST:
        raise MissingPackageError(
            f"OpenCV {version} is too old: ChArUco corners of releases before 4.14 are shifted by half a pixel, "
            f"which moves a camera by half a millimetre and shows in no residual. Install a newer one: pip install {INSTALL}",
            package="opencv",
        )
