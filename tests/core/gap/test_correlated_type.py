"""Errors that arms of a type have together: a search takes the whole covariance of the type, as an identification does."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.noise.covariance_models import SMALLEST
from kilter_core.gap.report.stored import Stored
from kilter_core.gap.search.linear import linearized
from kilter_core.identify import IdentifyOptions
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.measured_rows import measurement_for
from kilter_core.identify.methods.fit import fit_by_method
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import CorrelatedPrior
from tests.core.identify.fleet.simulated import ANGLE, LENGTH, PARALLEL, TOOL, Arm, document, poses, shifted, turned

Floats = NDArray[np.float64]
NOISE = 5e-5
ROBOT = robot_from_document(document())
ARMS, POSES = 60, 12
# One effect is looked for: what the search does with the geometry is the same as with all.
OPTIONS = GapOptions(
    effects=("eccentricity",), noise_mm=0.05, bootstraps=199, resamples=1, permutations=1, next_poses=0
)
TOLD = [(k, e) for k in range(6) for e in range(5) if e < 4 or k == PARALLEL]  # joint, error of simulated.Arm
NAMES = tuple(f"{('theta_offset', 'd', 'a', 'alpha', 'beta')[e]}_{k + 1}" for k, e in TOLD)
NOMINAL = np.array([Calibration.nominal(ROBOT).model.parameter(name).value for name in NAMES])
SPREAD = np.array([(ANGLE, LENGTH, LENGTH, ANGLE, ANGLE)[e] for _, e in TOLD])


@dataclass(frozen=True)
class Correlated:
    """A type whose errors come from three common causes and little of their own: mean and root of the covariance."""

    mean: Floats
    root: Floats

    @staticmethod
    def drawn(rng: np.random.Generator) -> Correlated:
        common = rng.standard_normal((len(TOLD), 3))
        common *= 0.95 / np.linalg.norm(common, axis=1)[:, None]
        root = np.hstack([common, np.sqrt(1.0 - 0.95**2) * np.eye(len(TOLD))])
        return Correlated(SPREAD * rng.standard_normal(len(TOLD)), SPREAD[:, None] * root)

    @property
    def prior(self) -> CorrelatedPrior:
        return CorrelatedPrior(NAMES, NOMINAL + self.mean, self.root @ self.root.T, 1e6)

    def arm(self, rng: np.random.Generator) -> tuple[Arm, Floats]:
        """An arm of the type, and its parameters in the order of the names."""
        told = self.mean + self.root @ rng.standard_normal(self.root.shape[1])
        errors = np.zeros((6, 5))
        errors[tuple(np.array(TOLD).T)] = told
        base = shifted(*rng.normal(0.0, 1e-3, 3)) @ turned("z", rng.normal(0.0, 5e-3, 1))[0]
        return Arm(errors, base, TOOL + rng.normal(0.0, 2e-3, 3)), NOMINAL + told


def identified(rows: Observations, prior: CorrelatedPrior) -> Fit:
    start = Calibration.nominal(ROBOT)
    asked = IdentifyOptions(noise_mm=float(np.hypot(0.05, 1e3 * SMALLEST)), prior="fleet")  # as a search has it
    told = replace(start, model=replace(start.model, of_type=prior))
    return fit_by_method(told, measurement_for(rows, asked, start.marker_points), asked)


def searched(rows: Observations, prior: CorrelatedPrior | None) -> Stored:
    start = Calibration.nominal(ROBOT)
    begin = replace(start, model=replace(start.model, of_type=prior))
    return find_gap(ROBOT, rows, OPTIONS, begin, 0.0).stored


@pytest.mark.parametrize("seed", [1, 2])
def test_a_search_and_an_identification_with_one_prior_are_one_fit(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both at the very minimum: a search ends where a step promises a tenth of a standard deviation of all data."""
    monkeypatch.setattr(linearized, "STILL", 1e-8)
    rng = np.random.default_rng(seed)
    kind = Correlated.drawn(rng)
    rows = kind.arm(rng)[0].measured(poses(POSES, rng), rng, NOISE)
    fit = identified(rows, kind.prior)
    assert fit.prior_use is not None
    assert fit.prior_use.state != "dropped"
    found = searched(rows, fit.problem.model.of_type)
    own = [fit.names.index(name) for name in NAMES]
    place = [found.posterior.names.index(name) for name in NAMES]
    theirs = fit.values[fit.problem.free][own]
    mine = np.array([found.calibration.values[found.calibration.names.index(name)] for name in NAMES])
    sigma = fit.sigma[own]
    np.testing.assert_array_less(np.abs(mine - theirs) / sigma, 1e-6)
    np.testing.assert_allclose(found.posterior.sigma[place], sigma, rtol=1e-6)


def test_a_search_of_an_arm_whose_base_and_tool_are_known_has_no_geometry_left_to_project_off() -> None:
    rng = np.random.default_rng(4)
    kind = Correlated.drawn(rng)
    arm, _ = kind.arm(rng)
    rows = replace(arm, base=np.eye(4), tool=TOOL).measured(poses(20, rng), rng, NOISE)
    start = Calibration.nominal(ROBOT)
    begin = replace(start, model=replace(start.model, of_type=kind.prior))
    report = find_gap(ROBOT, rows, replace(OPTIONS, base="fixed", tool="fixed"), begin, 0.0)
    assert report.verdict == "no_gap"


@pytest.mark.slow
def test_intervals_hold_what_they_say() -> None:
    rng = np.random.default_rng(3)
    kind = Correlated.drawn(rng)
    inside = []
    for _ in range(ARMS):
        arm, told = kind.arm(rng)
        found = searched(arm.measured(poses(POSES, rng), rng, NOISE), kind.prior)
        place = [found.posterior.names.index(name) for name in NAMES]
        mine = np.array([found.calibration.values[found.calibration.names.index(name)] for name in NAMES])
        inside.append(np.abs(mine - told) < 1.96 * found.posterior.sigma[place])
    share = float(np.mean(inside))
    assert 0.93 <= share <= 0.97, share
