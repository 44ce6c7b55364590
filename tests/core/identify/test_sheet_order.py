"""From which quarter point a circle is told: drawn by an arm that shares no code with core, read in four orders."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify.plausibility.sheet_order import sheet_order, sheet_orders
from kilter_core.observations import Observations
from tests.core.campaigns import table_errors
from tests.core.drawing import PLANE, Drawing, drawn
from tests.core.truth import ur10

Floats = NDArray[np.float64]

START = np.array([0.2, -1.2, 1.6, -1.9, -1.2, 0.3])
CENTRE = np.array([0.5, -0.3, 0.3])


def drawing(seed: int, count: int = 68) -> Drawing:
    rng, arm = np.random.default_rng(seed), ur10()
    offsets = {s.name: 5e-3 * rng.normal() for s in arm.steps if s.name and s.joint is not None}
    return drawn(arm, arm.moved(table_errors(arm, rng, 1e-5, 1e-4) | offsets), START, CENTRE, 0.08, count)


def misread(d: Drawing, quarters: int, seed: int) -> Observations:
    """Rows as they come when row k of the points file is in truth point k + ``quarters``: errors at the wrong place."""
    at = d.turn - quarters * np.pi / 2
    place = (np.arange(len(at)) - quarters * len(at) // 4) % len(at)
    r = d.radius + d.out[place]
    angle = at + d.along[place] / r + quarters * np.pi / 2
    local = np.stack([r * np.cos(angle), r * np.sin(angle), d.error[:, 2]], axis=1)
    noise = np.random.default_rng(seed).normal(0.0, 1e-5, local.shape)
    return Observations(d.q, d.centre + local @ PLANE.T + noise, sigma=np.full(noise.shape, 1e-5))


def tilting(seed: int) -> tuple[Drawing, np.random.Generator]:
    """A circle of an arm with hardly any geometric errors, whose joints tilt in their clearance and have play."""
    rng, arm = np.random.default_rng(seed), ur10()
    true = arm.moved({name: 0.1 * error for name, error in table_errors(arm, rng, 1e-5, 1e-4).items()})
    plain = drawn(arm, true, START, CENTRE + rng.uniform(-0.1, 0.1, 3), 0.08, 68)
    q = plain.q
    gone = np.diff(np.vstack([q, q[:1]]), axis=0)
    moved = np.einsum("nkj,nj->nk", true.joint_jacobians(q)[:, :3], -rng.uniform(5e-5, 2e-4, 6) * np.sign(gone))
    p = true.poses(q)[0]
    for j, (axis, place) in enumerate(zip(*true.joint_axes(q), strict=True)):
        lever = p - place
        moment = np.cross(lever, [0.0, 0.0, -1.0])
        across = moment - np.sum(moment * axis, axis=1)[:, None] * axis
        size = np.linalg.norm(across, axis=1)[:, None]
        tilt = rng.uniform(1e-4, 5e-4) * across / np.maximum(size, 1e-3) * np.tanh(size / 0.05)
        moved += np.cross(tilt, lever) * (j < 5)
    error = plain.error + moved @ PLANE
    t = plain.turn  # what is read off a sheet is wrong alike in near places
    for k in (1, 2, 3, 4):
        error = error + np.sqrt(0.5) * 3e-5 * rng.normal(size=3) * np.cos(k * t + rng.uniform(0.0, 6.3))[:, None]
    return Drawing(plain.radius, plain.centre, t, q, plain.commanded, error), rng


@pytest.mark.parametrize("seed", range(8))
def test_an_arm_that_tilts_is_not_refused(seed: int) -> None:
    """Nothing of what it drew is geometry, and the reading is as wrong as the differences between the orders."""
    robot = robot_from_document(ur10().document())
    found = [tilting(2 * seed + k)[0] for k in range(2)]
    rows = [Observations(d.q, d.measured()) for d in found]
    for judged in (sheet_order(robot, rows[0]), *sheet_orders(robot, rows)):
        assert judged is not None
        assert not judged.wrong


def test_sheets_of_one_arm_are_judged_together() -> None:
    """The sheet that was misread is named, the other is not, and it is the right order that is named."""
    robot = robot_from_document(ur10().document())
    d, rng = drawing(3), np.random.default_rng(3)
    arm = ur10()
    offsets = {s.name: 5e-3 * rng.normal() for s in arm.steps if s.name and s.joint is not None}
    true = arm.moved(table_errors(arm, rng, 1e-5, 1e-4) | offsets)
    other = drawn(arm, true, START, CENTRE + np.array([0.1, 0.05, 0.1]), 0.08, 68)
    same = drawn(arm, true, START, d.centre, 0.08, 68)
    wrong, right = sheet_orders(robot, [misread(same, 1, 0), misread(other, 0, 1)])
    assert wrong is not None
    assert right is not None
    assert wrong.order == (4, 1, 2, 3)
    assert wrong.wrong
    assert right.order == (1, 2, 3, 4)
    assert not right.wrong


@pytest.mark.parametrize("seed", range(6))
def test_the_order_is_found_and_the_right_one_is_never_doubted(seed: int) -> None:
    robot, d = robot_from_document(ur10().document()), drawing(seed)
    for quarters in range(4):
        found = sheet_order(robot, misread(d, quarters, seed))
        assert found is not None
        # Row k is in truth point k + quarters, so point 1 stands in row 1 - quarters.
        assert found.order == tuple((k - quarters) % 4 + 1 for k in range(4))
        if quarters == 0:
            assert not found.wrong
            assert not found.doubtful
            assert found.lead == 0
        else:
            # What is left as given may be as small as play leaves it: then it is doubted, and not refused.
            assert found.wrong or (found.doubtful and found.as_given < 3e-5)
            assert found.as_given > 1.5 * found.left
            assert f"in the order {', '.join(map(str, found.order))}, join" in found.sentence()


def test_what_the_model_does_not_explain_is_no_proof() -> None:
    """Errors that no geometry makes: another order may look better by chance, and nothing is refused for it."""
    robot, d = robot_from_document(ur10().document()), drawing(0)
    rng = np.random.default_rng(5)
    refused = 0
    for _ in range(20):
        waves = [rng.normal(0, 2e-4) * np.cos(k * d.turn + rng.uniform(0, 6)) for k in (2, 3, 4) for _ in range(3)]
        error = np.stack([sum(waves[k::3]) for k in range(3)], axis=1)
        found = sheet_order(robot, Observations(d.q, d.commanded + error @ PLANE.T))
        assert found is not None
        refused += found.wrong
    assert refused <= 1


def test_a_perfect_arm_tells_no_order() -> None:
    robot, d = robot_from_document(ur10().document()), drawing(0)
    noise = np.random.default_rng(1).normal(0.0, 1e-5, d.commanded.shape)
    found = sheet_order(robot, Observations(d.q, d.commanded + noise))
    assert found is not None
    assert not found.wrong
    assert not found.doubtful


def test_other_paths_are_not_judged() -> None:
    robot, d = robot_from_document(ur10().document()), drawing(0)
    rows = misread(d, 1, 0)
    assert rows.position is not None
    assert sheet_order(robot, rows.select(np.arange(40))) is None
    assert sheet_order(robot, rows.select(np.arange(0, 68, 4))) is None
    line = Observations(rows.q, np.linspace([0, 0, 0], [0.1, 0.2, 0.3], 68))
    assert sheet_order(robot, line) is None
    assert sheet_order(robot, Observations(rows.q)) is None
