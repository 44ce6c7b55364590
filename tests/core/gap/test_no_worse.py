"""A hunt never ends worse than the geometry alone, whatever a candidate imitates: arms of Pinocchio, poses that see little."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.search.forward_selection import worse
from kilter_core.gap.search.select import Selector
from kilter_core.identify import identify
from kilter_core.observations import Observations
from tests.core.identify.test_stubborn_poses import column, grid, observed
from tests.core.truth import Arm

Floats = NDArray[np.float64]

IMITATORS = ("axial_compliance", "eccentricity", "unknown_joint_curve", "unknown_field")
QUICK = GapOptions(effects=IMITATORS, resamples=5, permutations=3, bootstraps=199, next_poses=0, max_effects=4)


def campaign(make: Callable[[np.random.Generator], tuple[Arm, Floats]], see: str) -> tuple[Arm, Observations]:
    """Each pose approached twice; a part of what the arm does is known to no model."""
    rng = np.random.default_rng(11)
    arm, q = make(rng)
    once = observed(arm, q, rng, see)
    twice = once.select(np.r_[np.arange(len(q)), np.arange(len(q))])
    assert twice.position is not None
    noisy = twice.position + rng.normal(0.0, 5e-6, twice.position.shape)
    turned = twice.rotation
    if turned is not None:
        turned = Rotation.from_rotvec(rng.normal(0.0, 2e-5, (len(turned), 3))).as_matrix() @ turned
    return arm, replace(twice, position=noisy, rotation=turned, t=np.arange(2.0 * len(q)) * 10.0)


@pytest.mark.parametrize(
    ("make", "see"),
    [
        (column, "pose"),
        pytest.param(grid, "position", marks=pytest.mark.slow),
        pytest.param(grid, "pose", marks=pytest.mark.slow),
        pytest.param(column, "position", marks=pytest.mark.slow),
    ],
)
def test_after_is_never_above_before(make: Callable[[np.random.Generator], tuple[Arm, Floats]], see: str) -> None:
    arm, rows = campaign(make, see)
    robot = robot_from_document(arm.document())
    gap = find_gap(robot, rows, QUICK).to_document()["gap"]
    alone = identify(robot, rows).metrics["train"]
    assert gap["after_mm"] <= gap["before_mm"]
    assert gap["before_mm"] < alone["registration_only"]["rms_mm"]
    assert gap["before_mm"] == pytest.approx(alone["identified"]["rms_mm"], rel=0.25)
    assert gap["closure"] is None or gap["closure"] <= 1.0


def test_repeats_that_are_copies_do_not_stop_a_hunt() -> None:
    arm, rows = campaign(column, "pose")
    half = len(rows) // 2
    assert rows.rotation is not None
    copied = replace(rows, rotation=np.concatenate([rows.rotation[:half], rows.rotation[:half]]))
    gap = find_gap(robot_from_document(arm.document()), copied, QUICK).to_document()["gap"]
    assert gap["after_mm"] <= gap["before_mm"]


def test_a_set_that_leaves_more_is_refused() -> None:
    """The linear world may promise what the fit does not keep."""
    selector = SimpleNamespace(
        columns=list,
        slack=lambda chosen: 0.0,
        price=lambda chosen, ranks: 5.0 * len(chosen),
        variance=lambda gram, chosen: 1.0,
    )
    gram = SimpleNamespace(rank=len)

    def left(chi2: float) -> SimpleNamespace:
        return SimpleNamespace(chi2=chi2, gram=gram)

    def refused(one: tuple[float, tuple[int, ...]], other: tuple[float, tuple[int, ...]]) -> bool:
        assert isinstance(selector, SimpleNamespace | Selector)
        return worse(selector, (left(one[0]), one[1]), (left(other[0]), other[1]))  # type: ignore[arg-type]

    assert refused((101.0, (1, 2)), (100.0, (1,)))  # one more effect, and more is left
    assert not refused((99.0, (1, 2)), (100.0, (1,)))
    assert refused((100.0, (3,)), (90.0, (1,)))  # exchanged for one that explains less
    assert not refused((94.0, (3,)), (90.0, (1, 2)))  # one for two, at a lower price
