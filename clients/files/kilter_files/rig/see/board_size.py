"""Whether a board was printed with another number of columns than its JSON says: where its markers stand tells.

Markers are numbered row by row, so a wrong count of columns puts most of them elsewhere. OpenCV then finds no corner of a
ChArUco board; corners of AprilTags are those of the tags themselves, and all are found, at places that are wrong.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.rig.board.layout import DICTIONARIES, Board
from kilter_files.rig.board.opencv import opencv
from kilter_files.rig.see.finder import Markers
from kilter_files.rig.see.refusals import Refusal
from kilter_files.rig.see.target import Target

LEAST_MARKERS = 4  # two rows of them in part: fewer fit too many counts of columns
MOST_COLUMNS = 60
MOST_OFF = 0.2  # of a marker's side: a lens bends less, and a marker in another square is off by more than one


def differing(markers: Markers, target: Target, picture: str) -> Refusal | None:
    """Refuse a board whose ``markers`` stand as on one of another size; None where they stand as it says, or on no board."""
    board = target.board
    if len(target.faces) > 1 or len(markers.numbers) < LEAST_MARKERS or _off(markers, board, target.legacy) < MOST_OFF:
        return None
    printed = _smallest_fitting_board(markers, board)
    if printed is None:
        return None
    seen = f"{len(markers.numbers)} markers of {target.name} are seen"
    if (printed.columns, printed.rows) == (board.rows, board.columns):
        what = f"{seen}: it is a board of {board.rows} x {board.columns} squares, columns first"
        return Refusal(picture, "columns_rows_swapped", what, board=target.name)
    what = (
        f"{seen}, and stand as on a board of {printed.columns} columns with at least {printed.rows} rows, "
        f"not {board.columns} x {board.rows}"
    )
    return Refusal(picture, "board_size_differs", what, board=target.name)


def _smallest_fitting_board(markers: Markers, board: Board) -> Board | None:
    """The smallest board on which the markers stand as they are seen; None where none does, or counts do as well."""
    tried = []
    for columns in range(1 if board.kind == "apriltag" else 3, MOST_COLUMNS + 1):
        wide = replace(
            board, columns=columns, rows=_rows(max(markers.numbers) - board.first_id + 1, columns, board.kind)
        )
        if max(wide.markers()) < DICTIONARIES[board.dictionary][1]:
            off = min(
                _off(markers, wide, legacy) for legacy in ((False, True) if board.kind == "charuco" else (False,))
            )
            tried.append((off, columns, wide))
    tried.sort(key=lambda one: one[:2])
    if not tried or tried[0][0] > MOST_OFF or (len(tried) > 1 and tried[1][0] < 2 * MOST_OFF):
        return None
    return tried[0][2]


def _rows(count: int, columns: int, kind: str) -> int:
    """Rows that hold so many markers."""
    squares = count if kind == "apriltag" else 2 * count
    return max(-(-squares // columns), 1 if kind == "apriltag" else 3)


def _off(markers: Markers, board: Board, legacy: bool) -> float:
    """How far markers are from where a plane board has them (rms), in sides of a marker; infinite where it lacks one."""
    places = board.markers()
    if not set(markers.numbers) <= set(places):
        return float("inf")
    mm = np.array([places[number] for number in markers.numbers]).reshape(-1, 2)
    if legacy and board.rows % 2 == 0:  # every second row begins the other way
        row = np.repeat([int(places[n][0][1] // board.square_mm) for n in markers.numbers], 4)
        mm[:, 0] += np.where(row % 2 == 0, -board.square_mm, board.square_mm)
    pixels = markers.quads.reshape(-1, 2)
    h: Floats | None = opencv().findHomography(pixels, mm, 0)[0]
    if h is None:
        return float("inf")
    there = pixels @ h[:, :2].T + h[:, 2]
    left = there[:, :2] / there[:, 2:] - mm
    return float(np.sqrt((left**2).sum(axis=1).mean()) / board.marker_mm)
