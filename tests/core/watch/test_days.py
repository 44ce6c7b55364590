"""A few of the arms of `tools.lab drift`: nothing but what has changed alarms, and what has changed is seen and named."""

from __future__ import annotations

from benchmarks.drift import TARGETS, measured


def test_arms_are_watched_day_after_day() -> None:
    found = measured(robots=3, days=12)
    assert {name for name, _ in found} == set(TARGETS)
    for name in TARGETS:
        if name.startswith("false alarms"):
            assert found[name, True] <= 1, name
            assert found[name, False] >= 35, name
    for joint in (1, 2, 3, 4):  # beyond these the lever of the reflector decides
        assert found[f"0.03 deg of joint {joint} within 3 checks", False] == 0, joint
    right, wrong = (found["cause or class right", told] for told in (True, False))
    assert right >= 30
    assert wrong <= 1
    assert found["a wrong single cause", True] == 0
    assert found["0.1 mm a month before 0.2 mm", True] == 3
