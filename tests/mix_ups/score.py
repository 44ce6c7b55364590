"""Count mix-ups that are named or refused, and genuine campaigns that are accused: ``python -m tests.mix_ups.score``."""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from scipy.stats import beta

from kilter_core.errors import CoreError
from kilter_core.identify.plausibility.belonging import refuse_mixed_up
from kilter_core.model import Calibration
from tests.mix_ups.arms import BUILDS
from tests.mix_ups.campaigns import MIXED, POSES_MIXED, Genuine, fixed_steps, genuine, without_step

FEW = 5  # every fifth genuine campaign moves two or three joints only
LACKING = 3  # the table of every third arm lacks a step


def said(g: Genuine, rows: object = None) -> str:
    """What the rows are refused with, empty where they are taken."""
    try:
        refuse_mixed_up(Calibration.nominal(g.robot), g.rows if rows is None else rows)  # type: ignore[arg-type]
    except CoreError as error:
        return error.message
    return ""


def of_few_joints(seed: int) -> int | None:
    """How many joints move in the genuine campaign of this number; None: all."""
    return None if seed % FEW else 2 + (seed // FEW) % 2


def is_worn(seed: int) -> bool:
    """Every second pair of genuine campaigns: a zero up to 15 degrees off, compliance, tilt, loads and sessions."""
    return bool(seed // 2 % 2)


def of_number(seed: int) -> Genuine:
    """The genuine campaign of this number; the table of every third arm lacks one of its fixed steps."""
    g = genuine(seed, moving=of_few_joints(seed), worn=is_worn(seed))
    steps = len(fixed_steps(g))
    return g if seed % LACKING or not steps else without_step(g, seed // LACKING % steps)


def bounds(k: int, n: int) -> tuple[float, float]:
    """95 % bounds of Clopper and Pearson."""
    low = 0.0 if k == 0 else float(beta.ppf(0.025, k, n - k + 1))
    return low, 1.0 if k == n else float(beta.ppf(0.975, k + 1, n - k))


def main() -> None:
    """Score and print."""
    asked = argparse.ArgumentParser()
    asked.add_argument("--genuine", type=int, default=1000)
    asked.add_argument("--rounds", type=int, default=5, help="arms of each of the five builds, ten mix-ups each")
    asked.add_argument("--seed", type=int, default=0)
    given = asked.parse_args()
    accused = []
    for seed in range(given.seed, given.seed + given.genuine):
        g = of_number(seed)
        text = said(g)
        if text:
            accused.append(seed)
            print(f"accused: {seed} ({g.kind}): {text}")
    few = sum(of_few_joints(s) is not None for s in range(given.seed, given.seed + given.genuine))
    worn = sum(is_worn(s) for s in range(given.seed, given.seed + given.genuine))
    lacking = sum(s % LACKING == 0 for s in range(given.seed, given.seed + given.genuine))
    print(f"genuine campaigns accused: {len(accused)} of {given.genuine} ({few} with two or three moving joints, {worn} worn, "
          f"{lacking} with a table that lacks a step), 95 % bounds {bounds(len(accused), given.genuine)}")  # fmt: skip
    found, count = Counter[str](), 0
    for round_ in range(given.rounds):
        for build in BUILDS:
            for name, mix in (MIXED | POSES_MIXED).items():
                g = genuine(1000 * (given.seed + 1) + 7 * round_, build, see="pose" if name in POSES_MIXED else None)
                count += 1
                text = said(g, mix(g, np.random.default_rng(round_)))
                found[name] += bool(text)
                if not text:
                    print(f"missed: round {round_}, {name} ({g.kind}, {len(g.rows)} rows)")
    total = sum(found.values())
    print(f"mix-ups named or refused: {total} of {count}, 95 % bounds {bounds(total, count)}")
    for name, number in found.items():
        print(f"  {name}: {number} of {given.rounds * len(BUILDS)}")


if __name__ == "__main__":
    main()
