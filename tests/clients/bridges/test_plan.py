"""Setpoints of a plan and the commands to a robot that lost some: smooth, whatever is lost."""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from kilter_client.bridges.fci import CYCLE_S, Rejoined
from kilter_client.bridges.plan import EASE_S, Setpoints, Table


class Robot:
    """What a Franka robot does with commands: it extrapolates those it misses with constant acceleration."""

    def __init__(self, at: tuple[float, ...]) -> None:
        self.commands = [np.array(at)] * 3
        self.state = SimpleNamespace(q_d=np.array(at), dq_d=np.zeros(len(at)), ddq_d=np.zeros(len(at)))

    def miss(self) -> None:
        speed = self.state.dq_d + CYCLE_S * self.state.ddq_d
        self.take(self.state.q_d + CYCLE_S * speed)

    def take(self, command: np.ndarray) -> None:
        self.commands.append(np.array(command))
        q, before, first = (self.commands[-k] for k in (1, 2, 3))
        self.state = SimpleNamespace(q_d=q, dq_d=(q - before) / CYCLE_S, ddq_d=(q - 2.0 * before + first) / CYCLE_S**2)

    def largest(self) -> tuple[float, float]:
        """Acceleration rad/s2 and jerk rad/s3."""
        found = np.array(self.commands)
        second, third = (np.abs(np.diff(found, k, axis=0)).max() / CYCLE_S**k for k in (2, 3))
        return float(second), float(third)


def moved(cycles: int, lost: Callable[[int], int]) -> tuple[Robot, float]:
    """The robot after so many cycles, of which some are ``lost`` before each command, and how far off it came."""
    rejoined, robot = Rejoined(), Robot(swing(0.0))
    cycle, off = 0, 0.0
    while cycle < cycles:
        missing = lost(cycle)
        for _ in range(missing):
            robot.miss()
        cycle += missing + 1
        intended = swing(cycle * CYCLE_S)
        robot.take(np.array(rejoined.command(intended, missing + 1, robot.state)))
        off = max(off, float(np.abs(robot.state.q_d - intended).max()))
    return robot, off


def swing(t_s: float) -> tuple[float, ...]:
    """From rest; at most 4 rad/s2."""
    ease = min(1.0, t_s) ** 3 * (10.0 - min(1.0, t_s) * (15.0 - 6.0 * min(1.0, t_s)))
    return (0.4 * ease * math.sin(2.0 * t_s), 0.1 + 0.12 * ease * math.cos(3.0 * t_s))


@pytest.mark.parametrize("lost", [1, 5, 19])
def test_commands_go_on_smoothly_where_cycles_were_lost(lost: int) -> None:
    """The limits of the interface are 10 rad/s2 and 5000 rad/s3; without losses the command is what was intended."""
    robot, off = moved(3000, lambda cycle: lost if cycle in (1400, 1450) else 0)
    undisturbed = moved(3000, lambda _: 0)[0]
    assert robot.largest()[0] < 1.1 * undisturbed.largest()[0]
    assert robot.largest()[1] < 500.0
    assert off < 1e-4
    assert np.array_equal(robot.commands[1000], undisturbed.commands[1000])
    assert np.array_equal(robot.commands[-1], undisturbed.commands[-1])


@pytest.mark.parametrize("share", [0.02, 0.2, 0.9])
def test_the_arm_never_runs_away_however_many_cycles_are_lost(share: float) -> None:
    """In bursts of up to 18; the robot itself stops after 20."""
    rng = np.random.default_rng(2)
    robot, off = moved(40_000, lambda _: int(rng.integers(1, 19)) if rng.random() < share else 0)
    assert robot.largest()[0] < 7.0
    assert robot.largest()[1] < 1000.0
    assert off < 1e-3


@pytest.mark.parametrize("lost", [1, 10, 19])
def test_commands_of_which_each_is_followed_by_losses_stay_on_the_way(lost: int) -> None:
    robot, off = moved(20_000, lambda cycle: lost if cycle > 100 else 0)
    assert robot.largest()[0] < 7.0
    assert off < 2e-3  # 19 of 20 lost


def test_a_plan_that_begins_beside_the_arm_is_eased_into() -> None:
    rows = [swing(t) for t in np.arange(0.0, 2.0, CYCLE_S)]
    setpoints = Setpoints(Table([CYCLE_S * k for k in range(len(rows))], rows), math.radians(200.0), CYCLE_S)
    setpoints.start_from_joints([0.01, 0.29])
    found = np.array([(0.01, 0.29), *(setpoints.step(1) for _ in range(2100))])
    assert np.abs(np.diff(found[1:1900], 2, axis=0)).max() / CYCLE_S**2 < 7.0
    assert np.allclose(found[1], (0.01, 0.29), atol=1e-12)
    assert np.allclose(found[round(EASE_S / CYCLE_S) + 5], rows[round(EASE_S / CYCLE_S) + 4], atol=1e-9)
    assert setpoints.is_finished
    assert not setpoints.counts


def test_time_that_was_lost_has_passed_for_the_plan_too() -> None:
    rows = [(0.001 * k,) for k in range(200)]
    setpoints = Setpoints(Table([CYCLE_S * k for k in range(len(rows))], rows), math.radians(200.0), CYCLE_S)
    setpoints.start_from_joints(rows[0])
    found = [setpoints.step(cycles) for cycles in (1, 1, 1, 5, 1)]
    assert np.allclose(found, [rows[k] for k in (0, 1, 2, 7, 8)], atol=1e-12)


def test_a_plan_whose_time_passes_more_and_more_slowly_comes_to_rest() -> None:
    rows = [swing(t) for t in np.arange(0.0, 3.0, CYCLE_S)]
    setpoints = Setpoints(Table([CYCLE_S * k for k in range(len(rows))], rows), math.radians(200.0), CYCLE_S)
    setpoints.start_from_joints(rows[0])
    found = [setpoints.step(1) for _ in range(1000)]
    found += [setpoints.step(1, max(0.0, 1.0 - CYCLE_S * k)) for k in range(1300)]
    curves = np.abs(np.diff(np.array(found), 2, axis=0)).max(axis=1) / CYCLE_S**2
    assert curves[500:].max() < 10.0
    assert np.ptp(np.array(found[-200:]), axis=0).max() == 0.0
    assert not setpoints.is_finished
