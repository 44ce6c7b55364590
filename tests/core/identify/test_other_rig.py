"""Descriptions of another board or camera: refused by their own names, and what they say to do is tried."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.plausibility.unrelated_views import refuse_unrelated_views
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.pixel_scene import BROWN, Eye, Scene, eye_in_hand, eye_to_hand, grid, looking, soft

STIFF = np.zeros(6)
BOTH = (eye_to_hand(yielding=STIFF), eye_in_hand(yielding=STIFF))
SCENES = pytest.mark.parametrize("scene", BOTH, ids=["to", "in"])
RNG = np.random.default_rng(5)
LAYOUTS = {
    "columns and rows swapped": grid(6, 8),
    "a column more": grid(9, 6)[:48],
    "another order": grid()[RNG.permutation(48)],
}
INTRINSICS: dict[str, dict[str, Any]] = {
    "another zoom": {"focal": (1650.0, 1652.0)},
    "another picture size": {"focal": (1000.0, 1001.3), "centre": (641.4, 358.4)},
    "no lens": {"model": "none", "distortion": ()},
    "a prior that is too sure": {"focal": (1650.0, 1652.0), "intrinsics": "prior", "sigmas": (1.0,) * 9},
}


def rows_of(scene: Scene, count: int = 40) -> tuple[Calibration, Observations]:
    rng = np.random.default_rng(3)
    begin = Calibration.nominal(robot_from_document(scene.drawn.document()))
    return begin, scene.observed(scene.poses(count, rng), rng, 0.1)


@SCENES
@pytest.mark.parametrize("layout", list(LAYOUTS))
def test_corners_that_do_not_lie_as_described(scene: Scene, layout: str) -> None:
    """They were said to have the joints of other pictures."""
    begin, rows = rows_of(scene)
    wrong = replace(rows.rig.boards[0], corners=tuple(map(tuple, LAYOUTS[layout].tolist())))
    with pytest.raises(ObservationError, match="columns and rows are swapped") as refused:
        refuse_unrelated_views(begin, replace(rows, rig=replace(rows.rig, boards=(wrong,))))
    assert refused.value.code == "corners_misplaced"
    assert refused.value.context["board"] == rows.rig.boards[0].name
    assert refuse_unrelated_views(begin, rows) == ()


@pytest.mark.parametrize(("scene", "which"), [(BOTH[k % 2], which) for k, which in enumerate(INTRINSICS)])
def test_intrinsics_of_another_camera(scene: Scene, which: str) -> None:
    """They were said to be a camera that was bumped and a board that is not flat."""
    begin, rows = rows_of(scene)
    wrong = replace(rows.rig, cameras=(replace(rows.rig.cameras[0], **INTRINSICS[which]),))
    with pytest.raises(ObservationError, match="another camera, zoom, focus or picture size") as refused:
        refuse_unrelated_views(begin, replace(rows, rig=wrong))
    assert refused.value.code == "intrinsics_differ"
    assert refused.value.context["own_px"] < 0.5 * refused.value.context["stated_px"]


def test_its_remedy_finds_them() -> None:
    scene = eye_to_hand(yielding=STIFF)
    begin, rows = rows_of(scene)
    free = replace(rows.rig.cameras[0], focal=(1650.0, 1652.0), intrinsics="free")
    found = identify(
        begin.robot, replace(rows, rig=replace(rows.rig, cameras=(free,))), 0.25, IdentifyOptions(fix=("beta_*",))
    )
    camera = found.views["cameras"][0]
    assert camera["fx_px"] == pytest.approx(1500.0, abs=5.0)
    assert found.views["pixels"]["validation"]["rms_mm"] < 0.1
    assert not {"camera_moved", "board_not_flat", "views_astray"} & {one["code"] for one in found.warnings}


def test_the_second_of_two_cameras_is_named() -> None:
    scene = eye_to_hand(yielding=STIFF)
    p, R = scene.drawn.poses(np.array([[0.3, -1.4, 1.6, -0.3, 0.9, 0.2]]))
    other = Eye("door", "fixed", looking(p[0], 1.1, -(R[0] @ [-0.2, 0.05, 1.0])), distortion=BROWN)
    both = replace(scene, eyes=(*scene.eyes, other))
    begin, rows = rows_of(both, 30)
    assert refuse_unrelated_views(begin, rows) == ()
    cameras = (rows.rig.cameras[0], replace(rows.rig.cameras[1], focal=(1650.0, 1652.0)))
    with pytest.raises(ObservationError, match="camera 'door'") as refused:
        refuse_unrelated_views(begin, replace(rows, rig=replace(rows.rig, cameras=cameras)))
    assert refused.value.code == "intrinsics_differ"


def test_an_arm_that_is_far_off_is_not_another_camera() -> None:
    """Intrinsics of its views' own more than halve what is left of this arm, and bend its boards."""
    rng, drawn = np.random.default_rng([57, 77]), soft()
    names = {step.name for step in drawn.steps}
    sizes = (("theta_offset", 0.03), ("alpha", 0.015), ("a", 6e-3), ("d", 6e-3))
    errors = {f"{of}_{k}": rng.normal(0, s) for of, s in sizes for k in range(1, 7) if f"{of}_{k}" in names}
    scene = eye_to_hand(errors, STIFF)
    begin = Calibration.nominal(robot_from_document(scene.drawn.document()))
    refuse_unrelated_views(begin, scene.observed(scene.poses(30, rng), rng, 0.3))
