"""The whole way from pictures to rows: each picture is read, looked through, and forgotten."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, TextIO

import numpy as np

from kilter_files.ground.arrays import Floats
from kilter_files.ground.errors import FileError, UsageError
from kilter_files.ground.later import need
from kilter_files.rig.board_layout import DICTIONARIES, marker_family
from kilter_files.rig.see.intrinsics import Kept, check_known, fit_camera_with_report
from kilter_files.rig.see.optics.camera import Camera
from kilter_files.rig.see.pictures import REMEDIES, Grey, Refusal
from kilter_files.rig.see.sources import Frame, Pictures, Poses
from kilter_files.rig.see.target import Target
from kilter_files.rig.see.views import FEW_CORNERS, LARGE, Finder, Markers, View, detect_view, differing
from kilter_files.tables.table import JointLog, cells

FAMILIES = {"apriltag_36h11": "tag36h11", "apriltag_25h9": "tag25h9", "apriltag_16h5": "tag16h5"}
CENTRE = 0.5  # where it puts the centre of the upper left pixel
MOST_APART_PX, MOST_BIAS_PX = 1.0, 0.05
SAME_TAG_PX = 8.0
PACKAGE = "pupil-apriltags"


@dataclass
class Second:
    """Compares views of AprilTag boards: sums over all corners that both detectors found."""

    family: str
    corners: int = 0
    views: int = 0
    _sum: Floats = field(default_factory=lambda: np.zeros(2))
    _squares: Floats = field(default_factory=lambda: np.zeros(2))
    _detector: Any = None

    def compare(self, grey: Grey, view: View, target: Target) -> Refusal | None:
        """Compare a view's corners; a refusal where one is far from where the other detector sees it."""
        numbers = [target.numbers[place] for place in view.places]
        others = self._detect_tags(grey)
        off, known = [], []
        for number, place in zip(numbers, view.pixels, strict=True):
            quad = others.get(number // 4)
            if quad is None:
                continue
            apart = quad - place
            nearest = apart[np.linalg.norm(apart, axis=1).argmin()]
            if np.linalg.norm(nearest) < SAME_TAG_PX:
                off.append(-nearest)
                known.append(number)
        if not off:
            return None
        all_off = np.array(off)
        worst = int(np.linalg.norm(all_off, axis=1).argmax())
        if np.linalg.norm(all_off[worst]) > MOST_APART_PX:
            what = f"the two detectors put it {np.linalg.norm(all_off[worst]):.1f} px apart"
            return Refusal(view.picture, "detectors_differ", what, known[worst], target.name)
        self.views += 1
        self.corners += len(off)
        self._sum += all_off.sum(axis=0)
        self._squares += (all_off**2).sum(axis=0)
        return None

    def _detect_tags(self, grey: Grey) -> dict[int, Floats]:
        """Quads (4, 2) px by the number of the tag, in our convention."""
        if self._detector is None:
            self._detector = _detector(self.family)
        return {int(tag.tag_id): np.asarray(tag.corners) - CENTRE for tag in self._detector.detect(grey)}

    def bias_px(self) -> float:
        """How far the corners are apart on average, by direction."""
        return float(np.linalg.norm(self._sum) / max(1, self.corners))

    def to_document(self) -> dict[str, Any]:
        """Return what came of it: ours minus theirs."""
        count = max(1, self.corners)
        mean = self._sum / count
        return {
            "detector": PACKAGE,
            "views": self.views,
            "corners": self.corners,
            "mean_u_px": round(float(mean[0]), 4),
            "mean_v_px": round(float(mean[1]), 4),
            "rms_px": round(float(np.sqrt(self._squares.sum() / (2 * count))), 4),
        }


def create_second_detector(targets: list[Target]) -> Second:
    """Return the second detector for these boards.

    Raises:
        UsageError: boards without AprilTags, of several families, or of one that it does not know.
        MissingPackageError: it is not installed.

    """
    names = {target.board.dictionary for target in targets if target.board.kind == "apriltag"}
    if len(names) != 1 or not names <= set(FAMILIES):
        raise UsageError(f"--cross-check: is for AprilTag boards of one dictionary: {', '.join(FAMILIES)}.")
    second = Second(FAMILIES[names.pop()])
    second._detector = _detector(second.family)
    return second


@cache
def _detector(family: str) -> Any:
    """The detector of a family, one for the whole process: its own way to destroy itself frees the family's memory twice."""
    pupil_apriltags = need("The second detector needs", PACKAGE, "pupil_apriltags")
    kind = type("Kept", (pupil_apriltags.Detector,), {"__del__": lambda _: None})
    # smaller pictures (quad_decimate above 1) would shift its corners
    return kind(families=family, nthreads=2, quad_decimate=1.0, refine_edges=1)


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


PIXEL_DIGITS = SIGMA_DIGITS = 4


class Rows:
    """Writes the head, and a row for every view, to a stream."""

    def __init__(self, stream: TextIO, log: JointLog | None, targets: list[Target], camera: str | None) -> None:
        self._log, self._camera, self._many = log, camera, len(targets) > 1
        self._count = max(len(target.numbers) for target in targets)
        self._numbered = (self._many or camera is not None) and not (log is not None and "pose_id" in log.columns)
        self._writer = csv.writer(stream, lineterminator="\n")
        self._writer.writerow(self.columns())

    def columns(self) -> list[str]:
        """Names of the columns."""
        numbers = range(1, self._count + 1)
        names = [] if self._log is None else list(self._log.columns)
        names += ["pose_id"] if self._numbered else []
        names += ["camera"] if self._camera is not None else []
        names += ["board"] if self._many else []
        names += [f"{axis}{n}_px" for n in numbers for axis in "uv"]
        return names + [f"s{axis}{n}_px" for n in numbers for axis in "uv"]

    def write(self, view: View, row: int | None, pose: int) -> None:
        """Write a view; ``row`` is its row of the joint log, ``pose`` the number of its picture."""
        found: list[str] = []
        if self._log is not None and row is not None:
            for name, values in self._log.columns.items():
                found += cells(name, [float(values[row])])
        found += [str(pose if row is None else row + 1)] if self._numbered else []
        found += [self._camera] if self._camera is not None else []
        found += [view.board] if self._many else []
        self._writer.writerow(
            found + self._spread(view, view.pixels, PIXEL_DIGITS) + self._spread(view, view.sigmas, SIGMA_DIGITS)
        )

    def _spread(self, view: View, values: Floats, digits: int) -> list[str]:
        spread = [""] * (2 * self._count)
        for place, pair in zip(view.places, values.tolist(), strict=True):
            spread[2 * place : 2 * place + 2] = [f"{value:.{digits}f}" for value in pair]
        return spread


MOST_MOVED_PX, MOST_FRAME_S = 0.2, 0.25  # between frames of a video
MOST_SEARCHES = 20  # pictures without a board that are searched for what they show instead; later ones are like these
Told = Callable[["Seen"], None]


@dataclass
class Seen:
    """What came of all pictures."""

    pictures: int = 0
    views: list[dict[str, Any]] = field(default_factory=list)
    refused: list[Refusal] = field(default_factory=list)
    corners: int = 0
    warnings: list[str] = field(default_factory=list)
    size: tuple[int, int] | None = None
    intrinsics: dict[str, Any] | None = None

    def counts(self) -> dict[str, int]:
        """Refusals by code, the most frequent first."""
        return dict(Counter(refusal.code for refusal in self.refused).most_common())


@dataclass
class Looker:
    """Looks for boards in pictures of one camera; ``lens`` is the model whose intrinsics are wanted."""

    targets: list[Target]
    poses: Poses | None = None
    camera: Camera | None = None
    lens: str | None = None
    second: Second | None = None
    finder: Finder = field(default_factory=Finder)
    before: dict[str, tuple[float, View]] = field(default_factory=dict)
    searches: int = 0
    kept: Kept = field(default_factory=Kept)

    def write_views(
        self, source: Pictures, stream: TextIO, camera_name: str | None, told: Told = lambda _: None
    ) -> Seen:
        """Write a row for every view.

        Raises:
            FileError: no view at all; its code is that of the most frequent refusal.

        """
        seen = Seen(size=self.camera.size if self.camera else None)
        rows = Rows(stream, self.poses.log if self.poses else None, self.targets, camera_name)
        for frame in source.frames(seen.size):
            self._frame(frame, rows, seen)
            told(seen)
        if not seen.views:
            raise _no_view(seen)
        seen.warnings = self._warnings(seen, source)
        self._intrinsics(seen, camera_name or "camera")
        return seen

    def _intrinsics(self, seen: Seen, name: str) -> None:
        if self.lens is not None and seen.size is not None:
            self.camera, seen.intrinsics, warnings = fit_camera_with_report(self.kept, seen.size, self.lens, name)
            seen.warnings += warnings
        elif self.camera is not None:
            seen.warnings += check_known(self.kept, self.camera)
        else:
            seen.warnings.append("intrinsics are missing: give --camera FILE, or --intrinsics brown to find them")

    def _frame(self, frame: Frame, rows: Rows, seen: Seen) -> None:
        number = seen.pictures
        seen.pictures += 1
        if frame.grey is None or frame.refusal is not None:
            seen.refused += [frame.refusal] if frame.refusal else []
            return
        size = (frame.grey.shape[1], frame.grey.shape[0])
        if seen.size is not None and size != seen.size:
            what = f"has {size[0]} x {size[1]} pixels, and those before it {seen.size[0]} x {seen.size[1]}"
            seen.refused.append(Refusal(frame.name, "picture_other_camera", what))
            return
        row = self.poses.claim_row(frame, number) if self.poses else None
        if self.poses is not None and row is None:
            if frame.video is None:
                seen.refused.append(Refusal(frame.name, "joints_missing", "has no row in the joint log"))
            return
        for found in self.boards(frame.grey, frame.name):
            if isinstance(found, Refusal):
                seen.refused.append(found)
                continue
            target = next(target for target in self.targets if target.name == found.board)
            if against := self._moving(frame, found) or self._cross_check(frame.grey, found, target):
                seen.refused.append(against)
                continue
            seen.size = size
            self.kept.offer(found, target)
            rows.write(found, row, number + 1)
            seen.corners += len(found.places)
            seen.views.append(_summary(found, row))

    def _moving(self, frame: Frame, view: View) -> Refusal | None:
        """Whether the board has moved since the frame before; a camera that reads line by line bends it then."""
        if frame.video is None or frame.t_s is None:
            return None
        key = f"{frame.video} {view.board}"
        before = self.before.get(key)
        self.before[key] = frame.t_s, view
        if before is None or frame.t_s - before[0] > MOST_FRAME_S:
            return None
        old = dict(zip(before[1].places, before[1].pixels, strict=True))
        steps = [float(np.linalg.norm(p - old[k])) for k, p in zip(view.places, view.pixels, strict=True) if k in old]
        moved = float(np.median(steps)) if steps else 0.0
        limit = MOST_MOVED_PX + 3 * float(view.sigmas.mean())
        if moved <= limit:
            return None
        what = f"{view.board} has moved by {moved:.1f} px since the frame before"
        return Refusal(frame.name, "arm_moving", what, board=view.board)

    def _cross_check(self, grey: Grey, view: View, target: Target) -> Refusal | None:
        if self.second is None or target.board.kind != "apriltag":
            return None
        return self.second.compare(grey, view, target)

    def boards(self, grey: Grey, name: str) -> list[View | Refusal]:
        """Return the view of every board, or why there is none; a board of several may be out of sight."""
        by_dictionary = {
            key: self.finder.markers(grey, key, numbers)
            for key, numbers in self._marker_numbers_by_dictionary().items()
        }
        found = [self._board(grey, by_dictionary, target, name) for target in self.targets]
        some = any(isinstance(one, View) for one in found)
        both = zip(found, self.targets, strict=True)
        return [one or self._explain_missing_board(grey, target, name) for one, target in both if one or not some]

    def _board(self, grey: Grey, markers: dict[str, Markers], target: Target, name: str) -> View | Refusal | None:
        key = target.board.dictionary
        found = detect_view(self.finder, grey, markers[key], target, name)
        if found is None and grey.size > LARGE:
            markers[key] = self.finder.markers(grey, key, self._marker_numbers_by_dictionary()[key], thorough=True)
            found = detect_view(self.finder, grey, markers[key], target, name)
        return found

    def _marker_numbers_by_dictionary(self) -> dict[str, tuple[int, ...]]:
        """Numbers of all boards' markers, by dictionary."""
        names = {target.board.dictionary for target in self.targets}
        return {
            name: tuple(sorted({n for t in self.targets if t.board.dictionary == name for n in t.marker_numbers}))
            for name in names
        }

    def _explain_missing_board(self, grey: Grey, target: Target, name: str) -> Refusal:
        self.searches += 1
        if self.searches > MOST_SEARCHES:
            return Refusal(name, "board_not_found", f"{target.name} is not found", board=target.name)
        markers = self.finder.markers(grey, target.board.dictionary, thorough=True)
        return why_not(self.finder, grey, markers, target, name)

    def _warnings(self, seen: Seen, source: Pictures) -> list[str]:
        warnings = []
        few = [view for view in seen.views if view["corners"] < FEW_CORNERS]
        if few:
            names = ", ".join(view["picture"] for view in few[:3]) + (" ..." if len(few) > 3 else "")
            warnings.append(
                f"{len(few)} views have fewer than {FEW_CORNERS} corners ({names}): "
                "they tell the place of the board badly, whatever their pixels leave"
            )
        if self.poses is not None and (unused := self.poses.unused_rows()):
            rows = ", ".join(map(str, unused[:8])) + (" ..." if len(unused) > 8 else "")
            warnings.append(f"{len(unused)} rows of {self.poses.log.path} have no picture: {rows}")
        if self.second is not None and (biased := self.second.bias_px()) > MOST_BIAS_PX:
            warnings.append(f"the two detectors put corners {biased:.2f} px apart on average, all the same way")
        if source.videos:
            warnings.append(
                "a camera that reads line by line (rolling shutter) bends what moves: "
                "let the arm rest at every pose, longer than a frame"
            )
        return warnings


def _summary(view: View, row: int | None) -> dict[str, Any]:
    summary: dict[str, Any] = {"picture": view.picture, "board": view.board, "corners": len(view.places)}
    summary["sigma_px"] = round(float((view.sigmas**2).mean() ** 0.5), 4)
    return summary if row is None else summary | {"joints_row": row + 1}


def _no_view(seen: Seen) -> FileError:
    counts = seen.counts()
    code = next(iter(counts), "joints_missing")
    first = next((refusal for refusal in seen.refused if refusal.code == code), None)
    told = ", ".join(f"{count} x {name}" for name, count in counts.items()) or "no picture with a row of joints"
    said = first.sentence() if first is not None else REMEDIES[code]
    error = FileError(f"No view of {seen.pictures} pictures can be used ({told}). First: {said}", code=code)
    error.context["refused"] = [refusal.to_document() for refusal in seen.refused[:100]]
    return error
