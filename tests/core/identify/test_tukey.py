"""Wrong rows that agree with each other: let go by Tukey's loss, and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.errors import OptionError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured
from tests.core.identify.test_identify import somewhere
from tests.core.truth import Arm

NOISE = 2e-5


def spoilt(rows: Observations, share: float, see: str, rng: np.random.Generator) -> tuple[Observations, set[int]]:
    """The rows next to one pose are all off by half a millimetre in one direction."""
    points = rows.markers if see == "markers" else rows.position
    assert points is not None
    middle = points.reshape(len(rows), -1, 3).mean(axis=1)
    hit = np.argsort(np.linalg.norm(middle - middle[0], axis=1))[: round(share * len(rows))]
    off = rng.normal(size=3)
    wrong = points.copy()
    wrong[hit] += 5e-4 * off / np.linalg.norm(off)
    return replace(rows, **{"markers" if see == "markers" else "position": wrong}), set(hit.tolist())


def error(arm: Arm, rows: Observations, loss: str) -> tuple[float, set[int]]:
    robot, true, rng = somewhere(0)
    found = identify(robot, rows, None, IdentifyOptions(loss=loss))
    q = joints(true, 200, rng)
    off = found.calibration.predict(Observations(q)).position - arm.poses(q)[0]
    weight = found.fit.problem.weights.rows
    gone = set() if weight is None else set(np.flatnonzero(weight == 0.0).tolist())
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1)))), gone


@pytest.mark.parametrize("see", ["position", "pose"])
def test_a_seventh_of_the_rows_off_alike_do_not_bend_the_arm(see: str) -> None:
    _, true, rng = somewhere(0)
    rows, hit = spoilt(measured(true, joints(true, 120, rng), rng, NOISE, see), 0.15, see, rng)
    clean, _ = error(true, rows.select(np.setdiff1d(np.arange(120), list(hit))), "linear")
    (plain, _), (held, _), (free, gone) = (error(true, rows, loss) for loss in ("linear", "huber", "tukey"))
    assert gone == hit
    assert free < 1.25 * clean
    assert free < 0.6 * held < 0.6 * plain


def test_without_wrong_rows_it_is_least_squares_with_hardly_a_loss() -> None:
    _, true, rng = somewhere(0)
    rows = measured(true, joints(true, 120, rng), rng, NOISE)
    (plain, _), (free, gone) = (error(true, rows, loss) for loss in ("linear", "tukey"))
    assert len(gone) <= 2
    assert free < 1.15 * plain


def test_it_goes_with_methods_that_end_at_a_minimum() -> None:
    for method in ("kalman", "influence", "linear_least_squares"):
        with pytest.raises(OptionError, match="huber"):
            IdentifyOptions(method=method, loss="tukey")
