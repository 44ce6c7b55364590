"""Charts over many checks: false alarms with a scatter that nobody knows, slow drift, temperature, and since when."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from benchmarks.drift_sums import begun
from kilter_core.watch.history import alarm_limit, chart, cusum_limit, recursive_residuals


def test_checks_that_only_scatter_are_standard_normal_whatever_their_mean_and_scatter() -> None:
    rng = np.random.default_rng(0)
    z = np.concatenate(
        [recursive_residuals(rng.normal(rng.normal(0, 9), rng.uniform(0.1, 20), 40))[3:] for _ in range(300)]
    )
    assert kstest(z, "norm").pvalue > 0.01
    assert not np.isnan(z).any()


def test_false_alarms_are_as_rare_as_the_run_length_says() -> None:
    rng = np.random.default_rng(1)
    limit = cusum_limit(1, 200.0)
    lengths = []
    for _ in range(150):
        found = chart(rng.normal(3.0, 2.0, 400), limit)
        beyond = np.flatnonzero(np.fmax(found.up, found.down) > limit)
        lengths.append(beyond[0] if len(beyond) else 400)
    alarmed = np.mean(np.array(lengths) < 400)
    rate = alarmed * 150 / (np.sum(lengths) - 3 * 150)  # of a geometric run length, runs cut at 400 checks
    assert 1 / 300 < rate < 1 / 130


def test_alarms_of_sums_that_go_on_begin_as_rarely_as_asked() -> None:
    z, checks = np.random.default_rng(5).normal(size=(2000, 2, 250)), 100.0
    assert np.mean(begun(z, alarm_limit(2, checks))) / len(z) < 1.03 / checks  # of some 5000 alarms: two deviations
    assert np.mean(begun(z, cusum_limit(2, checks))) / len(z) > 1.15 / checks


def test_limits_grow_with_the_number_of_charts() -> None:
    assert cusum_limit(1, 465.0) == pytest.approx(
        5.0, abs=0.1
    )  # tables of two-sided sums with k = 0.5: 465 checks at h = 5
    assert cusum_limit(16) > cusum_limit(1) > 4.5


def test_a_slow_drift_is_seen_before_a_single_check_sees_it() -> None:
    rng = np.random.default_rng(2)
    limit = cusum_limit(16)
    seen = []
    for _ in range(40):
        values = rng.normal(0.0, 1.0, 90) + 0.12 * np.clip(np.arange(90) - 20, 0, None)
        found = chart(values, limit)
        days = np.flatnonzero(np.fmax(found.up, found.down) > limit)
        seen.append(0.12 * (days[0] - 20) if len(days) else np.inf)
    assert np.quantile(seen, 0.9) < 5.8  # what a single check sees in 95 %


def test_a_step_that_stays_is_dated() -> None:
    rng = np.random.default_rng(3)
    values = rng.normal(0.0, 1.0, 60) + 4.0 * (np.arange(60) >= 40)
    ends = [k for k in range(40, 60) if chart(values[: k + 1], cusum_limit(16)).alarms]
    assert ends
    assert ends[0] <= 45
    since = chart(values[: ends[0] + 1], cusum_limit(16)).since
    assert since is not None
    assert 36 <= since <= 41
    down = chart(-values[: ends[0] + 1], cusum_limit(16))
    assert down.since == since


def test_a_season_is_no_drift_where_the_temperature_was_measured() -> None:
    rng = np.random.default_rng(4)
    limit = cusum_limit(16)
    season = 22.0 + 6.0 * np.sin(np.arange(250) / 40.0)
    values = rng.normal(0.0, 1.0, 250) + 0.6 * (season - 22.0)
    beyond = lambda found: bool(np.nanmax(np.fmax(found.up, found.down)) > limit)  # noqa: E731
    assert beyond(chart(values, limit))
    assert not beyond(chart(values, limit, season))
    one_unknown = season.copy()
    one_unknown[7] = np.nan
    assert beyond(chart(values, limit, one_unknown))


def test_what_has_moved_and_stays_there_is_not_forgotten() -> None:
    """Half a year at another place is no good state; a false alarm, or an arm mended without a word, ends by itself."""
    limit = alarm_limit(12)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        values = rng.normal(0.0, 1.0, 300) + 2.0 * (np.arange(300) >= 30)
        found = chart(values, limit)
        assert found.alarms
        assert 20 <= found.since <= 45
        back = chart(np.r_[values, rng.normal(0.0, 1.0, 60)], limit)
        assert not back.alarms


def test_few_checks_say_nothing() -> None:
    found = chart(np.array([0.1, 5.0, -3.0]), cusum_limit(16))
    assert np.isnan(found.up).all()
    assert not found.alarms
    assert not chart(np.zeros(0), cusum_limit(16)).alarms
    assert not chart(np.zeros(9), cusum_limit(16)).alarms
