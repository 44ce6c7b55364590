"""One board in one picture: its corners with their standard deviations, or why it is refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.rig.see import board_size, chess_corners, tag_corners
from kilter_files.rig.see.edges import usual_blur
from kilter_files.rig.see.finder import Finder, Markers
from kilter_files.rig.see.noise import estimate_noise
from kilter_files.rig.see.pictures import Grey
from kilter_files.rig.see.refusals import Refusal
from kilter_files.rig.see.target import Target

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
    if target.board.kind == "apriltag" and (wrong := board_size.differing(own, target, picture)):
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
    places, covariances, blur = chess_corners.refine_corners(
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
    places, covariances, blur = tag_corners.refine_corners(grey, markers.quads, board.cells, white, noise)
    covariances[~(np.abs(places - markers.quads).max(axis=2) < MOST_MOVED_PX)] = np.nan
    numbers = [4 * number + k for number in markers.numbers for k in range(4)]
    return numbers, places.reshape(-1, 2), covariances.reshape(-1, 2, 2), blur
