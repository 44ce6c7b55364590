"""The blur of signs at the end of a hunt: as wide as the data leave the masses in doubt, not as they were stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.search.prepare import source_load_blur
from kilter_core.gap.search.sources.tool_source import ToolSource
from kilter_core.measurement import Measurement
from tests.core.gap.simulated import campaign, katana

QUICK = GapOptions(
    effects=("axial_compliance", "backlash_load"), resamples=10, permutations=5, bootstraps=499, next_poses=0
)
HIDDEN = [("axial_compliance", (2,), (2e-4,)), ("backlash_load", (2,), (1.5e-3,))]


def test_a_compliance_that_shows_the_masses_narrows_the_sign_of_its_joint() -> None:
    robot = katana()
    links = (replace(link, mass_sigma=0.3 * link.mass, com_sigma=0.02) for link in robot.links)
    unsure = replace(robot, links=tuple(links))
    report = find_gap(unsure, campaign(robot, HIDDEN, poses=150, revisits=25, seed=2), QUICK)
    assert {(e.evidence.candidate.id, e.evidence.candidate.joints) for e in report.effects} == {
        ("axial_compliance", (2,)), ("backlash_load", (2,))
    }  # fmt: skip
    (play,) = [e for e in report.calibration.model.effects if e.id == "backlash_load"]
    (width,) = play.softening_nm
    stored = report.stored
    source = ToolSource.from_model(
        stored.calibration.model,
        Measurement.from_observations(stored.shown, stored.calibration.marker_points),
        np.array([stored.calibration.names.index(n) for n in stored.posterior.names]),
        0,
    )
    prior = source_load_blur(source, stored.calibration.values, np.diag(source.prior_sigma[source.soft] ** 2))[2, 1]
    soft = np.flatnonzero(source.soft)
    known = source_load_blur(source, stored.calibration.values, stored.posterior.covariance[np.ix_(soft, soft)])[2, 1]
    assert known < 0.5 * prior
    # It was made of the posterior before the last re-fit, which knew a little less.
    assert known < width < 1.5 * known
