"""Wrong readings or an unknown effect: far visits are wrong only where nothing about the pose predicts them."""

from __future__ import annotations

import numpy as np
from scipy.stats import binom

from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.types import Bools, Floats, Ints

PREDICTED = 0.01  # chance of wrong readings that seem to follow from the pose
MOST = 0.4  # share of visits above which it is not known which part is wrong
FEW = 0.08  # share up to which far visits need no gap between them and the others
GAP = 1.5  # times the size of nearly all others that nearly all far visits must have
FEWEST_FAR_VISITS = 3  # far visits from which a pattern can be seen
APART = 0.1  # of the campaign between two visits of a pose that one disturbance does not reach both of
DRAWS = 999


def are_wrong(problem: LinearizedProblem, far: Bools, size: Floats) -> bool:
    """Whether the ``far (V,)`` visits, of these sizes (V,), are wrong readings and not structure of the model's error.

    An effect, however large, follows from pose, direction, load or temperature: it affects neighbours, and the same
    pose again. Wrong readings do neither. More than a few must also be separated from the others by a clear gap.
    """
    used = problem.settings.used
    count = int(far.sum())
    if not count or count > MOST * used.sum():
        return False
    if count > max(2, FEW * used.sum()) and not _stand_apart(size[used & ~far], size[far]):
        return False
    return count < FEWEST_FAR_VISITS or not (_again(problem, far) or _follows_from_pose(problem, far))


def _stand_apart(others: Floats, far: Floats) -> bool:
    """Whether there is a clear gap between nearly all of one and nearly all of the other."""
    return bool(np.quantile(far, 0.1) > GAP * np.quantile(others, 0.99))


def _again(problem: LinearizedProblem, far: Bools) -> bool:
    """Whether a pose that was far once is far again, long after."""
    group, place = problem.settings.group, np.arange(len(far))
    partners = hits = 0
    for k in np.flatnonzero(far):
        other = problem.settings.used & (group == group[k]) & (np.abs(place - k) > APART * len(far))
        partners, hits = partners + int(other.sum()), hits + int((other & far).sum())
    share = float(far.sum() - 1) / max(float(problem.settings.used.sum() - 1), 1.0)
    return partners >= FEWEST_FAR_VISITS and float(binom.sf(hits - 1, partners, share)) < PREDICTED


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
