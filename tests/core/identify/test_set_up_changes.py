"""Campaigns of one arm with another tool or base in each, and genuine ones, by a chain of plain DH in numpy."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.plausibility.set_up_changes import SetUpChange, set_up_change
from kilter_core.observations import Observations

Floats = NDArray[np.float64]
# A UR10: theta offset, d, a, alpha.
DH = np.array([
    [0.0, 0.1273, 0.0, np.pi / 2], [0.0, 0.0, -0.612, 0.0], [0.0, 0.0, -0.5723, 0.0],
    [0.0, 0.163941, 0.0, np.pi / 2], [0.0, 0.1157, 0.0, -np.pi / 2], [0.0, 0.0922, 0.0, 0.0],
])  # fmt: skip
TOOL, STATION = np.array([0.05, 0.03, 0.12]), np.array([1.0, 2.0, 0.5])
ROBOT = robot_from_document({**preset_document("ur10"), "name": "arm"})


def flanges(q: Floats, built: Floats) -> tuple[Floats, Floats]:
    """Rotations (N, 3, 3) and places (N, 3) m of the flange."""
    poses = []
    for row in q:
        pose = np.eye(4)
        for angle, (offset, d, a, alpha) in zip(row, built, strict=True):
            c, s, ca, sa = np.cos(angle + offset), np.sin(angle + offset), np.cos(alpha), np.sin(alpha)
            pose = pose @ np.array(
                [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
            )
        poses.append(pose)
    found = np.array(poses)
    return found[:, :3, :3], found[:, :3, 3]


def campaigns(seed: int, tool: Floats | None = None, station: Floats | None = None) -> list[Observations]:
    """Two campaigns of an arm with errors, sag and backlash of its own, and its poses all over or in a corner."""
    rng = np.random.default_rng(seed)
    built = DH + rng.normal(0.0, 10 ** rng.uniform(-4.0, -2.7), DH.shape)
    sag, backlash, noise = rng.choice([0.0, 1e-3]), rng.choice([0.0, 1e-3]), 10 ** rng.uniform(-5.0, -3.5)
    parts = []
    for later in (False, True):
        count, near = int(rng.choice([15, 30, 60])), rng.random() < 0.4
        q = (
            rng.uniform(-1.5, 1.5, 6) + rng.uniform(-0.6, 0.6, (count, 6))
            if near
            else rng.uniform(-2.2, 2.2, (count, 6))
        )
        driven = q.copy()
        load = rng.choice([1.0, 1.5])
        driven[:, 1] += sag * load * np.cos(q[:, 1])
        driven[:, 2] += 0.5 * sag * load * np.cos(q[:, 1] + q[:, 2])
        driven[:, 3] += backlash * rng.choice([-0.5, 0.5], count)
        turn, place = flanges(driven, built)
        own = TOOL if tool is None or not later else TOOL + tool
        at = STATION if station is None or not later else STATION + station
        points = place + turn @ own + at
        parts.append(Observations(q=q, position=points + noise * rng.normal(size=points.shape)))
    return parts


def found(parts: list[Observations]) -> SetUpChange | None:
    return set_up_change(identify(ROBOT, Observations.concatenate(parts)).calibration, parts)


@pytest.mark.parametrize("seed", [1, 3, 4])
def test_another_tool_or_base_is_named(seed: int) -> None:
    shift = np.array([0.009, -0.009, 0.006])
    for which in ("tool", "base"):
        change = found(campaigns(seed, **{"tool" if which == "tool" else "station": shift}))
        assert change is not None
        assert change.which == (which,)
        assert change.moved == pytest.approx(0.014, rel=0.1)
        assert change.apart < 0.3 * change.together


def test_a_tool_for_each_campaign_leaves_the_noise() -> None:
    parts = campaigns(1, tool=np.array([0.014, 0.0, 0.0]))
    marked = [
        Observations(q=one.q, position=one.position, session=np.full(len(one), k), setup=np.full(len(one), k))
        for k, one in enumerate(parts)
    ]
    change = found(parts)
    assert change is not None
    split = identify(ROBOT, Observations.concatenate(marked), options=IdentifyOptions(refit=("tool",)))
    left = split.metrics["train"]["identified"]["rms_mm"]
    assert left == pytest.approx(1e3 * change.apart, rel=0.1)


@pytest.mark.parametrize("seed", range(100, 112))
def test_genuine_campaigns_are_not_accused(seed: int) -> None:
    assert found(campaigns(seed)) is None
