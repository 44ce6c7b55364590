"""The second detector for AprilTags: its convention for pixels is converted, and corners that differ are refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_client.cli import run
from kilter_files.ground.errors import UsageError
from kilter_files.rig.see.pictures import Refusal
from kilter_files.rig.see.run import Second, create_second_detector
from kilter_files.rig.see.target import read_target
from kilter_files.rig.see.views import Finder, View, detect_view
from tests.clients.files.rig.see.boards import CHARUCO, TAGS, board, page_of, saved
from tests.clients.files.rig.see.raycaster import Shot, picture, true_corners

SHOTS = [
    Shot((20, -15, 8), (5, -5, 400), samples=3),
    Shot((-20, 25, 100), (0, 0, 420), samples=3, seed=1),
]


@pytest.fixture(scope="module")
def pictures() -> list[Any]:
    return [picture(page_of(TAGS), board(TAGS)[1], shot) for shot in SHOTS]


def test_both_detectors_have_no_bias_on_known_pixels(pictures: list[Any]) -> None:
    for grey, shot in zip(pictures, SHOTS, strict=True):
        truth = true_corners(board(TAGS)[1], shot)
        second = Second("tag36h11")
        quads = second._detect_tags(grey)
        assert len(quads) == 20
        apart = []
        for number, quad in quads.items():
            own = truth[4 * number : 4 * number + 4]
            apart += [min(quad - corner, key=np.linalg.norm) for corner in own]
        assert np.abs(np.mean(apart, axis=0)).max() <= 0.02
        assert np.std(apart) < 0.1


def test_views_are_compared_and_one_wrong_corner_is_named(pictures: list[Any]) -> None:
    target, finder = read_target(board(TAGS)[0]), Finder()
    second = create_second_detector([target])
    for grey in pictures:
        view = detect_view(finder, grey, finder.markers(grey, "apriltag_36h11"), target, "p.png")
        assert isinstance(view, View)
        assert second.compare(grey, view, target) is None
    document = second.to_document()
    assert (document["views"], document["corners"]) == (2, 160)
    assert second.bias_px() < 0.02
    assert document["rms_px"] < 0.1
    view.pixels[9] += [1.5, 0.0]
    refused = second.compare(pictures[-1], view, target)
    assert isinstance(refused, Refusal)
    assert (refused.code, refused.corner) == ("detectors_differ", target.numbers[view.places[9]])
    assert second.to_document()["views"] == 2


def test_the_command_shows_it(pictures: list[Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = saved(tmp_path / "pictures", one=pictures[0])
    capsys.readouterr()
    given = ["see", str(folder), "--board", str(board(TAGS)[0]), "-o", str(tmp_path / "views.csv"), "--cross-check"]
    assert run(given) == 0
    assert "pupil-apriltags on 80 corners: ours are" in capsys.readouterr().out
    assert run([*given, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["cross_check"]
    assert abs(found["mean_u_px"]) <= 0.02


def test_it_is_for_apriltags_of_one_dictionary() -> None:
    for options in (CHARUCO, (*TAGS, "--dictionary", "apriltag_36h10")):
        with pytest.raises(UsageError, match="AprilTag boards of one dictionary"):
            create_second_detector([read_target(board(options)[0])])
