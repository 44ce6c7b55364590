"""Poses that a search by views proposes: what they promise of an effect is what a fit of their pixels then knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import find, find_gap, plan_separation
from kilter_core.gap.options import GapOptions
from kilter_core.gap.report.next_poses import separate
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.seen_poses import seen_poses
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.gap.test_pixels_gap import STIFF, erring, play, seen_by
from tests.core.pixel_scene import Scene, eye_in_hand, eye_to_hand

QUICK = GapOptions(effects=("backlash",), permutations=3, resamples=10, bootstraps=199, next_poses=10)


@pytest.mark.parametrize("scene", [eye_to_hand({}, STIFF), eye_in_hand({}, STIFF)], ids=["to_hand", "in_hand"])
def test_the_deviation_that_planned_views_promise_comes_true(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    hiding, asked = erring(scene, play), []
    monkeypatch.setattr(find, "plan_next_poses", lambda *given: asked.append(given) or ([], None))
    robot, rows = robot_from_document(scene.drawn.document()), seen_by(hiding, 5)
    find_gap(robot, rows, QUICK, validation=0.0)
    [(study, search, (effect, *others))] = asked
    assert (effect.evidence.candidate.label, others) == ("backlash j2", [])
    amounts = np.array([one.value for one in effect.evidence.amplitudes])
    searched, named = search.prepared.visits.observations, effect.evidence.candidate
    given = (search.found.problem, searched, named, (), (), amounts, 15, 0)
    new = next(p for p in separate(*given, None, study.by_views) if p.kind == "new")
    assert new.rows.direction is not None
    # Joint 2 stops by the side from which it came, which a measured pose repeats.
    sided = erring(scene, lambda q: -2e-4 * new.rows.direction * np.eye(6)[1])
    more = replace(
        sided.observed(new.rows.q, np.random.default_rng(9), 0.1), direction=new.rows.direction, pose_id=None
    )
    assert len(more) == len(new.rows)
    known = []
    for some in (rows, Observations.concatenate([replace(rows, pose_id=None), more])):
        fitted = identify(robot, some, None, IdentifyOptions(effects=({"id": "backlash", "joints": [2]},)))
        known.append(dict(zip(fitted.fit.names, fitted.fit.sigma, strict=True))["backlash_2"])
    promised = abs(amounts[0]) / np.sqrt(new.after[-1])
    assert promised == pytest.approx(known[1], rel=0.15)
    assert known[1] < 0.85 * known[0]


@pytest.mark.parametrize("scene", [eye_to_hand({}, STIFF), eye_in_hand({}, STIFF)], ids=["to_hand", "in_hand"])
def test_poses_planned_for_an_effect_by_views_keep_what_they_promise(scene: Scene) -> None:
    """`plan_separation` weighs each pose by the pixels of its own view, so that a fit of them knows what was promised."""
    hiding = erring(scene, play)
    robot, rows = robot_from_document(scene.drawn.document()), seen_by(hiding, 5)
    plan = plan_separation(robot, rows, ("backlash", (1,)), count=15)
    new = next(p for p in plan.proposals if p.kind == "new")
    sides = new.rows.direction
    assert sides is not None
    assert (~np.isnan(scene.pixels(new.rows.q, scene.eyes[0], scene.sheets[0])[..., 0])).sum(axis=1).min() == 48
    sided = erring(scene, lambda q: -2e-4 * sides * np.eye(6)[1])
    more = replace(sided.observed(new.rows.q, np.random.default_rng(9), 0.1), direction=sides, pose_id=None)
    known = []
    for some in (rows, Observations.concatenate([replace(rows, pose_id=None), more])):
        fitted = identify(robot, some, None, IdentifyOptions(effects=({"id": "backlash", "joints": [2]},)))
        known.append(dict(zip(fitted.fit.names, fitted.fit.sigma, strict=True))["backlash_2"])
    assert known[1] < 0.85 * known[0]
    # Of an amount that counts as given: how much surer it becomes is what the information grows by.
    assert known[0] / known[1] == pytest.approx(np.sqrt(new.after[-1] / new.before), rel=0.2)


def test_a_search_by_views_proposes_poses_that_its_camera_sees() -> None:
    scene = erring(eye_in_hand({}, STIFF), lambda q: 0.1 * play(q))
    robot = robot_from_document(scene.drawn.document())
    report = find_gap(robot, seen_by(scene, 6), QUICK)
    new = [row for row in report.next_poses if row["kind"] == "new"]
    assert new
    q = np.radians([row["q_deg"] for row in new])
    assert (~np.isnan(scene.pixels(q, scene.eyes[0], scene.sheets[0])[..., 0])).sum(axis=1).min() >= 4


def test_views_as_poses_are_as_certain_as_their_pixels() -> None:
    """Over three draws the deviations of the same fit differ by the noise of 300 numbers, and on average by little."""
    scene = erring(eye_in_hand({}, STIFF), play)
    robot, ratio = robot_from_document(scene.drawn.document()), []
    asked = IdentifyOptions(effects=({"id": "backlash", "joints": [2]},), masses="as_stated")
    for seed in (5, 6, 7):
        rows = seen_by(scene, seed)
        ((seen,), _, _) = seen_poses(Calibration.nominal(robot), rows)
        sigma = [
            dict(zip(one.fit.names, one.fit.sigma, strict=True))["backlash_2"]
            for one in (identify(robot, seen, None, asked), identify(robot, rows, None, asked))
        ]
        ratio.append(sigma[0] / sigma[1])
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.08)
