"""A curve of a joint that was measured over 51 degrees: the version holds there, and elsewhere is no worse than geometry."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, find_gap
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.campaigns import table_errors
from tests.core.correct.twins import ARMS

QUICK = GapOptions(
    effects=("eccentricity", "encoder_scale", "second_harmonic", "unknown_smooth_curve"),
    resamples=5, permutations=5, bootstraps=299, next_poses=0,
)  # fmt: skip
MEASURED, OTHER, NOISE_M = np.radians([-30.0, 21.0]), np.radians([40.0, 91.0]), 2e-5


def hump(q: np.ndarray) -> np.ndarray:
    """A bent cover that a hose lifts: gone outside the sector."""
    return 1e-3 * np.exp(-((q / 0.45) ** 2)) * (1.0 + q)


def stop(q: np.ndarray) -> np.ndarray:
    """A hose that is taut on one side."""
    return 1e-3 * np.tanh(2.0 * (q - 0.2))


@pytest.mark.parametrize(("shape", "seed"), [(hump, 1), (hump, 3), (stop, 2)])
def test_beyond_its_range_a_curve_leaves_no_more_than_geometry(shape: Any, seed: int) -> None:
    rng, ideal = np.random.default_rng(seed), ARMS["six"]
    real, (lower, upper) = ideal.moved(table_errors(ideal, rng, 2e-4, 4e-4)), ideal.limits

    def poses(count: int, sector: np.ndarray) -> np.ndarray:
        q = rng.uniform(lower, upper, (count, ideal.n))
        q[:, 3] = rng.uniform(*sector, count)
        return q

    def points(q: np.ndarray) -> np.ndarray:
        actual = q.copy()
        actual[:, 3] += shape(q[:, 3])
        actual[:, 1] += 2e-4 * np.sin(2.0 * q[:, 1] + 1.0)
        return real.poses(actual)[0]

    order = np.concatenate([np.arange(90), rng.permutation(90)[:20]])
    q = poses(90, MEASURED)[order]
    seen = points(q) + rng.normal(0.0, NOISE_M, (len(q), 3))
    rows = Observations(q, seen, pose_id=order, t=60.0 * np.arange(len(q)))
    report = find_gap(robot_from_document(ideal.document()), rows, QUICK, validation=0.25)
    assert any("joint 4 over" in effect.display_name for effect in report.effects)
    spans = [effect.display_name.split(" over ")[1] for effect in report.effects if "joint 4" in effect.display_name]
    assert all(44 <= float(span.split(" deg, from ")[0]) <= 51 for span in spans)

    def left(version: Calibration, at: np.ndarray) -> float:
        off = version.predict(Observations(at)).position - points(at)
        return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))

    version, geometry = report.calibration, report.stored.geometry
    assert geometry is not None
    there, elsewhere = poses(200, MEASURED), poses(200, OTHER)
    assert left(version, there) < 0.5 * left(geometry, there)
    assert left(version, elsewhere) < 1.02 * left(geometry, elsewhere)
    if shape is hump:
        endless = tuple(replace(e, measured=None) for e in version.model.effects)
        assert left(replace(version, model=replace(version.model, effects=endless)), elsewhere) > left(
            geometry, elsewhere
        )
