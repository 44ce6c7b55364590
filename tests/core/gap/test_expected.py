"""How long a search would take: the pieces are made and timed, and more rows or names take longer."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from kilter_core.gap import GapOptions, expected
from kilter_core.gap.check import check_gap
from kilter_core.gap.expected import Probe, timed
from tests.core.gap.simulated import campaign, katana

QUICK = GapOptions(bootstraps=299, effects=("backlash", "eccentricity", "axial_compliance"))
HIDDEN = [("backlash", (1,), (6e-4,)), ("eccentricity", (2,), (6e-4, 4e-4))]
ONE = Probe(begun=1.0, null=0.1, selected=0.02, again=0.01, fit=0.3, looked=0.2, names=2, numbers=1000.0)


@pytest.fixture
def ticking(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes one second at every look: every piece of work takes one."""
    monkeypatch.setattr(expected, "clock", itertools.count(0.0).__next__)


@pytest.mark.usefixtures("ticking")
def test_every_piece_is_timed_once_and_what_the_selection_names_is_counted() -> None:
    assert timed(lambda: "made") == ("made", 1.0)
    hidden, clean = (campaign(katana(), what, poses=60, seed=5) for what in (HIDDEN, []))
    named, nothing = (check_gap(katana(), rows, QUICK).seconds for rows in (hidden, clean))
    seconds = [Probe(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, names, 135.0).search(1.0) for names in (0, 2)]
    assert [nothing, named] == pytest.approx(seconds)


def test_more_rows_more_names_and_slower_pieces_take_longer() -> None:
    least = ONE.search(1.0)
    assert least < ONE.search(2.0) < 2.0 * least  # what is selected from does not grow with the rows
    assert replace(ONE, names=0).search(1.0) < least < replace(ONE, names=5).search(1.0)
    slower = Probe(*(3.0 * v for v in (1.0, 0.1, 0.02, 0.01, 0.3, 0.2)), names=2, numbers=1000.0)
    assert slower.search(1.0) == pytest.approx(3.0 * least)
