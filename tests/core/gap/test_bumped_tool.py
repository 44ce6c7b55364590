"""A tool that was knocked half-way, shifted and rotated: plain DH in numpy draws the reflectors, nothing of the core."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.effects import make_effect
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.report.report import GapReport
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.gap.time_twins import BASE, DH, NOISE_M, TOOL, robot, tool_points, turned

QUICK = GapOptions(
    resamples=10, permutations=3, bootstraps=199, next_poses=0,
    effects=("base_step", "tool_step", "zero_step", "drift", "settling", "backlash", "eccentricity"),
)  # fmt: skip
ROW = 49  # the last before it, from 1
SHIFT, SPIN = np.array([4e-4, -3e-4, 2e-4]), np.array([2e-3, -1.5e-3, 2.5e-3])
TRIANGLE = np.array([[0.0, 0.0, 0.0], [0.11, 0.02, 0.03], [-0.03, 0.12, -0.02]])


def campaign(nests: NDArray[np.float64], seed: int, spin: NDArray[np.float64] = SPIN) -> Observations:
    """Reflectors at ``TOOL + nests (m, 3)``, all of which a knock at the flange's tool moved before the last rows."""
    rng = np.random.default_rng([seed, 5])
    pose = rng.permutation(np.concatenate([np.arange(60), np.tile(np.arange(20), 2)]))
    low, high = np.array([-2.8, -2.2, -2.0, -2.8, -2.5, -2.8]), np.array([2.8, -0.4, 2.0, 2.8, 2.5, 2.8])
    q, n = rng.uniform(low, high, (60, 6))[pose], len(pose)
    dh = DH + rng.normal(size=DH.shape) * np.array([1e-3, 3e-4, 3e-4, 1e-3])
    late = np.arange(n) >= ROW
    moved = turned(spin[None])[0]
    seen = []
    for nest in nests:
        tool = np.where(late[:, None], TOOL + moved @ nest + SHIFT, TOOL + nest)
        seen.append(tool_points(q, dh, tool) + BASE + NOISE_M * rng.normal(size=(n, 3)))
    columns: dict[str, Any] = {"position": seen[0]} if len(nests) == 1 else {"markers": np.stack(seen, axis=1)}
    return Observations(q=q, pose_id=pose, **columns)


def said(report: GapReport) -> dict[str, Any]:
    (effect,) = report.effects
    assert effect.evidence.candidate.id == "tool_step"
    (warning,) = [one for one in report.warnings if one["code"] == "moved_once"]
    assert warning["row"] == ROW + 1
    return warning


@pytest.mark.parametrize("seed", [1, 2])
def test_three_reflectors_show_how_far_a_tool_moved_and_rotated(seed: int) -> None:
    """Without its rotation the search named what else it could beside the step."""
    warning = said(find_gap(robot(), campaign(TRIANGLE, seed), QUICK))
    far = np.linalg.norm(SHIFT + TRIANGLE @ (turned(SPIN[None])[0] - np.eye(3)).T, axis=1)
    assert abs(warning["moved_mm"] - 1e3 * np.sqrt(np.mean(far**2))) < 2.0 * warning["u95_mm"] < 0.03
    assert abs(warning["rotated_deg"] - np.degrees(np.linalg.norm(SPIN))) < 2.0 * warning["u95_deg"] < 0.03
    assert f"mm) at the tool on average and {warning['rotated_deg']:.2g} deg (within" in warning["message"]


def test_one_reflector_shows_no_rotation_and_the_search_says_so() -> None:
    report = find_gap(robot(), campaign(TRIANGLE[:1], 1), QUICK)
    warning = said(report)
    assert (warning["rotated_deg"], warning["u95_deg"]) == (None, None)
    assert "one point of it was measured, which shows no rotation" in warning["message"]
    assert len(report.effects[0].evidence.amplitudes) == 3


def test_its_remedy_leaves_no_step() -> None:
    """A session from the row that is told, and a tool for each: what is left falls to the noise."""
    rows = campaign(TRIANGLE, 1)
    row = said(find_gap(robot(), rows, QUICK))["row"]
    session = (np.arange(len(rows)) >= row - 1).astype(np.int64)
    split = replace(rows, session=session, setup=session)
    left = [
        identify(robot(), one, options=IdentifyOptions(refit=refit)).metrics["train"]["identified"]["rms_mm"]
        for one, refit in ((rows, ()), (split, ("tool",)))
    ]
    assert left[1] < 0.07 < 3.0 * left[1] < left[0]


def test_a_version_stored_without_a_rotation_moves_as_it_did() -> None:
    step = make_effect("tool_step", at_row=3)
    document = Calibration.nominal(robot(), (step,)).to_document()
    shift = {f"step_tool_{k}": 1e-3 for k in "xyz"}
    document["values"] = {k: v for k, v in document["values"].items() if not k.startswith("step_tool_")} | shift
    kept = Calibration.from_document(robot(), document)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (4, 6))
    rows = Observations(q=q, row=np.array([1, 2, 3, 4]))
    off = kept.predict(rows).position - tool_points(q, DH, np.zeros((4, 3)))
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), 1e-3 * np.sqrt([3.0, 3.0, 0.0, 0.0]), atol=1e-9)
