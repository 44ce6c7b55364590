"""Priors of a type, robot by robot left out: ``python -m benchmarks.fleet --types 4 --robots 12`` prints one page.

The arms are drawn in plain numpy (``tests/core/identify/fleet/simulated.py``), which shares no code with what is judged. Each
robot of a type is identified from a few poses without and with the prior of the others, and judged at poses never used.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import CoreError
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.fleet_prior import FleetVersion
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.plan.d_optimal import d_optimal_poses
from tests.core.identify.fleet.simulated import Arm, Type, document, poses

Floats = NDArray[np.float64]
NOISE_MM, FITTED, UNSEEN = 0.05, 60, 300
PLANNED = (7, 8, 9, 10, 11, 12, 13, 14)
COUNTS = (7, 8, 9, 10, 11, 12, 13, 14, 16, 20, 30)
TARGET_MM = 0.2
FEW = (12, 14, 20)
ODD = (
    ("10 spreads off in all parameters", 10.0),
    ("3 spreads off in all parameters", 3.0),
    ("one zero 10 spreads off", 0.0),
)
WORSE = 1.05


@dataclass(frozen=True)
class Judged:
    """A robot identified from ``count`` poses: rms error (mm) at unseen ones without and with its type, NaN where refused."""

    count: int
    without: float
    with_type: float


def versions_of(arms: Sequence[Arm], rng: np.random.Generator) -> list[FleetVersion]:
    """A version of each arm from many poses."""
    robot, out = robot_from_document(document()), []
    for k, arm in enumerate(arms):
        found = identify(robot, arm.measured(poses(FITTED, rng), rng, NOISE_MM * 1e-3))
        out.append(FleetVersion.from_calibration(f"r{k}", f"v{k}", found.calibration, found.predictive.to_document()))
    return out


def judged(
    arm: Arm, others: Sequence[FleetVersion], count: int, rng: np.random.Generator, planned: bool = False
) -> Judged:
    """Identify an arm from so many poses, random or ``planned`` ones, without and with its type."""
    q, unseen = poses(count, rng), poses(UNSEEN, rng)
    truth, robot = arm.points(unseen), robot_from_document(document())
    rows, errors = arm.measured(q, rng, NOISE_MM * 1e-3), []
    for options in (IdentifyOptions(), IdentifyOptions(prior="fleet")):
        if planned:
            fleet = None if options.prior is None else others
            q = d_optimal_poses(Calibration.nominal(robot), count, seed=int(rng.integers(2**31)), fleet=fleet).q
            rows = arm.measured(q, rng, NOISE_MM * 1e-3)
        try:
            found = identify(robot, rows, options=options, fleet=others).calibration
        except CoreError:
            errors.append(np.nan)
            continue
        away = found.predict(Observations(unseen)).position - truth
        errors.append(1e3 * float(np.sqrt(np.mean(np.sum(away**2, axis=1)))))
    return Judged(count, *errors)


def left_one_out(
    robots: int, rng: np.random.Generator, counts: Sequence[int] = COUNTS, planned: bool = False
) -> Iterator[Judged]:
    """Every robot of a type, from a few poses and the versions of the others."""
    kind = Type.drawn(rng)
    arms = [kind.arm(rng) for _ in range(robots)]
    versions = versions_of(arms, rng)
    for k, arm in enumerate(arms):
        others = [*versions[:k], *versions[k + 1 :]]
        yield from (judged(arm, others, count, rng, planned) for count in counts)


def odd_ones(robots: int, shift: float, rng: np.random.Generator, counts: Sequence[int]) -> Iterator[Judged]:
    """Arms that are not as their type: by a ``shift`` in spreads of everything, or of one zero where it is 0."""
    kind = Type.drawn(rng)
    versions = versions_of([kind.arm(rng) for _ in range(robots)], rng)
    for _ in range(robots):
        arm = kind.arm(rng, shift)
        if shift == 0.0:
            arm.errors[int(rng.integers(1, 5)), 0] += 10.0 * kind.angle * rng.choice([-1.0, 1.0])
        yield from (judged(arm, versions, count, rng) for count in counts)


def worse_than_without(found: Sequence[Judged]) -> Floats:
    """How many times the error without its type an arm has with it, where it can be identified without."""
    return np.array([one.with_type / one.without for one in found if np.isfinite(one.without)])


def told(found: Sequence[Judged]) -> str:
    """The errors with the type over those without: of single arms, and of all together."""
    ratios = worse_than_without(found)
    both = [one for one in found if np.isfinite(one.without)]
    pooled = [float(np.sqrt(np.mean([getattr(one, name) ** 2 for one in both]))) for name in ("with_type", "without")]
    over = 100.0 * float(np.mean(ratios > WORSE))
    return (
        f"{len(ratios)} fits: all together {pooled[0] / pooled[1]:.3f}, median {np.median(ratios):.3f}, largest "
        f"{ratios.max():.3f}, over {WORSE} in {over:.1f} %"
    )


def show(which: str, found: Sequence[Judged]) -> None:
    """Print a table of errors by the number of poses."""
    print(
        f"{which} poses, median mm without / with, within 0.2 mm without / with (target: 0.2 mm with at most 10 poses)"
    )
    for count in dict.fromkeys(one.count for one in found):
        mine = [one for one in found if one.count == count]
        errors = [np.nan_to_num([getattr(one, name) for one in mine], nan=np.inf) for name in ("without", "with_type")]
        medians = [float(np.median(e)) for e in errors]
        shares = [100.0 * float(np.mean(e <= TARGET_MM)) for e in errors]
        print(
            f"{count:5d}   {medians[0]:9.3f} / {medians[1]:5.3f}         {shares[0]:9.0f} % / {shares[1]:3.0f} %",
            flush=True,
        )


def main() -> None:
    """Print the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--types", type=int, default=4)
    parser.add_argument("--robots", type=int, default=12)
    given = parser.parse_args()
    rng = np.random.default_rng(30)
    found = [one for _ in range(given.types) for one in left_one_out(given.robots, rng)]
    print(
        f"{given.types} types of {given.robots} robots, each left out; spread 0.3 mm and 0.03 deg, {NOISE_MM} mm noise"
    )
    show("random", found)
    show("planned", [one for _ in range(given.types) for one in left_one_out(given.robots, rng, PLANNED, planned=True)])
    print(f"error with the type over without (target for odd arms: at most {WORSE})")
    print(f"{'of the type':36} {told(found)}")
    for name, shift in ODD:
        odd = [one for _ in range(given.types) for one in odd_ones(given.robots, shift, rng, FEW)]
        print(f"{name:36} {told(odd)}")


if __name__ == "__main__":
    main()
