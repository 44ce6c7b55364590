"""A hunt on an arm whose zeros are degrees off: loads are those of the arm as it stands, and the version says so."""

from __future__ import annotations

import numpy as np

from kilter_core.gap import GapOptions, find_gap
from kilter_core.model import Calibration
from tests.core.off_zero import NOISE_M, soft_elbow

JOINTS, TRUTH = (1, 2), (4e-6, 6e-6)
QUICK = GapOptions(
    effects=("axial_compliance", "eccentricity", "backlash"), resamples=10, permutations=5, bootstraps=499, next_poses=0
)


def test_a_hunt_takes_its_loads_on_the_chain_that_it_fitted() -> None:
    twin = soft_elbow(axial_compliance=(JOINTS, TRUTH))
    rows, unseen = twin.rows(80, 1), twin.rows(40, 2)
    report = find_gap(twin.robot, rows, QUICK, validation=unseen)
    assert {j.evidence.candidate.id for j in report.effects} == {"axial_compliance"}
    found = Calibration.from_document(twin.robot, report.calibration.to_document())
    assert found.model.load_chain is not None
    values = dict(zip(found.names, found.values, strict=True))
    sigma = dict(zip(report.stored.posterior.names, report.stored.posterior.sigma, strict=True))
    for j, true in zip(JOINTS, TRUTH, strict=True):
        name = f"compliance_{j + 1}"
        assert abs(values[name] - true) < 3.0 * sigma[name]
    for name, value in zip(found.model.names[6:-6], found.model.load_chain.values, strict=False):
        assert abs(value - values[name]) < 1e-4, name
    left = found.predict(unseen).position - unseen.position
    assert np.sqrt(np.mean(left**2)) < 1.2 * NOISE_M
