"""How far the tool is from where a model has it, seen through views that are noisy themselves.

A single view tells the tool's place along its line of sight ten times worse than across it. So what views say is taken apart:
the noise of a view is what its corners scatter by about the pose that fits them, which owes nothing to the model; what views
scatter by beyond that is the tool's. Both are normal; their widths are the likeliest (EM), and the errors of single views are
shrunk by what is noise in them, and then scaled so that together they scatter as the tool does (Louis 1984).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from kilter_core.errors import ObservationError
from kilter_core.types import Bools, Floats, Ints

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
