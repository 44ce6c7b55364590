"""Corners of boards whose pixels are known: without bias, and within the intervals that are stated."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from kilter_files.rig.see.target import read_target
from kilter_files.rig.see.views import Finder, View, detect_view
from tests.clients.files.rig.see.boards import CHARUCO, TAGS, board, page_of
from tests.clients.files.rig.see.raycaster import Lens, Shot, clean, finished, true_corners

BROWN = Lens(model="brown", k=(-0.25, 0.1, 0.001, -0.0005, 0.0))
FISHEYE = Lens(focal=(500.0, 500.0), model="fisheye", k=(-0.02, 0.003, 0.0, 0.0))
SHOTS = [
    Shot((25, -20, 10), (10, -5, 360), blur_px=0.7),
    Shot((-30, 15, 40), (0, 0, 400), blur_px=0.5, noise=4.0, lens=BROWN),
    Shot((20, 30, -70), (10, 10, 370), blur_px=1.1, lens=BROWN),
    Shot((10, -30, 120), (-10, 5, 300), blur_px=0.8, noise=1.0, gain=0.6, lens=FISHEYE),
]  # a picture takes a second to be drawn
MOST_BIAS_PX = 0.02
KINDS_OF_BOARD = [
    pytest.param(CHARUCO, 0.02, id="charuco"),
    pytest.param(TAGS, 0.06, id="apriltag", marks=pytest.mark.slow),
]


def seen(options: tuple[str, ...], grey: Any) -> View:
    target = read_target(board(options)[0])
    finder = Finder()
    view = detect_view(finder, grey, finder.markers(grey, target.board.dictionary), target, "picture")
    assert isinstance(view, View), view
    return view


@pytest.mark.parametrize(("options", "scatter_px"), KINDS_OF_BOARD)
def test_corners_have_no_bias_and_are_within_their_intervals(options: tuple[str, ...], scatter_px: float) -> None:
    document = board(options)[1]
    off, pulls = [], []
    for shot in SHOTS:
        grey, truth = clean(page_of(options), document, shot), true_corners(document, shot)
        for seed in range(2):
            shot.seed = seed
            view = seen(options, finished(grey, shot))
            assert len(view.places) >= len(truth) - 2
            off.append(view.pixels - truth[view.places])
            pulls.append(off[-1] / view.sigmas)
    every, pull = np.concatenate(off), np.concatenate(pulls)
    each = np.array([one.mean(axis=0) for one in off])
    within = np.mean(np.abs(pull) < 1.96)
    print(
        f"bias {every.mean(axis=0).round(4)} px, of a picture at most {np.abs(each).max():.3f}, scatter {every.std():.3f}"
    )
    print(f"within 95 % intervals: {100 * within:.1f} %, pulls {pull.std():.2f}")
    assert np.abs(every.mean(axis=0)).max() <= MOST_BIAS_PX / 2
    assert np.abs(each).max() <= MOST_BIAS_PX
    assert every.std() <= scatter_px
    assert within >= 0.88
    assert 0.6 <= np.sqrt(np.mean(pull**2)) <= 1.4


@cache
def plain() -> tuple[Any, Any]:
    """The first picture without noise, and its corners."""
    document = board(CHARUCO)[1]
    return clean(page_of(CHARUCO), document, SHOTS[0]), true_corners(document, SHOTS[0])


def test_intervals_grow_with_the_noise_of_the_picture() -> None:
    grey, truth = plain()
    sigmas, pulls = [], []
    for noise in (2.0, 8.0):
        views = [seen(CHARUCO, finished(grey, Shot(noise=noise, seed=seed))) for seed in range(4)]
        sigmas.append(np.median(np.concatenate([view.sigmas for view in views])))
        pulls.append(np.std(np.concatenate([(view.pixels - truth[view.places]) / view.sigmas for view in views])))
    assert 2.5 < sigmas[1] / sigmas[0] < 5
    assert 0.7 < pulls[1] < 1.4


def test_ink_that_runs_moves_no_corner_of_a_chessboard() -> None:
    grey, truth = plain()
    bent = 255 * (grey / 255) ** 0.5  # as a camera with a gamma shows it: black squares look smaller
    view = seen(CHARUCO, finished(bent, Shot(noise=1.0)))
    off = view.pixels - truth[view.places]
    assert np.abs(off.mean(axis=0)).max() <= MOST_BIAS_PX
    assert off.std() <= 0.03
