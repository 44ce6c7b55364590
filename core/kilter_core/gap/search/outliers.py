"""Visits that nothing in the library could explain: interrupted laser beams, wrong poses.

No visit is masked because the model under test fails there. Each is predicted from all others by geometry and the whole
library at once, every parameter within its prior; only what is far from that prediction is set aside, and named. The
prediction is a redescending fit: it is not bent by those it lets go of, even if they are a third of all.

Wrong readings or an unknown effect: far visits are wrong only where nothing about the pose or the arm predicts them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import scipy.linalg
from scipy.linalg.blas import dtrmm
from scipy.linalg.lapack import dtrtri
from scipy.stats import binom, chi2, f

from kilter_core.gap.search.linear.gram import Stacked
from kilter_core.gap.search.linear.linearized import LinearizedProblem, Tick, ignore_step
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.identify.fit.robust import bulk_scale, descend_to_tukey_weights, median_scale
from kilter_core.types import Bools, Floats, Ints

CHANCE = 0.001  # of setting any good visit aside
POSE = 6  # numbers of a pose; visits with more show markers
UNSEEN = 1e-6
TOO_SMALL = 0.001  # chance of a bulk so far below the noise of the repeats, from which the repeats hold wrong readings
SUPPLE = 0.4  # library parameters per measured scalar above which the library can explain anything
WILD = 2.0  # times the squared limit, when geometry and what was named predict alone
ALIKE = 3  # fits in a row that let go of the same visits, after which the descent ends: its weights go on for dozens
LARGE = 3000  # visits from which the descent is made only where the plain fit leaves any visit far


def outliers(problem: LinearizedProblem, chosen: Sequence[int] = (), tick: Tick = ignore_step) -> Bools:
    """Visits (V,) to set aside. Leave-one-out residual against geometry and library, studentised, robust scale.

    Where the library has more parameters than the data could fix it explains anything, a wild reading too. Then geometry
    and the ``chosen`` columns alone predict, and a visit must be further outside the scatter than any smooth
    effect. ``tick`` is called before every fit, and may raise.
    """
    settings = problem.settings
    size = settings.whitener.shape[-1]
    y, whole = problem.within_priors()
    geometry = problem.G.shape[1]
    limit, alike = _limit(settings)
    supple = whole.width > SUPPLE * settings.used.sum() * size
    found = _find_outlying_visits(problem, whole, y, (limit, alike), supple, tick)
    if supple:
        known = [*range(geometry), *(geometry + k for k in chosen)]
        found |= _find_outlying_visits(problem, whole.only(known), y, (np.sqrt(WILD) * limit, alike), False, tick)
    return found


def stands_out(settings: ProblemSettings, values: Floats) -> bool:
    """Whether any visit is so far from the model at these values that it is worth asking what else could explain it."""
    limit, alike = _limit(settings)
    size = np.sqrt(np.sum(settings.whitened_residuals(values) ** 2, axis=1) / alike)
    return bool(size.max(initial=0.0) > limit)


def _limit(settings: ProblemSettings) -> tuple[float, int]:
    """Size beyond which chance puts hardly any visit, and how many numbers of a visit move together."""
    size = settings.whitener.shape[-1]
    # Errors of the model move all markers of a tool together: as many numbers, but no more independent ones than a point has.
    of_tool = settings.source.tool_numbers
    alike = of_tool // 3 if of_tool > POSE and not settings.noise.absolute else 1
    return float(np.sqrt(chi2.isf(CHANCE / len(settings.used), size / alike))), alike


def _find_outlying_visits(
    problem: LinearizedProblem, X: Stacked, y: Floats, limit_alike: tuple[float, int], supple: bool, tick: Tick
) -> Bools:
    """Visits beyond the limit, if they are wrong readings and no structure. What ``supple`` columns leave refutes no noise."""
    used, (limit, alike) = problem.settings.used, limit_alike
    dimension, X = max(1, round(X.size / alike)), X.condense_columns()

    def sizes(weight: Floats) -> Floats:
        tick()
        every = np.zeros(len(used))
        every[used] = weight
        return np.sqrt(_left_out(X, y, every)[used] / alike)

    start = sizes(np.ones(int(used.sum())))
    far = np.zeros(len(used), dtype=bool)
    if len(used) > LARGE and float(start.max(initial=0.0)) < limit:
        return far

    def beyond(size: Floats, scale: float) -> Bools:
        # A noise that comes from the fit, or is refuted, holds the wrong readings themselves: the bulk says better what it is.
        refuted = not supple and _is_noise_too_large(problem.settings, scale)
        least = 1.0 if problem.settings.trusted and not refuted else 0.0
        return np.asarray(size > limit * max(least, scale))

    known: list[bytes] = []

    def is_selection_stable(size: Floats) -> bool:
        known.append(beyond(size, bulk_scale(size, dimension, median_scale(size, dimension))).tobytes())
        return len(set(known[-ALIKE:])) == 1 and len(known) >= ALIKE

    robust = descend_to_tukey_weights(sizes, start, dimension, is_selection_stable)
    far[used] = beyond(robust.size, robust.scale)
    whole = np.zeros(len(used))
    whole[used] = robust.size
    if not far.any():
        return far
    every = np.zeros(len(used))
    every[used] = robust.weight
    return find_wrong(problem, far, whole, _weighted_fit_residuals(X, y, every))


def _is_noise_too_large(settings: ProblemSettings, scale: float) -> bool:
    """Whether the bulk of the visits, of this scale in units of the noise, is too small for it: wrong readings among the
    repeats made it. A median knows its scale half as well as a mean square does, and the fit took some: each visit counts
    as one number.
    """
    noise = settings.noise
    if noise.repeats is None or not noise.freedom > 0.0:
        return False
    return bool(f.cdf(scale**2, float(settings.used.sum()), noise.freedom) <= TOO_SMALL)


def _left_out(X: Stacked, y: Floats, weight: Floats) -> Floats:
    """Squared studentised distance (V,) of every visit from the weighted fit to all others."""
    beta, upper = _fit(X, y, weight)
    out = np.empty(len(weight))
    for part, columns in X.each():
        visits = slice(part.start // X.size, part.stop // X.size)
        half = dtrmm(1.0, upper, columns.T, trans_a=1).T  # a triangle: half of a product, and faster than solving
        blocks = half.reshape(-1, X.size, X.width)
        w, V = np.linalg.eigh(np.matmul(blocks, blocks.transpose(0, 2, 1)))
        z = np.einsum("vij,vi->vj", V, (y[part] - columns @ beta).reshape(-1, X.size))
        # Without its own visit a direction is off by z / (1 - w h) and known to 1 + h / (1 - w h).
        free = 1.0 - weight[visits, None] * w
        spread = free * (free + w)
        # A visit that nothing else can predict has no residual of its own: its directions count as nothing.
        out[visits] = np.sum(np.where(free > UNSEEN, z**2 / np.maximum(spread, UNSEEN**2), 0.0), axis=1)
    return out


def _weighted_fit_residuals(X: Stacked, y: Floats, weight: Floats) -> Floats:
    """Error (V, m) of every visit against the weighted fit."""
    beta, _ = _fit(X, y, weight)
    return np.concatenate([y[part] - columns @ beta for part, columns in X.each()]).reshape(-1, X.size)


def _fit(X: Stacked, y: Floats, weight: Floats) -> tuple[Floats, Floats]:
    """Amounts (F,) of the weighted fit within the priors, and the inverse (F, F) of the upper triangle of its matrix."""
    H, b = np.eye(X.width), np.zeros(X.width)
    for part, columns in X.each():
        root = np.repeat(np.sqrt(weight[part.start // X.size : part.stop // X.size]), X.size)
        K = columns * root[:, None]
        H += K.T @ K
        b += K.T @ (y[part] * root)
    factor = scipy.linalg.cholesky(H)
    return scipy.linalg.cho_solve((factor, False), b), dtrtri(factor)[0]


PREDICTED = 0.01  # chance of wrong readings that seem to follow from the pose
MOST = 0.4  # share of visits above which it is not known which part is wrong
FEW = 0.08  # share up to which far visits need no gap between them and the others
GAP = 1.5  # times the size of nearly all others that nearly all far visits must have
FEWEST_FAR_VISITS = 3  # far visits from which a pattern of their conditions can be seen
FEWEST_ALONG = 2  # far visits from which a joint can be seen that moves as they do
APART = 0.1  # of the campaign between two visits of a pose that one disturbance does not reach both of
ALIKE_ROWS = 0.5  # of the smaller of two errors, up to which they differ and are the same
DRAWS = 999


def find_wrong(problem: LinearizedProblem, far: Bools, size: Floats, left: Floats) -> Bools:
    """Which of the ``far (V,)`` visits, of these sizes (V,), are wrong readings and not structure of the model's error.

    ``left (V, m)`` is the whitened error of each. An effect, however large, follows from pose, direction, load or
    temperature: it affects neighbours, and the same pose again in the same way, and it moves the tool as a joint or a
    load does.
    Wrong readings do none of that. More than a few must also be separated from the others by a clear gap.
    """
    used, none = problem.settings.used, np.zeros_like(far)
    far = far & ~_comes_again(problem, far, left)
    far &= ~_along_joint_or_load(problem, far, left)
    count = int(far.sum())
    if not count or count > MOST * used.sum():
        return none
    if count > max(2, FEW * used.sum()) and not _stand_apart(size[used & ~far], size[far]):
        return none
    return none if count >= FEWEST_FAR_VISITS and _follows_from_pose(problem, far) else far


def _stand_apart(others: Floats, far: Floats) -> bool:
    """Whether there is a clear gap between nearly all of one and nearly all of the other."""
    return bool(np.quantile(far, 0.1) > GAP * np.quantile(others, 0.99))


def _comes_again(problem: LinearizedProblem, far: Bools, left: Floats) -> Bools:
    """Which far visits (V,) have the same error as another of their pose, long before or after, more than chance has it.

    By chance a visit is far as often as all are, and errs alike as often as far visits of other poses do: readings of one
    disturbance are all wrong alike.
    """
    used, group, out = problem.settings.used, problem.settings.group, np.zeros_like(far)
    place, k = np.arange(len(far)), np.flatnonzero(far)
    partner = used & (group == group[k][:, None]) & (np.abs(place - place[k][:, None]) > APART * len(far))
    alike = _is_alike(left[k])
    other = group[k] != group[k][:, None]
    again = alike & partner[:, k]
    share = (far.sum() - 1) / max(used.sum() - 1, 1) * (np.sum(alike & other) + 1) / (np.sum(other) + 2)
    pairs = int(np.sum(partner) - np.sum(partner[:, k]) / 2)
    if binom.sf(int(np.sum(again)) // 2 - 1, pairs, min(1.0, share)) < PREDICTED:
        out[k] = again.any(axis=1)
    return out


def _is_alike(left: Floats) -> Bools:
    """Which pairs (K, K) of errors (K, m) are one error, but for noise."""
    size = np.linalg.norm(left, axis=1)
    apart = np.linalg.norm(left[:, None] - left, axis=2)
    return np.asarray(apart < ALIKE_ROWS * np.minimum(size[:, None], size))


def _along_joint_or_load(problem: LinearizedProblem, far: Bools, left: Floats) -> Bools:
    """Which far visits (V,) are off as one joint, or one load through one compliance, moves the tool in all of them."""
    out, settings = np.zeros_like(far), problem.settings
    source, which = settings.source, np.flatnonzero(far)
    if not source.observes_tool:
        return out
    columns, n = source.joint_columns(problem.values), source.batch.q.shape[1]
    loads = [
        k
        for effect, at in source.model.effects_with_slices
        if "moments" in effect.needs
        for k in range(at.start, at.stop)
    ]
    first = len(source.model.names) - source.n_library  # of the library among the model's parameters
    loads = [k - first for k in loads if k >= first]

    def by_joint(joint: int) -> Floats:
        return settings.whitening.residual(columns(joint)).reshape(left.shape)

    def by_load(number: int) -> Floats:
        if number < len(loads):
            return problem.W_raw[:, loads[number]].reshape(left.shape)
        # A weight at the tool through gears that are all as soft: each joint deflects as far as its motion is along gravity.
        down = source.model.T_base[:3, :3] @ source.model.robot.gravity
        moved = [columns(joint) for joint in range(n)]
        return settings.whitening.residual(np.sum([one * (one[:, :3] @ down)[:, None] for one in moved], axis=0))

    out[which] = along_one_motion(left[which], which, by_joint, n)
    out[which] |= along_one_motion(left[which], which, by_load, len(loads) + (left.shape[1] % 3 == 0))
    return out


def along_one_motion(left: Floats, which: Ints, motion: Callable[[int], Floats], motions: int) -> Bools:
    """Which of the errors (K, m) lie in the direction in which one joint, or load, the same for all of these, moves the tool.

    ``motion(k)`` (V, m) is how that one of the ``motions`` moves the tool in all visits, of which the errors are those of
    ``which (K,)``. By chance an error lies so near to the motion of its own visit as often as to those of the others: errors
    that are all alike, or arms that move in one plane, prove nothing. Motions, and how many errors are taken, are as many
    more chances.
    """
    out = np.zeros(len(left), dtype=bool)
    if len(left) < FEWEST_ALONG or left.shape[1] < 2:
        return out
    for number in range(motions):
        cosine = _cosines(left, motion(number))
        own = cosine[np.arange(len(left)), which]
        least = np.sort(own)[::-1][FEWEST_ALONG - 1 :]
        by_chance = np.array([np.mean(cosine >= one) for one in least])
        as_many = binom.sf(np.arange(FEWEST_ALONG - 1, len(left)), len(left), by_chance)
        together = least[as_many * motions * len(least) < PREDICTED]
        out |= own >= together.min(initial=np.inf)
    return out


def _cosines(left: Floats, motion: Floats) -> Floats:
    """Cosines (K, V), without sign, between errors (K, m) and motions (V, m)."""
    length = np.linalg.norm(left, axis=1)[:, None] * np.linalg.norm(motion, axis=1)
    return np.asarray(np.abs(left @ motion.T) / np.where(length > 0.0, length, np.inf))


def _follows_from_pose(problem: LinearizedProblem, far: Bools) -> bool:
    """Whether any condition of the poses distinguishes the far ones from the others: by rank, or neighbours in order."""
    pose = np.unique(problem.settings.group, return_inverse=True)[1]
    conditions = _conditions(problem)
    mean = np.stack([np.bincount(pose, c) for c in conditions.T], axis=1) / np.bincount(pose)[:, None]
    label = (np.bincount(pose, far) / np.bincount(pose) > 0.5).astype(np.float64)
    varied = mean[:, np.ptp(mean, axis=0) > 1e-9]
    if label.sum() < FEWEST_FAR_VISITS or not varied.shape[1]:
        return False
    rng = np.random.default_rng(0)
    labels = np.stack([label, *(rng.permutation(label) for _ in range(DRAWS))])
    scores = np.concatenate([_patterns(labels, np.argsort(c, kind="stable")) for c in varied.T], axis=1)
    spread = scores.std(axis=0)
    worst = np.max((scores - scores.mean(axis=0)) / np.where(spread > 0.0, spread, np.inf), axis=1)
    return float(np.mean(worst >= worst[0])) < PREDICTED


def _patterns(labels: Floats, order: Ints) -> Floats:
    """Per row of labels (D, G): how far their mean rank is from the middle, and how many far ones are neighbours."""
    ranked = labels[:, order]
    rank = np.arange(ranked.shape[1]) - 0.5 * (ranked.shape[1] - 1)
    return np.asarray(np.stack([np.abs(ranked @ rank), np.sum(ranked[:, 1:] * ranked[:, :-1], axis=1)], axis=1))


def _conditions(problem: LinearizedProblem) -> Floats:
    """What an effect may follow (V, K): joints, loads, directions, payload and temperature. Not time: disturbances do."""
    batch = problem.settings.source.batch
    parts = [batch.q, np.cos(batch.q), batch.axial]
    parts += [
        v.reshape(len(batch.q), -1)
        for v in (batch.direction, batch.payload_kg, batch.temperature_c, batch.base_tilt_x, batch.base_tilt_y)
        if v is not None
    ]
    return np.asarray(np.nan_to_num(np.hstack(parts)))
