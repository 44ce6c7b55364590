"""Markers that are not what their numbers say: each slip has its own code, and sound sets have none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.measurement.markers import bending, marker_shape, refuse_bad_markers
from kilter_core.observations import Observations
from tests.core.campaigns import joints
from tests.core.truth import small_pose, ur10

Floats = NDArray[np.float64]
UNEVEN = np.array([[0.06, 0.0, 0.0], [-0.03, 0.04, 0.0], [0.0, -0.05, 0.02], [-0.02, 0.0, 0.05]])
EVEN = 0.05 * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.radians([0, 120, 240])])
NOISE = 5e-5


def sets(body: Floats, rows: int = 40, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    R = Rotation.random(rows, rng=rng).as_matrix()
    points = np.einsum("nij,mj->nmi", R, body) + rng.uniform(-1, 1, (rows, 1, 3))
    return points + rng.normal(0.0, NOISE, points.shape)


def code(markers: Floats, known: Floats | None = None) -> tuple[str, str, dict[str, Any]]:
    with pytest.raises(ObservationError) as refused:
        refuse_bad_markers(markers, known)
    return refused.value.code, refused.value.message, refused.value.context


@pytest.mark.parametrize("body", [UNEVEN, UNEVEN[:3], EVEN], ids=["four", "three", "even"])
def test_sound_sets_pass(body: Floats) -> None:
    markers = sets(body)
    refuse_bad_markers(markers)
    refuse_bad_markers(markers, marker_shape(sets(body, seed=1)))
    markers[5, 1] = np.nan
    markers[::3, 2] = np.nan
    refuse_bad_markers(markers)
    assert bending(markers, NOISE) is None


@pytest.mark.parametrize("share", [0.5, 0.9, 0.05])
def test_a_swap_part_of_the_way_names_row_and_markers(share: float) -> None:
    markers = sets(UNEVEN)
    start = round(len(markers) * (1 - share))
    markers[start:] = markers[start:, [0, 2, 1, 3]]
    name, message, context = code(markers)
    assert name == "markers_swapped"
    assert f"From row {start + 1} on markers 2 and 3" in message
    assert context["rows"] == len(markers) - start


def test_a_cycle_of_three_markers_is_a_swap_too() -> None:
    markers = sets(UNEVEN[:3])
    markers[30:] = markers[30:, [1, 2, 0]]
    name, message, _ = code(markers)
    assert (name, "markers 1, 2, 3" in message) == ("markers_swapped", True)


def test_an_order_that_goes_the_other_way_round_is_mirrored() -> None:
    known = marker_shape(sets(UNEVEN))
    assert code(sets(UNEVEN, seed=1)[:, [0, 2, 1, 3]], known)[0] == "markers_mirrored"
    assert code(sets(UNEVEN, seed=1)[:, [1, 2, 0, 3]], known)[0] == "markers_swapped"
    # A left-handed export keeps every distance.
    assert code(sets(UNEVEN, seed=1) * [1, -1, 1], known)[0] == "markers_mirrored"
    with pytest.raises(ObservationError, match="3 markers, the shape they are compared with 4"):
        refuse_bad_markers(sets(UNEVEN[:3]), known)


def test_a_loose_marker_is_named() -> None:
    markers = sets(UNEVEN)
    rng = np.random.default_rng(9)
    markers[:, 3] += rng.normal(0.0, 3e-3, (40, 3))
    name, message, _ = code(markers)
    assert name == "markers_not_rigid"
    assert "Without marker 4" in message
    assert code(np.delete(markers, 2, axis=1))[0] == "markers_not_rigid"


def test_a_wild_row_is_no_loose_marker() -> None:
    markers = sets(UNEVEN, 100)
    markers[17, 2] += 0.5
    markers[60, 0] = -0.3
    refuse_bad_markers(markers)
    assert bending(markers, NOISE) is None


def test_a_set_that_bends_a_little_is_worth_a_warning() -> None:
    markers = sets(UNEVEN)
    rng = np.random.default_rng(9)
    markers[:, 1] += rng.normal(0.0, 4e-4, (40, 3))
    refuse_bad_markers(markers)
    found = bending(markers, NOISE)
    assert found is not None
    assert 2 in found[:2]
    assert found[2] == pytest.approx(4e-4, rel=0.4)


def campaign(body: Floats, rows: int = 40) -> tuple[Any, Floats, Floats]:
    """Joints and markers of a robot that is not quite as drawn."""
    rng = np.random.default_rng(1)
    arm = ur10()
    q = joints(arm, rows, rng)
    base, tool = small_pose(rng, 2.0, 2.0), small_pose(rng, 0.1, 1.0)
    position, rotation = type(arm)(arm.steps, arm.n, base, tool).poses(q)
    points = position[:, None] + np.einsum("nij,mj->nmi", rotation, body)
    return robot_from_document(arm.document()), q, points + rng.normal(0.0, NOISE, points.shape)


@pytest.mark.parametrize("share", [0.5, 0.1])
def test_a_swap_in_an_even_set_shows_in_its_turn(share: float) -> None:
    robot, q, markers = campaign(EVEN)
    start = round(40 * (1 - share))
    swapped = markers.copy()
    swapped[start:] = markers[start:, [0, 2, 1]]
    refuse_bad_markers(swapped)  # no distance shows it
    with pytest.raises(ObservationError, match="180 degrees") as refused:
        identify(robot, Observations(q, markers=swapped))
    assert refused.value.code == "markers_swapped"
    assert refused.value.context["rows"] == 40 - start or share == 0.5
    sound = identify(robot, Observations(q, markers=markers))
    assert sound.metrics["train"]["identified"]["rms_mm"] < 0.15


def test_identify_refuses_and_warns() -> None:
    robot, q, markers = campaign(UNEVEN)
    swapped = markers.copy()
    swapped[20:] = swapped[20:, [1, 0, 2, 3]]
    with pytest.raises(ObservationError, match="From row 21"):
        identify(robot, Observations(q, markers=swapped))
    with pytest.raises(ObservationError, match="numbered the other way round"):
        identify(robot, Observations(q, markers=markers), Observations(q, markers=markers[:, [1, 0, 2, 3]]))
    bent = markers + np.random.default_rng(0).normal(0.0, 4e-4, markers.shape) * np.array([0, 1, 0, 0])[:, None]
    found = identify(robot, Observations(q, markers=bent))
    said = {w["code"]: w for w in found.warnings}
    assert 2 in said["markers_not_rigid"]["markers"]


def test_a_digitised_tip_is_the_tool_point_of_the_calibration() -> None:
    robot, q, markers = campaign(UNEVEN)
    place = np.array([0.0, 0.0, 0.2])
    rng = np.random.default_rng(1)
    joints(ur10(), 40, rng)
    base, tool = small_pose(rng, 2.0, 2.0), small_pose(rng, 0.1, 1.0)
    arm = type(ur10())(ur10().steps, 6, base, tool)
    position, rotation = arm.poses(q)
    tip = np.full((40, 3), np.nan)
    tip[:2] = position[:2] + rotation[:2] @ place
    whole = Observations.concatenate(
        [Observations(q[:20], markers=markers[:20], tip=tip[:20]), Observations(q[20:], markers=markers[20:])]
    )
    found = identify(robot, whole)
    predicted = found.calibration.predict(Observations(q)).position
    np.testing.assert_allclose(predicted, position + rotation @ place, atol=3e-4)
    middle = identify(robot, Observations(q, markers=markers)).calibration.predict(Observations(q)).position
    np.testing.assert_allclose(middle, markers.mean(axis=1), atol=2e-4)


def test_visibility_gaps_cost_little() -> None:
    robot, q, markers = campaign(UNEVEN, 60)
    hidden = markers.copy()
    rng = np.random.default_rng(3)
    for k in np.flatnonzero(np.arange(60) % 10 > 0):
        hidden[k, rng.integers(4)] = np.nan
    hidden[11] = np.nan  # nothing at all
    whole, gaps = (identify(robot, Observations(q, markers=m), None, IdentifyOptions()) for m in (markers, hidden))
    assert gaps.metrics["train"]["identified"]["rms_mm"] == pytest.approx(
        whole.metrics["train"]["identified"]["rms_mm"], rel=0.15
    )
