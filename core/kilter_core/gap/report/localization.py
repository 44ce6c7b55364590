"""Where simulation and measurement disagree (E3): contrasts of the same pose first, then bins of every factor."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc, gammaln
from scipy.stats import chi2, f

from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.scan import residual_given, sums_under_sign_flips
from kilter_core.observations import Observations
from kilter_core.observations.groups import subtract_group_means
from kilter_core.parameters import degrees
from kilter_core.types import Bools, Floats, Ints

BINS = 6
VISITS_PER_BIN = 4  # visits in a bin
FLIPS = 999
FEWEST_PAIRS = 3
STANDS_OUT = 0.05
MOVED = 0.01  # chance below which visits under the same conditions differ by more than noise


@dataclass(frozen=True)
class Place:
    """A level of a factor: chi-square above what noise gives there, per degree of freedom, and its family-wise p."""

    factor: str
    level: str
    excess: float
    p_value: float
    visits: int


def localize(problem: LinearizedProblem, rows: Observations, seed: int = 0, moving: bool = False) -> tuple[Place, ...]:
    """Levels by how clear they are, most significant first; contrasts before bins at equal p.

    Samples of a motion have no pose in common, so of motions (and of poses judged in blocks) there are no contrasts.
    """
    r, scale = _residuals(problem)
    found = [] if moving or problem.settings.inflation > 1.0 else list(_contrasts(problem, rows, r, scale))
    found += _bins(problem, rows, r, scale, seed)
    return tuple(sorted(found, key=lambda p: (p.p_value, -p.excess)))


def remains(found: LinearizedProblem, columns: Sequence[int], rows: Observations, seed: int = 0) -> Place | None:
    """Where what is left after everything named is clearest; None where no level stands out."""
    left = replace(found, y=residual_given(found, columns), U=found.basis(columns))
    bins = _bins(left, rows, *_residuals(left), seed)
    clearest = min(bins, key=lambda p: (p.p_value, -p.excess), default=None)
    return clearest if clearest is not None and clearest.p_value < STANDS_OUT else None


def _residuals(problem: LinearizedProblem) -> tuple[Floats, float]:
    """Studentised residuals (V, m), and their variance where the noise is not known."""
    r = _studentised_residuals(problem).reshape(-1, problem.settings.whitener.shape[-1])
    return r, 1.0 if problem.settings.trusted else float(np.mean(r[problem.settings.used] ** 2))


def _studentised_residuals(problem: LinearizedProblem) -> Floats:
    leverage = np.minimum(np.sum(problem.U**2, axis=1), 0.99)
    return np.asarray(problem.y / np.sqrt(1.0 - leverage))


def _contrasts(problem: LinearizedProblem, rows: Observations, r: Floats, scale: float) -> Iterator[Place]:
    """Same pose under two conditions: geometry cancels, so chi-square of the difference needs no fit."""
    used, group = problem.settings.used, problem.settings.group
    labels: dict[str, Floats] = {}
    own: dict[str, Floats] = {}
    condition = rows.conditions()[used]
    if rows.direction is not None:
        for j, part in enumerate(problem.settings.source.residuals_by_joint(r)):
            labels[f"direction of joint {j + 1}"] = rows.direction[:, j]
            own[f"direction of joint {j + 1}"] = part
    if rows.payload_kg is not None:
        labels["load"] = rows.payload_kg
    if rows.temperature_c is not None:
        labels["temperature"] = np.round(rows.temperature_c / 2.0)
    if rows.qd is not None:
        labels["speed"] = np.round(np.log2(1e-3 + np.linalg.norm(rows.qd, axis=1)))
    for factor, label in labels.items():
        part = own.get(factor, r)[used]
        taken, freedom, pairs = _contrast(part, group[used], label[used])
        if pairs >= FEWEST_PAIRS:
            p, size = _test_against_repeats(taken / scale, freedom, *_repeat_chi_square(part, condition, scale))
            excess = size / freedom - 1.0
            yield Place(f"contrast: {factor}", f"{pairs} poses measured under both", excess, p, 2 * pairs)


def _repeat_chi_square(r: Floats, condition: Ints, scale: float) -> tuple[float, float]:
    """Chi-square of visits that should agree about their mean, and its freedom: what moved with time is in it too."""
    free = float(r.shape[1] * (len(condition) - len(np.unique(condition))))
    return float(np.sum(subtract_group_means(r, np.unique(condition, return_inverse=True)[1]) ** 2)) / scale, free


def _test_against_repeats(taken: float, freedom: float, again: float, free: float) -> tuple[float, float]:
    """Chance of a contrast ``taken``, and the contrast in the scatter of visits under the same conditions.

    Where these differ by more than noise, as after a knock of the tripod, whatever is compared across time does.
    """
    if free <= 0.0 or chi2.sf(again, free) > MOVED:
        return float(chi2.sf(taken, freedom)), taken
    size = taken * (free / again)
    return float(f.sf(size / freedom, freedom, free)), size


def _contrast(r: Floats, group: Ints, label: Floats) -> tuple[float, float, int]:
    low, high = label.min(), label.max()
    if low == high or not r.shape[1]:
        return 0.0, 0.0, 0
    poses = int(group.max()) + 1
    sums, counts = [], []
    for value in (low, high):
        own = label == value
        counts.append(np.bincount(group[own], minlength=poses))
        sums.append(np.stack([np.bincount(group[own], c, poses) for c in r[own].T], axis=1))
    both = (counts[0] > 0) & (counts[1] > 0)
    if not both.any():
        return 0.0, 0.0, 0
    n0, n1 = counts[0][both], counts[1][both]
    difference = (sums[1][both] / n1[:, None] - sums[0][both] / n0[:, None]) / np.sqrt(1.0 / n0 + 1.0 / n1)[:, None]
    return float(np.sum(difference**2)), float(difference.size), int(both.sum())


def _bins(problem: LinearizedProblem, rows: Observations, r: Floats, scale: float, seed: int) -> list[Place]:
    """Mean residual of each bin, with the largest over all bins under sign flips of whole poses as the yardstick.

    Each bin is held against what flips make of it: an effect that is strong elsewhere would drown it otherwise.
    """
    used, group = problem.settings.used, problem.settings.group
    bins = [(f, level, mask & used, part) for f, level, mask, part in _levels(problem, rows, r)]
    bins = [b for b in bins if b[2].sum() >= VISITS_PER_BIN]
    if not bins:
        return []
    poses = int(group.max()) + 1
    sums = [
        np.bincount(group[mask], c[mask], poses) / np.sqrt(mask.sum() * scale)
        for _, _, mask, part in bins
        for c in part.T
    ]
    as_is = np.stack(sums, axis=1)
    under = sums_under_sign_flips((as_is,), FLIPS, np.random.default_rng(seed))[0]
    squares = np.vstack([np.sum(as_is, axis=0), under]) ** 2
    ends = np.cumsum([part.shape[1] for *_, part in bins])
    T = [np.sum(own, axis=1) for own in np.split(squares, ends[:-1], axis=1)]
    excess = [float(t[0]) / part.shape[1] - 1.0 for t, (*_, part) in zip(T, bins, strict=True)]
    z = [unlikelihood(*_match_chi_square(t)) for t in T]
    Z = np.stack(z)
    best = Z[:, 1:].max(axis=0)
    return [
        Place(f, level, e, (1.0 + float(np.sum(best >= row[0]))) / (FLIPS + 1.0), int(mask.sum()))
        for (f, level, mask, _), e, row in zip(bins, excess, Z, strict=True)
    ]


def _match_chi_square(T: Floats) -> tuple[Floats, float]:
    """Scale ``T``, its flips after the first, to chi-square of the freedom that has their mean and variance."""
    mean, variance = max(float(T[1:].mean()), 1e-300), max(float(T[1:].var()), 1e-300)
    freedom = 2.0 * mean * (mean / variance)
    return T * (freedom / mean), freedom


def unlikelihood(T: Floats, freedom: float) -> Floats:
    """Minus log of the tail probability of chi-square, also where that is too small for a number."""
    with np.errstate(divide="ignore"):
        exact = -np.log(chdtrc(freedom, T))
    half = np.maximum(T, 1.0) / 2.0
    far = half - (freedom / 2.0 - 1.0) * np.log(half) + gammaln(freedom / 2.0)
    return np.asarray(np.where(np.isfinite(exact), exact, far))


def _levels(problem: LinearizedProblem, rows: Observations, r: Floats) -> Iterator[tuple[str, str, Bools, Floats]]:
    """Factor, level, members (V,), and the residual part (V, k) that the factor would move."""
    for j, along in enumerate(_along_joints(problem, rows, r)):
        if np.ptp(rows.q[:, j]) < 1e-6 or not along.shape[1]:
            continue
        for level, mask in _ranges(degrees(rows.q[:, j]), "°"):
            yield f"angle of joint {j + 1}", level, mask, along
        if rows.direction is not None:
            for s, word in ((-1, "-"), (1, "+")):
                yield f"direction of joint {j + 1}", word, rows.direction[:, j] == s, along
    for name, values, unit in (
        ("load", rows.payload_kg, " kg"),
        ("temperature", rows.temperature_c, " °C"),
        ("time since the first row", None if rows.t is None else rows.t - rows.t.min(), " s"),
    ):
        if values is not None and np.ptp(values) > 0.0:
            for level, mask in _ranges(values, unit):
                yield name, level, mask, r
    if rows.position is not None:
        above = rows.position > np.median(rows.position, axis=0)
        octant = above @ np.array([1, 2, 4])
        for k in range(8):
            word = "".join(f"{axis}{'+' if k >> i & 1 else '-'}" for i, axis in enumerate("xyz"))
            yield "octant", word, octant == k, r


def _along_joints(problem: LinearizedProblem, rows: Observations, r: Floats) -> Iterator[Floats]:
    """Residual (V, 1) along what each joint's own angle would move, in units of noise."""
    source = problem.settings.source
    if not source.observes_tool:
        yield from source.residuals_by_joint(r)
        return
    column = source.joint_columns(problem.values)
    D = np.stack([column(j) for j in range(rows.q.shape[1])], axis=2)
    D = problem.settings.whitening.columns(np.nan_to_num(D)).reshape(D.shape)
    size = np.linalg.norm(D, axis=1)
    for j in range(rows.q.shape[1]):
        unit = D[:, :, j] / np.maximum(size[:, j], 1e-12 + 1e-6 * size[:, j].max())[:, None]
        yield np.sum(r * unit, axis=1, keepdims=True)


def _ranges(values: Floats, unit: str) -> Iterator[tuple[str, Bools]]:
    distinct = np.unique(values)
    if len(distinct) <= BINS:
        for v in distinct:
            yield f"{v:.4g}{unit}", values == v
        return
    edges = np.quantile(values, np.linspace(0, 1, BINS + 1))
    for low, high in itertools.pairwise(edges):
        last = high == edges[-1]
        yield f"{low:.4g} to {high:.4g}{unit}", (values >= low) & ((values <= high) if last else (values < high))
