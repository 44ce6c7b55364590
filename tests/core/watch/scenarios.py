"""Thirty days of checks under twenty conditions, stated and not: false alarms, and causes that are named wrongly.

``python -m tests.core.watch.scenarios`` is ``python -m tools.lab check-days``. Each arm is checked once a day by six poses;
half of the arms then change on day 16. How well the set-up repeats is learned from the checks before, as the service does.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.watch import Check, Conditions, check, learned_setup
from tests.blind.bounds import clopper_pearson
from tests.core.watch.drifting import set_up_again, some_arm, some_poses, warmed

NOISE = 2e-5
KNOWN = Predictive((), np.zeros((0, 0)), 0.0, NOISE)
DAYS, CHANGED, POSES = 30, 15, 6
FITTED_C = 21.0
CHANGES = {
    "zero_2": 9e-4,
    "zero_3": 9e-4,
    "zero_4": 1.2e-3,
    "zero_5": 1.2e-3,
    "base": 6e-4,
    "tool": 6e-4,
    "scale": 6e-4,
}


@dataclass(frozen=True)
class Scenario:
    """What differs from day to day: kelvin, set-up (m), times the noise, shots of a pose; whether that is ``stated``."""

    name: str
    stated: bool
    kelvin: float = 0.0
    setup: float = 0.0
    noise: float = 1.0
    shots: int = 1


SCENARIOS = (
    Scenario("nothing", True),
    Scenario("nothing, three shots", True, shots=3),
    Scenario("2 K", True, kelvin=2.0),
    Scenario("5 K", True, kelvin=5.0),
    Scenario("5 K, three shots", True, kelvin=5.0, shots=3),
    Scenario("nothing", False),
    Scenario("2 K", False, kelvin=2.0),
    Scenario("5 K", False, kelvin=5.0),
    Scenario("5 K, three shots", False, kelvin=5.0, shots=3),
    Scenario("set-up 10 um", False, setup=1e-5),
    Scenario("set-up 20 um", False, setup=2e-5),
    Scenario("set-up 50 um", False, setup=5e-5),
    Scenario("set-up 100 um", False, setup=1e-4),
    Scenario("noise 1.5", False, noise=1.5),
    Scenario("noise 2.2", False, noise=2.2),
    Scenario("noise 2.2, three shots", False, noise=2.2, shots=3),
    Scenario("3 K, set-up 20 um", False, kelvin=3.0, setup=2e-5),
    Scenario("3 K, noise 1.5", False, kelvin=3.0, noise=1.5),
    Scenario("set-up 20 um, noise 1.5", False, setup=2e-5, noise=1.5),
    Scenario("5 K, set-up 50 um, noise 2", False, kelvin=5.0, setup=5e-5, noise=2.0),
)


@dataclass(frozen=True)
class Day:
    """One check: what had changed by then, ``""`` for nothing, and what was found."""

    change: str
    found: Check

    @property
    def alarmed(self) -> bool:
        """Whether the arm was said to have moved."""
        return self.found.verdict != "ok"

    @property
    def wrong(self) -> bool:
        """Whether one cause was named, and it is not the one."""
        return self.found.verdict == "moved" and self.change not in [one.cause.name for one in self.found.causes]


def days(scenario: Scenario, change: str, seed: int) -> Iterator[Day]:
    """The checks of one arm, which changes half-way where a change is given."""
    rng = np.random.default_rng(seed)
    arm = replace(some_arm(rng), zeros=np.zeros(6), compliance=np.zeros(6))
    calibration = Calibration.nominal(robot_from_document(arm.document()))
    poses = np.repeat(some_poses(POSES, rng), scenario.shots, axis=0)
    shifts: list[tuple[np.ndarray, np.ndarray]] = []  # type: ignore[type-arg]
    for day in range(DAYS):
        now = change if day >= CHANGED else ""
        today = arm.after(now, CHANGES[now]) if now else arm
        kelvin = float(rng.uniform(-scenario.kelvin, scenario.kelvin))
        rows = set_up_again(warmed(today, kelvin, rng), scenario.setup, rng).measured(
            poses, rng, scenario.noise * NOISE
        )
        seen = [s for s in shifts if np.isfinite(s[1]).all()]
        setup = learned_setup(*(np.array([s[k] for s in seen]).reshape(-1, 3) for k in (0, 1)))
        conditions, fitted = Conditions(5.0, setup, False), None
        if scenario.stated:
            conditions, fitted = Conditions(), (FITTED_C, FITTED_C)
            rows = replace(rows, temperature_c=np.full(len(rows.q), FITTED_C + kelvin))
        found = check(calibration, rows, KNOWN, conditions=conditions, fitted_c=fitted)
        base = next((one for one in found.judged if one.cause.name == "base"), None)
        if base is not None and found.verdict == "ok":
            shifts.append((base.summed[:3], base.summed_sigma[:3]))
        yield Day(now, found)


def main() -> None:
    """Print a line for each scenario, then the rates under stated and unstated conditions."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument("--arms", type=int, default=14, help="of each scenario, half of which change")
    asked.add_argument("--seed", type=int, default=20261130)
    given = asked.parse_args()
    print(f"{'conditions':34} {'quiet':>6} {'alarms':>6} {'changed':>8} {'seen':>5} {'named':>6} {'wrong single':>13}")
    total = {stated: np.zeros(3, dtype=np.int64) for stated in (True, False)}
    for place, scenario in enumerate(SCENARIOS):
        all_days = []
        for arm in range(given.arms):
            change = list(CHANGES)[arm // 2 % len(CHANGES)] if arm % 2 else ""
            all_days += list(days(scenario, change, given.seed + 1000 * place + arm))
        quiet = [one for one in all_days if not one.change]
        moved = [one for one in all_days if one.change]
        alarms, wrong = sum(one.alarmed for one in quiet), sum(one.wrong for one in all_days)
        named = sum(one.found.verdict == "moved" and not one.wrong for one in moved)
        total[scenario.stated] += (len(quiet), alarms, wrong)
        name = f"{scenario.name}{'' if scenario.stated else ', unstated'}"
        seen = sum(one.alarmed for one in moved)
        print(f"{name:34} {len(quiet):6} {alarms:6} {len(moved):8} {seen:5} {named:6} {wrong:13}", flush=True)
    for stated, (count, alarms, wrong) in total.items():
        low, high = clopper_pearson(int(alarms), int(count))
        words = "stated" if stated else "unstated"
        print(f"{words}: {alarms} of {count} false alarms ({low:.2%} to {high:.2%}), {wrong} wrong single causes")


if __name__ == "__main__":
    main()
