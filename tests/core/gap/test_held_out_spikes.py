"""Wrong visits among held-out poses: an interrupted laser beam spoils all readings of a visit, and refutes no model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap import GapOptions, find_gap
from tests.blind.generator import cases, generate
from tests.blind.to_core import observations_of, robot_of


@pytest.mark.parametrize("wrong", [2, 6])
def test_few_visits_that_are_far_off_are_set_aside_and_many_count(wrong: int) -> None:
    case = next(case for case in cases(20261129, 60) if case.name == "0021-none-elbow-30")
    measured = replace(case.options, repeats=3, revisited=0.5, outliers=0.0, confirmation=False)
    campaign = generate(replace(case, poses=60, options=measured))
    rows = observations_of(campaign.columns)
    held = np.isin(rows.pose_groups(), np.unique(rows.pose_groups())[::4])
    seen = rows.select(held)
    visit = np.unique(seen.visits(), return_inverse=True)[1]
    spoilt = np.isin(visit, np.linspace(0, visit.max(), wrong).round())
    position = np.array(seen.position)
    position[spoilt] += np.array([1e-3, -2e-3, 1e-3])
    report = find_gap(
        robot_of(campaign), rows.select(~held), GapOptions(next_poses=0), validation=replace(seen, position=position)
    )
    assert spoilt.sum() == 3 * wrong
    assert report.gap["held_out_set_aside"] == (spoilt.sum() if wrong == 2 else 0)
    assert report.verdict == ("no_gap" if wrong == 2 else "unexplained")
