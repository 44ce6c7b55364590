"""How rarely the sums of arms that do not move begin to alarm: ``python -m benchmarks.drift_sums`` prints a table.

Checks are drawn and summed in plain numpy, thousands of arms at once; only the limit is that of ``kilter_core.watch.history``.
The scatter of each number is estimated from the checks before, as there.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

from kilter_core.watch.history import RUN_LENGTH, alarm_limit, cusum_limit

Floats = NDArray[np.float64]
CHARTS = (1, 6, 12, 16)
PARTS = (0, 25, 50, 100, 250)  # days
LIMITS: dict[str, Callable[[int], float]] = {"Siegmund": cusum_limit, "in use": alarm_limit}
AT_ONCE = 20_000  # numbers a day


def steps(values: Floats) -> Floats:
    """Each value (M, days) against the mean and scatter of those before it, as a standard normal number; 0 of the first."""
    out = np.zeros_like(values)
    for day in range(3, values.shape[1]):
        before = values[:, :day]
        scatter = before.std(axis=1, ddof=1) * np.sqrt(1.0 + 1.0 / day)
        away = (values[:, day] - before.mean(axis=1)) / scatter
        out[:, day] = np.sign(away) * norm.isf(t.sf(np.abs(away), day - 1))
    return out


def begun(z: Floats, limit: float) -> Floats:
    """Arms (days,) of z (arms, charts, days) whose sums go beyond the limit on a day, and were within it the day before."""
    up, down, out = np.zeros(z.shape[:2]), np.zeros(z.shape[:2]), np.zeros(z.shape[2])
    was = np.zeros(len(z), dtype=bool)
    for day in range(z.shape[2]):
        up, down = np.maximum(0.0, up + z[:, :, day] - 0.5), np.maximum(0.0, down - z[:, :, day] - 0.5)
        now = np.any(np.maximum(up, down) > limit, axis=1)
        out[day], was = np.sum(now & ~was), now
    return out


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checks", type=int, default=1_000_000, help="of arms that do not move, for each row")
    given = parser.parse_args()
    rng = np.random.default_rng(30)
    print(f"alarms of the sums that begin per {RUN_LENGTH} checks, target at most 1; {given.checks} checks a row")
    print("charts  limit            " + "".join(f"day {a}-{b:<8}" for a, b in pairwise(PARTS)) + "all")
    for charts in CHARTS:
        found, arms = {name: np.zeros(PARTS[-1]) for name in LIMITS}, 0
        while arms * PARTS[-1] < given.checks:
            some = AT_ONCE // charts
            z = steps(rng.normal(size=(some * charts, PARTS[-1]))).reshape(some, charts, -1)
            arms += some
            for name, limit in LIMITS.items():
                found[name] += begun(z, limit(charts))
        for name, limit in LIMITS.items():
            rates = 1e3 * found[name] / arms
            parts = "".join(f"{rates[a:b].mean():<13.2f}" for a, b in pairwise(PARTS))
            print(f"{charts:<8}{name:9}{limit(charts):<8.2f}{parts}{rates.mean():.2f}", flush=True)


if __name__ == "__main__":
    main()
