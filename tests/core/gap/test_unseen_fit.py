"""Nothing is closed that rows no choice saw refute; repeats that scatter by more than their instrument are said to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap import GapOptions, find_gap
from kilter_core.observations import Observations
from tests.core.gap.simulated import campaign, katana

QUICK = GapOptions(
    resamples=20, permutations=5, bootstraps=499, next_poses=0, effects=("backlash", "eccentricity", "axial_compliance")
)
PLAY = ("backlash", (1,), (6e-4,))


@pytest.mark.parametrize("measured", ["position", "markers", "pose"])
def test_held_out_rows_of_the_same_arm_agree(measured: str) -> None:
    report = find_gap(katana(), campaign(katana(), [PLAY], poses=80, seed=5, measured=measured), QUICK)
    told = report.to_document()["adequacy"]["held_out"]
    assert report.verdict != "unexplained"
    assert told["p_value"] > 1e-3
    assert 0.4 < told["chi2_per_freedom"] < 1.6
    assert told["poses"] == 20
    assert not told["refuted"]
    assert "held-out" not in report.sentence


def test_what_only_held_out_rows_show_leaves_the_gap_open() -> None:
    """The last quarter of the poses has an error of its own, by 0.1 mm: the rows searched say closed, and are not asked."""
    robot = katana()
    train = campaign(robot, [PLAY], poses=80, seed=5, arm=1)
    whole = find_gap(robot, train, QUICK, validation=0.25)
    assert whole.verdict == "closed"
    assert train.position is not None
    last = np.isin(train.pose_id, np.arange(60, 80))
    bent = 1e-4 * np.sin(3.0 * train.q[:, :3])
    moved = replace(train, position=np.where(last[:, None], train.position + bent, train.position))
    report = find_gap(robot, moved.select(~last), QUICK, validation=moved.select(last))
    told = report.to_document()["adequacy"]["held_out"]
    assert report.verdict == "unexplained"
    assert told["refuted"]
    assert told["left_mm"] > 1.5 * told["noise_mm"]
    assert f"{told['left_mm']:.3g} mm are left (rms error in space)" in report.sentence


def test_repeats_far_beyond_the_instrument_are_said_to_move() -> None:
    rows: Observations = campaign(katana(), [], poses=45, seed=2)
    for stated, warned in ((2e-5, False), (4e-6, True)):
        report = find_gap(katana(), replace(rows, sigma=np.full((len(rows), 3), stated)), QUICK)
        said = {w["code"]: w for w in report.warnings}
        assert ("noise_beyond_instrument" in said) == warned
    assert said["noise_beyond_instrument"]["ratio"] == pytest.approx(5.0, rel=0.25)
    assert "moves between visits" in said["noise_beyond_instrument"]["message"]
    assert "noise_beyond_instrument" in {
        w["code"] for w in find_gap(katana(), rows, replace(QUICK, noise_mm=4e-3)).warnings
    }
