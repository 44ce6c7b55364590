"""The gear of most light arms: three stiffnesses by the load and a loop of fixed width, as makers state them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.gap import GapOptions, find_gap
from tests.blind.generator import generate, outside
from tests.blind.generator.arm import Arm, Deflection
from tests.blind.generator.case import Case, Hidden
from tests.blind.generator.options import Options
from tests.blind.generator.physics import Physics
from tests.blind.generator.visits import Visits
from tests.blind.to_core import observations_of, robot_of

Floats = NDArray[np.float64]
K1_PER_T1 = 2300.0  # 1/rad, of makers' tables from size 14 to 58
K2, K3, T2 = 1.4, 1.75, 3.5  # of K1 and T1
LOOP_RAD = 1.5e-4
QUICK = GapOptions(
    resamples=10,
    permutations=5,
    bootstraps=299,
    next_poses=0,
    effects=("axial_compliance", "strain_wave", "hardening", "backlash_load", "backlash", "eccentricity"),
)


def twist(load: Floats, knee: float) -> Floats:
    """Twist rad of a strain wave gear under a load N m, whose stiffness changes at ``knee`` and at 3.5 times that."""
    stiff, size, far = K1_PER_T1 * knee, np.abs(load), T2 * knee
    pieces = np.minimum(size, knee) / stiff + np.clip(size - knee, 0.0, far - knee) / (K2 * stiff)
    return np.asarray((pieces + np.maximum(size - far, 0.0) / (K3 * stiff)) * np.sign(load))


def gears(arm: Arm, visits: Visits, joints: tuple[int, ...], rng: np.random.Generator) -> Physics:
    """Such gears at these joints."""
    load = visits.load.moment[:, :, 2]
    knees = {j: 0.1 * float(np.max(np.abs(load[:, j]))) for j in joints}

    def act(values: Floats, d: Deflection) -> None:
        for j, knee in knees.items():
            d.dq[:, j] += values[0] * (twist(load[:, j], knee) + LOOP_RAD * visits.direction[:, j])

    return Physics((("h", joints[0]),), np.array([1.0]), True, act)


@pytest.mark.parametrize("robot", ["seven", "elbow"])
def test_a_strain_wave_gear_is_named_and_nothing_beside_it(robot: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(outside.OUTSIDE, "gears", gears)
    case = Case("", robot, (Hidden("gears", (1,)),), (20000.0,), 60, Options(payload="two"), "outside", 11)
    campaign = generate(case)
    report = find_gap(robot_of(campaign), observations_of(campaign.columns), QUICK)
    found = {(j.evidence.candidate.id, j.evidence.candidate.joints) for j in report.effects}
    assert found == {(effect, (1,)) for effect in ("axial_compliance", "strain_wave", "backlash")}
