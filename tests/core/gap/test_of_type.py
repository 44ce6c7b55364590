"""A search that begins with what other arms of the type say."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import CoreError, OptionError
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.of_type import KnownType, known_type
from kilter_core.identify import identify
from kilter_core.identify.fleet_prior import FleetVersion
from kilter_core.observations import Observations
from tests.core.identify.fleet.simulated import Arm, Type, document, poses

Floats = NDArray[np.float64]
NOISE = 5e-5
OPTIONS = GapOptions(noise_mm=0.05, bootstraps=199, resamples=10, permutations=3, next_poses=0)
ROBOT = robot_from_document(document())


@dataclass(frozen=True)
class Fleet:
    kind: Type
    versions: list[FleetVersion]


@pytest.fixture(scope="module")
def fleet() -> Fleet:
    rng = np.random.default_rng(3)
    kind, versions = Type.drawn(rng), []
    for k in range(7):
        found = identify(ROBOT, kind.arm(rng).measured(poses(50, rng), rng, NOISE))
        versions.append(
            FleetVersion.from_calibration(f"r{k}", f"v{k}", found.calibration, found.predictive.to_document())
        )
    return Fleet(kind, versions)


def eccentric(arm: Arm, q: Floats, rng: np.random.Generator, amplitude_deg: float) -> Observations:
    """Rows of an arm whose third encoder is mounted off its centre."""
    turned = q.copy()
    turned[:, 2] += np.radians(amplitude_deg) * np.sin(q[:, 2])
    return replace(arm.measured(turned, rng, NOISE), q=q)


def begun(rows: Observations, fleet: Fleet) -> KnownType:
    return known_type(ROBOT, rows, OPTIONS, None, fleet.versions)


def test_an_effect_is_found_beside_a_geometry_that_the_type_holds(fleet: Fleet) -> None:
    rng = np.random.default_rng(4)
    rows = eccentric(fleet.kind.arm(rng), poses(24, rng), rng, 0.1)
    known = begun(rows, fleet)
    report = find_gap(ROBOT, rows, OPTIONS, known.start, 0.0)
    assert [one.evidence.candidate.id_and_joints() for one in report.effects] == [{"id": "eccentricity", "joints": [3]}]
    assert known.to_document()["source"] == "fleet"
    assert {row["from_prior"] for row in report.stored.parameters()} <= {True, False}


def test_an_arm_of_the_type_without_any_gets_no_name_and_smaller_ones_could_be_seen(fleet: Fleet) -> None:
    rng = np.random.default_rng(5)
    rows = fleet.kind.arm(rng).measured(poses(14, rng), rng, NOISE)
    known = begun(rows, fleet)
    with_type, without = (find_gap(ROBOT, rows, OPTIONS, start, 0.0) for start in (known.start, None))
    assert with_type.verdict == "no_gap"
    seen = [{d["parameter"]: d["smallest_detectable"] for d in r.smallest_detectable} for r in (with_type, without)]
    assert np.median([seen[0][name] / seen[1][name] for name in seen[0].keys() & seen[1].keys()]) < 1.0


def test_an_odd_arm_is_searched_without_the_prior(fleet: Fleet) -> None:
    rng = np.random.default_rng(6)
    rows = eccentric(fleet.kind.arm(rng, shift=10.0), poses(24, rng), rng, 0.1)
    known = begun(rows, fleet)
    assert known.start.model.of_type is None
    assert [one["code"] for one in known.warnings()] == ["fleet_prior_dropped"]
    report = find_gap(ROBOT, rows, OPTIONS, known.start, 0.0)
    assert report.to_document()["effects"] == find_gap(ROBOT, rows, OPTIONS, None, 0.0).to_document()["effects"]


def test_too_few_robots_and_rows_without_a_tool_are_refused(fleet: Fleet) -> None:
    rng = np.random.default_rng(7)
    rows = fleet.kind.arm(rng).measured(poses(14, rng), rng, NOISE)
    with pytest.raises(CoreError, match="at least 5 other robots"):
        begun(rows, replace(fleet, versions=fleet.versions[:3]))
    with pytest.raises(OptionError, match="measure the tool"):
        begun(Observations(rows.q, link_q=rows.q), fleet)
