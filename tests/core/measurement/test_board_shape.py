"""A board that is bowed or twisted is found, with its size, whatever the arm's errors; a flat one seldom is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.view_motion import BoardShape, board_shapes
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.pixel_scene import Scene, eye_in_hand, eye_to_hand

STIFF = np.zeros(6)


def bent(scene: Scene, bow_x: float = 0.0, bow_y: float = 0.0, twist: float = 0.0) -> Scene:
    """The same with a sheet whose middle stands out by so much (m); campaigns go on describing a flat one."""
    sheet = scene.sheets[0]
    x, y = (np.linspace(-1.0, 1.0, n) for n in (8, 6))
    x, y = (a.ravel() for a in np.meshgrid(x, y))
    corners = sheet.corners.copy()
    corners[:, 2] += bow_x * (1 - x**2) + bow_y * (1 - y**2) + twist * x * y
    return replace(scene, sheets=(replace(sheet, corners=corners),))


def shape(calibration: Calibration, rows: Observations) -> BoardShape:
    views = Measurement.from_observations(rows, held=True).pixels
    assert views is not None
    prediction = calibration.predict(rows)
    (found,) = board_shapes(views, prediction, views.resolve_rig(prediction))
    return found


@pytest.mark.parametrize("flat", [eye_to_hand(yielding=STIFF), eye_in_hand(yielding=STIFF)], ids=["to_hand", "in_hand"])
def test_a_bow_is_found_with_its_size_on_an_arm_that_is_not_calibrated(flat: Scene) -> None:
    rng = np.random.default_rng(1)
    nominal = Calibration.nominal(robot_from_document(flat.drawn.document()))
    q = flat.poses(40, rng)
    found = shape(nominal, bent(flat, 3e-4, 0.0, -1e-4).observed(q, rng, 0.2, flat.rig()))
    assert found.chance < 1e-6
    assert found.bows == pytest.approx((3e-4, 0.0), abs=1e-4)
    assert found.twist == pytest.approx(-1e-4, abs=6e-5)
    assert abs(found.size - 4e-4) < max(3.0 * found.sigma, 1e-4)


def test_flat_boards_are_called_bent_as_often_as_chance_says() -> None:
    scene = eye_to_hand({}, STIFF)
    nominal = Calibration.nominal(robot_from_document(scene.drawn.document()))
    chances = []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        chances.append(shape(nominal, scene.observed(scene.poses(20, rng), rng, 0.3)).chance)
    assert np.mean(np.array(chances) < 0.1) < 0.3
    assert 0.3 < np.mean(chances) < 0.7


def test_an_identification_warns_of_a_bent_board_and_not_of_a_flat_one() -> None:
    flat, said = eye_to_hand(yielding=STIFF), {}
    for height in (0.0, 4e-4):
        rng = np.random.default_rng(2)
        rows = bent(flat, height).observed(flat.poses(30, rng), rng, 0.1, flat.rig())
        result = identify(robot_from_document(flat.drawn.document()), rows, None, IdentifyOptions())
        said[height] = [w for w in result.warnings if w["code"] == "board_not_flat"]
    assert said[0.0] == []
    (one,) = said[4e-4]
    assert (one["board"], one["size_mm"]) == ("board", pytest.approx(0.4, abs=0.08))
    assert one["bow_x_mm"] == pytest.approx(0.4, abs=2.0 * one["u95_mm"])
    assert "Glue it to a stiff plate" in one["message"]


def test_few_views_say_nothing_of_a_shape() -> None:
    scene, rng = bent(eye_to_hand({}, STIFF), 1e-3), np.random.default_rng(3)
    rows = scene.observed(scene.poses(8, rng), rng, 0.1)
    views = Measurement.from_observations(rows, held=True).pixels
    assert views is not None
    prediction = Calibration.nominal(robot_from_document(scene.drawn.document())).predict(rows)
    assert list(board_shapes(views, prediction, views.resolve_rig(prediction))) == []
