"""A check by the joint log alone, of an arm in plain numpy that seats its ball in a socket: what it tells and what not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError, OptionError, TooFewPosesError
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.watch import Check, check
from tests.core.watch.drifting import DriftingArm, some_arm

Floats = NDArray[np.float64]
SEATING = 2e-5  # m
EXACT = Predictive((), np.zeros((0, 0)), 0.0, SEATING, noise_of="contacts")
TENTH = float(np.radians(0.1))
LIMIT = float(np.radians(170.0))
MIDDLE = np.array([0.3, -1.2, 1.4, -0.6, 1.1, 0.4])


def perfect(seed: int) -> tuple[DriftingArm, Calibration, np.random.Generator]:
    """An arm that is as it is described."""
    rng = np.random.default_rng(seed)
    arm = replace(some_arm(rng), zeros=np.zeros(6), compliance=np.zeros(6))
    return arm, Calibration.nominal(robot_from_document(arm.document())), rng


def slopes_at(arm: DriftingArm, q: Floats) -> Floats:
    """How the ball moves with each joint, (3, 6) m/rad."""
    return (arm.point(q + 1e-6 * np.eye(6)) - arm.point(q)).T * 1e6


def reached(arm: DriftingArm, q: Floats, seat: Floats) -> Floats | None:
    """Joints from these on that seat the ball, by Newton's steps of at most 0.3 rad; None where they leave their limits."""
    for _ in range(40):
        off = seat - arm.point(q)
        if np.linalg.norm(off) < 1e-8:
            return q if np.abs(q).max() < LIMIT else None
        step = np.linalg.pinv(slopes_at(arm, q)) @ off
        q = q + step * min(1.0, 0.3 / float(np.linalg.norm(step)))
    return None


def seated(
    arm: DriftingArm, count: int, rng: np.random.Generator, sockets: int = 1, noise: float = SEATING
) -> Observations:
    """Joint readings of an arm whose ball is seated by different poses, each to within the seating."""
    q, number = [], []
    for socket in range(sockets):
        middle = MIDDLE + rng.uniform(-0.3, 0.3, 6)
        place = arm.point(middle)
        while number.count(socket + 1) < count:
            begin, seat = middle + rng.uniform(-1.2, 1.2, 6), place + rng.normal(0.0, noise, 3)
            found = reached(arm, begin, seat)
            if found is not None:
                q.append(found)
                number.append(socket + 1)
    return Observations(np.array(q), socket=np.array(number))


def named(found: Check) -> list[str]:
    return [one.cause.name for one in found.causes]


def test_an_arm_that_has_not_moved_alarms_as_rarely_as_stated() -> None:
    arm, calibration, rng = perfect(0)
    chances = []
    for _ in range(2):
        still = seated(arm, 6, rng, noise=0.0)
        slopes = [slopes_at(arm, q) for q in still.q]
        for _ in range(60):  # seats so near that the arm reaches them along its derivative, to a nanometre
            away = [np.linalg.pinv(J) @ rng.normal(0.0, SEATING, 3) for J in slopes]
            chances.append(check(calibration, replace(still, q=still.q + np.array(away)), EXACT).p_value)
    assert min(chances) > 1e-4
    assert np.mean(np.array(chances) <= 0.05) <= 0.09  # at most 5 % are meant: two deviations of 120 checks
    assert np.mean(np.array(chances) <= 0.5) > 0.1  # and it is no number that says nothing


@pytest.mark.parametrize("change", ["zero_2", "zero_3", "zero_4", "zero_5", "tool"])
def test_a_tenth_of_a_degree_is_named_as_its_cause_or_a_class_that_has_it(change: str) -> None:
    told = 0
    for seed in range(2):
        arm, calibration, rng = perfect(seed)
        moved = arm.after(change, TENTH if change != "tool" else 5e-4)
        found = check(calibration, seated(moved, 8, rng), EXACT)
        assert found.verdict != "ok"
        assert change in named(found), (seed, named(found))
        told += found.verdict == "moved"
    assert told or change == "tool"


@pytest.mark.parametrize(("change", "size"), [("base", 2e-3), ("zero_1", 5e-3), ("scale", 1e-3)])
def test_what_moves_all_poses_alike_is_not_seen_and_listed(change: str, size: float) -> None:
    arm, calibration, rng = perfect(1)
    found = check(calibration, seated(arm.after(change, size), 8, rng, 2), EXACT)
    assert found.verdict == "ok"
    assert {"base", "zero_1", "scale"} <= {one.name for one in found.unseen}
    assert change not in found.smallest


def test_the_zero_of_the_last_joint_is_a_class_with_the_tool() -> None:
    arm, calibration, rng = perfect(2)
    found = check(calibration, seated(arm.after("zero_6", 4e-3), 8, rng), EXACT)
    assert found.verdict == "cannot_tell"
    assert {"zero_6", "tool"} <= set(named(found))


def test_bad_logs_are_refused_with_a_remedy() -> None:
    arm, calibration, rng = perfect(3)
    good = seated(arm, 6, rng)
    with pytest.raises(TooFewPosesError, match="poses more than sockets"):
        check(calibration, good.select(np.arange(3)), EXACT)
    with pytest.raises(TooFewPosesError, match="poses more than sockets"):
        check(calibration, good.select(np.zeros(8, dtype=np.int64)), EXACT)  # one pose repeated
    with pytest.raises(TooFewPosesError):
        check(calibration, replace(good, socket=np.arange(1, 7)), EXACT)  # each in a socket of its own
    with pytest.raises(OptionError, match="how well it sits"):
        check(calibration, good, replace(EXACT, noise_of="points"))
    assert check(calibration, good, replace(EXACT, noise_of="points"), noise=SEATING).verdict == "ok"
    with pytest.raises(ObservationError, match="plane_id"):
        check(calibration, replace(good, plane=np.zeros(6, dtype=np.int64)), EXACT)
    other = good.q + rng.uniform(-1.0, 1.0, good.q.shape)
    with pytest.raises(ObservationError, match="another robot"):
        check(calibration, replace(good, q=other), EXACT)
