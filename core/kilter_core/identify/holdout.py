"""Setting observations aside: always whole poses, so that a repeat never sits on both sides."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from kilter_core.errors import OptionError, TooFewPosesError
from kilter_core.observations import Observations
from kilter_core.types import Ints


@dataclass(frozen=True)
class Folds:
    """Cross-validation in ``folds`` parts."""

    folds: int


def split(observations: Observations, fraction: float, seed: int) -> tuple[Ints, Ints]:
    """Row indices (train, held out), with ``fraction`` of the poses held out at random.

    Raises:
        OptionError: a fraction outside (0, 1). TooFewPosesError: a side without poses.

    """
    if not 0.0 < fraction < 1.0:
        raise OptionError(f"validation is {fraction}: give a fraction between 0 and 1.", option="validation")
    groups = observations.pose_groups()
    shuffled = np.random.default_rng(seed).permutation(groups.max() + 1)
    held = round(fraction * len(shuffled))
    if held == 0 or held == len(shuffled):
        raise TooFewPosesError(
            f"{len(shuffled)} poses cannot be split {1 - fraction:.0%} to {fraction:.0%}: measure more."
        )
    inside = np.isin(groups, shuffled[:held])
    return np.flatnonzero(~inside), np.flatnonzero(inside)


def fold_splits(observations: Observations, folds: int, seed: int) -> Iterator[tuple[Ints, Ints]]:
    """Row indices (train, held out) of each fold; every pose is held out once.

    Raises:
        OptionError: fewer than two folds. TooFewPosesError: fewer poses than folds.

    """
    if folds < 2:
        raise OptionError(f"folds is {folds}: give two or more.", option="validation")
    groups = observations.pose_groups()
    shuffled = np.random.default_rng(seed).permutation(groups.max() + 1)
    if len(shuffled) < folds:
        raise TooFewPosesError(f"{len(shuffled)} poses cannot make {folds} folds: give fewer folds.")
    for part in np.array_split(shuffled, folds):
        inside = np.isin(groups, part)
        yield np.flatnonzero(~inside), np.flatnonzero(inside)
