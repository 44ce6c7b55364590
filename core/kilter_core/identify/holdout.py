"""Setting observations aside: always whole poses, so that a repeat never sits on both sides.

Of rows held by sockets, planes and bars whole placements are set aside: where a placement stands is fitted to its rows, so
rows of one placement on both sides would judge themselves.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kilter_core.errors import OptionError, TooFewPosesError
from kilter_core.measurement.contacts import placements
from kilter_core.observations import Observations
from kilter_core.types import Ints

FEWEST_PLACEMENTS = 2  # one to fit, one to hold out
REMEDY = "Measure in another socket, plane or bar mount too, name a campaign of other placements to validate"


@dataclass(frozen=True)
class Folds:
    """Cross-validation in ``folds`` parts."""

    folds: int


def split(observations: Observations, fraction: float, seed: int) -> tuple[Ints, Ints]:
    """Row indices (train, held out), with ``fraction`` of the poses (of contacts the placements) held out at random.

    Raises:
        OptionError: a fraction outside (0, 1). TooFewPosesError: a side without poses or placements.

    """
    if not 0.0 < fraction < 1.0:
        raise OptionError(f"validation is {fraction}: give a fraction between 0 and 1.", option="validation")
    groups, names = _units(observations)
    if names and len(names) < FEWEST_PLACEMENTS:
        raise TooFewPosesError(
            f"All rows are held by {names[0]}, and held out are whole placements. {REMEDY}, or leave the fraction out.",
            placements=len(names),
        )
    shuffled = np.random.default_rng(seed).permutation(groups.max() + 1)
    held = round(fraction * len(shuffled))
    if names:  # of three sockets a tenth is one of them
        held = min(max(held, 1), len(names) - 1)
    if held == 0 or held == len(shuffled):
        raise TooFewPosesError(
            f"{len(shuffled)} poses cannot be split {1 - fraction:.0%} to {fraction:.0%}: measure more."
        )
    inside = np.isin(groups, shuffled[:held])
    return np.flatnonzero(~inside), np.flatnonzero(inside)


def fold_splits(observations: Observations, folds: int, seed: int) -> Iterator[tuple[Ints, Ints]]:
    """Row indices (train, held out) of each fold; every pose (of contacts every placement) is held out once.

    Raises:
        OptionError: fewer than two folds. TooFewPosesError: fewer poses or placements than folds.

    """
    if folds < 2:
        raise OptionError(f"folds is {folds}: give two or more.", option="validation")
    groups, names = _units(observations)
    shuffled = np.random.default_rng(seed).permutation(groups.max() + 1)
    if names and len(names) < folds:
        fewer = f"give {len(names)} folds or fewer, or m" if len(names) >= FEWEST_PLACEMENTS else "m"
        raise TooFewPosesError(
            f"{len(names)} placements ({', '.join(names)}) cannot make {folds} folds, for held out are whole placements: "
            f"{fewer}{REMEDY[1:]}.",
            placements=len(names),
        )
    if len(shuffled) < folds:
        raise TooFewPosesError(f"{len(shuffled)} poses cannot make {folds} folds: give fewer folds.")
    for part in np.array_split(shuffled, folds):
        inside = np.isin(groups, part)
        yield np.flatnonzero(~inside), np.flatnonzero(inside)


def _units(observations: Observations) -> tuple[Ints, tuple[str, ...]]:
    """What is held out whole (N,): poses, or placements with their names."""
    placed = placements(observations)
    return (observations.pose_groups(), ()) if placed is None else placed
