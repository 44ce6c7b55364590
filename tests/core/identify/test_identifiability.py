"""Null directions: found, told apart from weak ones, and named in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.check import check_identification
from kilter_core.identify.identifiability import identifiable, null_directions
from kilter_core.identify.report import Known
from kilter_core.observations import Observations
from tests.core.soft_arm import scene

NAMES = ("a", "b", "c", "d")


def jacobian(rng: np.random.Generator) -> np.ndarray:
    return rng.normal(size=(50, 4)) * 1e4


def test_data_that_see_everything_leave_no_direction() -> None:
    assert null_directions(jacobian(np.random.default_rng(0)), NAMES, np.full(4, 1e-2)) == ()


def test_a_parameter_without_effect_is_named_alone() -> None:
    J = jacobian(np.random.default_rng(1))
    J[:, 2] = 0.0
    (blind,) = null_directions(J, NAMES, np.full(4, 1e-2))
    assert blind.structural
    assert blind.sentence() == "c has no effect on these measurements; it keeps its starting value."


def test_aliases_are_named_one_by_one_with_weights_that_cancel() -> None:
    J = jacobian(np.random.default_rng(2))
    J[:, 1] = -2.0 * J[:, 0]
    J[:, 3] = 0.5 * J[:, 2]
    found = null_directions(J, NAMES, np.array([1e-2, 1e-3, 1e-2, 1e-3]))
    assert {frozenset(name for name, _ in d.weights) for d in found} == {frozenset("ab"), frozenset("cd")}
    for d in found:
        assert d.structural
        # Weights compare what each member does to the measurements, so those of two aliases are equal and opposite.
        assert [abs(w) for _, w in d.weights] == pytest.approx([1.0, 1.0])
    assert any("cannot be told from" in d.sentence() for d in found)


def test_a_weak_direction_is_not_called_structural() -> None:
    rng = np.random.default_rng(3)
    J = jacobian(rng)
    J[:, 1] = J[:, 0] + rng.normal(size=50) * 5.0
    (weak,) = null_directions(J, NAMES, np.full(4, 1e-2))
    assert not weak.structural
    assert 0.0 < weak.learned < 0.5
    assert "can hardly be told from" in weak.sentence()


def test_fewer_rows_than_parameters_leave_the_rest_blind() -> None:
    found = null_directions(np.random.default_rng(4).normal(size=(3, 4)) * 1e4, NAMES, np.full(4, 1e-2))
    assert len(found) == 1


def test_identifiable_means_three_quarters_of_the_prior_variance_gone() -> None:
    assert identifiable(np.array([0.1, 0.49, 0.51, 1.0]), np.ones(4)).tolist() == [True, True, False, False]


def test_what_aliases_do_together_is_known_as_least_squares_says() -> None:
    """Two parameters in different units that act as one, and a third; numpy solves for the sum alone."""
    rng = np.random.default_rng(5)
    J = jacobian(rng)
    J[:, 1] = -2.5 * J[:, 0]
    J[:, 2] = 0.0
    truth, prior = np.array([3e-3, 1e-3, 0.0, -2e-3]), np.full(4, 1e-2)
    y = J @ truth + rng.normal(size=50)
    covariance = np.linalg.inv(J.T @ J + np.diag(prior**-2))
    values = covariance @ (J.T @ y)
    known = Known(NAMES, values, [("mm", 1e3)] * 4, covariance, prior)
    directions = null_directions(J, NAMES, prior)
    (found,) = [one for own in known.sums(directions) for one in own]
    own, *_ = np.linalg.lstsq(np.c_[J[:, 0], J[:, 3]], y, rcond=None)
    terms = {one["name"]: one["coefficient"] for one in found["parameters"]}
    assert set(terms) == {"a", "b"}
    assert terms["b"] / terms["a"] == pytest.approx(-2.5)
    assert found["value"] / terms["a"] == pytest.approx(1e3 * own[0], rel=1e-3)
    inverse = np.linalg.inv(np.c_[J[:, 0], J[:, 3]].T @ np.c_[J[:, 0], J[:, 3]])
    assert found["sigma"] / abs(terms["a"]) == pytest.approx(1e3 * np.sqrt(inverse[0, 0]), rel=1e-3)
    assert found["upper"] - found["lower"] == pytest.approx(2 * 1.959963984540054 * found["sigma"])
    assert found["unit"] == "mm"
    assert found["sentence"].startswith("Together they are known: ")


def test_no_sum_is_told_of_angles_of_frames_or_where_another_direction_hides_it() -> None:
    J = jacobian(np.random.default_rng(6))
    J[:, 1] = J[:, 0]
    prior = np.full(4, 1e-2)
    names = ("theta_offset_6", "tool_rz", "c", "d")
    covariance = np.linalg.inv(J.T @ J + np.diag(prior**-2))
    known = Known(names, np.ones(4), [("mm", 1e3)] * 4, covariance, prior)
    assert known.sums(null_directions(J, names, prior)) == [[]]
    J[:, 0] = J[:, 1] = 0.0
    wide = replace(known, names=NAMES, covariance=np.diag(prior**2))
    (direction,) = null_directions(np.c_[J[:, 2], J[:, 2], J[:, 3]], NAMES[:3], prior[:3])
    assert wide.sums([direction]) == [[]]


def test_of_three_that_act_as_one_their_sum_is_known() -> None:
    """As the distances along three parallel axes do."""
    J = jacobian(np.random.default_rng(7))
    J[:, 1] = J[:, 2] = J[:, 0]
    prior = np.full(4, 1e-2)
    covariance = np.linalg.inv(J.T @ J + np.diag(prior**-2))
    known = Known(
        NAMES, covariance @ J.T @ (J @ np.array([1e-3, 2e-3, 3e-3, 0.0])), [("mm", 1e3)] * 4, covariance, prior
    )
    directions = null_directions(J, NAMES, prior)
    assert len(directions) == 2
    (found,) = [one for own in known.sums(directions) for one in own]
    assert [one["coefficient"] for one in found["parameters"]] == pytest.approx([1.0, 1.0, 1.0])
    assert found["value"] == pytest.approx(6.0, abs=1e-4)
    assert found["sentence"].startswith("Together they are known: a + b + c = 6.0")


@pytest.mark.parametrize("seed", range(5))
def test_a_sum_that_is_known_better_than_rounding_shows_still_has_a_number(seed: int) -> None:
    """Exact measurements: what the members cancel is below the rounding of their variances, and may come out negative."""
    J = 1e7 * jacobian(np.random.default_rng(seed))
    J[:, 1] = -2.5 * J[:, 0]
    prior = np.array([1e-2, 3e-3, 1e-2, 1e-2])
    rounded = np.linalg.inv(J.T @ J + np.diag(prior**-2))
    rounded[:2, :2] -= 1e-16 * np.outer(prior[:2], prior[:2])
    known = Known(NAMES, np.ones(4), [("mm", 1e3)] * 4, rounded, prior)
    for one in (one for own in known.sums(null_directions(J, NAMES, prior)) for one in own):
        assert 0.0 <= one["sigma"] < 1e-3
        assert len(one["sentence"]) < 120


def test_of_parallel_axes_the_sum_of_distances_is_known() -> None:
    """A UR10 by its Denavit-Hartenberg rows in plain numpy: 1 mm in all along joints 2 to 4, which nobody can divide; and
    the tracker stands askew 2 m away, so the height of the first axis is one with the place of the base along its own z.
    """
    half = np.pi / 2
    rows = [
        (0.1273, 0, half),
        (3e-4, -0.612, 0),
        (5e-4, -0.5723, 0),
        (0.164141, 0, half),
        (0.1157, 0, -half),
        (0.0922, 0, 0),
    ]
    rng = np.random.default_rng(1)
    q, position = rng.uniform(-2.0, 2.0, (60, 6)), []
    for angles in q:
        T = np.eye(4)
        for angle, (d, a, alpha) in zip(angles, rows, strict=True):
            c, s, ca, sa = np.cos(angle), np.sin(angle), np.cos(alpha), np.sin(alpha)
            T = T @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        position.append(T[:3, 3] + T[:3, :3] @ [0.0, 0.0, 0.1] + 2e-5 * rng.standard_normal(3))
    robot = robot_from_document(scene(poses=2, again=1).drawn.document())
    askew, away = Rotation.from_euler("xyz", [0.02, -0.7, 1.1]).as_matrix(), np.array([1.6, -0.9, 0.4])
    rows = Observations(q=q, position=np.array(position) @ askew.T + away)
    found = identify(robot, rows).to_document()["null_directions"]
    sums = {one["parameters"][-1]["name"]: one for direction in found for one in direction["sums"]}
    assert {"d_1", "d_4", "tool_x", "tool_z"} <= set(sums)
    told, base, tool = sums["d_4"], sums["d_1"], sums["tool_z"]
    assert {one["name"]: one["coefficient"] for one in tool["parameters"]} == pytest.approx({"d_6": 1.0, "tool_z": 1.0})
    assert tool["value"] == pytest.approx(192.2, abs=4 * tool["sigma"])
    assert [one["name"] for one in base["parameters"]] == ["base_x", "base_y", "base_z", "d_1"]
    scaled = np.array([one["coefficient"] for one in base["parameters"]]) / base["parameters"][-1]["coefficient"]
    assert scaled[:3] == pytest.approx(askew[:, 2], abs=1e-4)
    assert base["value"] == pytest.approx(1e3 * (0.1273 + askew[:, 2] @ away), abs=4 * base["sigma"] + 0.1)
    assert max(base["sigma"], tool["sigma"]) < 0.1
    before = check_identification(robot, rows, IdentifyOptions(noise_mm=0.02)).directions
    promised = {one["parameters"][-1]["name"]: one for direction in before for one in direction["sums"]}
    for name in ("d_1", "d_4", "tool_z"):
        assert promised[name]["sigma"] == pytest.approx(sums[name]["sigma"], rel=0.3)
        assert promised[name]["sentence"].startswith("Together these poses tell them: ")
    assert [one["name"] for one in told["parameters"]] == ["d_2", "d_3", "d_4"]
    assert [one["coefficient"] for one in told["parameters"]] == pytest.approx([1.0, 1.0, 1.0], abs=1e-6)
    assert told["value"] == pytest.approx(164.941, abs=4 * told["sigma"])
    assert told["sigma"] < 0.02
    assert any(told["sentence"] in direction["sentence"] for direction in found)
