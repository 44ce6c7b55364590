"""Sums of checks that do not know the number alike: by a coarser instrument, or of fewer poses."""

from __future__ import annotations

import numpy as np

from kilter_core.watch.history import alarm_limit, chart, recursive_residuals


def mixed(
    rng: np.random.Generator, count: int, coarse: float = 8.0, share: float = 0.1
) -> tuple[np.ndarray, np.ndarray]:
    deviations = np.where(rng.random(count) < share, coarse, 1.0)
    return rng.normal(3.0, deviations), deviations


def test_coarse_checks_among_fine_ones_raise_no_alarm_of_the_sums() -> None:
    rng, limit, begun, checks = np.random.default_rng(0), alarm_limit(1, 1000.0), [0, 0], 0
    for _ in range(150):
        values, deviations = mixed(rng, 120)
        for way, known in enumerate((None, deviations)):
            found = chart(values, limit, None, known)
            beyond = np.fmax(found.up, found.down) > limit
            begun[way] += int(np.sum(beyond[1:] & ~beyond[:-1]))
        checks += 120
    assert begun[1] <= 1.6 * checks / 1000.0
    assert begun[0] > 2 * begun[1]  # taken as alike


def test_a_drift_is_seen_beside_a_coarse_check() -> None:
    rng, limit, seen = np.random.default_rng(1), alarm_limit(12), []
    for _ in range(40):
        deviations = np.ones(80)
        deviations[10] = 15.0
        values = rng.normal(0.0, deviations) + 0.12 * np.clip(np.arange(80) - 25, 0, None)
        found = chart(values, limit, None, deviations)
        days = np.flatnonzero(np.fmax(found.up, found.down) > limit)
        seen.append(0.12 * (days[0] - 25) if len(days) else np.inf)
    assert np.quantile(seen, 0.9) < 5.8  # what a single check sees in 95 %


def test_a_finer_instrument_does_not_make_the_scatter_of_set_ups_an_alarm() -> None:
    rng = np.random.default_rng(2)
    deviations = np.r_[np.ones(40), 0.1 * np.ones(10)]
    z = np.concatenate([recursive_residuals(rng.normal(0.0, 1.0, 50), None, deviations)[40:] for _ in range(200)])
    assert np.mean(np.abs(z) > 3.0) < 0.01
