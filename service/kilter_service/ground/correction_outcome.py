"""One correction for whoever asks, with a verdict on every row: `correct`, the preview and the guard of activation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from kilter_core.types import Bools, Floats, Ints
from kilter_files.ground.later import special
from kilter_service.contract.streams import Flag, Status
from kilter_service.ground.core import core_correct, core_model
from kilter_service.ground.wire import to_mm

if TYPE_CHECKING:
    from kilter_core.correct import CorrectedTrajectory, CorrectionOptions
    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration, Doubt
    from kilter_core.observations import Observations

LEVEL, TWO_SIDED, ONE_SIDED = 0.95, 1.959963984540054, 1.6448536269514722  # of the standard normal
FAR = 4.0  # biases in standard deviations beyond which the other side of the interval holds nothing
NODES = 401  # of the table of quantiles between


def from_parameters(
    calibration: Calibration,
    done: CorrectedTrajectory,
    known: Predictive | None,
    temperature_c: float | None = None,
) -> Floats:
    """Half widths (N, 3) m of the 95 % intervals that the parameters alone give, along the axes of the wanted base.

    NaN for rows that were refused, and everywhere when nothing is ``known`` of the version. An effect that is left out of
    the correction is left out here.
    """
    out = np.full((len(done.wanted), 3), np.nan)
    good = done.status == Status.OK
    if known is None or not good.any():
        return out
    arm, there = _as_corrected(calibration, done, temperature_c)
    out[good] = known.of_the_tool(arm, there.select(good), arm.nominal_in_wanted_frames().model.T_base[:3, :3])
    return out


def from_unknown_sides(
    calibration: Calibration, done: CorrectedTrajectory, temperature_c: float | None = None
) -> Floats:
    """Largest displacements (N, 3) m by joints whose last motion nobody knows, along the axes of the wanted base.

    Half of what the tool moves between the two sides of each such joint's backlash. 0 where all directions are known.
    """
    out = np.zeros((len(done.wanted), 3))
    arm, there = _as_corrected(calibration, done, temperature_c)
    if "direction" not in arm.model.needs:
        return out
    # What follows a column that a path lacks moves the tool alike on either side.
    arm = arm.with_effects(
        [e for e in arm.model.effects if all(getattr(there, name, 0) is not None for name in e.needs)]
    )
    axes = arm.nominal_in_wanted_frames().model.T_base[:3, :3]
    unknown = (done.direction == 0.0) & (done.status == Status.OK)[:, None]
    for joint in np.flatnonzero(unknown.any(axis=0)):
        rows = there.select(unknown[:, joint])
        assert rows.direction is not None
        sides = []
        for side in (-1.0, 1.0):
            direction = rows.direction.copy()
            direction[:, joint] = side
            sides.append(arm.predict(replace(rows, direction=direction)).position)
        out[unknown[:, joint]] += 0.5 * np.abs((sides[1] - sides[0]) @ axes)
    return out


def _as_corrected(
    calibration: Calibration, done: CorrectedTrajectory, temperature_c: float | None
) -> tuple[Calibration, Observations]:
    """The arm with the effects that are corrected, and the rows (N,) it was sent to."""
    rows = done.wanted
    there = replace(rows, q=done.q, direction=done.direction)
    if rows.temperature_c is None and temperature_c is not None:
        there = replace(there, temperature_c=np.full(len(rows), temperature_c))
    corrected = [
        e
        for key, e in zip(calibration.model.effect_slices(), calibration.model.effects, strict=True)
        if key not in done.not_corrected
    ]
    return calibration.with_effects(corrected), there


def about(bias: Floats, half: Floats) -> Floats:
    """Half widths w of the intervals -w to w that hold 95 % of a normal error with this mean and this own half width.

    What a correction leaves is known: it moves the error, and does not widen it. With b the ``bias``, s = ``half`` / 1.96
    and Phi the standard normal, w solves Phi((w - b) / s) - Phi((-w - b) / s) = 0.95, the quantile of a folded normal: it
    is ``half`` at b = 0 and |b| + 1.645 s far from it, less than their sum. (w / s)² is a quantile of the noncentral
    chi-squared distribution with one degree of freedom and noncentrality (b / s)².
    """
    size, sigma = np.abs(bias), half / TWO_SIDED
    away = np.divide(size, sigma, out=np.full_like(size, np.inf), where=sigma > 0.0)
    near = sigma * _quantiles(np.fmin(away, FAR))
    found: Floats = np.where(away < FAR, near, size + ONE_SIDED * sigma)
    return np.where(np.isnan(bias) | np.isnan(half), np.nan, found)


def _quantiles(away: Floats) -> Floats:
    """Quantiles w / s over b / s up to FAR, to 1e-9 by cubics between nodes: the distribution takes seconds for many."""
    value, slope = _nodes()
    step = FAR / (NODES - 1)
    k = np.minimum((away / step).astype(np.int64), NODES - 2)
    t = away / step - k
    first = (1.0 - t) ** 2 * ((1.0 + 2.0 * t) * value[k] + t * step * slope[k])
    last = t**2 * ((3.0 - 2.0 * t) * value[k + 1] - (1.0 - t) * step * slope[k + 1])
    return np.asarray(first + last)


@cache
def _nodes() -> tuple[Floats, Floats]:
    """Quantiles at the nodes and their slopes: Phi(w - b) - Phi(-w - b) stays where dw = tanh(w b) db."""
    away = np.linspace(0.0, FAR, NODES)
    value = np.sqrt(special.chndtrix(LEVEL, 1.0, away**2))
    return value, np.tanh(value * away)


# Of rows with numbers; a refused row has the name of its refusal.
OK, DAMPED, LIMITED, UNSURE = "OK", "DAMPED", "LIMITED", "UNSURE"
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
    ``sides (N, 3)`` m are what joints add whose last motion nobody knows; they count as left. ``doubts`` are those of
    the version: what it may be off there adds to ``u95``.
    ``oriented``: the orientation was asked for as well.
    """

    done: CorrectedTrajectory
    stated: Floats
    u95: Floats
    sides: Floats
    doubts: Sequence[Doubt]
    oriented: bool

    @property
    def answered_rows(self) -> Bools:
        """Rows (N,) that have numbers."""
        found: Bools = self.done.status == Status.OK
        return found

    @property
    def remaining_errors(self) -> Floats:
        """Largest distance (N,) m of the corrected tool from where it should be by the version; NaN where refused."""
        found: Floats = np.linalg.norm(np.abs(self.done.left) + self.sides, axis=1)
        return found

    @property
    def words(self) -> Sequence[str]:
        """The verdict on each row: OK, DAMPED, LIMITED, UNSURE, or why it was refused."""
        within = self._rows_within_stated_error()
        held = ((self.done.flags & HELD) != 0) | self.sides.any(axis=1)
        word = np.where(within, np.where(self.done.flags & Flag.UNSURE, UNSURE, OK), np.where(held, LIMITED, DAMPED))
        return [
            one if code == Status.OK else Status(code).name
            for code, one in zip(self.done.status.tolist(), word.tolist(), strict=True)
        ]

    @property
    def turns(self) -> bool:
        """Whether the orientation was a task at all: an arm with fewer than six joints holds none."""
        return self.oriented or self.done.q.shape[1] >= WHOLE_POSE

    @property
    def u95_kind(self) -> str:
        """What ``u95`` is of: neighbouring rows of a path share their error, and none is known beyond the instrument."""
        return f"{'along a path' if self.done.follow_one_another else 'for poses'}, relative to the instrument"

    def _rows_within_stated_error(self) -> Bools:
        """Rows whose remaining error is within what is stated, along each axis, and small; refused ones are not."""
        stated = np.maximum(np.where(np.isnan(self.stated), STATED_M, self.stated), REACHED_M)
        good: Bools = np.all(np.abs(self.done.left) + self.sides <= stated, axis=1) & (
            self.remaining_errors <= MOST_OK_M
        )
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
    done = core_correct.correct_trajectory(calibration, rows, options)
    stated = from_parameters(calibration, done, known, options.temperature_c)
    sides = from_unknown_sides(calibration, done, options.temperature_c)
    unexplained = core_model.unexplained_error(calibration.doubts, done.wanted.q)
    u95 = about(done.left, stated) + sides + unexplained[:, None]
    return Outcome(done, stated, u95, sides, calibration.doubts, options.task == "pose")


def summary(found: Outcome) -> tuple[str, ...]:
    """Say where the version is unsure, how many rows keep more of their error than is stated, and how much at worst."""
    words = np.array(found.words)
    kept = (
        _describe_rows_with_status(word.lower(), np.flatnonzero(words == word), found.remaining_errors)
        for word in (DAMPED, LIMITED)
        if (words == word).any()
    )
    return (*_unsure(found), *kept, *_unknown_sides(found))


def _unsure(found: Outcome) -> Iterator[str]:
    """Say what the version doubts of itself, each reason once with its rows; of a whole version without them."""
    q, count = found.done.wanted.q, len(found.remaining_errors)
    for reason in dict.fromkeys(doubt.reason for doubt in found.doubts):
        own = [doubt for doubt in found.doubts if doubt.reason == reason]
        rows = int(np.sum([doubt.holds(q) for doubt in own], axis=0).astype(bool).sum())
        if any(doubt.whole for doubt in own):
            yield f"This version is unsure everywhere: {reason}"
        elif rows:
            yield f"{rows} of {count} rows {'are' if rows > 1 else 'is'} unsure: {reason}"


def _unknown_sides(found: Outcome) -> Iterator[str]:
    """Say in how many rows the side of a backlash is not known, and what that may cost."""
    unknown = np.flatnonzero(found.sides.any(axis=1))
    if len(unknown):
        worst = float(np.linalg.norm(found.sides, axis=1).max())
        yield (
            f"From which side joints with backlash come is not known in {len(unknown)} of "
            f"{len(found.remaining_errors)} rows, the first "
            f"of them row {int(unknown[0]) + 1}: up to {to_mm(worst):.2g} mm. Begin with a short move of these joints, or "
            "state dir1 ... in every row."
        )


def _describe_rows_with_status(word: str, rows: Ints, left: Floats) -> str:
    worst = rows[int(np.argmax(left[rows]))]
    many = len(rows) > 1
    return (
        f"{len(rows)} of {len(left)} rows {'are' if many else 'is'} {word}, at worst {to_mm(float(left[worst])):.2g} mm are "
        f"left (row {worst + 1})."
    )


def flag_names(flags: int) -> str | None:
    """Name how a row was corrected, joined by ``|``; None: nothing to say."""
    return "|".join(flag.name for flag in HOW if flags & flag) or None
