"""Many checks one after another: a cumulative sum for each number, which sees what a single check does not.

The version is off by the same amount in every check, and the set-up scatters by more than the instrument: neither is known
beforehand. So each check is compared with those before it alone, as a recursive residual of a regression on a constant and,
where it was measured, on the temperature, each weighted by how well its rows tell the number. By Student's t it becomes a
standard normal number, independent of the earlier ones as long as nothing changes. Whatever the first checks scatter by, the
sums then alarm as rarely as they should.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtri, stdtr

from kilter_core.types import Floats

RUN_LENGTH = 1000  # checks between two false alarms of all charts together
# Times that a sum beyond its limit goes beyond it anew before it is back near zero (benchmarks/drift_sums.py).
RECROSSED = 1.4
ALLOWANCE = 0.5  # standard deviations of a check that a sum forgets each time
CORRECTION = 1.166  # of the boundary for sums that are looked at check by check (Siegmund)
HIGHEST = 2.0  # limits that a sum may reach: an arm that is as before again is told so after some twenty checks
LARGEST = 8.0  # standard deviations that a single check may count
SCATTER = 2  # checks beyond the regression before there is a scatter to compare with
KNOWN = 20  # checks that tell well enough how an arm was: fewer learn from all, or a false alarm would stay
DEPENDENT = 1e-9  # determinant over the product of the diagonal below which temperatures were all alike so far
VARIED_K = 1.0  # range of temperatures that is worth a slope

UNLEARNED = 5e-5  # m, before a check has shown it: a tracker that is set up again on its marks
TAKEN = 6  # numbers that this counts as: two checks beyond the first
RANGE = (1e-6, 2e-3)  # m, between which it is looked for
STEPS = 200


@dataclass(frozen=True)
class Chart:
    """The sums of one number: ``up`` and ``down (N,)`` in standard deviations, NaN of the first checks.

    ``since`` is the check (from 0) with which the step that alarms most likely began; None where none does. ``scatter`` is the
    standard deviation of the checks about their mean, in the unit of the values, NaN of too few.
    """

    up: Floats
    down: Floats
    limit: float
    since: int | None
    scatter: float

    @property
    def alarms(self) -> bool:
        """Whether the last check is beyond the limit."""
        return self.since is not None


def cusum_limit(charts: int, run_length: float = RUN_LENGTH) -> float:
    """Limit of two-sided sums of which so many together alarm once in so many checks."""
    one_sided = 2.0 * charts * run_length

    def run_length_error(h: float) -> float:
        b = 2.0 * ALLOWANCE * (h + CORRECTION)
        return float(np.log((np.exp(b) - b - 1.0) / (2.0 * ALLOWANCE**2)) - np.log(one_sided))

    return float(brentq(run_length_error, 0.1, 60.0))


def alarm_limit(charts: int, checks: float = RUN_LENGTH) -> float:
    """Limit of sums of which so many together *begin* to alarm once in so many ``checks``.

    Siegmund's run length counts from one alarm to the next of sums that are then set to zero. These go on: a sum that is
    beyond its limit falls below and rises again, and each time is an alarm that somebody reads.
    """
    return cusum_limit(charts, RECROSSED * checks)


def chart(values: Floats, limit: float, temperature_c: Floats | None = None, deviations: Floats | None = None) -> Chart:
    """Chart of a number (N,) over checks, oldest first, with the standard deviation that each has by itself, if known.

    What is beyond the limit is compared with the ``KNOWN`` checks or more before it, and not learned from: an arm that has
    moved and stays there would be as it always was after some hundred checks.
    """
    X, own = _weighted_design_and_values(values, temperature_c, deviations)
    before, z = _Before(X.shape[1]), np.full(len(own), np.nan)
    up, down = np.full(len(own), np.nan), np.full(len(own), np.nan)
    high = low = 0.0
    begun = {True: 0, False: 0}
    since: int | None = None
    for k, (x, value) in enumerate(zip(X, own, strict=True)):
        z[k], residual = before.step(x, value)
        if not np.isnan(z[k]):
            if high == 0.0:
                begun[True] = k
            if low == 0.0:
                begun[False] = k
            high, low = (_step_cusum(before_it, step, limit) for before_it, step in ((high, z[k]), (low, -z[k])))
            up[k], down[k] = high, low
            since = _locate_change(z[: k + 1], begun[high >= low]) if max(high, low) > limit else None
        if since is None or before.count < KNOWN:
            before.learn(x, value, residual)
    scatter = float(np.std(values, ddof=1)) if len(values) > SCATTER else float("nan")
    return Chart(up, down, limit, since, scatter)


def _step_cusum(sum_: float, step: float, limit: float) -> float:
    return float(min(HIGHEST * limit, max(0.0, sum_ + step - ALLOWANCE)))


def _locate_change(z: Floats, begun: int) -> int:
    """The likeliest check since a sum was zero with which a step began that lasts."""
    tail = z[begun:][::-1]
    together = np.abs(np.cumsum(tail)) / np.sqrt(np.arange(1, len(tail) + 1))
    return begun + len(tail) - 1 - int(together.argmax())


def recursive_residuals(
    values: Floats, temperature_c: Floats | None = None, deviations: Floats | None = None
) -> Floats:
    """Each value (N,) against those before it as a standard normal number; NaN as long as they do not tell their scatter.

    A check by a coarser instrument or of fewer poses scatters by more: how much more, ``deviations (N,)`` say.
    """
    X, own = _weighted_design_and_values(values, temperature_c, deviations)
    before, out = _Before(X.shape[1]), np.full(len(own), np.nan)
    for n, (x, value) in enumerate(zip(X, own, strict=True)):
        out[n], residual = before.step(x, value)
        before.learn(x, value, residual)
    return out


class _Before:
    """The checks before one: a regression of so many columns, and how its recursive residuals scatter."""

    def __init__(self, columns: int) -> None:
        self._G, self._b, self.count = np.zeros((columns, columns)), np.zeros(columns), 0
        self._squares, self._freedom = 0.0, 0

    def step(self, x: Floats, value: float) -> tuple[float, float]:
        """A value against those before it, as a standard normal number and as a residual; NaN of what these do not tell."""
        if self.count < len(self._b) or np.linalg.det(self._G) <= DEPENDENT * np.prod(np.diag(self._G)):
            return np.nan, np.nan
        inverse = np.linalg.inv(self._G)
        residual = float((value - x @ inverse @ self._b) / np.sqrt(1.0 + x @ inverse @ x))
        if self._freedom < SCATTER or self._squares <= 0.0:
            return np.nan, residual
        t = float(residual / np.sqrt(self._squares / self._freedom))
        return float(np.clip(-ndtri(stdtr(self._freedom, -abs(t))) * np.sign(t), -LARGEST, LARGEST)), residual

    def learn(self, x: Floats, value: float, residual: float) -> None:
        """Count a value among those before."""
        if not np.isnan(residual):
            self._squares, self._freedom = self._squares + residual**2, self._freedom + 1
        self._G, self._b, self.count = self._G + np.outer(x, x), self._b + x * value, self.count + 1


def _weighted_design_and_values(
    values: Floats, temperature_c: Floats | None, deviations: Floats | None
) -> tuple[Floats, Floats]:
    """Columns (N, p) and values (N,) that scatter alike."""
    scale = _scales(len(values), deviations)
    return _design(len(values), temperature_c) / scale[:, None], values / scale


def _scales(count: int, deviations: Floats | None) -> Floats:
    """Relative scatter (N,) of each check.

    None counts as better than most before it: how much set-ups scatter by, which a better instrument does not reduce, is told
    by these alone.
    """
    if deviations is None or not (np.isfinite(deviations) & (deviations > 0.0)).all():
        return np.ones(count)
    before = [float(np.quantile(deviations[: n + 1], 0.5, method="lower")) for n in range(count)]
    return np.asarray(np.maximum(deviations, np.array(before)) / deviations.min(initial=np.inf))


def _design(count: int, temperature_c: Floats | None) -> Floats:
    """Constant, and the temperature where every check has one and they differ."""
    ones = np.ones((count, 1))
    if temperature_c is None or np.isnan(temperature_c).any() or np.ptp(temperature_c) < VARIED_K:
        return ones
    return np.column_stack([ones, temperature_c - temperature_c.mean()])


limit_of = cusum_limit  # its name until 0.1; gone with 0.3


def learned_setup(shifts: Floats, sigmas: Floats) -> float:
    """Standard deviation (m) with which a set-up repeats, by shifts (N, 3) of the base in N checks and their own ``sigmas``.

    The likeliest beside ``UNLEARNED``; shifts that all checks have alike are the version's.
    """
    if len(shifts) < 2:
        return UNLEARNED
    weight = 1.0 / (UNLEARNED**2 + sigmas**2)
    away = shifts - np.sum(weight * shifts, axis=0) / np.sum(weight, axis=0)
    away *= np.sqrt(len(shifts) / (len(shifts) - 1.0))
    tried = np.geomspace(*RANGE, STEPS)
    total = tried[:, None, None] ** 2 + sigmas**2
    loss = np.sum(np.log(total) + away**2 / total, axis=(1, 2))
    loss += TAKEN * (2.0 * np.log(tried) + (UNLEARNED / tried) ** 2)
    return float(tried[int(np.argmin(loss))])
