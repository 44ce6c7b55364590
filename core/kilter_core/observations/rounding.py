"""The step that joint readings are multiples of: controllers that show hundredths of a degree, encoders that count ticks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kilter_core.types import Bools, Floats

FEWEST_LEVELS = 12  # different readings of a joint that tell a step: fewer are poses that were typed in
# Different readings from which a step that nobody knows tells, as of an encoder of 10 000 lines: that all of them are even
# happens by chance once in 500 000.
FEWEST_OF_A_MULTIPLE = 20
EXACT = 0.02  # of a step, by which readings may be off it: what a file's own decimals leave
DECIMALS = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002, 0.0001)
DEGREE = np.pi / 180.0  # rad
MILLIMETRE = 0.001  # m
BITS = tuple(range(8, 21))  # of an encoder, per revolution
LEROBOT_TICKS = 4095.0  # to 360 degrees, by which LeRobot converts the 4096 ticks of a servo


def reading_steps(q: Floats, slides: Sequence[bool] | Bools) -> Floats:
    """Largest step (n,), rad or m, that all readings of each joint are multiples of, up to a constant; 0 where there is none.

    Joints of too few different readings have the step of the others where it fits them.
    """
    steps = np.array([_step(column, _common_step_sizes(bool(slid))) for column, slid in zip(q.T, slides, strict=True)])
    for j, slid in enumerate(slides):
        others = [s for k, s in enumerate(steps) if s > 0.0 and bool(slides[k]) == bool(slid)]
        if len(np.unique(q[:, j])) < FEWEST_LEVELS:
            fits = [s for s in others if len(np.unique(q[:, j])) > 1 and _fits(q[:, j], s)]
            steps[j] = max(fits, default=0.0)
    return steps


def _common_step_sizes(slides: bool) -> Floats:
    """Steps that controllers and encoders have, the largest first."""
    decimals = np.array(DECIMALS)
    if slides:
        return decimals * MILLIMETRE
    ticks = 2.0 * np.pi / np.array([*(2.0**bits for bits in BITS), LEROBOT_TICKS])
    return np.sort(np.concatenate([decimals * DEGREE, decimals * 1e-2, ticks]))[::-1]


def _step(column: Floats, known: Floats) -> float:
    levels = np.unique(column)
    if len(levels) < FEWEST_LEVELS:
        return 0.0
    step = next((float(step) for step in known if _fits(column, step)), 0.0)
    if step > 0.0 and len(levels) >= FEWEST_OF_A_MULTIPLE:
        step *= int(np.gcd.reduce(np.round((levels - levels[0]) / step).astype(np.int64)))
    return step


def _fits(column: Floats, step: float) -> bool:
    away = (column - column[0]) / step
    return bool(np.all(np.abs(away - np.round(away)) < EXACT))
