"""Covariance of the parameters that holds when the rows of a pose are not independent of each other.

Three shots of one stop share the way the arm settled, and repeats of a pose share what the model gets wrong there: they
are one piece of evidence, not three. The covariance is a sandwich clustered by pose. Its middle is what the scatter of
all poses together says, one covariance of what rows of a pose share and one of what they do not; and, as far as poses
differ by more than chance, what each pose itself says (Liang and Zeger 1986, corrected as CR2 of Bell and McCaffrey
2002; mixed as Ledoit and Wolf 2004). By the poses alone, combinations of parameters would look certain, because there are
fewer poses than it takes to see them scatter.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.special import stdtrit

from kilter_core.identify.fit.least_squares import HUBER_SIGMAS, Fit, freedom_by_group
from kilter_core.identify.fit.problem import HOLD
from kilter_core.identify.fit.robust import Loss, row_dimension, row_sizes, tukey_limit
from kilter_core.measurement.kind import TURNS, Spanned
from kilter_core.types import QUANTILE, Bools, Floats, Ints

FOLLOWED = 0.02  # share of the noise below which the fit follows a pose in a direction, so that no residual shows it
SMALL = 1e-12  # share of the largest below which a direction of the scores is none

ROUNDS = 10  # of scoring, each half a step
LEAST = 0.003  # share of what is the same at every pose: without any, poses would be taken as exact across their levers
POSES_PER_SHARE = 4  # poses for each share that is estimated


def with_clustered_covariance(fit: Fit) -> Fit:
    """The fit with the covariance clustered by pose, and the ``freedom`` of its scale.

    Poses that weigh themselves by all of their covariance, as views do, need no scatter to tell how theirs is: the fit follows
    best what they know best, so by what it leaves of that they seemed a tenth more certain than their pixels.

    It is scaled so that 1.96 sigma are half the 95 % interval of Student's t. Distances between poses and contacts have
    no rows of their own: their fits are returned as they are, and so are those of filters and those clustered already.
    """
    problem = fit.problem
    if fit.freedom is not None:
        return fit
    groups = problem.measurement.observations.pose_groups()
    if not problem.measurement.observes_places:
        return fit
    if len(fit.J) > sum(problem.block_size(block) for block in fit.residual.blocks):
        return fit  # a filter goes on from what it knew, and takes the noise it is given
    each = RowNumbers.from_fit(fit)
    A, r = each.A, each.r
    total = products(A, A)
    eye, known = np.eye(len(total)), problem.prior_information()
    held = eye[:0] if problem.held is None else problem.held
    bend = robust_curvature_factor(fit)
    H = bend * total + known + HOLD * held.T @ held
    bread: Floats = np.asarray(np.linalg.inv(H), dtype=np.float64)
    numbers = problem.measurement.numbers()
    left = max(numbers - bend * float(np.trace(bread @ total)), 1.0)
    weighed = problem.measurement.observations.pose_weight is not None
    shared = (
        total
        if weighed
        else _pooled_score_covariance(each, groups, _residual_inflation(fit, each, bend * bread, numbers / left))
    )
    meat = shrink_score_covariance(shared, *scores_by_pose(A, r, groups, bread))
    around = sandwich(H, meat, H - bend * total, known)
    scale = as_normal(problem.prior_sigma, left)
    return replace(fit, covariance=around * np.outer(scale, scale) + _of_few(fit, left), freedom=left)


def sandwich(H: Floats, meat: Floats, rest: Floats, known: Floats) -> Floats:
    """Covariance (F, F) around the minimum of a matrix ``H`` whose scores have the covariance ``meat``.

    ``rest`` is the part of ``H`` that no measurement made, which pulls at values ``known`` so well. Through the root of
    ``H`` and not its inverse: between bread as large as a prior the rounding of a meat that is 1e11 times as large left
    deviations above the prior, where cameras cannot tell two parameters apart.
    """
    L = cholesky(H, lower=True)
    half = solve_triangular(L, solve_triangular(L, meat, lower=True).T, lower=True)
    around = solve_triangular(L, solve_triangular(L, 0.5 * (half + half.T), lower=True, trans=1).T, lower=True, trans=1)
    pull = cho_solve((L, True), rest)
    return np.asarray(around + pull @ np.linalg.solve(known, pull.T))


def as_normal(sigma: Floats, freedom: float) -> Floats:
    """Standard deviations so scaled that 1.96 of them are half of Student's 95 % interval."""
    return np.asarray(sigma * float(stdtrit(freedom, 0.975)) / QUANTILE)


def _of_few(fit: Fit, left: float) -> Floats:
    """What is added (F, F) because the noise of a kind is known by fewer numbers than ``left``, those of all kinds together.

    Where a tracker's frame stands a dozen points say, whose noise is known by what they leave, and not by all corners beside.
    It is added as the noise of the kind goes into the parameters: scaled one by one these would no longer cancel each other.
    """
    apart, start, more = freedom_by_group(fit), 0, np.zeros_like(fit.covariance)
    for block in fit.residual.blocks if apart else ():
        J = fit.J[start : start + fit.problem.block_size(block)]
        start += len(J)
        own, all_kinds = (float(stdtrit(f, 0.975)) for f in (min(apart[block.group], left), left))
        moved = J @ fit.covariance
        more += ((own**2 - all_kinds**2) / QUANTILE**2) * moved.T @ moved
    return more


def robust_curvature_factor(fit: Fit) -> float:
    """Mean slope of a robust loss's pull over its mean weight, by which the normal matrix is too certain (Huber 1981)."""
    if fit.problem.loss == "linear":
        return 1.0
    size, dimension = row_sizes(fit), row_dimension(fit.problem)
    loss = Loss("huber", HUBER_SIGMAS) if fit.problem.loss == "huber" else Loss("tukey", tukey_limit(dimension))
    weight = loss.weight(size)
    bend = (1.0 - 1.0 / dimension) * weight + loss.slope(size) / dimension
    return float(np.mean(bend) / np.mean(weight))


def _residual_inflation(fit: Fit, each: RowNumbers, bread: Floats, of_all: float) -> Floats:
    """What makes up (R,) for what the parameters took of each number, of which ``of_all`` is the mean.

    Where several kinds were measured each has its own: a dozen points give up a third of theirs, and thousands of corners
    next to nothing.
    """
    measurement, out = fit.problem.measurement, np.full(len(each.group), of_all)
    for kind in measurement.kinds if len(measurement.kinds) > 1 else ():
        of = np.array([group in (kind.group, *((TURNS,) if kind is measurement.tool else ())) for group in each.group])
        A = each.A[:, of]
        if (kind is measurement.tool or kind.follows_tool) and of.any():
            numbers = kind.numbers()
            out[of] = numbers / max(numbers - float(np.trace(bread @ products(A, A))), 1.0)
    return out


def _pooled_score_covariance(each: RowNumbers, groups: Ints, lost: Floats) -> Floats:
    """Covariance (F, F) of the scores, had all poses the same scatter: shared by the rows of a pose, and each row's own.

    ``lost (R,)`` makes up for what the parameters took from the poses. Numbers that a row has not say nothing of the scatter.
    """
    A, told = each.A, each.told.astype(np.float64)
    count = _sum_by_pose(told, groups)
    seen, own_count = count > 0.0, np.maximum(count, 1.0)
    mean = _sum_by_pose(each.r, groups) / own_count
    apart = (each.r - mean[groups]) * told
    both = np.asarray(seen.T @ seen.astype(np.float64))
    own = apart.T @ apart / np.maximum(told.T @ told - both, 1.0)
    scaled = np.sqrt(lost) * mean
    common = scaled.T @ scaled / np.maximum(both, 1.0)
    if len(A) > len(count):
        common = _bound_common_covariance(common - own * float(np.mean(1.0 / own_count[seen])), own, int(count.max()))
    order = np.argsort(groups, kind="stable")
    start = np.searchsorted(groups[order], np.arange(len(count)))
    whole = np.add.reduceat(A[order], start)
    lever = np.add.reduceat(each.L[order], start) / own_count[:, :, None]
    # The fit takes its share of the scatter; what rows have of their own is known already.
    known = own / np.sqrt(own_count[:, :, None] * own_count[:, None, :])
    of_poses = scatter_of_poses(scaled, lever, common, known, None if seen.all() else seen)
    return products(whole, of_poses @ whole) + products(A, own @ A)


def _sum_by_pose(values: Floats, groups: Ints) -> Floats:
    """Sums (G, R) of values (N, R) over the rows of each pose."""
    return np.stack([np.bincount(groups, weights=column) for column in values.T], axis=1)


def products(a: Floats, b: Floats) -> Floats:
    """Sum over the first two axes of (N, R, F) times (N, R, F): (F, F)."""
    return np.asarray(a.reshape(-1, a.shape[2]).T @ b.reshape(-1, b.shape[2]))


def scores_by_pose(A: Floats, r: Floats, groups: Ints, bread: Floats) -> tuple[Floats, Floats]:
    """Scores (G, F) of the poses, corrected for what the fit took from them; and of what it took wholly, (F, F)."""
    scores, unseen = [], np.zeros_like(bread)
    for J, e in _batches(A, r, groups):
        shown, V = np.linalg.eigh(np.eye(J.shape[1]) - J @ bread @ J.transpose(0, 2, 1))
        seen = shown > FOLLOWED
        root = np.where(seen, 1.0 / np.sqrt(np.where(seen, shown, 1.0)), 0.0)
        rotated = V.transpose(0, 2, 1) @ J
        scores.append(np.einsum("gn,gnp->gp", root * np.einsum("gmn,gm->gn", V, e), rotated))
        hidden = (rotated * ~seen[:, :, None]).reshape(-1, J.shape[2])
        unseen += hidden.T @ hidden
    return np.concatenate(scores), unseen


def shrink_score_covariance(shared: Floats, scores: Floats, unseen: Floats) -> Floats:
    """The middle of the sandwich (F, F).

    What the poses say by themselves counts as far as it differs from what they share by more than chance makes it.
    """
    w, V = np.linalg.eigh(shared)
    kept = w > SMALL * w[-1]
    root, back = V[:, kept] / np.sqrt(w[kept]), V[:, kept] * np.sqrt(w[kept])
    own = scores @ root
    seen = own.T @ own + root.T @ unseen @ root
    size = np.einsum("gp,gp->g", own, own)
    chance = float(np.sum(size**2) - np.sum((own.T @ own) ** 2) / len(own))
    differs = float(np.sum((seen - np.eye(len(seen))) ** 2))
    share = min(1.0, chance / differs) if differs > 0.0 else 1.0
    return np.asarray(back @ (share * np.eye(len(seen)) + (1.0 - share) * seen) @ back.T)


def _bound_common_covariance(common: Floats, own: Floats, most: int) -> Floats:
    """What rows share, as estimated; where chance makes it negative, no further than the mean of ``most`` rows allows.

    Cut off at zero it would be too large on average.
    """
    w, V = np.linalg.eigh(own)
    root = V * np.sqrt(np.maximum(w, SMALL * max(float(w[-1]), SMALL)))
    relative = np.linalg.solve(root, np.linalg.solve(root, common).T)
    size, rotation = np.linalg.eigh(0.5 * (relative + relative.T))
    sides = root @ rotation
    return np.asarray((sides * np.maximum(size, -0.9 / most)) @ sides.T)


def _batches(A: Floats, r: Floats, groups: Ints) -> Iterator[tuple[Floats, Floats]]:
    """Jacobians (K, n, F) and residuals (K, n) of the poses, those of as many rows together.

    A pose of more numbers than parameters is reduced to as many numbers as parameters, which say the same of them.
    """
    order = np.argsort(groups, kind="stable")
    count = np.bincount(groups)
    start = np.concatenate([[0], np.cumsum(count)])
    each, size = A.shape[1:]
    for rows in np.unique(count):
        place = order[start[:-1][count == rows][:, None] + np.arange(rows)]
        J, e = A[place].reshape(len(place), rows * each, size), r[place].reshape(len(place), rows * each)
        if rows * each > size:
            Q, J = np.linalg.qr(J)
            e = np.einsum("gnm,gn->gm", Q, e)
        yield J, e


# What each row of a fit says, in as many numbers as it follows.
# A view has two numbers for each corner and follows sixteen at most: the tool's six and those of lens and scale. What
# is left of the others is noise of corners that no error of the arm moves. Read with the rest, 96 numbers of a few
# dozen views hide how poses scatter, and corners that are far off look like poses that are.


@dataclass(frozen=True)
class RowNumbers:
    """Derivatives ``A (N, R, F)`` in prior sigmas, residuals ``r (N, R)`` and levers of the joints ``L (N, R, n)``, whitened;
    ``told (N, R)`` says which numbers each row has, and ``group`` (R) of which noise group they are.
    """

    A: Floats
    r: Floats
    L: Floats
    told: Bools
    group: tuple[str, ...]

    @staticmethod
    def from_fit(fit: Fit) -> RowNumbers:
        """Of the rows of a fit; views in a fit whose numbers are shortened already, and rows of a filter, as they are."""
        problem, rows = fit.problem, len(fit.problem.measurement.observations)
        here = problem.linearise(fit.values, fit.residual)
        A, r = problem.by_row(here)
        L, start, parts = levers(fit), 0, []
        for block, root in zip(fit.residual.blocks, problem.roots(fit.residual), strict=True):
            each = problem.block_size(block) // rows
            own = slice(start, start + each)
            start += each
            told = ~np.isnan(block.r).reshape(rows, -1)
            part = RowNumbers(A[:, own], r[:, own], L[:, own], told[:, :each], (block.group,) * each)
            if isinstance(block.slopes, Spanned) and each == told.shape[1]:  # not shortened yet
                part = part.project_on_span(block.slopes.span, root, told)
            parts.append(part)
        return RowNumbers(
            np.concatenate([p.A for p in parts], axis=1),
            np.concatenate([p.r for p in parts], axis=1),
            np.concatenate([p.L for p in parts], axis=1),
            np.concatenate([p.told for p in parts], axis=1),
            tuple(group for p in parts for group in p.group),
        )

    def project_on_span(self, span: Floats, root: Floats | None, told: Floats) -> RowNumbers:
        """As the numbers that move along a ``span (N, R, k)``, each row's own; a robust loss weighs them by a ``root``."""
        weight = (
            np.ones(told.shape) if root is None else np.broadcast_to(root, (*root.shape[:2], 2)).reshape(told.shape)
        )
        weight = weight * told
        Q = np.linalg.qr(span * weight[:, :, None])[0].transpose(0, 2, 1)
        some = np.repeat(told.any(axis=1, keepdims=True), Q.shape[1], axis=1)
        A, r, L = Q @ self.A, (Q @ self.r[:, :, None])[:, :, 0], Q @ (weight[:, :, None] * self.L)
        return RowNumbers(A, r, L, some, self.group[:1] * Q.shape[1])


# How the scatter of poses differs from pose to pose: joints come to rest a little off, and far poses show more of it.
# A joint that settles with the same scatter everywhere moves the tool by its lever, which is what its compliance does
# too: taken as the same scatter at every pose it would leave compliances far too sure.


def levers(fit: Fit) -> Floats:
    """What a rotation of each joint moves of every row (N, R, n), whitened as the residuals are."""
    problem = fit.problem
    prediction, J = problem.model.joint_jacobian(problem.batch, fit.values, problem.measurement.reads_joints)
    moved = problem.measurement.residual(prediction, J)
    parts = [problem.over_sigma_slope(block).reshape(len(J), -1, J.shape[2]) for block in moved.blocks]
    whole = np.concatenate(parts, axis=1)
    return whole if problem.weights.rows is None else whole * np.sqrt(problem.weights.rows)[:, None, None]


def scatter_of_poses(mean: Floats, lever: Floats, common: Floats, known: Floats, seen: Bools | None = None) -> Floats:
    """Covariance (G, R, R) of what the rows of each pose share, by scoring of variance components.

    ``mean (G, R)`` are the residuals of the poses, ``lever (G, R, n)`` what the joints move there. A share of ``common
    (R, R)``, the same at every pose, and of each joint's settling adds to what is ``known (G, R, R)`` of the rows' own.
    Numbers that a pose lacks, by ``seen (G, R)``, take no part there: zeros would say that it scatters less.
    """
    G, R, n = lever.shape
    flat = np.broadcast_to(common, (G, *common.shape))
    if seen is not None:
        flat = flat * (seen[:, :, None] & seen[:, None, :])
        known = np.where(seen[:, :, None] & seen[:, None, :], known, np.eye(R))
    if POSES_PER_SHARE * (n + 1) > G or np.linalg.eigvalsh(common)[0] <= 0.0:
        return flat
    size = np.einsum("gij,gij->j", lever, lever) / np.trace(common) / G
    scaled = lever / np.sqrt(np.where(size > 0.0, size, np.inf))  # a joint that moves nothing has no share
    share = np.concatenate([[1.0], np.zeros(n)])
    for _ in range(ROUNDS):
        inverse = np.asarray(np.linalg.inv(_together(share, flat, scaled) + known), dtype=np.float64)
        share = 0.5 * (share + _estimate_scatter_shares(inverse, mean, scaled, flat))
        share[0] = max(share[0], LEAST)
    return _together(share, flat, scaled)


def _together(share: Floats, flat: Floats, scaled: Floats) -> Floats:
    return np.asarray(share[0] * flat + (scaled * share[1:]) @ scaled.transpose(0, 2, 1))


def _estimate_scatter_shares(inverse: Floats, mean: Floats, scaled: Floats, flat: Floats) -> Floats:
    """Shares (1 + n,), none negative, that the residuals of the poses ask for under these inverse covariances."""
    n = scaled.shape[2]
    scaled_inverse = inverse @ scaled
    through = inverse @ flat
    M = np.empty((n + 1, n + 1))
    M[0, 0] = np.einsum("gij,gji->", through, through)
    M[0, 1:] = M[1:, 0] = np.einsum("gij,gij->j", scaled_inverse, flat @ scaled_inverse)
    M[1:, 1:] = np.sum((scaled.transpose(0, 2, 1) @ scaled_inverse) ** 2, axis=0)
    weighed = np.einsum("gij,gj->gi", inverse, mean)
    v = np.concatenate(
        [
            [np.einsum("gi,gij,gj->", weighed, flat, weighed)],
            np.sum(np.einsum("gij,gi->gj", scaled, weighed) ** 2, axis=0),
        ]
    )
    root = np.linalg.cholesky(M + 1e-9 * np.trace(M) * np.eye(n + 1))
    from scipy.optimize import nnls  # who only asks what a fit left does not compute it

    return np.asarray(nnls(root.T, np.linalg.solve(root, v))[0])
