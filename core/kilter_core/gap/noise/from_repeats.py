"""Measurement noise from repeats: within a visit and from one approach to the next, with full covariance.

The only noise that owes nothing to the model. Assuming it 1.5 times too small gives 50 % false alarms, so it is never
guessed: without repeats the search goes on with the scatter of the fit itself, and every verdict becomes relative.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from kilter_core.gap.noise.covariance_models import SMALLEST, PairModel, approach, even, second, shrunk, spread
from kilter_core.gap.noise.shared_drift import Drift, Repeats, estimate_drift_free_noise, scalar_blocks
from kilter_core.gap.noise.visits import Visits, isolate_unused_visits
from kilter_core.identify.measured_rows import pooled_columns
from kilter_core.observations.groups import subtract_group_means, unbiased_deviations
from kilter_core.types import Bools, Floats, Ints

# The share of an approach that no repeat shows: how the noise is shaped where visits were read several times and not
# repeated.
#
# Readings of a tracker scatter most across its line of sight, and how the arm comes to rest scatters alike in all
# directions. By the shape of the readings alone a visit weighs too much along that line, and the test takes what the
# approach did there for an effect. By their size alone priors would count for nothing beside the rows: masses known
# to 10 % were fitted 9 of their standard deviations away, to take up what the arm did from one approach to the next.

LEAST = 1e-4  # of the variance of the readings: an approach that is smaller changes no weight
MOST = 1e4  # one that is larger makes all coordinates weigh alike
SETTLED = 1e-2  # of the logarithm of that ratio


def of_approach(readings: Floats, residual: Floats, used: Bools, lost: float, blocks: Sequence[slice]) -> Floats:
    """Variances (m,) of the approach beside the covariance ``readings (V, m, m)`` of visits: one for each of the ``blocks``.

    It is the likeliest by what a fit leaves, ``residual (V, m)`` of the visits ``used (V,)``, of whose freedom
    it took the share ``lost``; what a model lacks counts as approach until it is named.
    """
    out = np.zeros(readings.shape[-1])
    for block in blocks:
        own = readings[:, block, block]
        width = own.shape[-1]
        w, V = np.linalg.eigh(own[used] + SMALLEST**2 * np.eye(width))
        z = np.einsum("vij,vi->vj", V, np.nan_to_num(residual[used][:, block]))
        typical = float(np.mean(w))
        out[block] = typical * _ratio(w / typical, z**2 / (typical * (1.0 - lost)))
    return out


def _ratio(w: Floats, square: Floats) -> float:
    """Likeliest variance of the approach beside those of the readings ``w (V, m)``, by the squares (V, m) of what is left."""

    def loss(log: float) -> float:
        total = w + np.exp(log)
        return float(np.sum(np.log(total) + square / total))

    found = minimize_scalar(loss, bounds=(np.log(LEAST), np.log(MOST)), method="bounded", options={"xatol": SETTLED})
    nothing = float(np.sum(np.log(w) + square / w))
    return float(np.exp(found.x)) if found.fun < nothing else 0.0


FEWEST_DEVIATIONS = 3  # independent deviations below which repeats say too little
SPIKE = 6.0  # robust standard deviations from its own repeats at which a row is a spike
SPIKE_PASSES = 4
UNMOVED = 0.01  # of the noise: repeats that a model moves no more leave it as it is
LENGTHS = 3  # leading scalars of a full pose that are lengths; the others are angles
FIT = "residuals of the fit"
WITHIN = "repeats within visits"
REVISITS = "revisits from other sides or under other loads"


@dataclass(frozen=True)
class RepeatRows:
    """What the noise of repeats is read from: residuals ``mean (V, m)`` of the visits, and rows ``away (N, m)`` from them.

    Rows of one visit share its conditions, so only the residuals of visits change from one model to the next. ``used (V,)``
    marks the visits that count. Revisits from other sides or under other loads differ by ``pairs`` beside the noise.
    """

    mean: Floats
    away: Floats
    visits: Visits
    points: Floats | None
    used: Bools
    pairs: PairModel | None = None

    def rms_repeat_change(self, mean: Floats) -> float:
        """Rms of a coordinate by which residuals (V, m) of another model move repeats against each other."""
        change = np.nan_to_num(mean - self.mean)
        return float(np.sqrt(np.mean(subtract_group_means(change, self.visits.condition) ** 2)))


@dataclass(frozen=True)
class Noise:
    """Covariance (V, m, m) of each visit's mean, and of a single row on average, ``row (m, m)``.

    ``freedom`` is the number of independent scalars behind it; ``absolute`` says it does not come from the fit.
    ``within`` and ``between`` are standard deviations of a coordinate (m, or rad for joint data), None when unknown;
    of poses ``lengths`` says how many of the m scalars are lengths, None for all of them. ``drift`` is what repeats showed
    of drift; ``most`` says that it may hold drift, so that noise is this at most. ``repeats`` are the rows it
    was read from, where repeated approaches showed it. Where none did, ``readings`` (V, m, m) is what the rows of a visit
    show, ``row_readings`` (m, m) of a single row, and the fit says what the approach adds. The last scalars may be of
    ``kinds`` beside the tool, so many of each.
    """

    visit: Floats
    row: Floats
    freedom: float
    absolute: bool
    source: str
    within: float | None = None
    between: float | None = None
    lengths: int | None = None
    drift: Drift | None = None
    most: bool = False
    repeats: RepeatRows | None = None
    kinds: tuple[int, ...] = ()
    readings: Floats | None = None
    row_readings: Floats | None = None

    @property
    def over_readings(self) -> float:
        """Variance of visits over that of their readings alone, the mean of lengths and rotations; 1 where repeats show all."""
        if self.readings is None:
            return 1.0
        tool = self.of_tool()
        blocks = scalar_blocks(len(tool.row), tool.lengths)
        whole, read = ([np.einsum("vii->", v[:, own, own]) for own in blocks] for v in (tool.visit, self.readings))
        return float(np.mean(np.divide(whole, np.maximum(read, SMALLEST**2))))

    @property
    def has_too_few_revisits(self) -> bool:
        """Whether revisits are too few to take out what sides and loads do to them."""
        told = self.repeats
        return told is not None and told.pairs is not None and not told.pairs.separable(told.used)

    @property
    def coordinate(self) -> float:
        """Standard deviation of one coordinate (m, or rad for joint data) of a single row."""
        return _deviation(self.row, self.lengths)

    def even(self) -> Noise:
        """Equal variances for the coordinates of all points, and for those of rotations: what an identification weighs by.

        Where the noise is the model's own error, weights by its covariance would fit another geometry than identify does
        (UR10 series B: 0.47 mm left instead of 0.43), and a name would then be confirmed for filling the difference.
        """
        if self.kinds:
            return self.of_tool().even().with_sensors_from_noise(self)
        read, of_row = (None if one is None else even(one) for one in (self.readings, self.row_readings))
        return replace(self, visit=even(self.visit), row=even(self.row), readings=read, row_readings=of_row)

    def of_tool(self) -> Noise:
        """The noise of the tool alone."""
        size = len(self.row) - sum(self.kinds)
        lengths = None if self.lengths == size else self.lengths
        visit, row = self.visit[:, :size, :size], self.row[:size, :size]
        read = None if self.readings is None else self.readings[:, :size, :size]
        return replace(self, visit=visit, row=row, lengths=lengths, kinds=(), readings=read)

    def with_sensors_from_noise(self, other: Noise) -> Noise:
        """This noise of the tool, and what another has of the kinds beside it."""
        count = sum(other.kinds)
        return self.with_independent_sensors(other.visit[:, -count:, -count:], other.row[-count:, -count:], other.kinds)

    def with_independent_sensors(self, visit: Floats, row: Floats, kinds: tuple[int, ...]) -> Noise:
        """This noise of the tool with covariances (V, k, k) and (k, k) of what was measured beside it, independent of it."""
        size, more = len(self.row), len(row)
        whole = np.zeros((len(visit), size + more, size + more))
        whole[:, :size, :size], whole[:, size:, size:] = self.visit, visit
        single = np.zeros((size + more, size + more))
        single[:size, :size], single[size:, size:] = self.row, row
        return replace(self, visit=whole, row=single, lengths=self.lengths or size, kinds=kinds)

    def whiteners(self) -> Floats:
        """Inverse Cholesky factors (V, m, m)."""
        size = self.visit.shape[-1]
        L = np.linalg.cholesky(self.visit + SMALLEST**2 * np.eye(size))
        return np.linalg.solve(L, np.broadcast_to(np.eye(size), L.shape))


def spikes(residual: Floats, visits: Visits) -> Bools:
    """Rows (N,) that are far from the mean of the other rows of their visit: three or more rows show which.

    The worst row of a visit only, then again without it: a spike pulls the mean that its neighbours are held against.
    """
    out = np.zeros(len(residual), dtype=bool)
    r = np.nan_to_num(residual)
    for _ in range(SPIKE_PASSES):
        kept = ~out
        count = np.bincount(visits.visit[kept], minlength=len(visits))
        told = kept & (count[visits.visit] >= 3)
        if not told.any():
            break
        sums = np.stack([np.bincount(visits.visit[kept], c[kept], len(visits)) for c in r.T], axis=1)
        n = count[visits.visit][:, None].astype(np.float64)
        others = (sums[visits.visit] - r) / np.maximum(n - 1.0, 1.0)
        apart = (r - others) * np.sqrt(np.maximum(n - 1.0, 1.0) / n)
        scale = np.median(np.abs(apart[told]), axis=0) / 0.6745 + SMALLEST
        size = np.where(told, np.abs(apart / scale).max(axis=1), 0.0)
        worst = np.full(len(visits), 0.0)
        np.maximum.at(worst, visits.visit, size)
        found = told & (size > SPIKE) & (size >= worst[visits.visit])
        if not found.any():
            break
        out |= found
    return out


def noise_again(noise: Noise, mean: Floats, taken: float, used: Bools) -> Noise | None:
    """The noise of the same repeats at another fit, by the residuals ``mean (V, m)`` of the visits ``used (V,)`` there.

    A drift that the model explains by now is no longer between the repeats, but stays written down; what wrong readings
    seemed to be does not. The fit took ``taken`` scalars of their scatter. The noise itself where nothing changed, None
    where too few repeats are left of those that count.
    """
    if noise.kinds:
        tool = noise.of_tool()
        found = noise_again(tool, mean[:, : len(tool.row)], taken, used)
        return noise if found is tool else None if found is None else found.with_sensors_from_noise(noise)
    told = noise.repeats
    if told is None or (np.array_equal(used, told.used) and told.rms_repeat_change(mean) < UNMOVED * noise.coordinate):
        return noise
    rows = told.away + mean[told.visits.visit]
    if told.pairs is None:
        again = repeat_noise(rows, mean, told.visits, told.points, taken, used)
    else:
        again = revisit_noise(rows, mean, told.visits, told.points, told.pairs, taken, used)
    if again is None or again.repeats is None:
        return None
    drift = noise.drift if taken > 0.0 else again.drift
    return replace(again, drift=drift, repeats=replace(told, mean=mean, used=used))


def repeat_noise(
    residual: Floats,
    visit_residual: Floats,
    visits: Visits,
    points: Floats | None,
    taken: float = 0.0,
    used: Bools | None = None,
) -> Noise | None:
    """Noise from repeats, None when there are too few: of the visits ``used (V,)``, None of all.

    ``residual (N, m)`` of the rows and ``visit_residual (V, m)`` of the visit means at a fit: between repeats only
    their differences count, so the model cancels; what drifted between them is distinguished from noise by how far they are
    apart.
    ``points (V, 3)`` are the measured positions, from which a tracker's line of sight is tried against one covariance
    for the whole room. ``taken`` scalars of what repeats differ by were fitted away with what follows time or temperature.
    """
    every = np.ones(len(visits), dtype=bool)
    told = RepeatRows(visit_residual, residual - visit_residual[visits.visit], visits, points, every)
    if np.isnan(residual).any():
        residual, visit_residual = np.nan_to_num(residual), np.nan_to_num(visit_residual)
    of_visit = visits.visit
    if used is not None:
        visits = replace(visits, condition=isolate_unused_visits(visits.condition, used))
        of_visit = isolate_unused_visits(of_visit, used[of_visit])
    within, k_within = _deviations_from_group_means(residual, of_visit)
    share, lengths = 1.0 / visits.count, _lengths(residual.shape[1], visits)
    repeats = estimate_drift_free_noise(visit_residual, visits, points, lengths, taken)
    k_between = repeats.vectors if repeats else 0.0
    if _too_few(k_within + k_between):
        return None
    at = None if points is None else points
    rows_cov = spread(within, k_within, None if at is None else at[visits.visit], at)
    if repeats is None or _too_few(k_between):
        # Rows of one visit say nothing of the next approach: their shape is used, their scale cannot be relied on.
        visit = np.asarray(rows_cov * share[:, None, None])
        made = _noise(visit, rows_cov.mean(axis=0), k_within, lengths, rows_cov, None)
        return replace(made, absolute=False, source=WITHIN, readings=visit, row_readings=made.row)
    total = _scaled_repeat_deviations(repeats, lengths)
    if _too_few(k_within):
        seen = spread(total, k_between, at, at)
        visit = np.broadcast_to(seen, (len(visits), *seen.shape[1:])).copy()
        made = _noise(visit, seen.mean(axis=0), k_between, lengths, None, seen)
        return replace(made, drift=repeats.drift, most=repeats.most, repeats=told)
    repeated = total[1]  # visits of few rows may be repeated more often than others: like is compared with like
    known = np.mean(
        np.broadcast_to(rows_cov, (len(visits), *rows_cov.shape[1:]))[repeated] * share[repeated, None, None], axis=0
    )
    beyond = second(total[0]) - known
    if np.trace(beyond) > 0.0:
        # The scale of the sum is that of the repeated approaches, however well the rows within a visit are known.
        extra = approach(second(total[0]), known, k_between)
    else:  # the approach is exact as far as anyone can see: both show the noise of a row
        rows_cov = (
            rows_cov * (k_within + k_between * (1.0 + np.trace(beyond) / np.trace(known))) / (k_within + k_between)
        )
        extra = np.zeros_like(known)
    visit = extra + rows_cov * share[:, None, None]
    made = _noise(visit, extra + rows_cov.mean(axis=0), k_between, lengths, rows_cov, extra)
    return replace(made, drift=repeats.drift, most=repeats.most, repeats=told)


def revisit_noise(
    residual: Floats,
    visit_residual: Floats,
    visits: Visits,
    points: Floats | None,
    pairs: PairModel,
    taken: float = 0.0,
    used: Bools | None = None,
) -> Noise | None:
    """Noise from revisits of poses, as :func:`repeat_noise`: what sides and loads do to them is taken out first.

    Where the revisits are too few to fit all candidates of these, it is a bound from above.
    """
    used = np.ones(len(visits), dtype=bool) if used is None else used
    visits = replace(visits, condition=pairs.pose)
    explained, fitted = pairs.fit_sides_and_loads(np.nan_to_num(visit_residual), used)
    rows, mean = residual - explained[visits.visit], visit_residual - explained
    made = repeat_noise(rows, mean, visits, points, taken + fitted, used)
    if made is None or made.repeats is None:
        return None
    told = replace(made.repeats, mean=visit_residual, pairs=pairs)
    return replace(made, source=REVISITS, most=made.most or not pairs.separable(used), repeats=told)


def _too_few(deviations: float) -> bool:
    return round(deviations, 9) < FEWEST_DEVIATIONS  # three come out as 2.9999999999999996 on some processors


def _scaled_repeat_deviations(repeats: Repeats, lengths: int | None) -> tuple[Floats, Ints]:
    """Deviations of repeats whose mean squares are the variances found, with their visits; equal ones where none are left."""
    deviation, index, size = repeats.deviation, repeats.index, repeats.deviation.shape[1]
    if len(deviation) < FEWEST_DEVIATIONS:
        deviation, index = np.eye(size) * np.sqrt(size), np.zeros(size, dtype=np.int64)
    scaled = np.zeros_like(deviation)
    for block, variance in zip(scalar_blocks(size, lengths), repeats.variance, strict=True):
        scaled[:, block] = deviation[:, block] * np.sqrt(
            variance / max(float(np.mean(deviation[:, block] ** 2)), 1e-300)
        )
    return scaled, index


def stated_noise(sigma: Floats | float, visits: Visits, size: int) -> Noise:
    """Noise as the user or the columns ``sx_mm ...`` state it: ``sigma`` m, one number or (V, 3) for visit means."""
    if isinstance(sigma, float):
        each = sigma**2 / visits.count[:, None, None] * np.eye(size)
        return Noise(each, sigma**2 * np.eye(size), np.inf, True, "stated", sigma)
    each = np.zeros((len(visits), size, size))
    each[:, range(size), range(size)] = np.tile(sigma**2, (1, size // 3))
    single = float(np.sqrt(np.mean(sigma**2 * visits.count[:, None])))
    return Noise(each, np.mean(each * visits.count[:, None, None], axis=0), np.inf, True, "columns", single)


def fit_noise(visit_residual: Floats, visits: Visits, used: Bools, lost: float) -> Noise:
    """Scatter of the fit itself: no repeats, so the scale is relative. ``lost`` is the share of freedom it took."""
    return _scatter(visit_residual, used, lost, _lengths(visit_residual.shape[1], visits))


def re_estimate_fit_noise(noise: Noise, visit_residual: Floats, used: Bools, lost: float) -> Noise:
    """The same at another fit of the same visits."""
    if noise.kinds:
        tool = noise.of_tool()
        found = re_estimate_fit_noise(tool, visit_residual[:, : len(tool.row)], used, lost)
        count = np.full(len(visit_residual), 1)
        return found.with_independent_sensors(
            *sensors(visit_residual[used, len(tool.row) :], None, noise.kinds, count), noise.kinds
        )
    return _scatter(visit_residual, used, lost, noise.lengths)


def add_approach_noise(noise: Noise, visit_residual: Floats, used: Bools, lost: float) -> Noise:
    """The noise of readings within visits, shaped as what a fit leaves says of an approach that nothing repeats."""
    if noise.kinds:
        tool = noise.of_tool()
        return add_approach_noise(tool, visit_residual[:, : len(tool.row)], used, lost).with_sensors_from_noise(noise)
    if noise.readings is None or noise.row_readings is None:
        return noise
    added = np.diag(
        of_approach(noise.readings, visit_residual, used, lost, scalar_blocks(len(noise.row), noise.lengths))
    )
    return replace(noise, visit=noise.readings + added, row=noise.row_readings + added)


def sensors(residual: Floats, condition: Ints | None, kinds: tuple[int, ...], count: Ints) -> tuple[Floats, Floats]:
    """Covariances of visits (V, k, k), of ``count (V,)`` rows each, and of a row, of sensors beside the tool.

    Each of the ``kinds`` has one variance for its numbers in ``residual (N, k)``: that of repeats of a ``condition (N,)``
    where there are enough, else what the fit leaves, robustly.
    """
    variance, start = [], 0
    for size in kinds:
        own = residual[:, start : start + size]
        told = None if condition is None else pooled_columns(own, condition)
        left = own[~np.isnan(own)]
        if told is None:
            told = float(np.median(np.abs(left)) / 0.6745) if len(left) else 1.0
        variance += [max(told, SMALLEST) ** 2] * size
        start += size
    row = np.diag(variance)
    return row / count[:, None, None], row


def _scatter(visit_residual: Floats, used: Bools, lost: float, lengths: int | None) -> Noise:
    kept = np.nan_to_num(visit_residual[used])
    size = np.abs(kept - np.median(kept, axis=0))
    robust = np.median(size, axis=0) / 0.6745 + SMALLEST
    inside = kept[(size / robust).max(axis=1) < SPIKE]
    cov = shrunk(inside.T @ inside / max(len(inside) * (1.0 - lost), 1.0), len(inside))
    each = np.broadcast_to(cov, (len(visit_residual), *cov.shape)).copy()
    return Noise(each, cov, 0.0, False, FIT, lengths=lengths)


def _noise(
    visit: Floats, row: Floats, vectors: float, lengths: int | None, within: Floats | None, between: Floats | None
) -> Noise:
    def size(cov: Floats | None) -> float | None:
        return None if cov is None else _deviation(cov.mean(axis=0) if cov.ndim == 3 else cov, lengths)

    return Noise(visit, row, vectors * visit.shape[-1], True, "repeats", size(within), size(between), lengths)


def _lengths(size: int, visits: Visits) -> int | None:
    """How many of a visit's scalars are lengths where the others are angles: a pose was measured. None otherwise."""
    o = visits.observations
    return LENGTHS if o.rotation is not None and o.position is not None and size == 2 * LENGTHS else None


def _deviation(cov: Floats, lengths: int | None) -> float:
    return float(np.sqrt(np.mean(np.diag(cov)[:lengths])))


def _deviations_from_group_means(values: Floats, group: Ints) -> tuple[tuple[Floats, Ints], int]:
    """Deviations from the mean of their group, made unbiased, without spikes; and how many are independent."""
    count = np.bincount(group)
    many = count[group] > 1
    if not many.any():
        return (np.zeros((0, values.shape[1])), np.zeros(0, dtype=np.int64)), 0
    kept = many.copy()
    deviation = np.zeros_like(values)
    for _ in range(3):
        count = np.bincount(group[kept], minlength=len(count))
        deviation = unbiased_deviations(values, group, kept)[0]
        scale = np.median(np.abs(deviation[kept]), axis=0) / 0.6745 + SMALLEST
        again = many & ((np.abs(deviation) / scale).max(axis=1) < SPIKE) & (count[group] > 1)
        if np.array_equal(again, kept) or not again.any():
            break
        kept = again
    index = np.flatnonzero(kept & (np.bincount(group[kept], minlength=len(count))[group] > 1))
    independent = int(len(index) - len(np.unique(group[index])))
    return (deviation[index], index.astype(np.int64)), independent
