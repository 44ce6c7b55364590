"""Held-out poses: never on both sides, whatever the repeats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError, OptionError, TooFewPosesError
from kilter_core.gap.study import held_out
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.holdout import fold_splits, split
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured
from tests.core.truth import ur10

POSE_IDS = st.lists(st.integers(0, 40), min_size=2, max_size=80).filter(lambda ids: len(set(ids)) >= 2)
SEEDS = st.integers(0, 2**32 - 1)


def rows(ids: list[int], named: bool) -> Observations:
    """Rows of poses, told apart by their id or by their joints alone."""
    q = np.array(ids, dtype=np.float64)[:, None] * [0.1, -0.2]
    return Observations(q, pose_id=np.array(ids) if named else None)


@given(POSE_IDS, st.floats(0.01, 0.99), SEEDS, st.booleans())
def test_a_fraction_splits_whole_poses(ids: list[int], fraction: float, seed: int, named: bool) -> None:
    poses = len(set(ids))
    if round(fraction * poses) in (0, poses):
        with pytest.raises(TooFewPosesError):
            split(rows(ids, named), fraction, seed)
        return
    train, held = split(rows(ids, named), fraction, seed)
    assert sorted([*train, *held]) == list(range(len(ids)))
    sides = [{ids[k] for k in side} for side in (train, held)]
    assert not sides[0] & sides[1]
    assert len(sides[1]) == round(fraction * poses)


@given(POSE_IDS, st.integers(2, 8), SEEDS, st.booleans())
def test_folds_hold_every_pose_out_once(ids: list[int], folds: int, seed: int, named: bool) -> None:
    if len(set(ids)) < folds:
        with pytest.raises(TooFewPosesError):
            list(fold_splits(rows(ids, named), folds, seed))
        return
    held_rows = []
    sizes = []
    for train, held in fold_splits(rows(ids, named), folds, seed):
        assert sorted([*train, *held]) == list(range(len(ids)))
        assert not {ids[k] for k in train} & {ids[k] for k in held}
        held_rows += list(held)
        sizes.append(len({ids[k] for k in held}))
    assert sorted(held_rows) == list(range(len(ids)))
    assert max(sizes) - min(sizes) <= 1


def test_the_seed_decides() -> None:
    o = rows(list(range(50)), True)
    np.testing.assert_array_equal(split(o, 0.3, 1)[1], split(o, 0.3, 1)[1])
    assert not np.array_equal(split(o, 0.3, 1)[1], split(o, 0.3, 2)[1])


def repeated(seed: int) -> Observations:
    """Measured poses, every fourth of them three times, as a file in degrees would say them."""
    rng = np.random.default_rng(seed)
    q = np.round(np.degrees(rng.uniform(-2.0, 2.0, (80, 6))), 3)
    q = np.repeat(q, np.where(np.arange(80) % 4 == 0, 3, 1), axis=0)
    return Observations(np.radians(q), position=rng.normal(size=(len(q), 3)))


def named(o: Observations, held: np.ndarray) -> set[bytes]:
    """The poses held out, by their joints in thousandths of a degree."""
    return {row.tobytes() for row in np.round(np.degrees(o.q[held]) * 1e3).astype(int)}


@given(st.integers(0, 50), st.floats(0.05, 0.9))
def test_neither_the_order_of_rows_nor_their_ids_nor_their_unit_choose_the_poses(seed: int, share: float) -> None:
    o = repeated(seed)
    held = named(o, split(o, share, 3)[1])
    order = np.random.default_rng([seed, 1]).permutation(len(o))
    shuffled = o.select(order)
    assert named(shuffled, split(shuffled, share, 3)[1]) == held
    ids = np.random.default_rng([seed, 2]).permutation(1000)[o.pose_groups()]
    with_ids = replace(o, pose_id=ids, q=np.radians(np.degrees(o.q)))
    assert named(with_ids, split(with_ids, share, 3)[1]) == held


def test_a_search_and_an_identification_hold_the_same_quarter_out() -> None:
    o = repeated(1)
    asked, unasked = held_out(o, 0.25, 0)[1], held_out(o, None, 0)[1]
    np.testing.assert_array_equal(asked, split(o, 0.25, 0)[1])
    np.testing.assert_array_equal(unasked, split(o, 0.25, 0)[1])


def test_a_smaller_share_is_part_of_a_larger_one_and_of_the_first_folds() -> None:
    o = repeated(2)
    fifth, quarter = (named(o, split(o, share, 0)[1]) for share in (0.2, 0.25))
    assert fifth < quarter
    assert named(o, next(fold_splits(o, 4, 0))[1]) == quarter


def test_repeats_are_held_out_in_the_proportion_they_have() -> None:
    o = repeated(3)
    for share in (0.1, 0.25, 0.5):
        groups = o.pose_groups()
        held = np.unique(groups[split(o, share, 0)[1]])
        assert np.sum(np.bincount(groups)[held] > 1) == pytest.approx(share * 20, abs=1)


def test_another_campaign_of_the_same_poses_holds_the_same_out() -> None:
    o = repeated(4)
    again = replace(o, position=o.position + 1.0)
    assert named(again, split(again, 0.3, 0)[1]) == named(o, split(o, 0.3, 0)[1])


def test_impossible_splits_are_refused() -> None:
    o = rows([0, 1, 2, 3], True)
    for fraction in (0.0, 1.0, -0.2, 3.0):
        with pytest.raises(OptionError, match="between 0 and 1"):
            split(o, fraction, 0)
    with pytest.raises(OptionError, match="two or more"):
        list(fold_splits(o, 1, 0))


def test_options_in_the_place_of_the_validation_are_refused() -> None:
    rng = np.random.default_rng(0)
    seen = measured(ur10(), joints(ur10(), 30, rng), rng, 1e-5)
    with pytest.raises(OptionError, match=r"validation is IdentifyOptions: give observations, a fraction"):
        identify(robot_from_document(ur10().document()), seen, IdentifyOptions())  # type: ignore[arg-type]


@pytest.mark.parametrize("see", ["position", "pose"])
def test_rows_of_the_fit_are_not_held_out(see: str) -> None:
    """Copies in another order and unit, moved in time and, of whole poses, without their orientation."""
    rng = np.random.default_rng(0)
    every = measured(ur10(), joints(ur10(), 30, rng), rng, 1e-5, see, t=np.arange(30.0))
    copied = every.select(np.array([25, 4, 17]))
    assert copied.position is not None
    others = Observations(
        np.radians(np.degrees(copied.q)), position=copied.position * 1e3 / 1e3, t=np.arange(3.0) + 1e6
    )
    robot = robot_from_document(ur10().document())
    with pytest.raises(ObservationError, match="3 of 3 rows for validation") as refused:
        identify(robot, every, others, IdentifyOptions(level=1))
    assert refused.value.code == "rows_shared"
