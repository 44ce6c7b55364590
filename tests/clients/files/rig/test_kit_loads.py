"""Which way gravity pulls the joints over views, and what is asked for: moments by MuJoCo, of the public model's numbers."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_files.rig.kit.loads import LEAST_LOAD_NM, Sought, count_gravity_directions, gravity_moments
from tests.clients.lerobot.so101_arm import JOINTS, PRESET
from tests.clients.lerobot.so101_twin import gravity_nm

CHAIN: dict[str, Any] = json.loads(PRESET.read_text())
LIMITS = [(joint["limits_deg"][0], joint["limits_deg"][1]) for joint in CHAIN["joints"]]
PULLS = 0.1  # N m


def poses(number: int) -> NDArray[np.float64]:
    return np.random.default_rng(3).uniform(-1.0, 1.0, (number, 5)) * [60.0, 70.0, 70.0, 70.0, 140.0]


def test_moments_are_those_of_mujoco() -> None:
    q, held = poses(20), np.where(np.arange(20) % 2, 0.2, 0.0)
    found = gravity_moments(CHAIN, q, held)
    wanted = np.array([gravity_nm(row, kg) for row, kg in zip(q, held, strict=True)])
    assert found is not None
    assert np.abs(wanted).max() > 0.5
    assert found == pytest.approx(wanted, abs=2e-3)  # standard gravity here, 9.81 there


def without(key: str) -> dict[str, Any]:
    return {name: value for name, value in CHAIN.items() if name != key}


def linked() -> dict[str, Any]:
    return CHAIN | {"elements": [*CHAIN["elements"], {"joint": JOINTS[1], "axis": "Rz", "ratio": -1.0}]}


@pytest.mark.parametrize("chain", [without("links"), linked()], ids=["without masses", "with a linkage"])
def test_nothing_is_said_of_loads_that_the_document_does_not_tell(chain: Mapping[str, Any]) -> None:
    assert count_gravity_directions(Sought(chain, np.array(poses(5), dtype=float), LIMITS), [0.0] * 5) == []


def one_way() -> Iterator[tuple[NDArray[np.float64], float]]:
    """40 views in which gravity pulls joint 2 forwards only."""
    held = [(row, kg) for row in poses(200) for kg in (0.0, 0.2)]
    return (one for one in held if gravity_nm(*one)[1] > PULLS)


def test_a_pose_is_named_at_which_gravity_pulls_the_other_way() -> None:
    """Within the limits, with and without the payload, as MuJoCo has it; six views of it are enough."""
    views = [view for _, view in zip(range(40), one_way(), strict=False)]
    asked = {
        one.joint: one
        for one in count_gravity_directions(
            Sought(CHAIN, np.array([q for q, _ in views]), LIMITS), [kg for _, kg in views]
        )
    }
    lift = asked[2]
    assert [*asked] == [2, 3, 4]
    assert (lift.more, lift.fewer, lift.wanted) == (40, 0, 6)
    assert len(lift.examples_deg) == 3
    for example in lift.examples_deg:
        assert all(low <= value <= high for value, (low, high) in zip(example, LIMITS, strict=True))
        for kg in (0.0, 0.2):
            assert gravity_nm(np.array(example), kg)[1] < -LEAST_LOAD_NM
    told = " or ".join(f"({', '.join(f'{value:.0f}' for value in example)})" for example in lift.examples_deg)
    assert lift.missing == (
        "views in which gravity pulls joint 2 (shoulder_lift) the other way: it does in 0 of 40, take 6 more, for example "
        f"near {told} deg, rotating the first and the last joint until the camera sees the board: these views do not say "
        "where it stands"
    )
    assert lift.untold is not None
    assert "cannot be told from its zero: gravity pulls it the other way in 0 of 40 views only" in lift.untold
    more = [*views, *[(np.array(lift.examples_deg[0]), kg) for kg in (0.0, 0.2)] * 3]
    again = count_gravity_directions(Sought(CHAIN, np.array([q for q, _ in more]), LIMITS), [kg for _, kg in more])[0]
    assert (again.wanted, again.missing, again.untold, again.examples_deg) == (0, None, None, ())


def test_an_arm_that_cannot_is_told_so_and_asked_for_nothing() -> None:
    """Its joints stop before the upper arm is upright."""
    views = [view for _, view in zip(range(40), one_way(), strict=False)]
    tight = [(-1.0, 1.0), (30.0, 40.0), (-10.0, 10.0), (-10.0, 10.0), (-1.0, 1.0)]
    lift = count_gravity_directions(Sought(CHAIN, np.array([q for q, _ in views]), tight), [kg for _, kg in views])[0]
    assert lift.missing is None
    assert lift.untold is not None
    assert lift.untold.endswith("and within the limits of the joints no pose changes that")
