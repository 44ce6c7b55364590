"""Calibration without an instrument: sockets, planes and ball bars on an arm that Pinocchio holds there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError, OptionError, TooFewPosesError
from kilter_core.evaluate import evaluate
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.holdout import fold_splits, split
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import has_contacts as held_by
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from tests.core.campaigns import held, joints, measured, table_errors
from tests.core.truth import Arm, ur10

Floats = NDArray[np.float64]
PLAY = 1e-5  # m, of a ball in its socket
HOME = np.array([0.3, -1.2, 1.4, -0.6, -1.1, 0.4])


def pair(seed: int = 0) -> tuple[Arm, Arm]:
    """The arm as drawn with a probe on it, and as it is."""
    import pinocchio as pin

    rng = np.random.default_rng(seed)
    drawn = ur10(tool=pin.SE3(np.eye(3), np.array([0.03, -0.02, 0.12])), limits=(-6.3, 6.3))
    return drawn, drawn.moved(table_errors(drawn, rng))


def about(rng: np.random.Generator, count: int, spread: float = 0.7) -> Floats:
    return HOME + rng.uniform(-spread, spread, (count, 6))


def in_sockets(actual: Arm, rng: np.random.Generator, places: Floats, count: int) -> tuple[Floats, NDArray[np.int64]]:
    q, number = [], []
    for k, place in enumerate(places, 1):
        found = held(actual, about(rng, count), lambda p, c=place: (p - c, np.eye(3)))
        q.append(found)
        number += [k] * len(found)
    return np.concatenate(q), np.array(number)


def with_play(actual: Arm, q: Floats, rng: np.random.Generator) -> Floats:
    """Joint readings as if the ball stood off its place by the play: moved joints, not moved balls."""
    J = actual.joint_jacobians(q)[:, :3]
    off = rng.normal(0.0, PLAY, (len(q), 3))
    return q + np.einsum("nij,nj->ni", np.linalg.pinv(J), off)


PLACES = np.array([[0.45, 0.25, 0.25], [0.75, 0.05, 0.45], [0.35, -0.35, 0.6]])


def sockets(seed: int = 1, count: int = 40) -> tuple[Arm, Arm, Observations]:
    rng = np.random.default_rng(seed)
    drawn, actual = pair()
    q, number = in_sockets(actual, rng, PLACES, count)
    return drawn, actual, Observations(with_play(actual, q, rng), socket=number)


def relative_errors(drawn: Arm, actual: Arm, found: Any, scaled: bool = False) -> tuple[float, float]:
    """Rms of distances between poses near the sockets, m: as drawn and as identified; ``scaled`` up or down to fit best."""
    rng = np.random.default_rng(9)
    q = about(rng, 60, 0.6)
    truth = actual.poses(q)[0]

    def rms(points: Floats) -> float:
        a, b = np.triu_indices(len(q), 1)
        mine, true = (np.linalg.norm(x[a] - x[b], axis=1) for x in (points, truth))
        factor = float(mine @ true / (mine @ mine)) if scaled else 1.0
        return float(np.sqrt(np.mean((factor * mine - true) ** 2)))

    return rms(drawn.poses(q)[0]), rms(found.calibration.predict(Observations(q)).position)


def lengths(places: Floats = PLACES) -> dict[str, float]:
    return {f"{a + 1}-{b + 1}": 1e3 * float(np.linalg.norm(places[a] - places[b])) for a, b in ((0, 1), (0, 2), (1, 2))}


def test_a_ball_in_three_sockets_of_known_distances_calibrates_the_arm() -> None:
    drawn, actual, rows = sockets()
    robot = robot_from_document(drawn.document())
    found = identify(robot, rows, 0.25, IdentifyOptions(socket_distances_mm=lengths()))
    before, after = relative_errors(drawn, actual, found)
    assert before > 5e-4
    assert after < before / 60.0
    held_out = found.metrics["validation"]
    assert held_out["nominal"]["rms_mm"] > 0.5
    assert held_out["identified"]["rms_mm"] < 3.0 * PLAY * 1e3
    assert found.noise_m == pytest.approx(PLAY, rel=0.25)
    assert not [name for name in found.free_names if name.startswith("base_")]


def test_a_single_socket_knows_no_scale_and_says_so() -> None:
    drawn, _, rows = sockets()
    one = rows.select(np.flatnonzero(rows.socket == 1))
    found = identify(robot_from_document(drawn.document()), one, None, IdentifyOptions(level=2))
    members = [dict(d.weights) for d in found.null_directions]
    # All lengths grown by one share keep a ball in its socket.
    assert any(sum(name[:2] in ("a_", "d_") for name in m) >= 4 for m in members)


def test_balls_on_planes_calibrate_the_arm() -> None:
    rng = np.random.default_rng(2)
    drawn, actual = pair()
    q, number = [], []
    planes = [([0, 0, 1.0], 0.3), ([1.0, 0, 0], 0.6), ([0, 1.0, 0], 0.1), ([0.6, 0, 0.8], 0.65)]
    for k, (normal, distance) in enumerate(planes, 1):
        n = np.array(normal)
        found = held(actual, about(rng, 90, 0.9), lambda p, n=n, d=distance: (np.array([n @ p - d]), n[None]))
        q.append(found)
        number += [k] * len(found)
    rows = Observations(with_play(actual, np.concatenate(q), rng), plane=np.array(number))
    found = identify(robot_from_document(drawn.document()), rows, 0.2)
    assert found.metrics["validation"]["identified"]["rms_mm"] < 2.0 * PLAY * 1e3
    assert found.metrics["validation"]["nominal"]["rms_mm"] > 0.3
    # Planes leave the scale to the drawing; everything else they find.
    before, after = relative_errors(drawn, actual, found, scaled=True)
    assert after < before / 10.0


def bars(rng: np.random.Generator, actual: Arm, feet: Floats, count: int) -> Observations:
    q = about(rng, count * len(feet), 0.8)
    number = np.repeat(np.arange(1, len(feet) + 1), count)
    length = np.linalg.norm(actual.poses(q)[0] - feet[number - 1], axis=1)
    return Observations(q, bar=number, bar_length=length + rng.normal(0.0, PLAY, len(q)))


def test_a_telescoping_ball_bar_about_two_feet_calibrates_the_arm_scale_and_all() -> None:
    rng = np.random.default_rng(3)
    drawn, actual = pair()
    feet = np.array([[0.5, 0.5, 0.0], [0.9, -0.3, 0.1]])
    rows, other = bars(rng, actual, feet, 100), bars(rng, actual, feet, 30)
    found = identify(robot_from_document(drawn.document()), rows, other)
    before, after = relative_errors(drawn, actual, found)
    assert after < before / 25.0
    held_out = found.metrics["validation"]
    assert held_out["identified"]["rms_mm"] < 1.5 * PLAY * 1e3 < held_out["nominal"]["rms_mm"] / 20


def test_circles_of_a_double_ball_bar_calibrate_what_they_see() -> None:
    """The bar's foot in the plane of the circle: a length says nothing of its height, and the fit must not go looking."""
    rng = np.random.default_rng(6)
    drawn, actual = pair()
    angles, q, number = np.radians(np.arange(0, 360, 12)), [], []
    for k, (centre, normal) in enumerate((
        ([0.6, 0.1, 0.3], 2), ([0.5, -0.25, 0.45], 2), ([0.55, 0.2, 0.5], 0), ([0.7, 0.0, 0.4], 1), ([0.4, 0.3, 0.35], 1),
    ), 1):  # fmt: skip
        u, v = np.delete(np.eye(3), normal, axis=0)
        for a in angles:
            place = np.array(centre) + 0.15 * (np.cos(a) * u + np.sin(a) * v)
            found = held(drawn, HOME[None] + 0.1 * k, lambda p, c=place: (p - c, np.eye(3)))
            q.append(found)
            number += [k] * len(found)
    q, number = np.concatenate(q), np.array(number)
    centres = np.array([[0.6, 0.1, 0.3], [0.5, -0.25, 0.45], [0.55, 0.2, 0.5], [0.7, 0.0, 0.4], [0.4, 0.3, 0.35]])
    length = np.linalg.norm(actual.poses(q)[0] - centres[number - 1], axis=1) + rng.normal(0.0, 1e-6, len(q))
    rows = Observations(q, bar=number, bar_length=length)
    others = np.arange(len(rows)) % 4 == 0
    found = identify(robot_from_document(drawn.document()), rows.select(~others), rows.select(others)).metrics
    assert found["validation"]["nominal"]["rms_mm"] > 0.05
    assert found["validation"]["identified"]["rms_mm"] < 0.004


def test_contacts_may_be_mixed_and_pose_the_same_slopes_as_differences() -> None:
    rng = np.random.default_rng(5)
    drawn, actual = pair()
    q, number = in_sockets(actual, rng, PLACES[:2], 8)
    bar = bars(rng, actual, np.array([[0.5, 0.5, 0.0]]), 12)
    flat = held(actual, about(rng, 12), lambda p: (np.array([p[2] - 0.4]), np.array([[0, 0, 1.0]])))
    zero = np.zeros(len(q) + len(bar) + len(flat), dtype=np.int64)
    socket, plane, rod, length = zero.copy(), zero.copy(), zero.copy(), zero.astype(float)
    socket[: len(q)] = number
    rod[len(q) : len(q) + 12], length[len(q) : len(q) + 12] = 1, bar.bar_length
    plane[len(q) + 12 :] = 1
    rows = Observations(np.concatenate([q, bar.q, flat]), socket=socket, plane=plane, bar=rod, bar_length=length)
    measurement = Measurement.from_observations(rows, held=True, socket_distances={(1, 2): 0.4})
    model = RobotModel(robot_from_document(drawn.document()))
    values = model.values0()
    prediction, J = model.jacobian(rows, values)
    residual = measurement.residual(prediction, J)
    assert residual.points.shape == (3 * len(q) + 12 + len(flat) + 1, 1, 1)
    r = residual.points.ravel()
    for name in ("alpha_2", "a_3", "tool_x"):
        k = model.names.index(name)
        sides = []
        for step in (1e-6, -1e-6):
            moved = values.copy()
            moved[k] += step
            sides.append(measurement.residual(model.predict(rows, moved)).points.ravel())
        # Variable projection has the slope of the sum of squares exactly; of single residuals to first order.
        true = np.sum(sides[0] ** 2) - np.sum(sides[1] ** 2)
        mine = -2.0 * float(r @ residual.d_points[:, 0, 0, k]) * 2e-6  # type: ignore[index]
        assert mine == pytest.approx(true, rel=1e-3, abs=1e-14)


def test_held_out_rows_are_compared_with_the_places_of_the_training_rows() -> None:
    drawn, actual, rows = sockets()
    found = identify(robot_from_document(drawn.document()), rows, None, IdentifyOptions(socket_distances_mm=lengths()))
    # The same poses in a socket that stands a millimetre off: rows by themselves could never show it.
    rng = np.random.default_rng(8)
    q, number = in_sockets(actual, rng, PLACES + np.array([0.0, 0.0, 1e-3]), 10)
    other = Measurement.from_observations(
        Observations(q, socket=number), held=True, anchor=Measurement.from_observations(rows, held=True)
    )
    errors, _ = other.errors(found.calibration)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(1e-3, rel=0.1)


def test_what_cannot_be_calibrated_is_refused() -> None:
    drawn, _, rows = sockets(count=12)
    robot = robot_from_document(drawn.document())
    few = rows.select(np.flatnonzero((rows.socket != 2) | (np.cumsum(rows.socket == 2) <= 1)))
    with pytest.raises(ObservationError, match="Socket 2 holds 1 rows") as refused:
        identify(robot, few)
    assert refused.value.code == "contact_too_small"
    with pytest.raises(ObservationError, match="no rows"):
        identify(robot, rows, None, IdentifyOptions(socket_distances_mm={"1-7": 100.0}))
    with pytest.raises(OptionError, match="socket ids"):
        IdentifyOptions(socket_distances_mm={"one-two": 100.0})
    with pytest.raises(OptionError, match="least_squares only"):
        identify(robot, rows, None, IdentifyOptions(method="influence"))
    with pytest.raises(ObservationError, match="noise_mm"):
        identify(robot, replace(rows, sigma=np.full((len(rows), 3), 1e-5)))
    lone = rows.select(np.flatnonzero(rows.socket != 3))
    with pytest.raises(ObservationError, match="Socket 3 is only in the rows held out and holds 1 rows"):
        identify(robot, lone, rows.select(np.flatnonzero(rows.socket == 3)[:1]))


def test_whole_placements_are_held_out_each_where_it_fits_its_own_rows() -> None:
    drawn, _, rows = sockets()
    held_out = rows.socket == rows.socket.max()  # type: ignore[union-attr]
    train, unseen = rows.select(~held_out), rows.select(held_out)
    options = IdentifyOptions(socket_distances_mm={"1-2": lengths()["1-2"]})
    found = identify(robot_from_document(drawn.document()), train, unseen, options)
    validation = found.metrics["validation"]
    assert validation["n"] == len(unseen)
    assert validation["identified"]["rms_mm"] < 0.2 * validation["registration_only"]["rms_mm"]


def test_a_fraction_and_folds_hold_out_whole_placements() -> None:
    _, _, rows = sockets(count=8)
    assert rows.socket is not None
    for seed in range(5):
        inside, outside = split(rows, 0.25, seed)
        assert len(set(rows.socket[outside])) == 1
        assert not set(rows.socket[outside]) & set(rows.socket[inside])
    seen = [set(rows.socket[outside]) for _, outside in fold_splits(rows, 3, 0)]
    assert sorted(n for placements in seen for n in placements) == [1, 2, 3]
    mixed = Observations(rows.q, socket=np.where(rows.socket == 1, 1, 0), plane=np.where(rows.socket > 1, 1, 0))
    inside, outside = split(mixed, 0.5, 0)
    assert len(set(rows.socket[outside] > 1)) == len(set(rows.socket[inside] > 1)) == 1


def test_too_few_placements_to_hold_one_out_are_refused_with_a_remedy_that_works() -> None:
    _, _, rows = sockets(count=8)
    one = rows.select(np.flatnonzero(rows.socket == 1))
    with pytest.raises(TooFewPosesError, match=r"held by socket 1.*another socket.*leave the fraction out"):
        split(one, 0.25, 0)
    with pytest.raises(
        TooFewPosesError, match=r"3 placements \(socket 1, socket 2, socket 3\) cannot make 5.*give 3 folds"
    ):
        next(fold_splits(rows, 5, 0))
    assert len(list(fold_splits(rows, 3, 0))) == 3


def test_contacts_are_evaluated_each_where_it_fits_best() -> None:
    drawn, _, rows = sockets()
    robot = robot_from_document(drawn.document())
    found = identify(robot, rows, None, IdentifyOptions(socket_distances_mm=lengths()))
    result = evaluate(found.calibration, rows)
    assert result["n"] == len(rows)
    assert result["identified"]["rms_mm"] < 0.2 * result["nominal"]["rms_mm"]
    assert result["identified"]["rms_mm"] == pytest.approx(found.metrics["train"]["identified"]["rms_mm"], rel=1e-6)
    assert result["rows"]["row"] == []


def test_positions_are_not_contacts() -> None:
    rng = np.random.default_rng(0)
    drawn, _ = pair()
    assert not held_by(measured(drawn, joints(drawn, 3, rng), rng))
