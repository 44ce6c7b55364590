"""Views, ten points of a tracker and a ball bar together: what hides is named and fitted, and nothing else is.

Pinocchio moves the arm and plain numpy draws its pixels, 0.3 px off; gears yield and joint 2 has play.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.gap.find import find_gap
from kilter_core.gap.options import GapOptions
from kilter_core.identify import Identification, IdentifyOptions, identify
from kilter_core.identify.seen_poses import seen_poses
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.watch.arm_check import check
from tests.core.gap.test_pixels_gap import LOOKED_FOR, direction, erring, play
from tests.core.identify.test_pixels import UNSURE, lengths
from tests.core.identify.test_pixels_beside_contacts import FEET, PLAY
from tests.core.measurement.test_pixels import STIFF
from tests.core.pixel_scene import HOME, Floats, Scene, eye_to_hand

PLACE = pin.SE3(pin.exp3(np.array([0.1, 0.2, 2.0])), np.array([2.0, 1.0, 0.3]))  # of the tracker
REFLECTORS = np.array([[0.05, 0.0, 0.02], [-0.03, 0.05, 0.0], [-0.02, -0.04, 0.03]])
CAUSES = ({"id": "axial_compliance", "joints": [2, 3]}, {"id": "backlash", "joints": [2]})


def hiding(seed: int) -> Scene:
    return erring(eye_to_hand(lengths(seed), scale=1e-3), play)


def sided(rows: Observations) -> Observations:
    return replace(rows, direction=direction(rows.q), pose_id=None)


def views(scene: Scene, rng: np.random.Generator, count: int = 60) -> Observations:
    return sided(scene.observed(scene.poses(count, rng), rng, 0.3, scene.rig(boards=UNSURE)))


def points(scene: Scene, rng: np.random.Generator, count: int = 10) -> Observations:
    q = HOME + rng.uniform(-1.2, 1.2, (count, 6))
    seen = scene.tools(q)[0] @ PLACE.rotation.T + PLACE.translation
    return sided(Observations(q, position=seen + PLAY * rng.standard_normal((count, 3))))


def markers(scene: Scene, rng: np.random.Generator, tip: bool, count: int = 10) -> Observations:
    q = HOME + rng.uniform(-1.2, 1.2, (count, 6))
    p, R = scene.tools(q)
    on = p[:, None] + np.einsum("nij,mj->nmi", R, REFLECTORS)
    seen, ball = (one @ PLACE.rotation.T + PLACE.translation for one in (on, p))
    noise = [PLAY * rng.standard_normal(one.shape) for one in (seen, ball)]
    return sided(Observations(q, markers=seen + noise[0], tip=ball + noise[1] if tip else None))


def bar(scene: Scene, rng: np.random.Generator, count: int = 16) -> Observations:
    q = scene.poses(count, rng)
    length = np.linalg.norm(scene.tools(q)[0] - FEET[0], axis=1) + rng.normal(0.0, PLAY, count)
    return sided(Observations(q, bar=np.ones(count, dtype=np.int64), bar_length=length))


def fitted(scene: Scene, rows: Observations) -> Identification:
    return identify(robot_from_document(scene.drawn.document()), rows, None, IdentifyOptions(effects=CAUSES))


def error_mm(found: Calibration, scene: Scene, q: Floats) -> float:
    """Mean distance of the tool from the truth, the base placed where that fits best."""
    a, b = found.predict(sided(Observations(q))).position, scene.tools(q)[0]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return float(1e3 * np.linalg.norm(b - a @ R.T, axis=1).mean())


def labels(scene: Scene, rows: Observations) -> list[str]:
    quick = GapOptions(permutations=3, resamples=10, bootstraps=199, effects=LOOKED_FOR, next_poses=0)
    report = find_gap(robot_from_document(scene.drawn.document()), rows, quick)
    return [one.evidence.candidate.label for one in report.effects]


@pytest.mark.parametrize("seed", [3, 4])
def test_ten_points_leave_a_tenth_of_a_millimetre_and_their_noise_is_their_own(seed: int) -> None:
    scene, rng = hiding(seed), np.random.default_rng(seed)
    found = fitted(scene, Observations.concatenate([views(scene, rng), points(scene, rng), bar(scene, rng)]))
    assert error_mm(found.calibration, scene, scene.poses(60, rng)) <= 0.08
    values = dict(zip(found.calibration.names, found.calibration.values, strict=True))
    assert values["compliance_2"] == pytest.approx(scene.yielding[1], rel=0.1)
    noise = {row["kind"]: row["noise"] for row in found.to_document()["measurements"]}
    assert 0.5e3 * PLAY < noise["points"] < 2e3 * PLAY  # of some five numbers that parameters leave
    assert 0.5e3 * PLAY < noise["contacts"] < 2e3 * PLAY


def test_a_later_tracker_does_not_raise_an_alarm_over_the_noise_of_ten_points() -> None:
    scene, rng = hiding(3), np.random.default_rng(3)
    found = fitted(scene, Observations.concatenate([views(scene, rng), points(scene, rng), bar(scene, rng)]))
    later = check(found.calibration, points(scene, rng, 15), found.predictive)
    assert later.verdict == "ok"
    assert found.predictive.freedom < 30.0  # the numbers of ten points, and not those of all corners


def test_markers_with_a_digitised_ball_stand_beside_views_and_contacts() -> None:
    scene, rng = hiding(3), np.random.default_rng(3)
    seen, held = views(scene, rng), bar(scene, rng)
    found = fitted(scene, Observations.concatenate([seen, markers(scene, rng, tip=True), held]))
    assert error_mm(found.calibration, scene, scene.poses(60, rng)) <= 0.08
    assert [row["kind"] for row in found.to_document()["measurements"]] == ["markers", "contacts", "pixels"]
    again = check(found.calibration, views(scene, rng, 15), found.predictive)  # by views alone, which show no marker
    assert again.verdict == "ok"
    with pytest.raises(ObservationError, match="where on the tool the ball is") as refused:
        fitted(scene, Observations.concatenate([seen, markers(scene, rng, tip=False), held]))
    assert refused.value.code == "ball_unknown"


@pytest.mark.parametrize(
    "instrument", [points, lambda scene, rng: markers(scene, rng, tip=True)], ids=["points", "markers"]
)
def test_a_search_beside_few_points_names_sag_and_backlash_by_the_views(instrument) -> None:  # type: ignore[no-untyped-def]
    scene, rng = hiding(4), np.random.default_rng(4)
    rows = Observations.concatenate([views(scene, rng), instrument(scene, rng), bar(scene, rng)])
    assert {"axial_compliance j2", "backlash j2"} <= set(labels(scene, rows))


def test_a_search_beside_many_points_takes_these() -> None:
    scene, rng = hiding(4), np.random.default_rng(4)
    tracked = points(scene, rng, 40)
    rows = Observations.concatenate([views(scene, rng), tracked, bar(scene, rng)])
    ((seen,), _, _) = seen_poses(Calibration.nominal(robot_from_document(scene.drawn.document())), rows)
    measured = ~np.isnan(seen.position).any(axis=1)
    np.testing.assert_array_equal(seen.position[measured], tracked.position)
    assert {"axial_compliance j2", "backlash j2"} <= set(labels(scene, rows))


@pytest.mark.parametrize("seed", [5, 6])
def test_an_arm_without_a_hidden_cause_gets_no_name(seed: int) -> None:
    scene, rng = eye_to_hand(lengths(seed), yielding=STIFF, scale=1e-3), np.random.default_rng(seed)
    assert labels(scene, Observations.concatenate([views(scene, rng), points(scene, rng), bar(scene, rng)])) == []
