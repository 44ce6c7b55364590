"""Pictures of a moving arm that come late, or line by line, are said with the time; those of an arm at rest never."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.view_motion import Timing, timing, velocities
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.pixel_scene import Floats, Scene, eye_to_hand

SCENE = eye_to_hand({}, np.zeros(6))
LATE, LINES = 8e-3, 15e-3  # s


def moving(rng: np.random.Generator, count: int, late: float, lines: float, noise_px: float = 0.2) -> Observations:
    """Views of an arm that moves at some 10 degrees a second, ``late`` and read over ``lines`` s."""
    q = SCENE.poses(count, rng, fewest=40, spread=0.5)
    qd = rng.uniform(-0.3, 0.3, q.shape)
    rows = SCENE.observed(q, rng, 0.0)
    seen = rows.pixels
    ahead = _pixels(SCENE, q + qd * 1e-3)
    speed = (ahead - _pixels(SCENE, q - qd * 1e-3)) / 2e-3
    line = seen[..., 1:] / SCENE.eyes[0].size[1] - 0.5
    pixels = seen + speed * (late + lines * line) + noise_px * rng.standard_normal(seen.shape)
    return replace(rows, pixels=pixels, qd=qd)


def _pixels(scene: Scene, q: Floats) -> Floats:
    return scene.pixels(q, scene.eyes[0], scene.sheets[0])


def found(rows: Observations) -> Timing | None:
    views = Measurement.from_observations(rows, held=True).pixels
    assert views is not None
    return timing(views, Calibration.nominal(robot_from_document(SCENE.drawn.document())))


@pytest.mark.parametrize(("late", "lines"), [(LATE, 0.0), (0.0, LINES), (-LATE, LINES), (0.0, 0.0)])
def test_the_times_are_found_and_told_apart(late: float, lines: float) -> None:
    seen = found(moving(np.random.default_rng(1), 60, late, lines))
    assert seen is not None
    assert seen.pictures.s == pytest.approx(late, abs=max(4.0 * seen.pictures.sigma, 5e-4))
    assert seen.lines.s == pytest.approx(lines, abs=max(4.0 * seen.lines.sigma, 5e-4))
    assert (seen.pictures.chance < 1e-3) == (late != 0.0)
    assert (seen.lines.chance < 1e-3) == (lines != 0.0)


def test_an_identification_says_both_and_nothing_of_an_arm_at_rest() -> None:
    robot = robot_from_document(SCENE.drawn.document())
    rows = moving(np.random.default_rng(2), 50, LATE, LINES)
    said = {w["code"]: w for w in identify(robot, rows, None, IdentifyOptions(level=1)).warnings}
    assert said["pictures_late"]["time_s"] == pytest.approx(LATE, rel=0.2)
    assert said["rolling_shutter"]["time_s"] == pytest.approx(LINES, rel=0.2)
    rest = replace(moving(np.random.default_rng(2), 50, 0.0, 0.0), qd=np.zeros((50, 6)))
    codes = {w["code"] for w in identify(robot, rest, None, IdentifyOptions(level=1)).warnings}
    assert not codes & {"pictures_late", "rolling_shutter"}
    assert found(rest) is None


def test_velocities_come_from_times_where_rows_follow_each_other() -> None:
    t = np.array([0.0, 0.1, 0.2, 5.0, 5.1])
    q = np.outer(t, np.arange(1.0, 7.0))
    told = velocities(Observations(q, t=t))
    assert told[1] == pytest.approx(np.arange(1.0, 7.0))
    assert not told[[0, 2, 3, 4]].any()
    assert velocities(Observations(q)) is None
