"""The teaching twin: the thesis's Katana behaves like the thesis's Katana."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.identify import IdentifyOptions, identify
from kilter_core.plan.d_optimal import iso_poses
from kilter_core.twin import Twin, thesis_katana

NOISE = 1e-5
CONVENTIONAL = IdentifyOptions(level=2)
FULL = IdentifyOptions(level=3)


@pytest.fixture(scope="module")
def katana() -> tuple[Twin, np.ndarray]:
    twin = thesis_katana()
    return twin, iso_poses(twin.robot, 178, seed=0)


def test_the_error_before_calibration_is_that_of_the_thesis(katana: tuple[Twin, np.ndarray]) -> None:
    twin, q = katana
    rows = twin.observe(q[:118])
    assert rows.position is not None
    nominal = Twin(twin.robot, {}).observe(q[:118]).position
    assert nominal is not None
    before = np.linalg.norm(rows.position - nominal, axis=1) * 1e3
    assert before.mean() == pytest.approx(1.21, abs=0.3)  # table 4.5: 1.21 mm, 2.11 at most


def test_full_tilting_leaves_the_noise_and_the_conventional_model_does_not(katana: tuple[Twin, np.ndarray]) -> None:
    twin, q = katana
    train, held = twin.observe(q[:118], noise_m=NOISE, seed=1), twin.observe(q[118:], noise_m=NOISE, seed=2)
    left = {
        name: identify(twin.robot, train, held, options).metrics["validation"]["identified"]["mean_mm"]
        for name, options in (("conventional", CONVENTIONAL), ("full", FULL))
    }
    assert left["full"] <= 0.020
    assert left["conventional"] > 2 * left["full"]


def test_the_seed_decides_the_noise_and_repeats_share_a_pose(katana: tuple[Twin, np.ndarray]) -> None:
    twin, q = katana
    one, same, other = (twin.observe(q[:5], noise_m=NOISE, seed=s, repeats=3) for s in (1, 1, 2))
    assert one.position is not None
    assert other.position is not None
    np.testing.assert_array_equal(one.position, same.position)
    assert not np.array_equal(one.position, other.position)
    assert one.pose_id is not None
    assert one.pose_id.tolist() == np.repeat(np.arange(5), 3).tolist()
    exact = twin.observe(q[:5]).position
    assert exact is not None
    assert np.std(one.position - np.repeat(exact, 3, axis=0)) == pytest.approx(NOISE, rel=0.5)
