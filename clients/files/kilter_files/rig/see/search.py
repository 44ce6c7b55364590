"""Why a board is not found in a picture: what else would be found there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_files.rig.board.layout import DICTIONARIES, marker_family
from kilter_files.rig.see.board_size import differing
from kilter_files.rig.see.finder import Finder, Markers
from kilter_files.rig.see.pictures import Grey
from kilter_files.rig.see.refusals import Refusal
from kilter_files.rig.see.target import Target

LEAST_MARKERS = 3  # of another dictionary, which chance does not give
SURE = ("6x6", "7x7", "apriltag_36h11", "5x5", "apriltag_25h9", "apriltag_36h10", "4x4", "apriltag_16h5")
WIDE_PX = 6.0  # an edge over which grey levels rise, from which the picture is blurred


def why_not(finder: Finder, grey: Grey, markers: Markers, target: Target, picture: str) -> Refusal:
    """Say why ``target`` is not found; ``markers`` are those of its dictionary."""
    own = markers.select_numbers(set(target.marker_numbers))
    if len(own.numbers) >= 2:
        found = _other_pattern(finder, grey, own, target, picture)
        found = found or differing(_markers_from_first_id(markers, target), target, picture)
        if found is not None:
            return found
        what = f"{len(own.numbers)} markers of {target.name} are seen, and no corner between two of them"
        return Refusal(picture, "too_few_corners", what, board=target.name)
    if len(markers.numbers) >= LEAST_MARKERS and not own.numbers:
        low, high = min(markers.numbers), max(markers.numbers)
        first, last = target.marker_numbers[0], target.marker_numbers[-1]
        what = f"markers {low} to {high} are seen, and {target.name} has {first} to {last}"
        return Refusal(picture, "markers_unknown", what, board=target.name)
    return _nothing(finder, grey, target, picture)


def _markers_from_first_id(markers: Markers, target: Target) -> Markers:
    """Markers from the board's first on: one that was printed larger has more than its JSON."""
    return markers.select_numbers({number for number in markers.numbers if number >= target.board.first_id})


def _nothing(finder: Finder, grey: Grey, target: Target, picture: str) -> Refusal:
    name = target.board.dictionary
    other = None if finder.instead is None else other_dictionary(finder, grey, name, finder.instead)
    if other is None and len(finder.markers(np.ascontiguousarray(grey[:, ::-1]), name).numbers) >= LEAST_MARKERS:
        what = f"markers of {target.name} are seen in the picture's mirror image"
        return Refusal(picture, "print_mirrored", what, board=target.name)
    if other := other or other_dictionary(finder, grey, name):
        what = f"markers of {other} are seen, and {target.name} has {name}"
        return Refusal(picture, "dictionary_differs", what, board=target.name)
    if (wide := edge_px(grey)) > WIDE_PX:
        what = f"no marker is seen, and the sharpest edges are {wide:.0f} px wide"
        return Refusal(picture, "picture_blurred", what, board=target.name)
    return Refusal(picture, "board_not_found", f"no marker of {target.name} is seen", board=target.name)


def _other_pattern(finder: Finder, grey: Grey, own: Markers, target: Target, picture: str) -> Refusal | None:
    """Whether the board would be found with columns and rows swapped, or drawn the legacy way or not."""
    board = target.board
    if board.kind != "charuco":
        return None
    board = max(target.faces, key=lambda face: len(own.select_numbers(set(face.markers())).numbers))
    own = own.select_numbers(set(board.markers()))
    swapped = replace(board, columns=board.rows, rows=board.columns)
    other = f"it is a board of {board.rows} x {board.columns} squares, columns first"
    tries = [
        ("columns_rows_swapped", swapped, target.legacy, other),
        ("legacy_pattern", board, not target.legacy, _legacy(target)),
        ("columns_rows_swapped", swapped, not target.legacy, f"{other}, and {_legacy(target)}"),
    ]
    for code, tried, legacy, what in tries:
        if len(finder.chessboard(grey, own, tried, legacy)) >= 2:
            said = f"{len(own.numbers)} markers of {target.name} are seen and no corner: {what}"
            return Refusal(picture, code, said, board=target.name)
    return None


def _legacy(target: Target) -> str:
    corner = "black" if target.legacy else "white, as OpenCV drew boards before 4.6"
    return f"its upper left square is {corner} (legacy_pattern {str(not target.legacy).lower()})"


def other_dictionary(finder: Finder, grey: Grey, own: str, among: str | None = None) -> str | None:
    """Return the smallest dictionary whose markers are seen, or None; ``among`` those of one family, or of all."""
    family = marker_family(own)
    for start in SURE if among is None else (among,):
        for name in (n for n in DICTIONARIES if n.startswith(start) and n.endswith(("1000", "h5", "h9", "h10", "h11"))):
            if start == family:
                continue
            seen = finder.markers(grey, name).numbers
            if len(set(seen)) >= LEAST_MARKERS:
                finder.instead = start
                fits = [n for n, (_, held) in DICTIONARIES.items() if n.startswith(start) and max(seen) < held]
                return fits[0]
    return None


def edge_px(grey: Grey) -> float:
    """Width of the sharpest edges, in the direction in which they are widest: the span of grey levels by the slope."""
    part = grey[::1, ::1].astype(np.float32)
    low, high = np.percentile(part[::4, ::4], [2, 98])
    if high - low < 20:
        return 0.0
    slopes = [np.abs(np.diff(part, axis=axis)) for axis in (0, 1)]
    return float(max((high - low) / max(float(np.percentile(slope, 99.8)), 1.0) for slope in slopes))
