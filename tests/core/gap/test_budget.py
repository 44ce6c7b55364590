"""A search with a budget ends with the best it has, says what was left out, and claims no more than it tried."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from kilter_core.errors import OptionError
from kilter_core.gap import GapOptions, GapReport, find_gap, options
from kilter_core.gap.effect_search import AGAIN
from kilter_core.gap.search.events import WRONG
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import unheard
from tests.core.gap.simulated import campaign, katana

QUICK = GapOptions(
    resamples=40, permutations=5, bootstraps=499, next_poses=3, effects=("backlash", "eccentricity", "axial_compliance")
)
HIDDEN = [("backlash", (1,), (6e-4,)), ("eccentricity", (2,), (6e-4, 4e-4))]


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes one second at every look: what is cut short does not depend on the machine."""
    monkeypatch.setattr(options, "clock", itertools.count(0.0).__next__)


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
    named = searched(60.0)  # time for both names, none for the resamples and shuffles behind them
    assert {j.evidence.candidate.id for j in named.effects} == {"backlash", "eccentricity"}
    assert "resamples of poses" in left_out(named)
    assert {j.verdict for j in named.effects} == {"provisional"}
    assert {(j.gates["inclusion"], j.gates["negative_control"]) for j in named.effects} == {(None, None)}  # not failed
    assert "not every test was made" in named.sentence
    remedies = {one for row in named.to_document()["effects"] for one in row["to_confirm"]}
    assert "Not tested in the time: inclusion, negative_control. Search again with a larger budget_s." in remedies
    assert named.calibration.values.shape == whole.calibration.values.shape
    (said,) = [w["message"] for w in named.warnings if w["code"] == "budget_spent"]
    assert "resamples of poses" in said
    assert "budget_s" in said


def test_a_budget_that_is_not_reached_changes_nothing() -> None:
    assert searched(None).to_document() == searched(3600.0).to_document()


def spoilt() -> Observations:
    """A campaign in which every seventh reading is 0.5 mm off."""
    rows = campaign(katana(), poses=100, revisits=0, seed=5)
    assert rows.position is not None
    position = rows.position.copy()
    position[::7, 0] += 5e-4
    return replace(rows, position=position)


@pytest.mark.usefixtures("ticking")
def test_the_search_for_wrong_readings_ends_in_time() -> None:
    short, long = options.Budget(12.0), options.Budget(1e6)  # at a second for each look, three fits of the descent
    cut, whole = (prepare_data(Calibration.nominal(katana()), spoilt(), QUICK, unheard, b) for b in (short, long))
    assert cut.problem.settings.used.all()
    assert short.left_out == [WRONG]
    assert whole.problem.settings.used.sum() < len(whole.problem.settings.used)
    assert not long.left_out


@pytest.mark.usefixtures("ticking")
def test_noise_and_wrong_readings_are_judged_again_only_in_time() -> None:
    """A hunt for nothing that is there: the wrong readings of the first fit stay aside, no later look is begun."""
    cut = find_gap(katana(), spoilt(), replace(QUICK, budget_s=1.0))
    assert WRONG in left_out(cut)
    assert AGAIN in left_out(cut)
    assert not cut.set_aside
    assert find_gap(katana(), spoilt(), replace(QUICK, budget_s=1e6)).set_aside


@pytest.mark.parametrize("wrong", [0.0, -1.0, "ten", True])
def test_what_is_no_budget_is_refused(wrong: object) -> None:
    with pytest.raises(OptionError, match="budget_s"):
        GapOptions(budget_s=wrong)  # type: ignore[arg-type]
