"""Directions by the order of the rows, against orders whose directions are written down beside them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.observations import Observations
from kilter_core.observations.groups import with_directions

Q = np.radians([[0.0, 0.0], [10.0, -5.0], [10.0, 5.0], [9.9, 20.0], [9.9, 20.0], [30.0, 20.0], [-10.0, 0.0]])
SIDES = [[0, 0], [1, -1], [1, 1], [0, 1], [0, 1], [1, 1], [-1, -1]]  # 0.1 deg back says nothing of a backlash


def derived(rows: Observations) -> list[list[float]]:
    found = with_directions(rows)
    assert found.directions_derived
    assert found.stated_direction is None
    assert found.direction is not None
    return found.direction.tolist()


def test_directions_follow_the_order_of_the_rows() -> None:
    assert derived(Observations(q=Q)) == SIDES


def test_time_orders_rows_before_their_place_in_the_file() -> None:
    order = np.array([3, 0, 6, 2, 5, 1, 4])
    assert derived(Observations(q=Q[order], t=order.astype(float))) == [SIDES[k] for k in order]


def test_the_first_row_of_a_session_has_no_direction() -> None:
    session = np.array([1, 1, 1, 1, 1, 2, 2])
    assert derived(Observations(q=Q, session=session)) == [*SIDES[:5], [0, 0], [-1, -1]]


def test_shots_of_a_pose_keep_the_side_it_was_reached_from() -> None:
    q = np.repeat(Q[:3], 2, axis=0) + np.radians(0.03) * np.array([1, -1, 1, -1, 1, -1])[:, None]
    assert derived(Observations(q=q, pose_id=np.repeat([1, 2, 3], 2))) == [
        [0, 0],
        [0, 0],
        [1, -1],
        [1, -1],
        [0, 1],
        [0, 1],
    ]  # 0.06 deg may have been a motion of joint 1, or none


def test_stated_directions_and_single_rows_stay() -> None:
    stated = Observations(q=Q, direction=np.ones_like(Q))
    assert with_directions(stated) is stated
    assert with_directions(Observations(q=Q[:1])).direction is None


def test_samples_of_a_motion_get_no_directions() -> None:
    t = np.linspace(0.0, 10.0, 1000)
    rows = Observations(q=np.stack([np.sin(t), np.cos(t)], axis=1), t=t)
    assert with_directions(rows) is rows


def test_derived_directions_part_no_repeats() -> None:
    rows = Observations(q=Q[[1, 0, 1, 6, 1]])
    assert with_directions(rows).conditions().tolist() == rows.conditions().tolist()
    parted = replace(with_directions(rows), directions_derived=False)
    assert len(set(parted.conditions().tolist())) == 4  # the third row is reached as the last one is


@pytest.mark.parametrize("lacking", ["direction", "session", "t", "row", "pose_id"])
def test_campaigns_with_and_without_a_condition_go_together(lacking: str) -> None:
    n = len(Q)
    whole = Observations(
        q=Q, position=np.zeros((n, 3)), direction=np.ones_like(Q), session=np.full(n, 4), t=np.arange(n) * 1.0,
        row=np.arange(n), pose_id=np.arange(n),
    )  # fmt: skip
    without: dict[str, None] = {lacking: None}
    joined = Observations.concatenate([whole, replace(whole, **without)])
    assert len(joined) == 2 * n
    found = getattr(joined, lacking)
    if lacking in ("t", "row"):
        assert found is None
    elif lacking == "direction":
        assert found[n:].tolist() == np.zeros_like(Q).tolist()
    else:
        assert not set(found[:n].tolist()) & set(found[n:].tolist())


def test_a_row_after_ones_that_are_not_there_has_no_direction() -> None:
    whole = with_directions(Observations(q=Q, row=np.arange(1, len(Q) + 1)))
    assert whole.direction is not None
    kept = [0, 1, 4, 5]
    found = with_directions(Observations(q=Q[kept], row=np.array(kept) + 1)).direction
    assert found is not None
    assert found[2].tolist() == [0, 0]
    assert found[1].tolist() == whole.direction[1].tolist()
