"""Views beside a ball in sockets or on a bar in one fit: a length of half a metre settles what a printed board does not.

Pinocchio's arm is held and drawn; a board is printed 0.1 % too large, and nobody knows where the ball is to 5 mm.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.identify import Folds, Identification, IdentifyOptions, identify
from kilter_core.identify.seen_poses import seen_poses
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.campaigns import held
from tests.core.identify.test_pixels import UNSURE, lengths
from tests.core.measurement.test_pixels import STIFF, registered_error
from tests.core.pixel_scene import Floats, Scene, eye_to_hand

PLAY = 2e-5  # m, of a ball in its socket
OFF = np.array([0.004, -0.003, 0.002])  # m, of the ball from where it is stated
FEET = np.array([[0.55, 0.25, 0.35], [0.35, -0.25, 0.55]])


def scene_of(seed: int) -> Scene:
    return eye_to_hand(lengths(seed), yielding=STIFF, scale=1e-3)


def with_play(scene: Scene, q: Floats, rng: np.random.Generator) -> Floats:
    J = scene.built.joint_jacobians(q)[:, :3]
    return q + np.einsum("nij,nj->ni", np.linalg.pinv(J), rng.normal(0.0, PLAY, (len(q), 3)))


def sockets(scene: Scene, rng: np.random.Generator, count: int = 8) -> Observations:
    q, number = [], []
    for k, foot in enumerate(FEET, 1):
        begun = scene.poses(count, rng)
        found = held(scene.built, begun, lambda p, c=foot: (p - c, np.eye(3)))
        q.append(found)
        number += [k] * len(found)
    return Observations(with_play(scene, np.concatenate(q), rng), socket=np.array(number))


def bar(scene: Scene, rng: np.random.Generator, count: int = 16) -> Observations:
    q = scene.poses(count, rng)
    length = np.linalg.norm(scene.built.poses(q)[0] - FEET[0], axis=1) + rng.normal(0.0, PLAY, count)
    return Observations(q, bar=np.ones(count, dtype=np.int64), bar_length=length)


def fitted(scene: Scene, rows: Observations, **options: object) -> Identification:
    drawn = replace(scene.drawn, tool=scene.drawn.tool * pin.SE3(np.eye(3), OFF))
    return identify(robot_from_document(drawn.document()), rows, None, IdentifyOptions(**options))


def gauges(found: Identification) -> list[str]:
    return [w["gauge"] for w in found.warnings if w["code"] == "camera_gauge"]


def test_two_sockets_a_known_distance_apart_settle_the_scale() -> None:
    scene, rng = scene_of(3), np.random.default_rng(3)
    views = scene.observed(scene.poses(40, rng), rng, 0.1, scene.rig(boards=UNSURE))
    both = Observations.concatenate([views, sockets(scene, rng)])
    apart = {"1-2": 1e3 * float(np.linalg.norm(FEET[0] - FEET[1]))}
    alone, unknown, found = (
        fitted(scene, views), fitted(scene, both), fitted(scene, both, socket_distances_mm=apart),
    )  # fmt: skip
    assert "board_scale" in gauges(alone)
    assert "board_scale" in gauges(unknown)  # a ball stays in its socket whatever the scale
    assert "board_scale" not in gauges(found)
    scale = found.views["boards"][0]
    assert scale["scale_percent"] == pytest.approx(0.1, abs=3.0 * scale["scale_sigma_percent"])
    assert scale["scale_sigma_percent"] < 0.02
    check = scene.poses(60, rng)
    assert 1e3 * registered_error(found.calibration, scene, check) <= 0.08
    kinds = {row["kind"]: row for row in found.to_document()["measurements"]}
    assert kinds["contacts"]["noise"] == pytest.approx(1e3 * PLAY, rel=0.4)
    assert kinds["pixels"]["noise"] > 0.0
    assert found.views["pixels"]["noise_px"] == pytest.approx(0.1, rel=0.1)
    at = found.calibration.model.T_tool[:3, 3]
    assert np.linalg.norm(at - scene.drawn.tool.translation) < 0.5e-3  # d_6 and the tool are one length to views
    q = scene.poses(5, rng)
    halves = found.predictive.of_the_tool(found.calibration, Observations(q))
    assert np.all((halves > 0.0) & (halves < 1e-3))


def test_a_ball_bar_settles_the_scale_and_the_hold_out_has_both() -> None:
    scene, rng = scene_of(4), np.random.default_rng(4)
    views = scene.observed(scene.poses(40, rng), rng, 0.1, scene.rig(boards=UNSURE))
    both = Observations.concatenate([bar(scene, rng), views])
    drawn = replace(scene.drawn, tool=scene.drawn.tool * pin.SE3(np.eye(3), OFF))
    found = identify(robot_from_document(drawn.document()), both, 0.25, IdentifyOptions())
    assert "board_scale" not in gauges(found)
    assert found.views["boards"][0]["scale_percent"] == pytest.approx(0.1, abs=0.03)
    assert found.views["pixels"]["validation"]["rms_mm"] < 0.08
    measured = {row["kind"]: row for row in found.to_document()["measurements"]}
    assert measured["contacts"]["train"]["identified"] < 0.1
    assert measured["contacts"]["validation"] is None  # all of them were fitted, and whole poses of views held out
    folded = identify(robot_from_document(drawn.document()), both, Folds(2), IdentifyOptions())
    assert folded.metrics["validation"]["identified"]["mean_mm"] < 0.08


def points(scene: Scene, rng: np.random.Generator, count: int = 12) -> Observations:
    """A tracker's points of the ball, in the tracker's own frame."""
    q = scene.poses(count, rng)
    place = pin.SE3(pin.exp3(np.array([0.1, 0.2, 2.0])), np.array([2.0, 1.0, 0.3]))
    seen = scene.tools(q)[0] @ place.rotation.T + place.translation
    return Observations(q, position=seen + PLAY * rng.standard_normal((count, 3)))


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0)])
def test_views_a_tracker_and_contacts_are_one_fit(order: tuple[int, ...]) -> None:
    """Each says what it brought, and how noisy it is; held out are poses of the tracker and of the views."""
    scene, rng = scene_of(3), np.random.default_rng(3)
    parts = [
        scene.observed(scene.poses(40, rng), rng, 0.1, scene.rig(boards=UNSURE)),
        points(scene, rng),
        bar(scene, rng),
    ]
    both = Observations.concatenate([replace(parts[k], pose_id=None) for k in order])
    drawn = replace(scene.drawn, tool=scene.drawn.tool * pin.SE3(np.eye(3), OFF))
    found = identify(robot_from_document(drawn.document()), both, 0.25, IdentifyOptions())
    assert not gauges(found)
    assert 1e3 * registered_error(found.calibration, scene, scene.poses(60, rng)) <= 0.08
    measured = {row["kind"]: row for row in found.to_document()["measurements"]}
    assert list(measured) == ["points", "contacts", "pixels"]
    assert measured["points"]["numbers"] == 27  # of nine of twelve poses
    assert measured["contacts"]["numbers"] == 13  # sixteen lengths, less the three of the bar's foot
    assert measured["points"]["noise"] == pytest.approx(1e3 * PLAY, rel=0.4)
    assert measured["contacts"]["noise"] == pytest.approx(1e3 * PLAY, rel=0.5)
    assert measured["points"]["validation"]["identified"] < 0.1
    assert measured["contacts"]["validation"] is None
    assert "base_x" in measured["points"]["known_because_of_it"]
    assert "d_5" in measured["pixels"]["known_because_of_it"]


def test_a_tracker_and_contacts_alone_are_refused_with_what_joins_them() -> None:
    scene, rng = scene_of(3), np.random.default_rng(3)
    with pytest.raises(ObservationError, match="beside views of a camera"):
        Observations.concatenate([points(scene, rng), bar(scene, rng)])


def test_a_search_takes_the_views_and_leaves_the_contacts_to_the_geometry() -> None:
    scene, rng = scene_of(5), np.random.default_rng(5)
    views = scene.observed(scene.poses(30, rng), rng, 0.1, scene.rig(boards=UNSURE))
    both = Observations.concatenate([views, sockets(scene, rng)])
    robot = robot_from_document(scene.drawn.document())
    ((seen,), _, _) = seen_poses(Calibration.nominal(robot), both)
    assert len(seen) == len(views)
    assert (seen.socket, seen.pixels) == (None, None)
    assert np.linalg.norm(seen.position - scene.tools(seen.q)[0], axis=1).max() < 0.05
