"""Time is told from what went with it: twins in plain numpy, whose order of measurement is all that differs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from kilter_core.effects.physical import Separator
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.evidence.revisits import number_revisited_poses
from kilter_core.gap.evidence.separators import Separated, assess_visit_order
from kilter_core.observations import Observations
from tests.core.gap.time_twins import robot, twin

QUICK = GapOptions(resamples=2, permutations=2, bootstraps=299, next_poses=0)


def asked(rows: Observations, *effects: str) -> tuple[Any, Separated]:
    """The first effect that a search names, and what the order says of it."""
    report = find_gap(robot(), rows, replace(QUICK, effects=effects))
    judged = report.effects[0]
    (order,) = [e for e in judged.claim.evidence if e.separator is Separator.ORDER]
    assert judged.claim.words in report.sentence
    return judged, order


@pytest.mark.parametrize("effect", ["drift", "settling", "base_step"])
def test_where_the_poses_rose_with_the_clock_no_time_is_named(effect):
    judged, order = asked(twin("climbing", 3).rows, effect)
    assert not order.met
    assert judged.claim.said == "class"
    assert judged.claim.label == "motion with time of base, station, air or arm, or with whatever went with it"
    assert "no pose was revisited at another time" in judged.claim.words
    assert "the height of the tool rose with the clock (correlation 0.9" in judged.claim.words
    assert "revisit poses at other times, or measure all in random order" in judged.claim.words
    document = judged.claim.to_document()["claim"]["evidence"]
    assert next(e for e in document if e["name"] == "order")["told"] == order.told


def test_a_step_that_may_be_the_order_of_the_poses_is_only_possible():
    report = find_gap(robot(), twin("climbing", 3).rows, replace(QUICK, effects=("base_step",)))
    (warning,) = [w for w in report.warnings if w["code"] == "moved_once"]
    assert "may have moved" in warning["message"]


@pytest.mark.parametrize(("kind", "effect"), [("drift", "drift"), ("base", "base_step"), ("zero_drift", "zero_drift")])
def test_revisits_vary_as_the_other_poses_predict(kind, effect):
    judged, order = asked(twin(kind, 4).rows, effect)
    assert order.met
    assert order.number is not None
    assert order.number > 3.0
    assert "and the other poses predict" in order.told
    assert "whatever" not in judged.claim.words


def test_without_revisits_a_random_order_tells_time():
    judged, order = asked(twin("drift", 4, poses=70, revisits=0).rows, "drift")
    assert (order.met, order.told) == (True, "the poses were measured in random order")
    assert judged.claim.words.startswith("motion with time of base, station, air or arm, in the shape of drift")


def test_revisits_that_stay_where_they_were_refute_the_law():
    """From low to high, and at the end a few of the first poses again: they have not moved."""
    climbed = twin("climbing", 3, poses=80)
    rows = climbed.rows
    again = rows.select(np.arange(0, 40, 4))
    rng = np.random.default_rng(1)
    assert again.position is not None
    assert rows.t is not None
    again = replace(
        again, position=again.position + 3e-5 * rng.normal(size=(10, 3)), t=rows.t[-1] + 30.0 * np.arange(1, 11)
    )
    report = find_gap(robot(), Observations.concatenate([rows, again]), replace(QUICK, effects=("drift", "base_step")))
    for judged in report.effects:
        assert judged.claim.is_confounded, judged.claim.words
        assert judged.claim.said == "class"


def course(q: np.ndarray, order: np.ndarray) -> Any:
    """What the order is judged by: joints, tool points, time."""
    q = q[order]
    tool = np.stack(
        [np.cos(q[:, 0]) * np.cos(q[:, 1]), np.sin(q[:, 0]) * np.cos(q[:, 1]), np.sin(q[:, 1] + q[:, 2])], axis=1
    )
    rows = Observations(q=q, t=30.0 * np.arange(len(q)))
    return cast("Any", SimpleNamespace(observations=rows, batch=SimpleNamespace(tool_point=tool)))


def test_an_order_is_random_only_where_neighbours_are_not_neighbours_in_time():
    refused = weak = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-1.5, 1.5, (60, 6))
        used = np.ones(60, dtype=bool)
        refused += not assess_visit_order(course(q, rng.permutation(60)), used).random
        bent = np.tanh(2.0 * q[:, 2]) + 0.2 * q[:, 4]
        for key in (q[:, 1], bent, np.round(q[:, 3]) + 1e-3 * rng.normal(size=60), np.abs(q[:, 0])):
            assert not assess_visit_order(course(q, np.argsort(key)), used).random, seed
        weak += not assess_visit_order(course(q, np.argsort(q[:, 1] + 0.85 * rng.normal(size=60))), used).random
    assert weak >= 38  # correlation 0.7 with the clock
    assert refused <= 4  # 1 % expected: more in one of 3000 such tests
    few = assess_visit_order(course(q[:15], np.arange(15)), used[:15])
    assert not few.random


def test_what_rose_with_the_clock_is_named_by_its_correlation():
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (50, 6))
    said = assess_visit_order(course(q, np.argsort(-q[:, 3])), np.ones(50, dtype=bool))
    assert said.words == "joint 4 fell with the clock (correlation -1.00)"


def test_near_poses_are_revisits_and_samples_of_a_motion_are_not():
    q = np.zeros((6, 3))
    q[:, 0] = [0.0, 1.0, 0.004, 1.003, 2.0, 3.0]
    rows = Observations(q=q)
    assert number_revisited_poses(rows, rows.pose_groups()).tolist() == [0, 1, 0, 1, 2, 3]
    loaded = replace(rows, payload_kg=np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    assert (
        number_revisited_poses(loaded, rows.pose_groups()).tolist()[0]
        != number_revisited_poses(loaded, rows.pose_groups()).tolist()[2]
    )
    motion = Observations(q=np.outer(np.arange(50), [5e-3, 0.0, 0.0]))
    assert len(set(number_revisited_poses(motion, motion.pose_groups()).tolist())) == 50
