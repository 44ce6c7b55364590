"""One board in one picture: its corners with their standard deviations, or why it is refused.

Markers are numbered row by row, so a wrong count of columns puts most of them elsewhere. OpenCV then finds no corner of a
ChArUco board; corners of AprilTags are those of the tags themselves, and all are found, at places that are wrong.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.rig.board_layout import DICTIONARIES, Board, dictionary, opencv
from kilter_files.rig.see import edges
from kilter_files.rig.see.edges import (
    Noise,
    Pieces,
    area,
    estimate_noise,
    fit_edge_curves,
    iterate_until_settled,
    offsets,
    profile_reach,
    usual_blur,
)
from kilter_files.rig.see.pictures import Grey, Refusal
from kilter_files.rig.see.target import Target

ENDS = 0.12  # of an edge at either end, left out: blur of the corner
LEAST_PROFILES, MOST_PROFILES = 5, 60
BOWED_FROM = 16  # profiles, from which an edge may be bowed by a lens
FLOOR_PX = 0.015


def refine_corners(grey: Grey, quads: Floats, cells: int, white: float, noise: Noise) -> tuple[Floats, Floats, Floats]:
    """Return corners (n, 4, 2), clockwise, covariances (n, 4, 2, 2) px², and blur (n, 4) across each edge.

    ``quads`` are within 2 px; ``white`` is how wide the white around a tag is, in parts of its side.
    """
    gap, straight = min(1.0 / cells, white), np.zeros(4 * len(quads))
    return iterate_until_settled(quads, straight, lambda at, blur, bow: _meeting(grey, at, gap, noise, blur, bow))


def _meeting(
    grey: Grey, quads: Floats, gap: float, noise: Noise, blur: float, bow: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    count = len(quads)
    chords = np.roll(quads, -1, axis=1) - quads
    lengths = np.linalg.norm(chords, axis=2)
    along = chords / lengths[..., None]
    normals = np.stack([along[..., 1], -along[..., 0]], axis=-1)  # outwards
    whole = area(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]) / 2
    reach, left = profile_reach(gap * float(np.percentile(whole[:, None] / lengths, 10)), blur, 1.0, FLOOR_PX)
    profiles = int(np.clip((1 - 2 * ENDS) * np.median(lengths), LEAST_PROFILES, MOST_PROFILES))
    t = lengths[..., None] * np.linspace(ENDS, 1 - ENDS, profiles)
    starts, ways, outwards, flat = (part.reshape(4 * count, -1) for part in (quads, along, normals, t))
    bowed = bow[:, None] * flat * (flat - lengths.reshape(-1, 1))  # nothing at the corners
    seen = offsets(grey, Pieces(starts, ways, outwards, flat, bowed), reach, noise)
    degree = 2 if profiles >= BOWED_FROM else 1
    curves, covariances = fit_edge_curves(flat, seen.out, seen.variances, degree)
    ends = [_evaluate_curves(curves, covariances, where) for where in (np.zeros(4 * count), lengths.ravel())]
    (begin, begin_slope, begin_variance), (end, end_slope, end_variance) = (
        tuple(part.reshape(count, 4) for part in one) for one in ends
    )
    # corner k is where edge k - 1 ends and edge k begins
    off = np.stack([np.roll(end, 1, axis=1), begin], axis=-1)
    variance = np.stack([np.roll(end_variance, 1, axis=1), begin_variance], axis=-1) + left**2
    tilted = np.stack(
        [np.roll(normals - end_slope[..., None] * along, 1, axis=1), normals - begin_slope[..., None] * along], axis=2
    )
    bright = (seen.rises == 1).reshape(count, 4)
    known = bright & np.roll(bright, 1, axis=1) & (np.abs(np.linalg.det(tilted)) > 0.1)
    inverse = np.linalg.inv(tilted[known])
    places, spread = np.full(quads.shape, np.nan), np.full((*quads.shape, 2), np.nan)
    places[known] = quads[known] + np.einsum("nij,nj->ni", inverse, off[known])
    spread[known] = np.einsum("nij,nj,nkj->nik", inverse, variance[known], inverse)
    return places, spread, seen.blur_px.reshape(count, 4), curves[:, 2] if degree == 2 else bow


def _evaluate_curves(curves: Floats, covariances: Floats, t: Floats) -> tuple[Floats, Floats, Floats]:
    """Offset, slope and variance of curves at one place each."""
    powers = t[:, None] ** np.arange(curves.shape[1])
    degrees = np.arange(1, curves.shape[1])
    slopes = (curves[:, 1:] * degrees * powers[:, :-1]).sum(axis=1)
    return (curves * powers).sum(axis=1), slopes, np.einsum("ni,nij,nj->n", powers, covariances, powers)


LEAST_CORNERS, FEW_CORNERS = 4, 12
MOST_MOVED_PX = 3.0
MOST_BLUR_PX = 2.5  # standard deviation across edges; a usual lens has 0.6 to 1.2


@dataclass(frozen=True)
class View:
    """Corners of one board: ``places`` (n) in the board's order, ``pixels`` (n, 2), ``covariances`` (n, 2, 2)."""

    picture: str
    board: str
    places: list[int]
    pixels: Floats
    covariances: Floats
    size: tuple[int, int]

    @property
    def sigmas(self) -> Floats:
        """Standard deviation of every corner along u and v (n, 2) px."""
        return np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2))


def detect_view(finder: Finder, grey: Grey, markers: Markers, target: Target, picture: str) -> View | Refusal | None:
    """Return the view of a board, a refusal that needs no further search, or None where nothing was found."""
    own = markers.select_numbers(set(target.marker_numbers))
    if twice := own.twice():
        what = f"marker {twice[0]} of {target.name} is seen at two places"
        return Refusal(picture, "board_twice", what, board=target.name)
    if not own.numbers:
        return None
    if target.board.kind == "apriltag" and (wrong := differing(own, target, picture)):
        return wrong
    numbers, pixels, covariances, blur = _corners(finder, grey, own, target)
    if not numbers:
        return None
    if (wide := usual_blur(blur.max(axis=-1, initial=0.0))) > MOST_BLUR_PX:
        what = f"edges of {target.name} are blurred over {wide:.1f} px"
        return Refusal(picture, "picture_blurred", what, board=target.name)
    sure = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(pixels).all(axis=1)
    if sure.sum() < LEAST_CORNERS:
        count = int(sure.sum())
        what = f"one corner of {target.name} is seen" if count == 1 else f"{count} corners of {target.name} are seen"
        if not sure.any() and len(numbers) >= LEAST_CORNERS:
            what = f"no corner of {target.name} is seen well enough, or {len(numbers)} on one line"
        return Refusal(picture, "too_few_corners", what, corner=numbers[0], board=target.name)
    column = target.column_by_number()
    order = sorted(np.flatnonzero(sure), key=lambda k: column[numbers[k]])
    places = [column[numbers[k]] for k in order]
    size = (grey.shape[1], grey.shape[0])
    return View(picture, target.name, places, pixels[order], covariances[order], size)


def _corners(finder: Finder, grey: Grey, markers: Markers, target: Target) -> tuple[list[int], Floats, Floats, Floats]:
    if target.board.kind == "apriltag":
        return _tags(grey, markers, target)
    found = [_face(finder, grey, markers, target, face) for face in range(len(target.faces))]
    numbers = [number for part in found for number in part[0]]
    places, covariances, blur = (np.concatenate([part[k] for part in found]) for k in (1, 2, 3))
    return numbers, places, covariances, blur


def _face(
    finder: Finder, grey: Grey, markers: Markers, target: Target, face: int
) -> tuple[list[int], Floats, Floats, Floats]:
    board, first = target.faces[face], target.board.first_corner(face)
    rough = finder.chessboard(grey, markers.select_numbers(set(board.markers())), board, target.legacy)
    numbers = sorted(rough)
    start = np.array([rough[number] for number in numbers]).reshape(-1, 2)
    on_board = board.corners()
    mm = np.array([on_board[number] for number in numbers]).reshape(-1, 2)
    if len(start) < LEAST_CORNERS or _on_a_line(mm):
        nothing = np.full((len(start), 2, 2), np.nan)
        return [first + number for number in numbers], start, nothing, np.full((len(start), 2), np.nan)
    places, covariances, blur = edges.refine_corners(
        grey, start, mm, board.square_mm, board.marker_mm, estimate_noise(grey, start)
    )
    covariances[~(np.abs(places - start).max(axis=1) < MOST_MOVED_PX)] = np.nan
    return [first + number for number in numbers], places, covariances, blur


def _on_a_line(mm: Floats) -> bool:
    """Whether corners (n, 2) of a chessboard tell nothing of how it is tilted."""
    return bool(np.linalg.matrix_rank(mm - mm[0], tol=1e-6 * np.abs(mm).max()) < 2)


def _tags(grey: Grey, markers: Markers, target: Target) -> tuple[list[int], Floats, Floats, Floats]:
    board = target.board
    noise = estimate_noise(grey, markers.quads.reshape(-1, 2))
    white = board.square_mm / board.marker_mm - 1.0
    places, covariances, blur = refine_corners(grey, markers.quads, board.cells, white, noise)
    covariances[~(np.abs(places - markers.quads).max(axis=2) < MOST_MOVED_PX)] = np.nan
    numbers = [4 * number + k for number in markers.numbers for k in range(4)]
    return numbers, places.reshape(-1, 2), covariances.reshape(-1, 2, 2), blur


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
