"""What cameras see of boards: pixels of all corners, and how they follow the tool and the unknowns of the rig.

How far the tool is from where a model has it, seen through views that are noisy themselves.

A single view tells the tool's place along its line of sight ten times worse than across it. So what views say is taken apart:
the noise of a view is what its corners scatter by about the pose that fits them, which owes nothing to the model; what views
scatter by beyond that is the tool's. Both are normal; their widths are the likeliest (EM), and the errors of single views are
shrunk by what is noise in them, and then scaled so that together they scatter as the tool does (Louis 1984).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from kilter_core.errors import ObservationError
from kilter_core.measurement.camera.camera_model import project, project_held
from kilter_core.model.placed_rig import Place, PlacedRig
from kilter_core.types import Bools, Floats, Ints


def camera_board_pairs(camera: Ints, board: Ints) -> list[tuple[int, int]]:
    """Every camera (N,) with each board (N,) that it saw; rows that no camera saw have -1."""
    seen = np.unique(np.stack([camera, board], axis=1)[camera >= 0], axis=0)
    return [(int(c), int(b)) for c, b in seen]


@dataclass(frozen=True)
class Views:
    """N views: which ``camera (N,)`` of the rig saw which ``board (N,)``, and the tool's ``position`` and ``rotation``."""

    camera: Ints
    board: Ints
    position: Floats
    rotation: Floats

    def only(self, rows: Ints) -> Views:
        """Some of the views."""
        return Views(self.camera[rows], self.board[rows], self.position[rows], self.rotation[rows])

    def pairs(self) -> Iterator[tuple[Ints, int, int]]:
        """Rows of each pair of a camera and a board."""
        for c, b in camera_board_pairs(self.camera, self.board):
            yield np.flatnonzero((self.camera == c) & (self.board == b)), c, b


@dataclass(frozen=True)
class Slopes:
    """How pixels (N, M, 2) follow the tool and the unknowns of the rig; zero where there is no pixel.

    ``by_tool (N, M, 2, 6)`` are their derivatives by a motion of the tool in the axes of the measurements, about the tool
    point. A camera or board that moves is seen as the tool that moves by ``carried (N, 6, K)``, so only intrinsics and scales
    have derivatives of their own: ``by_own (N, M, 2, O)``, of the unknowns ``own (N, O)`` of the K. A view follows those of its
    own camera and board alone; where these are fewer than O, ``own`` is -1 and the derivative zero.
    """

    by_tool: Floats
    carried: Floats
    by_own: Floats
    own: Ints

    def low_rank_factors(self) -> tuple[Floats, Floats]:
        """Derivatives (N, M, 2, 6 + O) by the few numbers that pixels follow, and those of these (N, 6 + O, K)."""
        inner = np.zeros((len(self.carried), 6 + self.own.shape[1], self.carried.shape[2]))
        inner[:, :6] = self.carried
        view, place = np.nonzero(self.own >= 0)
        inner[view, 6 + place, self.own[view, place]] = 1.0
        return np.concatenate([self.by_tool, self.by_own], axis=3), inner

    def by_unknown(self, rows: Ints) -> Floats:
        """Derivatives of some views (n, M, 2, U) by all the unknowns that any of them follows by itself."""
        own = self.own[rows]
        out = np.zeros((*self.by_own[rows].shape[:3], self.carried.shape[2]))
        for place in range(own.shape[1]):
            view = np.flatnonzero(own[:, place] >= 0)
            out[view, :, :, own[view, place]] = self.by_own[rows[view], :, :, place]
        return out[..., np.unique(own[own >= 0])]


def sight(rig: PlacedRig, views: Views, corners: int) -> Floats:
    """Pixels (N, M, 2) in all views of boards with at most so many ``corners``.

    NaN where a board has no such corner or it is behind the camera.
    """
    pixels = np.full((len(views.position), corners, 2), np.nan)
    for which, c, b in views.pairs():
        seen = _Pair(rig, c, b, views.position[which], views.rotation[which])
        pixels[which, : seen.pixels.shape[1]] = seen.pixels
    return pixels


def sight_by_tool(rig: PlacedRig, views: Views, corners: int) -> tuple[Floats, Floats]:
    """As :func:`sight`, and how the pixels follow the tool (N, M, 2, 6), as :class:`Slopes` has it."""
    pixels = np.full((len(views.position), corners, 2), np.nan)
    by_tool = np.zeros((*pixels.shape, 6))
    for which, c, b in views.pairs():
        seen = _Pair(rig, c, b, views.position[which], views.rotation[which])
        m = seen.pixels.shape[1]
        pixels[which, :m], by_tool[which, :m] = seen.pixels, seen.zero_unseen_slopes(seen.by_tool())
    return pixels, by_tool


def equivalent_tool_motions(rig: PlacedRig, views: Views) -> Floats:
    """How the tool would have to move (N, 6, K) to show what the unknowns of the rig do, as :class:`Slopes` has it."""
    out = np.zeros((len(views.position), 6, len(rig.unknowns)))
    for which, c, b in views.pairs():
        pair = _Pair(rig, c, b, views.position[which], views.rotation[which])
        for one in _pair_unknowns(rig, c, b):
            if one.what == "pose":
                out[which, :, one.columns] = pair.equivalent_tool_motion(one.camera)
    return out


def sight_and_slopes(rig: PlacedRig, views: Views, corners: int) -> tuple[Floats, Slopes]:
    """As :func:`sight`, and how the pixels follow."""
    rows, pairs = len(views.position), [(which, c, b, _pair_unknowns(rig, c, b)) for which, c, b in views.pairs()]
    most = max((sum(one.width for one in parts if one.what != "pose") for _, _, _, parts in pairs), default=0)
    pixels, by_tool = np.full((rows, corners, 2), np.nan), np.zeros((rows, corners, 2, 6))
    carried = np.zeros((rows, 6, len(rig.unknowns)))
    by_own, own = np.zeros((rows, corners, 2, most)), np.full((rows, most), -1, dtype=np.int64)
    for which, c, b, parts in pairs:
        lens, place = any(one.what == "intrinsics" for one in parts), 0
        seen = _Pair(rig, c, b, views.position[which], views.rotation[which], lens=lens)
        m = seen.pixels.shape[1]
        pixels[which, :m] = seen.pixels
        by_tool[which, :m] = seen.zero_unseen_slopes(seen.by_tool())
        for one in parts:
            if one.what == "pose":
                carried[which, :, one.columns] = seen.equivalent_tool_motion(one.camera)
                continue
            there = slice(place, place + one.width)
            by_own[which, :m, :, there] = seen.zero_unseen_slopes(seen.by_intrinsics if one.camera else seen.by_scale())
            own[which, there] = np.arange(one.columns.start, one.columns.stop)
            place = there.stop
    return pixels, Slopes(by_tool, carried, by_own, own)


class _Part(NamedTuple):
    """What is unknown of a camera or board at a ``place``: the pose, the intrinsics or the scale, in these columns."""

    camera: bool
    place: int
    what: str
    columns: slice

    @property
    def width(self) -> int:
        """How many numbers."""
        return int(self.columns.stop - self.columns.start)


def _pair_unknowns(rig: PlacedRig, c: int, b: int) -> list[_Part]:
    """The unknowns of one camera and one board."""
    return [one for one in _group_unknowns(rig) if one.place == (c if one.camera else b)]


def _group_unknowns(rig: PlacedRig) -> Iterator[_Part]:
    """The unknowns of a rig by what they are of: those of one thing follow each other, all of it."""
    start = 0
    for (camera, place, what), each in groupby(rig.unknowns, lambda one: (one[0].camera, one[0].place, one[0].what)):
        stop = start + len(list(each))
        yield _Part(camera, place, what, slice(start, stop))
        start = stop


def by_corners(rig: PlacedRig, views: Views, moves: Floats) -> Iterator[tuple[Ints, Floats]]:
    """Rows of each pair of a camera and a board, and how their pixels (n, m, 2, K) follow moves (m, K, 3) m of the corners in
    the frame of the board.
    """
    for which, c, b in views.pairs():
        yield which, _Pair(rig, c, b, views.position[which], views.rotation[which]).by_corners(moves)


class _Pair:
    """One camera and one board in n rows: points on their way from the board into the picture."""

    def __init__(
        self, rig: PlacedRig, c: int, b: int, position: Floats, rotation: Floats, *, lens: bool = False
    ) -> None:
        self.camera, board = rig.rig.cameras[c], rig.rig.boards[b]
        self.lens: Place = rig.cameras[c]
        self.sheet: Place = rig.boards[b]
        self.free_lens, self.outside = lens, self.camera.mount == "fixed"
        self.X, self.Y_whole = self.lens.pose, self.sheet.pose
        self.nominal = np.array(board.corners)
        self.corners = rig.corners(b)
        self.Y = self.Y_whole[:3, :3]
        self.position, self.rotation = position, rotation

    @cached_property
    def arms(self) -> Floats:
        """Corners (n, m, 3) m off the tool point, in the axes of the room."""
        on_part = self.corners @ self.Y.T + self.Y_whole[:3, 3]
        if self.outside:  # the board goes with the tool
            return np.asarray(on_part @ self.rotation.transpose(0, 2, 1))
        return np.asarray(on_part - self.position[:, None])  # the camera goes with the tool

    @cached_property
    def to_camera(self) -> Floats:
        """From the axes of the room to those of the camera (n, 3, 3)."""
        X = self.X[:3, :3].T
        return np.broadcast_to(X, self.rotation.shape) if self.outside else X @ self.rotation.transpose(0, 2, 1)

    @property
    def board_rotation(self) -> Floats:
        """From the axes of what the board is mounted on to those of the camera (n, 3, 3)."""
        return self.to_camera @ self.rotation if self.outside else self.to_camera

    @cached_property
    def _projected_corners(self) -> tuple[Floats, Floats, Floats | None]:
        there = self.arms + self.position[:, None] if self.outside else self.arms @ self.rotation
        points = (there - self.X[:3, 3]) @ self.X[:3, :3]
        if self.free_lens:
            return project(self.camera.model, self.lens.values, points)
        return *project_held(self.camera.model, self.lens.values, points), None

    @property
    def pixels(self) -> Floats:
        """Pixels (n, m, 2)."""
        return self._projected_corners[0]

    @property
    def by_point(self) -> Floats:
        """Their derivatives (n, m, 2, 3) by the points before the camera."""
        return self._projected_corners[1]

    @property
    def by_intrinsics(self) -> Floats:
        """Their derivatives (n, m, 2, K) by the intrinsics, of a lens that is free."""
        assert self._projected_corners[2] is not None
        return self._projected_corners[2]

    @cached_property
    def unseen(self) -> Bools:
        """Corners (n, m) behind the camera."""
        return np.asarray(np.isnan(self.pixels[..., 0]))

    def zero_unseen_slopes(self, slopes: Floats) -> Floats:
        """Slopes (n, m, 2, K), zero of a corner behind the camera."""
        if self.unseen.any():
            slopes = np.where(self.unseen[..., None, None], 0.0, slopes)
        return slopes

    def by_tool(self) -> Floats:
        """Derivative (n, m, 2, 6) by a motion of the tool."""
        toward = _in_axes(self.by_point, self.to_camera)
        side = 1.0 if self.outside else -1.0
        return np.concatenate([side * toward, -side * cross(toward, self.arms[:, :, None])], axis=-1)

    def by_corners(self, moves: Floats) -> Floats:
        """Derivative (n, m, 2, K) by moves (m, K, 3) of the corners in the frame of the board."""
        return np.asarray(_in_axes(self.by_point, self.board_rotation) @ (moves @ self.Y.T).transpose(0, 2, 1))

    def equivalent_tool_motion(self, camera: bool) -> Floats:
        """Motions (n, 6, 6) of the tool that show the same as the six increments of the camera's pose, or the board's."""
        place, pose = (self.lens, self.X) if camera else (self.sheet, self.Y_whole)
        on_tool = camera is not self.outside
        to_room = self.rotation if on_tool else np.broadcast_to(np.eye(3), self.rotation.shape)
        spin = to_room @ (pose[:3, :3] @ place.spin)
        # About the part's own origin, which the tool point lies off by this much.
        off = -to_room @ pose[:3, 3] if on_tool else self.position - pose[:3, 3]
        out = np.zeros((len(off), 6, 6))
        out[:, :3, :3] = to_room @ place.origin[:3, :3]
        out[:, :3, 3:] = cross(spin.transpose(0, 2, 1), off[:, None]).transpose(0, 2, 1)
        out[:, 3:, 3:] = spin
        return out if on_tool else -out

    def by_scale(self) -> Floats:
        """Derivative (n, m, 2, 1) by the scale of the board."""
        moves = (self.nominal @ self.Y.T) @ self.board_rotation.transpose(0, 2, 1)
        along = sum(self.by_point[..., k] * moves[:, :, None, k] for k in range(3))
        return np.asarray(along)[..., None]


def cross(a: Floats, b: Floats) -> Floats:
    """Cross products (..., 3): the row ``a`` times the matrix that crosses with ``b``."""
    x, y, z = (b[..., k] for k in range(3))
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = a[..., 1] * z - a[..., 2] * y
    out[..., 1] = a[..., 2] * x - a[..., 0] * z
    out[..., 2] = a[..., 0] * y - a[..., 1] * x
    return out


def _in_axes(rows: Floats, rotation: Floats) -> Floats:
    """Rows (n, m, 2, 3) of each view times its rotation (n, 3, 3)."""
    return np.asarray((rows.reshape(len(rows), -1, 3) @ rotation).reshape(rows.shape))


ROUNDS = 80
STILL = 1e-10  # share of a width that a round changes it by where it has ended
MOST = 400  # views that widths are found from
SMALLEST_M, SMALLEST_RAD = 1e-8, 1e-8
GRID = 60
LEVEL = 0.95
CHANCE = 0.05  # that views scatter by more than their corners although the tool is where the model has it
FEWEST_CORNERS = 4  # of a view that tells a pose
ON_A_LINE = 1e-11  # smallest eigenvalue of what derivatives correlate by; rounding leaves 1e-16 of corners on a line


@dataclass(frozen=True)
class ViewScatter:
    """Standard deviations of a coordinate of the tool: ``place`` m, its 95 % interval, and ``turn`` rad.

    ``sigma_px`` is that of a corner, from within views; ``beyond`` is how much larger the variance between views is than the
    noise of their corners explains, with ``freedom`` numbers.
    """

    place: float
    place_low: float
    place_high: float
    turn: float
    sigma_px: float
    beyond: float
    freedom: float

    @property
    def exceeds_noise(self) -> bool:
        """Whether views scatter by more than chance: the likeliest width of something that is not there is above 0."""
        return self.beyond > float(chdtri(self.freedom, CHANCE)) / self.freedom

    @property
    def rms_m(self) -> float:
        """Root mean square distance of the tool."""
        return float(np.sqrt(3.0) * self.place)


def estimate_view_scatter(e: Floats, C: Floats, rest: float, numbers: float, used: float = 0.0) -> ViewScatter:
    """Widths from motions ``e (N, 6)`` with covariances ``C (N, 6, 6)`` for corners of 1 px.

    ``rest`` px² is what poses of their own leave of all corners, in as many ``numbers``; ``used`` numbers went into a model
    that was fitted to these views.
    """
    square = rest / max(numbers, 1.0)
    whole = float(np.einsum("ni,nij,nj->", e, np.linalg.inv(C), e))
    freedom = max(6.0 * len(e) - used, 1.0)
    lost = 6.0 * len(e) / freedom
    some = slice(None, None, max(1, -(-len(e) // MOST)))
    e, noise = e[some] * np.sqrt(lost), square * C[some]
    place, turn = _widths(e, noise)
    low, high, mean = _interval(e, noise, place, turn)
    return ViewScatter(mean, low, high, turn, float(np.sqrt(square)), whole / freedom / max(square, 1e-300), freedom)


def shrunk(e: Floats, C: Floats, found: ViewScatter) -> Floats:
    """Errors (N, 6) of single views without their noise, that scatter as the tool does."""
    noise = found.sigma_px**2 * C
    T = np.diag([max(found.place, SMALLEST_M) ** 2] * 3 + [max(found.turn, SMALLEST_RAD) ** 2] * 3)
    kept: Floats = (T @ np.linalg.inv(T + noise) @ e[:, :, None])[:, :, 0]
    for part, width in ((slice(0, 3), found.place), (slice(3, 6), found.turn)):
        size = float(np.sqrt(np.mean(kept[:, part] ** 2)))
        kept[:, part] *= width / size if size > 0.0 else 1.0
    return np.asarray(kept)


def _widths(e: Floats, noise: Floats) -> tuple[float, float]:
    precision = np.linalg.inv(noise)
    pull = precision @ e[:, :, None]
    place, turn = (max(float(np.sqrt(np.mean(e[:, k : k + 3] ** 2))), 1e-6) for k in (0, 3))
    for _ in range(ROUNDS):
        before = place, turn
        P = np.linalg.inv(precision + np.diag([place**-2.0] * 3 + [turn**-2.0] * 3))
        m = (P @ pull)[:, :, 0]
        second = m**2 + np.diagonal(P, axis1=1, axis2=2)
        place, turn = (
            max(float(np.sqrt(second[:, k : k + 3].mean())), least) for k, least in ((0, SMALLEST_M), (3, SMALLEST_RAD))
        )
        if abs(place - before[0]) <= STILL * place and abs(turn - before[1]) <= STILL * turn:
            break
    return place, turn


def _interval(e: Floats, noise: Floats, place: float, turn: float) -> tuple[float, float, float]:
    """The 95 % interval of a coordinate's width, all widths likely before, and the root of its mean square."""
    spread = float(np.sqrt(np.median(np.diagonal(noise, axis1=1, axis2=2)[:, :3].min(axis=1))))
    widths = np.linspace(0.0, 3.0 * place + 2.0 * spread / np.sqrt(len(e)), GRID)
    logs = _log_likelihood(e, noise, np.maximum(widths, SMALLEST_M), turn)
    weight = np.exp(logs - logs.max())
    weight /= weight.sum()
    total = np.cumsum(weight)
    low, high = (float(np.interp(p, total, widths)) for p in ((1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0))
    return low, high, float(np.sqrt(weight @ widths**2))


def _log_likelihood(e: Floats, noise: Floats, places: Floats, turn: float) -> Floats:
    """Of widths ``places (K,)``, up to a constant: of the place beside the rotation, whose width is held (K,)."""
    R = np.linalg.inv(noise[:, 3:, 3:] + turn**2 * np.eye(3))
    lever = noise[:, :3, 3:] @ R
    beside = noise[:, :3, :3] - lever @ noise[:, 3:, :3]
    w, V = np.linalg.eigh(beside)
    own = np.einsum("nji,nj->ni", V, e[:, :3] - np.einsum("nij,nj->ni", lever, e[:, 3:]))
    whole = w + places[:, None, None] ** 2
    return np.asarray(-0.5 * (np.log(whole).sum(axis=(1, 2)) + (own**2 / whole).sum(axis=(1, 2))))


def _tell_a_pose(A: Floats) -> Bools:
    """Which views (N,) tell all six of a pose, by derivatives ``A (N, R, 6)``."""
    H = A.transpose(0, 2, 1) @ A
    size = np.sqrt(np.maximum(np.diagonal(H, axis1=1, axis2=2), np.finfo(np.float64).tiny))
    return np.asarray(np.linalg.eigvalsh(H / (size[:, :, None] * size[:, None, :]))[:, 0] > ON_A_LINE)


@dataclass(frozen=True)
class ToolErrors:
    """Motions ``motion (K, 6)`` m, rad that explain the views ``rows (K,)``, and their ``covariance`` for corners of 1 px.

    ``rest`` px² is what they leave, in ``numbers`` beyond the poses.
    """

    rows: Ints
    motion: Floats
    covariance: Floats
    rest: float
    numbers: int

    @staticmethod
    def from_residuals(left: Floats, by_tool: Floats) -> ToolErrors:
        """From what is ``left (N, M, 2)`` px of corners, whose pixels follow the tool ``by_tool (N, M, 2, 6)``.

        Corners on one line tell no pose: nothing says how the tool is rotated about that line.
        """
        told = ~np.isnan(left)
        rows = np.flatnonzero(told.sum(axis=(1, 2)) >= 2 * FEWEST_CORNERS)
        A = (by_tool * told[..., None])[rows].reshape(len(rows), 2 * left.shape[1], 6)
        tells = _tell_a_pose(A)
        rows, A = rows[tells], A[tells]
        flat = np.nan_to_num(left[rows]).reshape(len(rows), 2 * left.shape[1], 1)
        C: Floats = np.asarray(np.linalg.inv(A.transpose(0, 2, 1) @ A), dtype=np.float64)
        e = C @ (A.transpose(0, 2, 1) @ flat)
        count = int(np.count_nonzero(told[rows])) - 6 * len(rows)
        return ToolErrors(rows, e[:, :, 0], C, float(np.sum((flat - A @ e) ** 2)), count)

    @staticmethod
    def concatenate(parts: Sequence[ToolErrors]) -> ToolErrors:
        """Errors of several parts of the views, as of folds; rows count within their part."""
        return ToolErrors(
            np.concatenate([part.rows for part in parts]),
            np.concatenate([part.motion for part in parts]),
            np.concatenate([part.covariance for part in parts]),
            sum(part.rest for part in parts),
            sum(part.numbers for part in parts),
        )

    @property
    def sigma_px(self) -> float:
        """Standard deviation of a corner about the pose that fits its view, as :meth:`scatter` has it."""
        return float(np.sqrt(self.rest / max(self.numbers, 1.0)))

    @cached_property
    def without_noise(self) -> Floats:
        """The motions (K, 6) without what is noise in them, of a model that owes nothing to these views."""
        return shrunk(self.motion, self.covariance, self.scatter())

    def scatter(self, used: float = 0.0, within: float = 0.0) -> ViewScatter:
        """How far off the tool is; ``used`` numbers between and ``within`` views went into a model fitted to them.

        Raises:
            ObservationError: no view that tells a pose.

        """
        if not len(self.rows) or self.numbers <= within:
            raise ObservationError(
                f"No view shows {FEWEST_CORNERS} corners or more: none tells a pose. Measure views that show more of a board.",
                code="no_view",
            )
        return estimate_view_scatter(self.motion, self.covariance, self.rest, self.numbers - within, used)
