"""Many checks one after another: a cumulative sum for each number, which sees what a single check does not.

The version is off by the same amount in every check, and the set-up scatters by more than the instrument: neither is known
beforehand. So each check is compared with those before it alone, as a recursive residual of a regression on a constant and,
where it was measured, on the temperature; by Student's t it becomes a standard normal number, independent of the earlier ones
as long as nothing changes. Whatever the first checks scatter by, the sums then alarm as rarely as they should.
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
LARGEST = 8.0  # standard deviations that a single check may count
SCATTER = 2  # checks beyond the regression before there is a scatter to compare with
DEPENDENT = 1e-9  # determinant over the product of the diagonal below which temperatures were all alike so far
VARIED_K = 1.0  # range of temperatures that is worth a slope


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


def limit_of(charts: int, run_length: float = RUN_LENGTH) -> float:
    """Limit of two-sided sums of which so many together alarm once in so many checks."""
    one_sided = 2.0 * charts * run_length

    def apart(h: float) -> float:
        b = 2.0 * ALLOWANCE * (h + CORRECTION)
        return float(np.log((np.exp(b) - b - 1.0) / (2.0 * ALLOWANCE**2)) - np.log(one_sided))

    return float(brentq(apart, 0.1, 60.0))


def alarm_limit(charts: int, checks: float = RUN_LENGTH) -> float:
    """Limit of sums of which so many together *begin* to alarm once in so many ``checks``.

    Siegmund's run length counts from one alarm to the next of sums that are then set to zero. These go on: a sum that is
    beyond its limit falls below and rises again, and each time is an alarm that somebody reads.
    """
    return limit_of(charts, RECROSSED * checks)


def chart(values: Floats, limit: float, temperature_c: Floats | None = None) -> Chart:
    """Chart of a number (N,) over checks, oldest first."""
    z = standardised(values, temperature_c)
    up, down = np.full(len(z), np.nan), np.full(len(z), np.nan)
    high = low = 0.0
    begun = {True: 0, False: 0}
    since: int | None = None
    for k, step in enumerate(z):
        if np.isnan(step):
            continue
        if high == 0.0:
            begun[True] = k
        if low == 0.0:
            begun[False] = k
        high, low = max(0.0, high + step - ALLOWANCE), max(0.0, low - step - ALLOWANCE)
        up[k], down[k] = high, low
        since = _changed_at(z[: k + 1], begun[high >= low]) if max(high, low) > limit else None
    scatter = float(np.std(values, ddof=1)) if len(values) > SCATTER else float("nan")
    return Chart(up, down, limit, since, scatter)


def _changed_at(z: Floats, begun: int) -> int:
    """The likeliest check since a sum was zero with which a step began that lasts."""
    tail = z[begun:][::-1]
    together = np.abs(np.cumsum(tail)) / np.sqrt(np.arange(1, len(tail) + 1))
    return begun + len(tail) - 1 - int(together.argmax())


def standardised(values: Floats, temperature_c: Floats | None = None) -> Floats:
    """Each value (N,) against those before it as a standard normal number; NaN as long as they do not tell their scatter."""
    X = _design(len(values), temperature_c)
    p = X.shape[1]
    out, squares, freedom = np.full(len(values), np.nan), 0.0, 0
    G, b = np.zeros((p, p)), np.zeros(p)
    for n, (x, value) in enumerate(zip(X, values, strict=True)):
        if n >= p and np.linalg.det(G) > DEPENDENT * np.prod(np.diag(G)):
            inverse = np.linalg.inv(G)
            residual = (value - x @ inverse @ b) / np.sqrt(1.0 + x @ inverse @ x)
            if freedom >= SCATTER and squares > 0.0:
                t = float(residual / np.sqrt(squares / freedom))
                out[n] = np.clip(-ndtri(stdtr(freedom, -abs(t))) * np.sign(t), -LARGEST, LARGEST)
            squares, freedom = squares + residual**2, freedom + 1
        G, b = G + np.outer(x, x), b + x * value
    return out


def _design(count: int, temperature_c: Floats | None) -> Floats:
    """Constant, and the temperature where every check has one and they differ."""
    ones = np.ones((count, 1))
    if temperature_c is None or np.isnan(temperature_c).any() or np.ptp(temperature_c) < VARIED_K:
        return ones
    return np.column_stack([ones, temperature_c - temperature_c.mean()])
