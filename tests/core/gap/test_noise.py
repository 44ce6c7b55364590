from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap.noise.from_repeats import repeat_noise, spikes
from kilter_core.gap.noise.visits import average_visits
from kilter_core.observations import Observations


def repeated(rng, poses=200, visits=2, repeats=3, within=1e-5, between=2e-5, angle=0.0):
    q = np.repeat(rng.uniform(-1, 1, (poses, 2)), visits * repeats, axis=0)
    pose = np.repeat(np.arange(poses), visits * repeats)
    point = np.repeat(rng.uniform(0.5, 3.0, (poses, 3)), visits * repeats, axis=0)
    approach = np.repeat(rng.normal(0, between, (poses * visits, 3)), repeats, axis=0)
    distance = np.linalg.norm(point, axis=1, keepdims=True)
    u = point / distance
    e = rng.normal(0, within, (len(q), 3))
    if angle:
        side = rng.normal(0, 1, (len(q), 3)) * angle * distance
        e = u * np.sum(e * u, axis=1, keepdims=True) + side - u * np.sum(side * u, axis=1, keepdims=True)
    # The second visits of a pose come after all first ones, so that each is a visit of its own.
    order = np.argsort(np.tile(np.repeat(np.arange(visits), repeats), poses), kind="stable")
    rows = Observations(q=q[order], position=(point + approach + e)[order], pose_id=pose[order])
    return rows, (point)[order]


def test_visits_average_only_rows_that_follow_each_other():
    rows = Observations(
        q=np.array([[0.0], [0.0], [1.0], [0.0]]),
        position=np.array([[0.0, 0, 0], [2.0, 0, 0], [5.0, 0, 0], [7.0, 0, 0]]),
        pose_id=np.array([4, 4, 9, 4]),
    )
    visits = average_visits(rows)
    assert visits.count.tolist() == [2, 1, 1]
    assert visits.pose.tolist() == [0, 1, 0]
    assert visits.observations.position[:, 0].tolist() == [1.0, 5.0, 7.0]


def test_within_visit_and_re_approach_parts_are_told_apart():
    rows, truth = repeated(np.random.default_rng(1))
    visits = average_visits(rows)
    mean = visits.observations.position - truth[np.unique(visits.visit, return_index=True)[1]]
    noise = repeat_noise(rows.position - truth, mean, visits, visits.observations.position)
    assert noise is not None
    assert abs(noise.within / 1e-5 - 1) < 0.1
    assert abs(noise.between / 2e-5 - 1) < 0.1
    assert abs(np.sqrt(np.trace(noise.visit.mean(axis=0)) / 3) / np.sqrt(4e-10 + 1e-10 / 3) - 1) < 0.1


def test_a_tracker_is_noisier_across_its_line_of_sight():
    rows, truth = repeated(np.random.default_rng(2), between=0.0, within=5e-6, angle=2e-5)
    visits = average_visits(rows)
    points = visits.observations.position
    mean = points - truth[np.unique(visits.visit, return_index=True)[1]]
    noise = repeat_noise(rows.position - truth, mean, visits, points)
    assert noise is not None
    u = points / np.linalg.norm(points, axis=1, keepdims=True)
    along = np.einsum("vi,vij,vj->v", u, noise.visit, u)
    across = (np.trace(noise.visit, axis1=1, axis2=2) - along) / 2
    assert np.median(across / along) > 5
    assert np.corrcoef(across, np.linalg.norm(points, axis=1) ** 2)[0, 1] > 0.9


def test_one_wrong_row_of_a_visit_is_a_spike_and_does_not_widen_the_noise():
    rows, truth = repeated(np.random.default_rng(3))
    rows.position[7] += 1e-3
    visits = average_visits(rows)
    assert np.flatnonzero(spikes(rows.position - truth, visits)).tolist() == [7]


def test_without_repeats_there_is_no_noise_to_speak_of():
    rng = np.random.default_rng(0)
    rows = Observations(q=rng.uniform(size=(30, 2)), position=rng.normal(size=(30, 3)))
    assert repeat_noise(rows.position, rows.position, average_visits(rows), rows.position) is None


def shots(rng, pause, jitter=0.0, poses=30, each=3, approach=6e-5, noise=9e-6):
    """Three shots at each stop, ``pause`` s apart, the next stop after 40 s: every stop is one approach."""
    q = np.repeat(rng.uniform(-1, 1, (poses, 3)), each, axis=0)
    q += jitter * rng.integers(-1, 2, q.shape)
    error = np.repeat(rng.normal(0, approach, (poses, 3)), each, axis=0) + rng.normal(0, noise, q.shape)
    t = np.cumsum(np.where(np.arange(len(q)) % each == 0, 40.0, rng.uniform(*pause, len(q))))
    rows = Observations(q=q, position=q + error, pose_id=np.repeat(np.arange(poses), each), t=t)
    return rows, error


@pytest.mark.parametrize("pause", [(0.5, 0.6), (15.0, 60.0), (100.0, 101.0)])
@pytest.mark.parametrize("jitter", [0.0, 2e-6])
def test_shots_without_a_motion_are_one_visit_whatever_the_clock_says(pause, jitter):
    rows, error = shots(np.random.default_rng(4), pause, jitter)
    visits = average_visits(rows)
    assert visits.count.tolist() == [3] * 30
    mean = error[::3]
    noise = repeat_noise(error, mean, visits, visits.observations.position)
    assert noise is not None
    assert not noise.absolute


def test_another_pose_in_between_ends_a_visit_in_the_order_of_time():
    """Rows sorted by pose: the clock shows that other poses were measured in between."""
    pose = np.array([0, 0, 0, 1, 1, 1, 2, 2, 2])
    t = np.array([0.0, 30, 60, 10, 40, 70, 20, 50, 80])
    rows = Observations(q=pose[:, None] * 0.3, position=np.zeros((9, 3)), pose_id=pose, t=t)
    assert average_visits(rows).count.tolist() == [1] * 9
    assert average_visits(replace(rows, t=None)).count.tolist() == [3, 3, 3]


def test_readings_that_change_over_pauses_only_show_that_the_arm_came_back():
    rng = np.random.default_rng(0)
    stop = np.repeat(np.arange(30), 3)
    pose = np.where(stop % 3 == 2, stop - 1, stop)  # every third stop returns to the pose before
    q = rng.uniform(-1, 1, (30, 4))[pose] + np.repeat(1e-6 * rng.normal(size=(30, 4)), 3, axis=0)
    t = np.cumsum(np.where(np.arange(90) % 3 == 0, 30.0, 0.5))
    rows = Observations(q=q, position=np.zeros((90, 3)), pose_id=pose, t=t)
    assert average_visits(rows).count.tolist() == [3] * 30
    assert len(average_visits(replace(rows, q=rng.uniform(-1, 1, (30, 4))[pose]))) == 20


def test_a_clock_set_back_splits_no_visits():
    rows, _ = shots(np.random.default_rng(1), (0.5, 0.6))
    half = len(rows) // 2
    back = replace(rows, t=np.where(np.arange(90) < half, rows.t, rows.t - rows.t[half] + 0.3))
    assert average_visits(back).count.tolist() == [3] * 30


def wild_doubles(rng, size=2e-5):
    """Sixty poses visited twice, long apart; of four visits a second row by chance three times as far off as is usual."""
    pose = np.concatenate([np.arange(60), np.arange(60)])
    error = rng.normal(0.0, size, (120, 3))
    rows = np.sort(np.concatenate([np.arange(120), [0, 20, 40, 70]]))
    doubled = np.r_[False, rows[1:] == rows[:-1]]
    error = error[rows]
    error[doubled] += 3.0 * np.sqrt(2.0) * size * np.array([1.0, 0.0, 0.0])
    q = rng.uniform(-1, 1, (60, 3))[pose][rows]
    return Observations(q=q, position=q + error, pose_id=pose[rows]), error


def test_few_rows_of_one_visit_do_not_outweigh_many_repeated_approaches():
    rows, error = wild_doubles(np.random.default_rng(0))
    visits = average_visits(rows)
    mean = np.stack([np.bincount(visits.visit, e) for e in error.T], axis=1) / visits.count[:, None]
    noise = repeat_noise(error, mean, visits, None)
    assert noise is not None
    assert noise.between == 0.0
    assert np.sqrt(np.trace(noise.visit.mean(axis=0)) / 3.0) == pytest.approx(2e-5, rel=0.12)


def test_no_direction_is_left_without_noise_by_the_difference_of_two_estimates():
    """A tracker is better along its line of sight; approaches scatter alike in all directions."""
    for seed in range(30):
        rows, truth = repeated(np.random.default_rng(seed), poses=30, between=1e-5, within=5e-6, angle=3e-6)
        visits = average_visits(rows)
        points = visits.observations.position
        mean = points - truth[np.unique(visits.visit, return_index=True)[1]]
        noise = repeat_noise(rows.position - truth, mean, visits, points)
        assert noise is not None
        least = np.sqrt(np.linalg.eigvalsh(noise.visit).min())
        assert least > 0.75 * np.sqrt(1e-10 + 5e-6**2 / 3.0)


def test_a_line_of_sight_is_not_seen_where_there_is_none():
    """Of equal variances one number is better than the three of a tracker."""
    flat = []
    for seed in range(20):
        rows, truth = repeated(np.random.default_rng(seed), poses=25, repeats=1, between=2e-5, within=0.0)
        visits = average_visits(rows)
        points = visits.observations.position
        noise = repeat_noise(rows.position - truth, points - truth, visits, points)
        assert noise is not None
        flat.append(np.ptp(noise.visit, axis=0).max() == 0.0)
    assert sum(flat) >= 15


def test_scatter_that_was_fitted_away_is_counted():
    """Twelve waves in time fitted to noise leave less of it between repeats: what was taken is given back."""
    found = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        rows, truth = repeated(rng, poses=25, repeats=1, between=2e-5, within=0.0)
        visits, error = average_visits(rows), rows.position - truth
        when = np.linspace(0.0, 1.0, len(rows))
        basis = np.linalg.qr(np.cos(np.pi * np.outer(when, np.arange(1, 13))))[0]
        left = error - basis @ (basis.T @ error)
        within = np.stack([np.bincount(visits.condition, b) for b in basis.T], axis=1) / 2.0
        taken = 3.0 * float(np.sum((basis - within[visits.condition]) ** 2))
        noise = repeat_noise(left, left, visits, None, taken)
        assert noise is not None
        assert noise.freedom == pytest.approx(75.0 - taken, rel=0.05)
        found.append(np.trace(noise.row) / 3.0 / 2e-5**2)
    assert np.mean(found) == pytest.approx(1.0, abs=0.08)
