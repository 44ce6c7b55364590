"""Setpoints of a plan and the commands to a robot that lost some: smooth, whatever is lost."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from kilter_client.bridges.fci import CYCLE_S, Rejoined
from kilter_client.bridges.plan import EASE_S, Setpoints, Table


def swing(t_s: float) -> tuple[float, ...]:
    return (math.sin(2.0 * t_s), 0.3 * math.cos(3.0 * t_s))


@pytest.mark.parametrize("lost", [1, 5, 19])
def test_commands_go_on_without_a_jump_in_speed_where_cycles_were_lost(lost: int) -> None:
    """The robot extrapolates with the acceleration it saw last; the limits are those of the interface."""
    rejoined = Rejoined()
    seen: list[np.ndarray] = []
    cycle = 0
    while cycle < 1000:
        missing = lost if cycle in (400, 450) else 0
        state = None
        for _ in range(missing):
            speed = (seen[-1] - seen[-2]) / CYCLE_S if state is None else state.dq_d
            curve = (seen[-1] - 2 * seen[-2] + seen[-3]) / CYCLE_S**2 if state is None else state.ddq_d
            speed = speed + CYCLE_S * curve
            state = SimpleNamespace(q_d=seen[-1] + CYCLE_S * speed, dq_d=speed, ddq_d=curve)
            seen.append(state.q_d)
        cycle += missing + 1
        seen.append(np.array(rejoined.command(swing(cycle * CYCLE_S), missing + 1, state)))
    commands = np.array(seen)
    assert np.abs(np.diff(commands, 2, axis=0)).max() / CYCLE_S**2 < 7.0  # rad/s2, of 10
    assert np.abs(np.diff(commands, 3, axis=0)).max() / CYCLE_S**3 < 1000.0  # rad/s3, of 5000
    assert commands[-1] == pytest.approx(swing(cycle * CYCLE_S), abs=1e-12)
    assert commands[300] == pytest.approx(swing(301 * CYCLE_S), abs=1e-12)


def test_a_plan_that_begins_beside_the_arm_is_eased_into() -> None:
    rows = [swing(t) for t in np.arange(0.0, 2.0, CYCLE_S)]
    setpoints = Setpoints(Table([CYCLE_S * k for k in range(len(rows))], rows), math.radians(200.0), CYCLE_S)
    setpoints.begin([0.01, 0.29])
    found = np.array([(0.01, 0.29), *(setpoints.step(1) for _ in range(2100))])
    assert np.abs(np.diff(found[1:1900], 2, axis=0)).max() / CYCLE_S**2 < 7.0
    assert np.allclose(found[1], (0.01, 0.29), atol=1e-12)
    assert np.allclose(found[round(EASE_S / CYCLE_S) + 5], rows[round(EASE_S / CYCLE_S) + 4], atol=1e-9)
    assert setpoints.ended
    assert not setpoints.counts


def test_time_that_was_lost_has_passed_for_the_plan_too() -> None:
    rows = [(0.001 * k,) for k in range(200)]
    setpoints = Setpoints(Table([CYCLE_S * k for k in range(len(rows))], rows), math.radians(200.0), CYCLE_S)
    setpoints.begin(rows[0])
    found = [setpoints.step(cycles) for cycles in (1, 1, 1, 5, 1)]
    assert np.allclose(found, [rows[k] for k in (0, 1, 2, 7, 8)], atol=1e-12)


def test_a_plan_whose_time_passes_more_and_more_slowly_comes_to_rest() -> None:
    rows = [swing(t) for t in np.arange(0.0, 3.0, CYCLE_S)]
    setpoints = Setpoints(Table([CYCLE_S * k for k in range(len(rows))], rows), math.radians(200.0), CYCLE_S)
    setpoints.begin(rows[0])
    found = [setpoints.step(1) for _ in range(1000)]
    found += [setpoints.step(1, max(0.0, 1.0 - CYCLE_S * k)) for k in range(1300)]
    curves = np.abs(np.diff(np.array(found), 2, axis=0)).max(axis=1) / CYCLE_S**2
    assert curves[500:].max() < 10.0
    assert np.ptp(np.array(found[-200:]), axis=0).max() == 0.0
    assert not setpoints.ended
