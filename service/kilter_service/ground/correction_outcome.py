"""One correction for whoever asks, with a verdict on every row: `correct`, the preview and the guard of activation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kilter_core.types import Bools, Floats, Ints
from kilter_service.contract.stream_messages import Flag, Status
from kilter_service.ground.core import walker
from kilter_service.ground.correction_uncertainty import about, from_parameters, from_unknown_sides
from kilter_service.ground.wire import to_mm

if TYPE_CHECKING:
    from kilter_core.correct.program import CorrectionOptions
    from kilter_core.correct.walker import CorrectedTrajectory
    from kilter_core.identify.uncertainty.predictive import Predictive
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations


OK, DAMPED, LIMITED = "OK", "DAMPED", "LIMITED"  # of rows with numbers; a refused row has the name of its refusal
# What is stated of a version without a covariance, and of an orientation, whose accuracy no version states.
STATED_M, STATED_RAD = 1e-5, math.radians(0.01)
MOST_OK_M = 5e-5  # however little is stated of a version: a row of which more is left is not OK
WHOLE_POSE = 6  # joints from which on a correction minds the orientation
REACHED_M = 1e-6  # to which a correction is computed: nothing smaller is left
HELD = Flag.REVERSING | Flag.SATURATED | Flag.SLOWED | Flag.RAMPING
HOW = tuple(flag for flag in Flag if flag >= Flag.DYNAMIC)  # flags that say how an answer was made


@dataclass(frozen=True)
class Outcome:
    """A corrected trajectory of N rows, and what is said of each.

    ``stated (N, 3)`` m are half widths of the 95 % intervals from the parameters alone, ``u95 (N, 3)`` m of where the tool
    is after this correction: parameters and what is left together. NaN where refused, or nothing is known of the version.
    ``sides (N, 3)`` m are what joints add whose last motion nobody knows; they count as left.
    ``oriented``: the orientation was asked for as well.
    """

    done: CorrectedTrajectory
    stated: Floats
    u95: Floats
    sides: Floats
    oriented: bool

    @property
    def answered(self) -> Bools:
        """Rows (N,) that have numbers."""
        found: Bools = self.done.status == Status.OK
        return found

    @property
    def left(self) -> Floats:
        """Largest distance (N,) m of the corrected tool from where it should be by the version; NaN where refused."""
        found: Floats = np.linalg.norm(np.abs(self.done.left) + self.sides, axis=1)
        return found

    @property
    def words(self) -> Sequence[str]:
        """The verdict on each row: OK, DAMPED, LIMITED, or why it was refused."""
        within = self._within()
        held = ((self.done.flags & HELD) != 0) | self.sides.any(axis=1)
        return [
            Status(code).name if code != Status.OK else OK if good else LIMITED if limit else DAMPED
            for code, good, limit in zip(self.done.status.tolist(), within.tolist(), held.tolist(), strict=True)
        ]

    @property
    def turns(self) -> bool:
        """Whether the orientation was a task at all: an arm with fewer than six joints holds none."""
        return self.oriented or self.done.q.shape[1] >= WHOLE_POSE

    def _within(self) -> Bools:
        """Rows whose remaining error is within what is stated, along each axis, and small; refused ones are not."""
        stated = np.maximum(np.where(np.isnan(self.stated), STATED_M, self.stated), REACHED_M)
        good: Bools = np.all(np.abs(self.done.left) + self.sides <= stated, axis=1) & (self.left <= MOST_OK_M)
        if self.oriented:
            good = good & (self.done.left_rad <= STATED_RAD)
        return good


def correct(
    calibration: Calibration, rows: Observations, options: CorrectionOptions, known: Predictive | None
) -> Outcome:
    """Correct rows as a file, a query or the stream is corrected, and say what is left of each.

    Raises:
        ObservationError: times that go back, or load and temperature that change too often.

    """
    done = walker.correct_trajectory(calibration, rows, options)
    stated = from_parameters(calibration, done, known, options.temperature_c)
    sides = from_unknown_sides(calibration, done, options.temperature_c)
    return Outcome(done, stated, about(done.left, stated) + sides, sides, options.task == "pose")


def summary(found: Outcome) -> tuple[str, ...]:
    """Say how many rows keep more of their error than is stated, how much at worst and in which row; nothing if none does."""
    words = np.array(found.words)
    kept = tuple(
        _kept(word.lower(), np.flatnonzero(words == word), found.left)
        for word in (DAMPED, LIMITED)
        if (words == word).any()
    )
    unknown = np.flatnonzero(found.sides.any(axis=1))
    if not len(unknown):
        return kept
    worst = float(np.linalg.norm(found.sides, axis=1).max())
    return (
        *kept,
        f"From which side joints with backlash come is not known in {len(unknown)} of {len(words)} rows, the first of them "
        f"row {int(unknown[0]) + 1}: up to {to_mm(worst):.2g} mm. Begin with a short move of these joints, or state dir1 ... "
        "in every row.",
    )


def _kept(word: str, rows: Ints, left: Floats) -> str:
    worst = rows[int(np.argmax(left[rows]))]
    many = len(rows) > 1
    return (
        f"{len(rows)} of {len(left)} rows {'are' if many else 'is'} {word}, at worst {to_mm(float(left[worst])):.2g} mm are "
        f"left (row {worst + 1})."
    )


def flag_names(flags: int) -> str | None:
    """Name how a row was corrected, joined by ``|``; None: nothing to say."""
    return "|".join(flag.name for flag in HOW if flags & flag) or None
