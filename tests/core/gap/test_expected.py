"""How long a search would take: the pieces are made and timed, and more rows or names take longer."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from kilter_core.gap import GapOptions, check, find_gap
from kilter_core.gap.check import Probe, check_gap, run_and_time
from kilter_core.gap.evidence import stability
from tests.core.gap.simulated import campaign, katana

QUICK = GapOptions(bootstraps=299, effects=("backlash", "eccentricity", "axial_compliance"))
HIDDEN = [("backlash", (1,), (6e-4,)), ("eccentricity", (2,), (6e-4, 4e-4))]
PIECES = (1.0, 0.1, 0.02, 0.015, 0.01, 0.3, 0.2)
ONE = Probe(*PIECES, names=2, numbers=1000.0, settled=True)


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes one second at every look: every piece of work takes one."""
    monkeypatch.setattr(check, "clock", itertools.count(0.0).__next__)


@pytest.mark.usefixtures("ticking")
def test_every_piece_is_timed_once_and_what_the_selection_names_is_counted() -> None:
    assert run_and_time(lambda: "made") == ("made", 1.0)
    hidden, clean = (campaign(katana(), what, poses=60, seed=5) for what in (HIDDEN, []))
    named, nothing = (check_gap(katana(), rows, QUICK).seconds for rows in (hidden, clean))
    seconds = [Probe(*(1.0,) * 7, names, 135.0, True).search(1.0) for names in (0, 2)]
    assert [nothing, named] == pytest.approx(seconds)


def test_more_rows_more_names_and_slower_pieces_take_longer() -> None:
    least = ONE.search(1.0)
    assert least < ONE.search(2.0) < 2.0 * least  # what is selected from does not grow with the rows
    assert replace(ONE, names=0).search(1.0) < least < replace(ONE, names=5).search(1.0)
    slower = Probe(*(3.0 * v for v in PIECES), names=2, numbers=1000.0, settled=True)
    assert slower.search(1.0) == pytest.approx(3.0 * least)


def test_no_verdict_waits_for_resamples_where_something_is_left() -> None:
    """Forty decide where names may rise; else a few are drawn, and the halves of the campaign are asked."""
    settled, left = ONE.search(1.0), replace(ONE, settled=False).search(1.0)
    assert settled - left == pytest.approx(35 * ONE.again - ONE.halves)


def test_a_search_draws_as_many_resamples_as_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where poses held out may confirm what repeats bear out, and where some are lacking for both."""
    drawn: list[int] = []
    plain = stability._make_resampler

    def counted(search, rng):
        draw = plain(search, rng)
        drawn.append(0)

        def one():
            drawn[-1] += 1
            return draw()

        return one

    monkeypatch.setattr(stability, "_make_resampler", counted)
    probes: list[Probe] = []
    probe = check.probe
    monkeypatch.setattr(check, "probe", lambda *given: probes.append(probe(*given)) or probes[-1])
    for poses in (80, 40):
        rows = campaign(katana(), HIDDEN, poses=poses, seed=5)
        check_gap(katana(), rows, QUICK)
        find_gap(katana(), rows, replace(QUICK, permutations=1, next_poses=0))
    assert [p.settled for p in probes] == [True, False]
    assert drawn == [check.DECIDING, stability.FEW]
