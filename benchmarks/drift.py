"""Checks of simulated arms, day after day: ``python -m benchmarks.drift --robots 1000 --days 250`` prints one page.

The arms, their changes and their campaigns are drawn in plain numpy (``tests/core/watch/drifting.py``), which shares no code
with what is judged; the charts are those that the service shows.
"""

from __future__ import annotations

import argparse
import math
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.model.region import Region
from kilter_core.watch import Check, check, check_poses
from kilter_service.contract.today import ControlChart
from kilter_service.versions.drift import wire
from kilter_service.versions.drift.wire import StoredCheck, control_charts
from tests.blind.bounds import clopper_pearson
from tests.core.watch.drifting import DriftingArm, some_arm, some_poses

Floats = NDArray[np.float64]
NOISE, FITTED, POSES = 5e-5, 80, 6
STEP = math.radians(0.03)
WARM_UP = 20  # days before something happens
MONTH = 30.0
GROWTH, ZEROS = 12e-6, 5e-6  # 1/K and rad/K of an arm that is warmer
SIZES = {
    **{f"zero_{k}": 2e-3 for k in range(1, 7)}, "sag_2": 3e-5, "sag_3": 8e-5, "base": 1e-3, "tool": 1e-3, "scale": 5e-4,
}  # fmt: skip
WIDER = {"zero_1": {"base"}, "zero_6": {"tool"}}  # of which a special case looks the same
FITTED_C = (22.0, 24.0)
TARGETS = {
    "false alarms, single checks": "<= 0.1 %",
    "false alarms, sums (days on which one begins)": "<= 0.1 %",
    "false alarms, warm and cold, single checks": "<= 0.1 %",
    "false alarms, warm and cold, sums": "<= 0.1 %",
    **{f"0.03 deg of joint {k} within 3 checks": ">= 95 %" for k in range(1, 7)},
    "cause or class right": ">= 97 %",
    "a wrong single cause": "0 %",
    "0.1 mm a month before 0.2 mm": "all",
}


@dataclass(frozen=True)
class Watched:
    """An arm, the version that was fitted to it, and the poses of its checks."""

    arm: DriftingArm
    calibration: Calibration
    known: Predictive
    q: Floats
    rng: np.random.Generator

    @staticmethod
    def of(seed: int) -> Watched:
        """Draw an arm, fit it, and plan its checks."""
        rng = np.random.default_rng([30, seed])
        arm = some_arm(rng)
        options = IdentifyOptions(effects=({"id": "axial_compliance", "joints": [2, 3]},), masses="as_stated")
        rows = arm.measured(some_poses(FITTED, rng), rng, NOISE)
        found = identify(robot_from_document(arm.document()), rows, options=options)
        assert found.predictive is not None
        region = Region.from_calibration(found.calibration)
        plan = check_poses(found.calibration, found.predictive, POSES, region, seed=seed)
        return Watched(arm, found.calibration, found.predictive, plan.q, rng)

    def check(self, arm: DriftingArm, temperature_c: float | None = None) -> Check:
        """Measure an arm and check it."""
        rows = arm.measured(self.q, self.rng, NOISE)
        if temperature_c is None:
            return check(self.calibration, rows, self.known)
        rows = replace(rows, temperature_c=np.full(len(rows), temperature_c))
        return check(self.calibration, rows, self.known, fitted_c=FITTED_C)


def stored(day: int, found: Check, temperature_c: float | None = None) -> StoredCheck:
    """A check as the service keeps it."""
    at = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=day)
    looked = [wire.cause_document(one) for one in found.judged]
    result = {"verdict": found.verdict, "looked_at": looked, "temperature_c": temperature_c}
    return StoredCheck(f"job_{day}", f"cmp_{day}", at, result)


def beyond(charts: Sequence[ControlChart], days: int) -> list[bool]:
    """On which days some sum is beyond its limit."""
    return [any(max(one.up[day] or 0.0, one.down[day] or 0.0) > one.limit for one in charts) for day in range(days)]


def quiet(one: Watched, days: int) -> Iterator[tuple[str, bool]]:
    """An arm that does not move."""
    made = [one.check(one.arm) for _ in range(days)]
    yield from (("false alarms, single checks", found.verdict != "ok") for found in made)
    over = beyond(control_charts([stored(day, found) for day, found in enumerate(made)]), days)
    yield from (
        ("false alarms, sums (days on which one begins)", now and not was)
        for was, now in zip([False, *over], over, strict=False)
    )


def seasons(one: Watched, days: int) -> Iterator[tuple[str, bool]]:
    """An arm in a hall without heating, whose temperature is measured."""
    made = []
    for day in range(days):
        warm = float(6.0 * np.sin(2.0 * np.pi * day / 250.0) + one.rng.normal(0.0, 1.5))
        grown = 1.0 + GROWTH * warm
        arm = replace(
            one.arm, rows=one.arm.rows * np.array([grown, grown, 1.0]), zeros=one.arm.zeros + ZEROS * warm * _signs(one)
        )
        made.append((one.check(arm, 23.0 + warm), 23.0 + warm))
    yield from (("false alarms, warm and cold, single checks", found.verdict != "ok") for found, _ in made)
    over = beyond(control_charts([stored(day, *found) for day, found in enumerate(made)]), days)
    yield from (
        ("false alarms, warm and cold, sums", now and not was) for was, now in zip([False, *over], over, strict=False)
    )


def _signs(one: Watched) -> Floats:
    return np.sign(one.arm.zeros)


def steps(one: Watched, days: int) -> Iterator[tuple[str, bool]]:
    """A step of each zero after some weeks: by a single check or by the sums."""
    before = [stored(day, one.check(one.arm)) for day in range(WARM_UP)]
    for joint in range(1, 7):
        moved = one.arm.after(f"zero_{joint}", STEP)
        after = [stored(WARM_UP + day, one.check(moved)) for day in range(3)]
        over = beyond(control_charts([*before, *after]), WARM_UP + 3)[WARM_UP:]
        seen = any(made.result["verdict"] != "ok" for made in after) or any(over)
        yield f"0.03 deg of joint {joint} within 3 checks", seen


def causes(one: Watched, days: int) -> Iterator[tuple[str, bool]]:
    """Each cause, by a size between one that is just seen and a large one."""
    for name, size in SIZES.items():
        found = one.check(one.arm.after(name, size * float(one.rng.uniform(0.3, 1.5))))
        if found.verdict == "ok":
            continue
        named = {judged.cause.name for judged in found.causes}
        yield "cause or class right", name in named
        yield "a wrong single cause", found.verdict == "moved" and not named & {name, *WIDER.get(name, ())}


def ramp(one: Watched, days: int) -> Iterator[tuple[str, bool]]:
    """A zero that creeps until the tool is 0.2 mm off, 0.1 mm a month."""
    joint = int(one.rng.integers(2, 4))
    tool = one.arm.point(one.q)
    moved = one.arm.after(f"zero_{joint}", 1e-6).point(one.q)
    a_day = 1e-4 / MONTH / (float(np.linalg.norm(moved - tool, axis=1).max()) / 1e-6)
    made = [stored(day, one.check(one.arm)) for day in range(WARM_UP)]
    made += [stored(WARM_UP + day, one.check(one.arm.after(f"zero_{joint}", a_day * day))) for day in range(60)]
    over = beyond(control_charts(made), len(made))
    yield (
        "0.1 mm a month before 0.2 mm",
        any(over[WARM_UP:]) or any(one.result["verdict"] != "ok" for one in made[WARM_UP:]),
    )


STORIES: tuple[Callable[[Watched, int], Iterator[tuple[str, bool]]], ...] = (quiet, seasons, steps, causes, ramp)


def of_robot(seed: int, days: int) -> Counter[tuple[str, bool]]:
    """All that happens to a robot: how often each figure was so, and not so."""
    one = Watched.of(seed)
    return Counter(told for story in STORIES for told in story(one, days))


def measured(robots: int, days: int, processes: int = 1, first: int = 0) -> Counter[tuple[str, bool]]:
    """The figures of many robots, the first of which has that seed."""
    total: Counter[tuple[str, bool]] = Counter()
    seeds = range(first, first + robots)
    if processes == 1:
        for seed in seeds:
            total += of_robot(seed, days)
        return total
    with ProcessPoolExecutor(processes) as pool:
        for one in pool.map(partial(of_robot, days=days), seeds):
            total += one
    return total


def page(found: Counter[tuple[str, bool]]) -> Iterator[str]:
    """The figures with their 95 % bounds by Clopper and Pearson, and their targets."""
    for name, target in TARGETS.items():
        hits, count = found[name, True], found[name, True] + found[name, False]
        low, high = (100.0 * bound for bound in clopper_pearson(hits, max(count, 1)))
        share = f"{100.0 * hits / max(count, 1):8.3f} % ({low:.3f} to {high:.3f})"
        yield f"{name:48}{hits:8d} of {count:8d}  {share:30}   target {target}"


def main() -> None:
    """Print the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--days", type=int, default=50)
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--first", type=int, default=0, help="seed of the first robot: others give fresh ones")
    given = parser.parse_args()
    found = measured(given.robots, given.days, given.processes, given.first)
    print(
        f"{given.robots} robots, {given.days} days; {POSES} planned poses, {NOISE * 1e3:g} mm, fits of {FITTED} poses"
    )
    print("\n".join(page(found)))


if __name__ == "__main__":
    main()
