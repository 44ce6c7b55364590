"""How much of what a fit leaves follows the joints or the clock: error of the model, told from noise without any repeats.

Noise does not know where the arm stands; what a model lacks does. So what is left is read as noise plus joint errors that
are smooth functions of the joint coordinates or of the order of the rows, seen through the levers of the joints. The ratio
of their variances has a restricted likelihood (REML; Patterson and Thompson 1971), as for a Gaussian process whose kernel
is a product of von Mises functions in its leading harmonics (Rasmussen and Williams 2006, 4.2, 5.4). Its mean over all
ratios and kernels counts, not the likeliest: small errors hide in the noise, and no choice hangs on the last digit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg.lapack import dsytrd
from scipy.special import expit, ive, logit, logsumexp

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.uncertainty.clustered import RowNumbers
from kilter_core.observations import Observations
from kilter_core.observations.clock import read_clock
from kilter_core.types import QUANTILE, Bools, Floats, Ints

HARMONICS = 2  # of one joint; of pairs of joints the first
OVER_TIME = 4  # half waves over the rows in their order
BENDS = (0.2, 0.8)  # concentrations of the kernel: smooth and rough
TAKEN = 0.5  # of a direction, beyond which the fit has followed it so that no residual shows it
SHARES = np.linspace(0.005, 0.995, 100) ** 2  # denser towards none: a share is the square of what a deviation shows
LACKING = 0.05  # prior probability that a model lacks something, before its residuals are seen
EQUATIONS_PER_JOINT = 3  # equations left over for each joint
SMALL = 1e-9


@dataclass(frozen=True)
class Structure:
    """What is left of the measured points by a fit: ``share``, 0 to 1, of its variance is smooth, as expected over the
    posterior; ``lacking`` is the posterior probability that the model lacks anything smooth at all. ``reach`` says how many
    times further than 1.96 standard deviations 95 % of the coordinates reach that a fit without their pose would leave.
    """

    share: float
    lacking: float
    reach: float = 1.0

    def at_most(self, rough: float = float("inf")) -> float:
        """Share that may be the model's where no noise is known: all as soon as it lacks something.

        What is rough in it looks like noise; where something else says how large that may be, a ``rough`` share at most.
        """
        return min(self.lacking + (1.0 - self.lacking) * self.share, self.share + self.lacking * rough)

    @staticmethod
    def from_fit(fit: Fit) -> Structure | None:
        """Read the residuals of a fit; None where rows measure no places, or too few are left to tell."""
        problem = fit.problem
        rows = problem.measurement.observations
        if not problem.measurement.observes_places or len(fit.residual.points) != len(rows):
            return None
        if len(fit.J) > sum(problem.block_size(block) for block in fit.residual.blocks):
            return None  # a filter goes on from what it knew
        poses, each = _Poses.from_observations(rows), RowNumbers.from_fit(fit)
        A, r, L = poses.mean(each.A), poses.mean(each.r), poses.mean(each.L)
        of_points = np.zeros(r.shape, dtype=bool)
        of_points[:, : fit.residual.points[0].size] = True
        said = (np.abs(A).max(axis=2) > 0.0).reshape(-1)
        basis = _fitted_directions(A.reshape(len(said), -1)[said])
        left, points = _remove_fitted_part(basis, r.reshape(-1)[said]), of_points.reshape(-1)[said]
        freedom = len(left) - basis.shape[1]
        if freedom < EQUATIONS_PER_JOINT * L.shape[2] or not np.any(left):
            return None
        sliding = np.array([joint.kind == "prismatic" for joint in problem.model.robot.joints])
        shapes, kind = _shapes(rows.q[poses.first], sliding)
        levers = L.reshape(len(said), -1)[said]
        of_pose = np.nonzero(said)[0] // r.shape[1]
        drifting = _over_time(L, poses.when, of_points).reshape(len(said), -1)[said]
        smooth = [_Kernel.of_shapes(levers, shapes * _weights(bend)[kind], of_pose, basis, left) for bend in BENDS]
        found = _read([*smooth, _Kernel.of_columns(_remove_fitted_part(basis, drifting), left)], left, freedom, points)
        without = _without_pose(basis, left, of_pose)[points]
        return replace(found, reach=_reach(without / np.sqrt(left @ left / freedom)))


@dataclass(frozen=True)
class _Poses:
    """Poses with their ``first`` row, and ``when`` it was measured, from 0 to 1 over the rows in the order of time.

    Rows of a pose count together, as much as it has visits (``root`` of their number).
    """

    groups: Ints
    first: Ints
    when: Floats
    root: Floats

    @staticmethod
    def from_observations(rows: Observations) -> _Poses:
        groups = rows.pose_groups()
        first = np.unique(groups, return_index=True)[1]
        visited = np.unique(np.stack([groups, rows.visits()]), axis=1)[0]
        place = np.argsort(read_clock(rows).order)
        return _Poses(groups, first, place[first] / max(len(rows) - 1, 1), np.sqrt(np.bincount(visited)))

    def mean(self, values: Floats) -> Floats:
        """Mean (G, ...) over the rows of each pose, times the root of its visits: the noise of all is the same again."""
        order = np.argsort(self.groups, kind="stable")
        count = np.bincount(self.groups)
        total = np.add.reduceat(values[order], np.concatenate([[0], np.cumsum(count)[:-1]]))
        return np.asarray(total * (self.root / count).reshape(-1, *[1] * (values.ndim - 1)))


@dataclass(frozen=True)
class _Kernel:
    """A covariance K (R, R) of what the fit did not follow, by the smaller of itself and X'X where K = XX'.

    ``gram`` is that, ``start`` the residuals r or X'r, ``of_rows (R,)`` the diagonal of K.
    """

    gram: Floats
    start: Floats
    of_rows: Floats

    @staticmethod
    def of_columns(columns: Floats, left: Floats) -> _Kernel:
        """From columns X (R, K) and residuals ``left (R,)``."""
        wide = columns.shape[1] > columns.shape[0]
        gram, start = (columns @ columns.T, left) if wide else (columns.T @ columns, columns.T @ left)
        return _Kernel(gram, start, np.sum(columns**2, axis=1))

    @staticmethod
    def of_shapes(levers: Floats, shapes: Floats, of_pose: Ints, basis: Floats, left: Floats) -> _Kernel:
        """From levers (R, n) times shapes (G, K) of each row's pose, without the fitted directions ``basis (R, k)``.

        Every joint has the same shapes: their covariance is that of the levers times that of the shapes, entry by entry.
        """
        if levers.shape[1] * shapes.shape[1] <= len(levers):
            return _Kernel.of_columns(_remove_fitted_part(basis, _products(levers, shapes[of_pose])), left)
        whole = (levers @ levers.T) * (shapes @ shapes.T)[np.ix_(of_pose, of_pose)]
        seen = whole @ basis
        seen -= basis @ (0.5 * basis.T @ seen)
        both = seen @ basis.T
        whole -= both
        whole -= both.T
        return _Kernel(whole, left, np.diagonal(whole).copy())

    def log_likelihoods(self, left: Floats, freedom: int, ratios: Floats) -> Floats:
        """Logarithms of the restricted likelihoods of variance ratios, against that of noise alone."""
        whole = float(left @ left)
        log_det, part = _solve_shifted(self.gram, self.start, ratios)
        rest = part + SMALL * whole if self.start is left else whole - ratios * part
        return np.asarray(-0.5 * (log_det + freedom * np.log(np.maximum(rest / whole, SMALL))))


def _read(kernels: list[_Kernel], left: Floats, freedom: int, points: Bools) -> Structure:
    """Average over kernels and shares."""
    likelihood, shares = [], []
    for kernel in kernels:
        size = float(np.sum(kernel.of_rows)) / freedom
        if size <= 0.0:
            continue
        here = float(np.mean(kernel.of_rows[points])) * len(points) / freedom / size
        ratio = SHARES / (1.0 - SHARES)
        likelihood.append(kernel.log_likelihoods(left, freedom, ratio / size))
        shares.append(ratio * here / (1.0 + ratio * here))
    if not likelihood:
        return Structure(0.0, 0.0)
    of, share = np.concatenate(likelihood), np.concatenate(shares)
    evidence = float(logsumexp(of)) - np.log(len(of))  # logarithm of the Bayes factor against noise alone
    mean = float(np.exp(of - logsumexp(of)) @ share)
    return Structure(mean, float(expit(evidence + logit(LACKING))))


def _without_pose(basis: Floats, left: Floats, pose: Ints) -> Floats:
    """What a fit without its pose would leave of each number (R,), times what makes the variance of noise one again."""
    out, kept = np.empty_like(left), 1.0 - np.sum(basis**2, axis=1)
    first, count = np.unique(pose, return_index=True, return_counts=True)[1:]  # the rows of a pose stand together
    for size in np.unique(count):  # poses with as many numbers at once
        rows = first[count == size, None] + np.arange(size)
        apart = np.eye(size) - basis[rows] @ basis[rows].transpose(0, 2, 1)
        out[rows] = np.einsum("pij,pj->pi", np.linalg.pinv(apart, rcond=SMALL, hermitian=True), left[rows])
    return np.asarray(out * np.sqrt(np.maximum(kept, 0.0)))


def _reach(z: Floats) -> float:
    return max(1.0, float(np.quantile(np.abs(z), 0.95)) / QUANTILE)


def _solve_shifted(gram: Floats, start: Floats, ratios: Floats) -> tuple[Floats, Floats]:
    """Return log det B and start' inv(B) start for each B = I + ratio * gram, in a third of the time of its eigenvectors.

    Both are read off the tridiagonal form of ``gram``, which is lost, that begins with ``start`` (Golub and Meurant 2010,
    chapter 7).
    """
    length, mirror = float(np.linalg.norm(start)), start.copy()
    mirror[0] += np.copysign(length, start[0])
    mirror /= max(float(np.linalg.norm(mirror)), SMALL * SMALL)
    moved = gram @ mirror
    moved -= (mirror @ moved) * mirror
    mirrored = np.outer(mirror, 2.0 * moved)
    gram -= mirrored
    gram -= mirrored.T  # ``start`` lies on its first axis
    _, along, beside, _, _ = dsytrd(gram.T, lower=1, lwork=16 * len(gram), overwrite_a=1)
    pivots = 1.0 + np.outer(along[::-1], ratios)
    for pivot, following, next_to in zip(pivots[:-1], pivots[1:], np.outer(beside[::-1] ** 2, ratios**2), strict=True):
        following -= next_to / pivot
    return np.sum(np.log(pivots), axis=0), length**2 / pivots[-1]


def _fitted_directions(J: Floats) -> Floats:
    """Orthonormal directions (R, k) of the residuals that the fit has followed; ``J (R, F)`` per prior sigma."""
    squares, V = np.linalg.eigh(J.T @ J)
    kept = squares > TAKEN / (1.0 - TAKEN)
    return np.asarray(np.linalg.qr(J @ V[:, kept])[0])


def _remove_fitted_part(basis: Floats, columns: Floats) -> Floats:
    return np.asarray(columns - basis @ (basis.T @ columns))


def _over_time(levers: Floats, when: Floats, points: Bools) -> Floats:
    """What joints and instrument that drift move of the numbers (G, R) of each pose, (G, R, K); ``when (G,)`` is 0 to 1."""
    waves = np.cos(np.pi * np.outer(when, np.arange(1, OVER_TIME + 1)))[:, None]
    out = _products(levers, waves)
    count = int(points[0].sum())
    if count % 3:
        return out
    along = np.zeros((levers.shape[1], 3))
    along[:count] = np.tile(np.eye(3), (count // 3, 1)) * np.sqrt(np.mean(levers[points] ** 2) * 3.0)
    return np.concatenate([out, _products(along, waves)], axis=2)


def _products(levers: Floats, shapes: Floats) -> Floats:
    """Levers (..., n) times shapes (..., K): (..., n K)."""
    out = levers[..., :, None] * shapes[..., None, :]
    return np.asarray(out.reshape(*out.shape[:-2], -1))


def _shapes(q: Floats, sliding: Bools) -> tuple[Floats, Ints]:
    """Smooth shapes (G, K) over the joint coordinates (G, n), and the kind (K,) of each."""
    span = np.maximum(np.ptp(q, axis=0), SMALL)
    angle = np.where(sliding, np.pi * (q - q.min(axis=0)) / span, q)
    one = [[np.stack([np.cos(m * a), np.sin(m * a)], axis=1) for m in range(1, HARMONICS + 1)] for a in angle.T]
    out, kind = [np.ones((len(q), 1))], [0]
    for of in one:
        for m, pair in enumerate(of, start=1):
            out.append(pair)
            kind += [m, m]
    for a, b in combinations(one, 2):
        out.append(np.einsum("gi,gj->gij", a[0], b[0]).reshape(len(q), -1))
        kind += [HARMONICS + 1] * 4
    return np.concatenate(out, axis=1), np.array(kind)


def _weights(bend: float) -> Floats:
    """Root of the weight, against the constant, of each kind of shape: constant, harmonics of a joint, of a pair."""
    one = 2.0 * ive(np.arange(HARMONICS + 1), bend) / ive(0, bend)
    return np.asarray(np.sqrt(np.concatenate([[1.0], one[1:], [one[1] ** 2]])))
