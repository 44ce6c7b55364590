"""A gap search on views alone: what hides in the joints is named as surely as an identification knows it, nothing else is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapReport, check, find_gap
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.seen_poses import seen_poses
from kilter_core.measurement.poses import typical_deviations, weights
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.pixel_scene import Floats, Scene, eye_in_hand, eye_to_hand

STIFF = np.zeros(6)
LOOKED_FOR = ("axial_compliance", "base_step", "tool_step", "zero_step", "backlash", "eccentricity")


def direction(q: Floats) -> Floats:
    """Which way each joint came, as good as drawn, yet known again from its angle."""
    return np.where(np.sin(9973.0 * q) > 0.0, 1.0, -1.0)


def play(q: Floats) -> Floats:
    """Joint 2 stops a fifth of a milliradian before where it was sent, from either side."""
    return -2e-4 * direction(q) * np.eye(6)[1]


def off_centre(q: Floats) -> Floats:
    """The disc of joint 3 is off its axis."""
    return 4e-4 * np.cos(q - 0.7) * np.eye(6)[2]


@dataclass(frozen=True)
class Erring(Scene):
    """A scene whose joints are not where they read."""

    erring: Callable[[Floats], Floats] = np.zeros_like

    def tools(self, q: Floats) -> tuple[Floats, Floats]:
        return super().tools(q + self.erring(q))


def erring(scene: Scene, by: Callable[[Floats], Floats]) -> Erring:
    return Erring(scene.drawn, scene.built, scene.eyes, scene.sheets, scene.yielding, by)


def seen_by(scene: Scene, seed: int) -> Observations:
    rng = np.random.default_rng(seed)
    rows = scene.observed(scene.poses(50, rng), rng, 0.1)
    return replace(rows, direction=direction(rows.q))


def search(scene: Scene, rows: Observations) -> GapReport:
    quick = GapOptions(permutations=3, resamples=10, bootstraps=199, effects=LOOKED_FOR, next_poses=0)
    return find_gap(robot_from_document(scene.drawn.document()), rows, quick)


def test_a_check_looks_at_the_poses_that_a_search_looks_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """It had fitted cameras and boards anew for every step of the arm, and did not end."""
    looked: list[Observations] = []
    monkeypatch.setattr(
        check, "prepare_data", lambda begin, rows, *rest: looked.append(rows) or prepare_data(begin, rows, *rest)
    )
    scene = eye_to_hand({}, STIFF)
    rows = seen_by(scene, 3)
    said = check.check_gap(robot_from_document(scene.drawn.document()), rows, GapOptions(effects=LOOKED_FOR))
    assert all(one.pixels is None and one.position is not None for one in looked)
    assert said.poses == 50
    assert {one.id for one in said.testable} >= {"axial_compliance", "backlash", "eccentricity"}


@pytest.mark.parametrize("scene", [eye_to_hand({}, STIFF), eye_in_hand({}, STIFF)], ids=["to_hand", "in_hand"])
def test_views_are_poses_of_the_tool(scene: Scene) -> None:
    rng = np.random.default_rng(4)
    rows = scene.observed(scene.poses(30, rng), rng, 0.1)
    ((seen,), _, _) = seen_poses(Calibration.nominal(robot_from_document(scene.drawn.document())), rows)
    off = seen.position - scene.tools(seen.q)[0]
    assert seen.pixels is None
    assert np.sqrt(np.mean((off / seen.sigma) ** 2)) < 2.0
    assert np.sqrt(np.mean((seen.rotation - scene.tools(seen.q)[1]) ** 2)) < 1e-3


@pytest.mark.parametrize(
    ("scene", "named"),
    [
        (eye_to_hand(), ("axial_compliance j2", "compliance_2")),
        (erring(eye_in_hand({}, STIFF), play), ("backlash j2", "backlash_2")),
        (
            erring(eye_to_hand(yielding=STIFF), off_centre),
            ("eccentricity j3", "eccentricity_sin_3", "eccentricity_cos_3"),
        ),
    ],
    ids=["sag", "backlash", "eccentric"],
)
def test_a_cause_is_named_and_known_as_well_as_pixels_know_it(scene: Scene, named: tuple[str, ...]) -> None:
    """The deviations of its parameters are those of a fit of all pixels within a tenth."""
    label, *parameters = named
    effect, rows = label.partition(" ")[0], seen_by(scene, 5)
    report = search(scene, rows)
    labels = [one.evidence.candidate.label for one in report.effects]
    assert labels[0] == label
    assert {one.partition(" ")[0] for one in labels} == {effect}
    joints = [int(one[-1]) for one in labels]
    options = IdentifyOptions(effects=({"id": effect, "joints": joints},))
    exact = identify(robot_from_document(scene.drawn.document()), rows, None, options)
    sigma = dict(zip(exact.fit.names, exact.fit.sigma, strict=True))
    amplitudes = sorted(report.effects[0].evidence.amplitudes, key=lambda one: one.column)
    assert [one.sigma for one in amplitudes] == pytest.approx([sigma[name] for name in parameters], rel=0.1)


@pytest.mark.parametrize(
    "scene", [eye_to_hand(yielding=STIFF), eye_in_hand(yielding=STIFF)], ids=["to_hand", "in_hand"]
)
def test_an_arm_without_a_hidden_cause_gets_no_name(scene: Scene) -> None:
    assert [one for seed in (6, 7) for one in search(scene, seen_by(scene, seed)).effects] == []


def test_weights_hold_all_that_a_covariance_says() -> None:
    rng = np.random.default_rng(8)
    root = rng.standard_normal((5, 6, 6)) * np.array([1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2])[:, None]
    covariance = root @ root.transpose(0, 2, 1)
    scale = typical_deviations(covariance)
    W = weights(covariance, scale)
    own = W / np.repeat(scale, 3)[:, None]
    np.testing.assert_allclose(own @ covariance @ own.transpose(0, 2, 1), np.tile(np.eye(6), (5, 1, 1)), atol=1e-6)


def test_a_camera_bumped_half_way_is_found_and_not_averaged() -> None:
    scene = eye_to_hand(yielding=STIFF)
    rng = np.random.default_rng(1)
    q = scene.poses(60, rng)
    eye = scene.eyes[0]
    bump = pin.SE3(pin.exp3(np.array([0.0, 0.004, 0.0])), np.array([0.003, 0.0, 0.0]))
    bumped = replace(scene, eyes=(replace(eye, pose=eye.pose * bump),))
    halves = [scene.observed(q[:30], rng, 0.1), bumped.observed(q[30:], rng, 0.1)]
    rows = Observations.concatenate([replace(one, pose_id=None) for one in halves])
    report = search(scene, rows)
    assert report.effects[0].evidence.candidate.label == "base_step"
    assert report.effects[0].verdict in ("confirmed", "class_confirmed", "provisional")


@pytest.mark.parametrize("scene", [eye_in_hand(yielding=STIFF), eye_to_hand(yielding=STIFF)], ids=["camera", "board"])
def test_what_was_bumped_on_the_flange_is_one_name_with_its_shift_and_its_rotation(scene: Scene) -> None:
    """As a shift alone it left a rotation, for which the search named backlash and zeros that jumped."""
    rng = np.random.default_rng(6)
    q, bump = scene.poses(60, rng), pin.SE3(pin.exp3(np.array([0.003, -0.002, 0.004])), np.array([0.003, 0.0, 0.0]))
    (eye,), (sheet,) = scene.eyes, scene.sheets
    part = eye if eye.mount == "flange" else sheet
    moved = replace(part, pose=part.pose * bump)
    bumped = replace(scene, eyes=(moved,)) if part is eye else replace(scene, sheets=(moved,))
    halves = [scene.observed(q[:33], rng, 0.1), bumped.observed(q[33:], rng, 0.1)]
    rows = Observations.concatenate([replace(one, pose_id=None) for one in halves])
    report = search(scene, replace(rows, direction=direction(rows.q)))
    assert [one.evidence.candidate.label for one in report.effects] == ["tool_step"]
    (warning,) = [one for one in report.warnings if one["code"] == "moved_once"]
    change = part.pose * bump * part.pose.inverse()
    assert warning["row"] == 34
    assert abs(warning["moved_mm"] - 1e3 * np.linalg.norm(change.translation)) < 2.0 * warning["u95_mm"] < 0.1
    turn = np.degrees(np.linalg.norm([0.003, -0.002, 0.004]))
    assert abs(warning["rotated_deg"] - turn) < 2.0 * warning["u95_deg"] < 0.05
    assert warning["message"].startswith("The tool, or the camera or board on the flange ")
