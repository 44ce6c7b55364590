"""A search with a budget ends with the best it has, says what was left out, and claims no more than it tried."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from kilter_core.errors import OptionError
from kilter_core.gap import GapOptions, GapReport, budget, find_gap
from tests.core.gap.simulated import campaign, katana

QUICK = GapOptions(
    resamples=40, permutations=5, bootstraps=499, next_poses=3, effects=("backlash", "eccentricity", "axial_compliance")
)
HIDDEN = [("backlash", (1,), (6e-4,)), ("eccentricity", (2,), (6e-4, 4e-4))]


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes one second at every look: what is cut short does not depend on the machine."""

    def seconds() -> Iterator[float]:
        now = 0.0
        while True:
            yield now
            now += 1.0

    monkeypatch.setattr(budget, "clock", seconds().__next__)


def searched(seconds: float | None) -> GapReport:
    return find_gap(katana(), campaign(katana(), HIDDEN, poses=80, seed=5), replace(QUICK, budget_s=seconds))


def left_out(report: GapReport) -> list[str]:
    return [what for w in report.warnings if w["code"] == "budget_spent" for what in w["left_out"]]


@pytest.mark.usefixtures("ticking")
def test_what_there_is_no_time_for_is_left_out_and_said() -> None:
    whole = searched(1e6)
    assert {j.evidence.candidate.id for j in whole.effects} == {"backlash", "eccentricity"}
    assert whole.effects[0].verdict != "provisional"
    assert not left_out(whole)
    one = searched(1.0)
    assert "effects beyond those named" in left_out(one)
    assert len(one.effects) < 2
    assert one.verdict != "closed"
    named = searched(30.0)  # time for both names, none for the resamples and shuffles behind them
    assert {j.evidence.candidate.id for j in named.effects} == {"backlash", "eccentricity"}
    assert "resamples of poses" in left_out(named)
    assert {j.verdict for j in named.effects} == {"provisional"}
    assert named.calibration.values.shape == whole.calibration.values.shape
    (said,) = [w["message"] for w in named.warnings if w["code"] == "budget_spent"]
    assert "resamples of poses" in said
    assert "budget_s" in said


def test_a_budget_that_is_not_reached_changes_nothing() -> None:
    assert searched(None).to_document() == searched(3600.0).to_document()


@pytest.mark.parametrize("wrong", [0.0, -1.0, "ten", True])
def test_what_is_no_budget_is_refused(wrong: object) -> None:
    with pytest.raises(OptionError, match="budget_s"):
        GapOptions(budget_s=wrong)  # type: ignore[arg-type]
