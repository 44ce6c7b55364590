"""Effects that several joints share, on arms of six and seven axes whose statics share nothing with the core."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, find_gap
from kilter_core.observations import Observations
from tests.core.gap.many_joints import campaign, hidden

SHARED = ("axial_compliance", "backlash", "clearance_tilt")
QUICK = GapOptions(
    resamples=5, permutations=2, bootstraps=299, next_poses=0, effects=(*SHARED, "radial_compliance", "eccentricity")
)


@pytest.mark.parametrize(
    ("axes", "seed", "share"), [(6, 0, 0.2), pytest.param(7, 0, 1.0, marks=pytest.mark.slow)]
)  # fmt: skip
def test_the_joints_of_three_effects_are_found(axes: int, seed: int, share: float) -> None:
    truth = hidden(seed, axes, SHARED, share)
    made = campaign(seed, axes, truth)
    report = find_gap(robot_from_document(made.document), Observations(**made.columns), QUICK, validation=0)
    found = {
        (e.evidence.candidate.id, j) for e in report.effects for j in e.evidence.candidate.joints or (-1,)
    }  # fmt: skip
    assert found == {(effect, j) for effect, amounts in truth.items() for j in np.flatnonzero(amounts)}
    assert report.adequacy.adequate
