"""Rows and rigs that are not as stated: joints of other pictures, a camera that was bumped, a board of another size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import Finding, ObservationError
from kilter_core.gap.evidence.held_out.when import describe_moved_part, not_said_by
from kilter_core.gap.find import find_gap
from kilter_core.gap.options import GapOptions
from kilter_core.gap.outcome_warnings import SENTENCES
from kilter_core.identify import Identification, IdentifyOptions, identify
from kilter_core.identify.plausibility.unrelated_views import far_views, refuse_unrelated_views
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.pixel_scene import Scene, eye_in_hand, eye_to_hand

STIFF = np.zeros(6)
WRONG = ("views_astray", "camera_moved", "board_scale_differs")
SCENES = pytest.mark.parametrize("scene", [eye_to_hand(yielding=STIFF), eye_in_hand(yielding=STIFF)], ids=["to", "in"])


def said(found: Identification) -> list[dict[str, Any]]:
    return [one for one in found.warnings if one["code"] in WRONG]


def fitted(scene: Scene, rows: Observations, validation: float | None = None) -> Identification:
    return identify(robot_from_document(scene.drawn.document()), rows, validation, IdentifyOptions(fix=("beta_*",)))


@SCENES
def test_rows_with_the_joints_of_other_pictures_are_named(scene: Scene) -> None:
    rng = np.random.default_rng(1)
    rows = scene.observed(scene.poses(40, rng), rng)
    begin = Calibration.nominal(robot_from_document(scene.drawn.document()))
    assert far_views(begin, rows) == []
    which = np.array([3, 11, 25, 30])
    q = rows.q.copy()
    q[which] = rows.q[np.roll(which, 1)]
    swapped = replace(rows, q=q)
    assert [row for row, _ in far_views(begin, swapped)] == which.tolist()
    with pytest.raises(ObservationError, match=r"Rows 4 .*, 12 .*, 26 .*, 31 ") as refused:
        fitted(scene, swapped)
    assert refused.value.code == "views_astray"
    assert refused.value.context["rows"] == [4, 12, 26, 31]


@SCENES
def test_rows_a_little_off_are_named_after_the_fit(scene: Scene) -> None:
    """Half a degree of one joint is no other picture: a nominal arm leaves as much, and only the fit of the others tells."""
    rng = np.random.default_rng(2)
    rows = scene.observed(scene.poses(40, rng), rng)
    assert said(fitted(scene, rows)) == []
    q = rows.q.copy()
    q[[4, 11, 30], 2] += np.radians(0.5)
    (warning,) = said(fitted(scene, replace(rows, q=q)))
    assert warning["code"] == "views_astray"
    assert warning["rows"] == [5, 12, 31]


@SCENES
@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.003, -0.002, 0.004)], ids=["shift", "rotation"])
def test_a_camera_that_moved_is_found_with_its_size(scene: Scene, turn: tuple[float, float, float]) -> None:
    """Its remedy, another name from the row that is told, leaves nothing to warn of."""
    rng = np.random.default_rng(3)
    q, eye = scene.poses(50, rng), scene.eyes[0]
    bump = pin.SE3(pin.exp3(np.array(turn)), np.array([0.003, 0.0, 0.0]))
    bumped = replace(scene, eyes=(replace(eye, pose=eye.pose * bump),))
    halves = [scene.observed(q[:27], rng), bumped.observed(q[27:], rng)]
    rows = Observations.concatenate([replace(one, pose_id=None) for one in halves])
    (warning,) = said(fitted(scene, rows))
    assert (warning["code"], warning["name"], warning["row"]) == ("camera_moved", eye.name, 28)
    change = eye.pose * bump * eye.pose.inverse()  # in the room, or on the tool
    at = scene.tools(q[27:])[0] if eye.mount == "fixed" else np.zeros((1, 3))
    off = at @ (change.rotation - np.eye(3)).T + change.translation
    true = 1e3 * np.sqrt(np.mean(np.sum(off**2, axis=1)))
    assert abs(warning["moved_mm"] - true) < 2.0 * warning["u95_mm"] < 0.5
    assert abs(warning["rotated_deg"] - np.degrees(np.linalg.norm(turn))) < 2.0 * warning["u95_deg"] < 0.1
    rig = replace(rows.rig, cameras=(rows.rig.cameras[0], replace(rows.rig.cameras[0], name="other")))
    assert said(fitted(scene, replace(rows, rig=rig, camera=(np.arange(50) >= 27).astype(np.int64)))) == []


@pytest.mark.parametrize("size", [0.96, 1.04])
def test_a_board_of_another_size_is_refused_with_its_size(size: float) -> None:
    scene = eye_to_hand(yielding=STIFF, scale=size - 1.0)
    rng = np.random.default_rng(4)
    rows = scene.observed(scene.poses(40, rng), rng)
    begin = Calibration.nominal(robot_from_document(scene.drawn.document()))
    with pytest.raises(ObservationError, match="Measure its ruler") as refused:
        refuse_unrelated_views(begin, rows)
    assert refused.value.code == "board_scale_differs"
    assert refused.value.context["larger_percent"] == pytest.approx(1e2 * (size - 1.0), abs=0.5)
    right = replace(rows.rig.boards[0], corners=tuple(tuple(size * np.array(c)) for c in rows.rig.boards[0].corners))
    assert refuse_unrelated_views(begin, replace(rows, rig=replace(rows.rig, boards=(right,)))) == ()


@pytest.mark.parametrize("sigma", [0.0, 1e-3])
def test_a_smaller_contradiction_of_board_and_lengths_is_told_after_the_fit(sigma: float) -> None:
    rng = np.random.default_rng(5)
    for scale in (0.0, 0.008):
        scene = eye_to_hand(yielding=STIFF, scale=scale)
        rows = scene.observed(scene.poses(40, rng), rng, 0.1, scene.rig(boards={"scale_sigma": sigma}))
        found = said(fitted(scene, rows))
        assert [one["code"] for one in found] == ["board_scale_differs"] * (scale > 0.0)
        for one in found:
            assert abs(one["larger_percent"] - 1e2 * scale) < one["u95_percent"] < 0.4


def test_a_search_says_how_far_a_camera_moved() -> None:
    """Millimetres at the tool: weighed by what views know well, 3 mm across the line of sight were 26."""
    scene = eye_to_hand(yielding=STIFF)
    rng = np.random.default_rng(6)
    q, eye = scene.poses(60, rng), scene.eyes[0]
    bumped = replace(scene, eyes=(replace(eye, pose=eye.pose * pin.SE3(np.eye(3), np.array([0.003, 0.0, 0.0]))),))
    halves = [scene.observed(q[:30], rng), bumped.observed(q[30:], rng)]
    rows = Observations.concatenate([replace(one, pose_id=None) for one in halves])
    quick = GapOptions(permutations=3, resamples=10, bootstraps=99, effects=("base_step", "tool_step"), next_poses=0)
    report = find_gap(robot_from_document(scene.drawn.document()), rows, quick)
    told = {one["code"]: one for one in report.warnings}
    assert "camera_moved" not in told  # of the fit before it, which has one place of the camera; the version has both
    assert (told["moved_once"]["row"], told["moved_once"]["part"], told["moved_once"]["name"]) == (
        31,
        "camera",
        eye.name,
    )
    assert "by 3 mm (95 %: within " in told["moved_once"]["message"]
    assert f"If camera {eye.name} moved, give it another name from there on" in told["moved_once"]["message"]


@pytest.mark.parametrize(
    ("rows", "turn", "one"),
    [
        ([30, 32], 0.1, True),
        ([40, 41], 0.1, False),  # another move
        ([31, 31], None, False),  # the zero of a joint
    ],
)
def test_a_move_is_told_once_where_a_search_names_it(rows: list[int], turn: float | None, one: bool) -> None:
    step = {"row": 31, "rows_95": rows, "moved_mm": 1.0, "u95_mm": 0.1, "rotated_deg": turn, "u95_deg": 0.01}
    camera = {"code": "camera_moved", "rows_95": [31, 33], "part": "camera", "name": "eye", "message": "It averages."}
    astray = {"code": "views_astray", "message": "Rows."}
    part = describe_moved_part(step, [astray, camera])
    words = {"effect": "base_step", "joint": 1, "before": 30, "likely": False, "by_views": True}
    found = Finding("moved_once", {**step, **part}, {**words, "moves_frame": turn is not None}).to_document(SENTENCES)
    left = [w["code"] for w in not_said_by([found], [astray, camera])]
    assert left == ["views_astray", *([] if one else ["camera_moved"])]
    assert ("If camera eye moved, give it another name" in found["message"]) == one
    assert found.get("name") == ("eye" if one else None)
