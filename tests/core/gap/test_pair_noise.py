"""The noise of a campaign whose poses were visited again from other sides or under other loads; arms by Pinocchio."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.prepare import Prepared, prepare_data
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.campaigns import table_errors
from tests.core.correct.twins import ARMS
from tests.core.truth import Arm, Body

NOISE_M = 1.1e-5
MASSES_KG = {6: (8.0, 12.0, 6.0, 2.0, 2.0, 0.5), 7: (4.0, 4.0, 3.0, 3.0, 2.0, 2.0, 0.5)}
SIDES, LOADS = "sides", "loads"


def heavy(name: str) -> Arm:
    """An arm of :data:`ARMS` with a link at each joint."""
    arm = ARMS[name]
    upper, other = np.array([-0.15, 0.02, 0.01]), np.array([0.0, 0.0, -0.05])
    return replace(
        arm,
        bodies=tuple(
            Body(j, kg, upper if j in (1, 2) else other, 0.02 * np.eye(3)) for j, kg in enumerate(MASSES_KG[arm.n])
        ),
    )


def revisited(arm: Arm, seed: int, poses: int, again: int, other: str, drift_m: float = 0.0) -> Observations:
    """Poses once, then some ``again`` from the other side of every joint or with the other load.

    Most joints have backlash and most a compliance, both unknown; the base may drift along x over the campaign.
    """
    rng = np.random.default_rng([seed, 5])
    real = arm.moved(table_errors(arm, rng, 3e-4, 8e-4))
    pose = np.concatenate([np.arange(poses), rng.choice(poses, again, replace=False)])
    q = (0.9 * rng.uniform(*arm.limits, (poses, arm.n)))[pose]
    side, load = rng.choice([-1.0, 1.0], (poses, arm.n))[pose], rng.choice([0.0, 3.0], poses)[pose]
    if other == SIDES:
        side[poses:] *= -1.0
    else:
        load[poses:] = 3.0 - load[poses:]
    backlash = rng.uniform(1e-4, 8e-4, arm.n) * (rng.random(arm.n) < 0.6)
    compliance = rng.uniform(2e-6, 2e-5, arm.n) * (rng.random(arm.n) < 0.6)
    torque = np.where(load[:, None] > 0.0, real.torques(q, (3.0, np.zeros(3))), real.torques(q))
    position = real.poses(q + 0.5 * backlash * side - compliance * torque)[0]
    position[:, 0] += drift_m * np.arange(len(pose)) / len(pose)
    seen = position + NOISE_M * rng.standard_normal(position.shape)
    return Observations(
        q, position=seen, direction=side, payload_kg=load, pose_id=pose, t=30.0 * np.arange(len(pose))
    )  # fmt: skip


def prepared(arm: Arm, rows: Observations, **options: object) -> Prepared:
    return prepare_data(Calibration.nominal(robot_from_document(arm.document())), rows, GapOptions(**options))


@pytest.mark.parametrize(
    ("name", "seed", "poses", "again", "other", "drift_m"),
    [("ur", 0, 70, 20, SIDES, 0.0), ("seven", 1, 70, 20, LOADS, 0.0), ("six", 2, 90, 30, SIDES, 1e-4)],
)
def test_revisits_in_other_ways_show_the_noise(name, seed, poses, again, other, drift_m):
    """Sides and loads move the tool by up to 40 times the noise between these visits."""
    arm = heavy(name)
    made = prepared(arm, revisited(arm, seed, poses, again, other, drift_m))
    noise = made.problem.settings.noise
    assert noise.absolute
    assert NOISE_M / 1.3 < noise.coordinate < 1.3 * NOISE_M
    assert "no_repeats" not in {w["code"] for w in made.warnings}


def test_few_revisits_in_other_ways_bound_the_noise():
    """Five pairs are fewer numbers than what sides and loads may do to them."""
    arm = heavy("ur")
    made = prepared(arm, revisited(arm, 3, 60, 5, SIDES))
    noise = made.problem.settings.noise
    assert (noise.absolute, noise.most) == (True, True)
    assert noise.coordinate > NOISE_M / 1.3
    assert "revisits_bound_noise" in {w["code"] for w in made.warnings}


def test_few_revisits_tell_less_than_shots_and_the_fit():
    """Of 12 numbers the tails are so wide that three effects of a non-centrality of 100 stayed unnamed."""
    arm = heavy("ur")
    rows = revisited(arm, 3, 60, 5, SIDES)
    twice = rows.select(np.repeat(np.arange(len(rows)), 2))
    twice.position[:] += NOISE_M * np.random.default_rng(1).standard_normal(twice.position.shape)
    noise = prepared(arm, twice).problem.settings.noise
    assert (noise.absolute, noise.source) == (False, "repeats within visits")


def test_a_wrong_reading_among_revisits_does_not_widen_the_noise():
    arm = heavy("ur")
    rows = revisited(arm, 4, 70, 20, SIDES)
    rows.position[72] += 2e-3
    noise = prepared(arm, rows).problem.settings.noise
    assert NOISE_M / 1.3 < noise.coordinate < 1.3 * NOISE_M
