"""Poses of a board in pictures: as it stood, and computed once for the same pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kilter_core.measurement.camera import board_poses as module
from kilter_core.measurement.camera.board_poses import board_poses
from tests.core.pixel_scene import Floats, eye_to_hand

SCENE = eye_to_hand(yielding=np.zeros(6))
EYE, SHEET = SCENE.eyes[0], SCENE.sheets[0]


def seen(count: int, seed: int = 0) -> tuple[Floats, Floats]:
    """Pixels of views, and where the corners stood before the camera."""
    q = SCENE.poses(count, np.random.default_rng(seed))
    return SCENE.pixels(q, EYE, SHEET), SCENE.in_camera(q, EYE, SHEET)


def found(pixels: Floats, focal: float = 1.0) -> tuple[Any, ...]:
    camera = EYE.described()
    values = np.array(camera.values) * np.r_[focal, focal, np.ones(len(camera.values) - 2)]
    return board_poses(camera, values, SHEET.described(), pixels)


@pytest.mark.parametrize("most", [0, 1 << 20], ids=["each time", "once"])
def test_a_board_is_where_it_stood(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_BYTES", most)
    pixels, places = seen(12)
    p, R, rms, told = found(pixels)
    assert told.all()
    assert rms.max() < 1e-6
    np.testing.assert_allclose(SHEET.corners @ R.transpose(0, 2, 1) + p[:, None], places, atol=1e-8)


def test_the_same_views_are_computed_once_and_others_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    pixels, _ = seen(12, 1)
    first = found(pixels)
    with pytest.raises(ValueError, match="read-only"):
        first[0][0] = 0.0  # whoever asks next would get it
    refined = module._refined
    asked: list[int] = []
    monkeypatch.setattr(module, "_refined", lambda *given: asked.append(len(given[4])) or refined(*given))
    again = found(pixels.copy())
    assert not asked
    assert all(np.array_equal(one, other, equal_nan=True) for one, other in zip(first, again, strict=True))
    found(pixels, focal=1.001)
    moved = pixels.copy()
    moved[3, 7] += 1e-9
    found(moved)
    assert asked == [12, 12, 12, 12]  # both sides of the board, of each
