"""Wrong readings or an unknown effect: far visits are wrong only where nothing about the pose or the arm predicts them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.stats import binom

from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.types import Bools, Floats, Ints

PREDICTED = 0.01  # chance of wrong readings that seem to follow from the pose
MOST = 0.4  # share of visits above which it is not known which part is wrong
FEW = 0.08  # share up to which far visits need no gap between them and the others
GAP = 1.5  # times the size of nearly all others that nearly all far visits must have
FEWEST_FAR_VISITS = 3  # far visits from which a pattern of their conditions can be seen
FEWEST_ALONG = 2  # far visits from which a joint can be seen that moves as they do
APART = 0.1  # of the campaign between two visits of a pose that one disturbance does not reach both of
ALIKE = 0.5  # of the smaller of two errors, up to which they differ and are the same
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
    return np.asarray(apart < ALIKE * np.minimum(size[:, None], size))


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
