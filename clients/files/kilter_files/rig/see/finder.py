"""Finds boards in a picture by OpenCV: markers first, in a smaller picture where it is large, then corners."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.rig.board.layout import Board
from kilter_files.rig.board.opencv import dictionary, opencv
from kilter_files.rig.see.pictures import Grey

Wanted = tuple[str, tuple[int, ...] | None]  # a dictionary, and which of its markers

LARGE = 1_000_000  # pixels from which markers are looked for in a picture of half the size first
LEAST_SIDE_PX = 20.0  # of markers there, below which the whole picture is looked through again


@dataclass(frozen=True)
class Markers:
    """Markers found: ``numbers`` (n) and ``quads`` (n, 4, 2) in px, clockwise from the marker's upper left."""

    numbers: list[int]
    quads: Floats

    def select_numbers(self, numbers: set[int]) -> Markers:
        """Those with one of these numbers."""
        kept = [k for k, number in enumerate(self.numbers) if number in numbers]
        return Markers([self.numbers[k] for k in kept], self.quads[kept])

    def twice(self) -> list[int]:
        """Numbers seen more than once."""
        return sorted(number for number, count in Counter(self.numbers).items() if count > 1)


@dataclass
class Finder:
    """Looks for markers and for a board's chessboard corners; what OpenCV needs is built once.

    ``instead`` is the dictionary that was last seen in place of the board's, which the next picture is likely to show too.
    """

    instead: str | None = None
    _detectors: dict[Wanted, Any] = field(default_factory=dict)
    _boards: dict[tuple[Board, bool], Any] = field(default_factory=dict)

    def markers(self, grey: Grey, name: str, numbers: tuple[int, ...] | None = None, thorough: bool = False) -> Markers:
        """Find the markers of a dictionary, all or those of ``numbers``; ``thorough`` is the whole picture at once.

        A thousand markers take ten times as long as the thirty of a board.
        """
        cv2 = opencv()
        if grey.size > LARGE and not thorough:
            height, width = (side // 2 for side in grey.shape)
            half = cv2.resize(grey[: 2 * height, : 2 * width], (width, height), interpolation=cv2.INTER_AREA)
            found = self._detect(half, (name, numbers))
            sides = np.linalg.norm(np.diff(found.quads, axis=1), axis=2)
            if found.numbers and np.median(sides) >= LEAST_SIDE_PX:
                return Markers(found.numbers, found.quads * 2 + 0.5)  # centres of pixels are whole numbers
        return self._detect(grey, (name, numbers))

    def _detect(self, grey: Grey, wanted: Wanted) -> Markers:
        name, chosen = wanted
        if wanted not in self._detectors:
            cv2, known = dictionary(name)
            if chosen is not None:
                rows = known.bytesList[list(chosen)]
                known = cv2.aruco.Dictionary(rows, known.markerSize, known.maxCorrectionBits)
            self._detectors[wanted] = cv2.aruco.ArucoDetector(known, cv2.aruco.DetectorParameters())
        quads, found, _ = self._detectors[wanted].detectMarkers(grey)
        if found is None or not len(quads):
            return Markers([], np.zeros((0, 4, 2)))
        numbers = [int(n) if chosen is None else chosen[int(n)] for n in found.ravel()]
        return Markers(numbers, np.array(quads, dtype=np.float64).reshape(-1, 4, 2))

    def chessboard(self, grey: Grey, markers: Markers, board: Board, legacy: bool) -> dict[int, Floats]:
        """Corners of a ChArUco board by number, to about a tenth of a pixel."""
        if not markers.numbers:
            return {}
        quads = tuple(quad.astype(np.float32).reshape(1, 4, 2) for quad in markers.quads)
        numbers = np.array(markers.numbers, dtype=np.int32).reshape(-1, 1)
        corners, found, *_ = self._board(board, legacy).detectBoard(grey, markerCorners=quads, markerIds=numbers)
        if found is None or corners is None:
            return {}
        places = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
        return dict(zip([int(number) for number in np.ravel(found)], places, strict=True))

    def _board(self, board: Board, legacy: bool) -> Any:
        key = (board, legacy)
        if key not in self._boards:
            cv2, known = dictionary(board.dictionary)
            numbers = np.array(sorted(board.markers()))
            size = (board.columns, board.rows)
            made = cv2.aruco.CharucoBoard(size, board.square_mm, board.marker_mm, known, numbers)
            made.setLegacyPattern(legacy)
            self._boards[key] = cv2.aruco.CharucoDetector(made)
        return self._boards[key]
