"""A few arms of `tools.lab check-days`."""

from __future__ import annotations

import pytest

from tests.core.watch.scenarios import CHANGED, DAYS, SCENARIOS, Scenario, days


@pytest.mark.parametrize("scenario", SCENARIOS[4::5], ids=lambda one: f"{one.name}-{one.stated}")
def test_thirty_days_alarm_for_nothing_and_name_what_changed(scenario: Scenario) -> None:
    quiet, moved = list(days(scenario, "", 7)), list(days(scenario, "zero_3", 8))
    assert sum(one.alarmed for one in (*quiet, *moved[:CHANGED])) <= 1
    assert sum(one.alarmed for one in moved[CHANGED:]) >= DAYS - CHANGED - 1
    assert sum(one.wrong for one in (*quiet, *moved)) == 0
