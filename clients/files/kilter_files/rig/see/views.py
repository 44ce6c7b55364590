"""One board in one picture: its corners with their standard deviations, or why it is refused."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.rig.see import board_size, chess_corners
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
from kilter_files.rig.see.finder import Finder, Markers
from kilter_files.rig.see.pictures import Grey
from kilter_files.rig.see.refusals import Refusal
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
    places, covariances, blur = refine_corners(grey, markers.quads, board.cells, white, noise)
    covariances[~(np.abs(places - markers.quads).max(axis=2) < MOST_MOVED_PX)] = np.nan
    numbers = [4 * number + k for number in markers.numbers for k in range(4)]
    return numbers, places.reshape(-1, 2), covariances.reshape(-1, 2, 2), blur
