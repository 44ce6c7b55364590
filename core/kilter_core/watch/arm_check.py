"""The check: has the arm moved since its version was made, and which one cause explains it.

An alarm is a chi-square of all that was measured, or the likelihood ratio of one cause; both and all causes share the stated
chance. The cause that explains most for its numbers (BIC) is named, with every cause that the rows do not refute beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import chdtrc, chdtri, chndtrinc, fdtrc, fdtri

from kilter_core.errors import ObservationError
from kilter_core.identify.estimate import Frame, new_frames, refit_frames
from kilter_core.identify.plausibility.believable import reach
from kilter_core.identify.seen_poses import as_seen_places
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import QUANTILE, Floats
from kilter_core.watch.causes import Cause, Column, apply_cause, cause_columns
from kilter_core.watch.innovation import STATED, Conditions, Innovation
from kilter_core.watch.sockets import Measured, held_by_sockets, noise_of_seating, place_rows_in_sockets

MOST = 9.0  # times the variance of the version's noise that a day's may have: three times the noise
CHANCE = 0.01  # of an alarm where the noise of the day is larger
FEWEST = 6.0  # numbers of repeated shots that tell the noise better than what a cause leaves


# The noise of the day: how much more the rows of a check scatter than the version's own, as far as they show it.
#
# Repeated shots show it by themselves. Without them it is what the best single cause leaves, so that an alarm is what
# stands out of the scatter, and not the scatter itself.


@dataclass(frozen=True)
class DayNoise:
    """Variance of the rows in units of the one that was expected, 1 to ``MOST``, with its ``freedom``.

    ``within`` is the part of chi-square that repeated shots have alone, of ``shots`` numbers; 0 where they do not tell it.
    """

    ratio: float
    freedom: float
    within: float = 0.0
    shots: float = 0.0

    @staticmethod
    def from_innovation(innovation: Innovation, chi_square: float, numbers: int, gain: float, rank: int) -> DayNoise:
        """Of rows with so much chi-square in so many numbers, of which the best cause takes ``gain`` by ``rank``."""
        within, shots = innovation.within_pose_scatter()
        if shots >= FEWEST:
            return DayNoise(float(np.clip(within / shots, 1.0, MOST)), shots, within, shots)
        # Numbers that the version, the temperature or the set-up may move scatter by no more where the noise is larger.
        freedom = max(innovation.numbers_of_noise - rank, 1.0)
        more = (chi_square - gain - (numbers - rank)) / freedom
        return DayNoise(float(np.clip(1.0 + more, 1.0, MOST)), freedom)

    def p_value(self, chi_square: float, numbers: int, gains: Floats, ranks: Floats) -> float:
        """Chance of the chi-square, or of the largest of the causes' ``gains (K,)``, by rows that scatter as these do."""
        singles = min((self._chance(g, r) for g, r in zip(gains, ranks, strict=True)), default=1.0)
        if self.shots:
            whole = self._chance(max(chi_square - self.within, 0.0), max(numbers - self.shots, 1.0))
        else:  # what is left of all causes says nothing of itself, unless no noise is so large
            whole = float(chdtrc(max(numbers, 1), chi_square / MOST))
        return min(1.0, 2.0 * whole, 2.0 * len(gains) * singles)

    def _chance(self, gain: float, rank: float) -> float:
        """By F against what the rows scatter, or by the largest noise there may be: what that leaves is a change anyway."""
        largest = float(chdtrc(rank, gain / MOST))
        if self.ratio >= MOST:
            return largest
        return min(largest, float(fdtrc(rank, self.freedom, gain / rank / self.ratio)))


FALSE_ALARM = 1e-3  # chance that an arm that has not moved is said to have
POWER = 0.95  # with which the smallest change is seen
REFUTED = 1e-3  # chance that the true cause is refuted beside another one
EXACT = 1e5  # freedom of a scale beyond which it counts as known
PASSES = 3  # about the change found: a large one bends the derivatives
FOREIGN = 0.02  # of the reach: rows that miss it by more, and that no one cause brings near, are not of this arm
BROUGHT_NEAR = 0.1  # share of the misfit that the cause may leave
ANOTHER_ARM = "rows_of_another_arm"  # the code of that refusal
SEEN_LEAST = 1e-6  # of what a frame shows in all directions, what it must show in each to be seen in all

Verdict = Literal["ok", "moved", "cannot_tell"]


@dataclass(frozen=True)
class Judged:
    """A cause before the rows: ``gain`` in chi-square by its ``rank`` numbers, its ``bic``, and whether the rows
    refute it beside the best one.

    ``change (K,)`` has standard deviations ``sigma (K,)``, infinite where nothing measured shows that number. Of a frame
    ``size_sigma (2,)`` are those of the lengths of its shift (m) and rotation (rad), else it is empty.

    ``summed (K,)`` is the change by weights that do not depend on the temperature of the rows. What is compared over many days
    has to hold the errors of the version in the same proportion each day, and the allowance for expansion changes that.
    ``summed_sigma (K,)`` are its standard deviations.
    """

    cause: Cause
    gain: float
    rank: int
    bic: float
    change: Floats
    sigma: Floats
    size_sigma: Floats
    refuted: bool
    summed: Floats
    summed_sigma: Floats

    @property
    def u95(self) -> Floats:
        """Half width (K,) of the 95 % interval of each number."""
        return QUANTILE * self.sigma

    @property
    def size_u95(self) -> Floats:
        """The same of ``size_sigma``."""
        return QUANTILE * self.size_sigma


@dataclass(frozen=True)
class Check:
    """Verdict on rows against a version.

    ``causes`` are those that explain it and that the rows do not refute, best first; empty where all is well, and where no
    single cause explains the rows. ``p_value`` is the chance of so much from an arm that has not moved. ``smallest`` are the
    changes seen with 95 %, by name of the cause: of a frame a shift (m) in the direction that shows least. ``unseen``: no
    change of these moves what was measured. ``misfit`` m is how far measured and predicted are apart (rms), and ``noise`` m of
    a coordinate counted as such; ``by_views`` both are lengths beside the tool's rotation. ``joint_log``: nobody measured a
    place, and rows were compared with each other in their sockets. ``conditions`` are those under which it holds.
    ``scatter`` is how much more than expected the rows scatter, in standard deviations, where their noise was not known.
    """

    verdict: Verdict
    causes: tuple[Judged, ...]
    judged: tuple[Judged, ...]
    p_value: float
    chi_square: float
    numbers: int
    poses: int
    misfit: float
    noise: float
    smallest: dict[str, float]
    unseen: tuple[Cause, ...]
    new_setup: tuple[Frame, ...]
    joint_log: bool = False
    by_views: bool = False
    conditions: Conditions = STATED
    scatter: float = 1.0


@dataclass(frozen=True)
class _Linear:
    """A whitened innovation (R,), freed of what a new set-up takes up, with ``numbers`` left, and the causes beside it."""

    r: Floats
    numbers: int
    columns: tuple[Column, ...]
    hidden: tuple[Column, ...]
    freedom: float
    scatter_freedom: float = np.inf  # of the noise where the day's own rows tell it

    @staticmethod
    def from_innovation(innovation: Innovation, calibration: Calibration, anew: tuple[Frame, ...]) -> _Linear:
        nuisance, columns = cause_columns(innovation, calibration, anew)
        r = innovation.r - nuisance @ (nuisance.T @ innovation.r)
        seen, hidden = ([one for one in columns if one.is_visible is which] for which in (True, False))
        return _Linear(r, len(r) - nuisance.shape[1], tuple(seen), tuple(hidden), innovation.freedom)

    def about(self, cause: Cause, change: Floats) -> _Linear:
        """The same problem linear about a change: the innovation that a cause leaves, with what it took put back."""
        column = next(one for one in self.columns if one.cause == cause)
        return replace(self, r=self.r + column.white @ change)

    def scattering(self, day: DayNoise) -> _Linear:
        """The same by rows that scatter as those of the day do."""
        if day.ratio <= 1.0:
            return self
        by = 1.0 / float(np.sqrt(day.ratio))
        columns = tuple(replace(one, white=one.white * by) for one in self.columns)
        return replace(self, r=self.r * by, columns=columns, scatter_freedom=day.freedom)

    def day_noise(self, innovation: Innovation) -> DayNoise:
        """The noise of the day by these rows."""
        total = float(self.r @ self.r)
        if not self.columns:
            return DayNoise.from_innovation(innovation, total, self.numbers, 0.0, 0)
        best = self.columns[int(np.argmin(_bic(self)))]
        return DayNoise.from_innovation(innovation, total, self.numbers, _gain(self.r, best.span), best.span.shape[1])

    def chance(self, chi_square: float, numbers: int, beside_scatter: bool = False) -> float:
        """Chance of as much from so many numbers of an arm that has not moved; of F, as far as the scale was estimated.

        ``beside_scatter``: these numbers took no part in what tells the noise of the day.
        """
        freedom = min(self.freedom, self.scatter_freedom) if beside_scatter else self.freedom
        if freedom > EXACT:
            return float(chdtrc(numbers, chi_square))
        return float(fdtrc(numbers, freedom, chi_square / numbers))


def check(
    calibration: Calibration,
    rows: Observations,
    known: Predictive,
    *,
    noise: float | None = None,
    new_setup: Sequence[str] = (),
    fitted_c: tuple[float, float] | None = None,
    conditions: Conditions = STATED,
) -> Check:
    """Check an arm by rows that its version was not fitted to; ``noise`` m of a coordinate, the version's own when None.

    Views are poses of the tool, each as certain as its corners make it along and about each axis, unless ``noise`` is stated.

    Nothing of the arm is refitted. Only what ``new_setup`` says was set up anew, [], ["base"] or ["base", "tool"], may take
    any value: then a cause that looks like it, as the zero of the first joint does, is not seen. ``fitted_c`` are the lowest
    and highest temperature of the fit's rows: what the arm expands beyond them has not moved it. ``conditions`` say what is
    open of temperature, set-up and noise.
    Rows with ``socket`` alone, a joint log of a ball that was seated, are compared with each other within each socket.

    Raises:
        OptionError: another set-up, or no noise known.
        ObservationError: no positions, rows of another arm or tool, another temperature.
        TooFewPosesError: under three poses.

    """
    anew = new_frames(new_setup, "new_setup")
    calibration = absorb_frame_increments(calibration)
    given, rows, counts = rows, as_seen_places(calibration, rows, noise), Measured()
    if rows is not given:
        calibration = replace(calibration, marker_points=None)  # views tell the tool point itself
    if held_by_sockets(rows):
        rows, counts = place_rows_in_sockets(calibration, rows)
        noise = noise_of_seating(known) if noise is None else noise
    conditions = conditions.of_rows(calibration, rows, fitted_c, placed=not counts.alone and not anew)
    innovation = Innovation.from_observations(calibration, rows, known, noise, fitted_c, counts, conditions)
    # In a socket it makes no difference where base and instrument stand; a new tool is projected off.
    if anew and not counts.alone:
        calibration = absorb_frame_increments(refit_frames(calibration, innovation.measurement, anew))
        innovation = Innovation.from_observations(calibration, rows, known, noise, fitted_c, conditions=conditions)
    linear = _Linear.from_innovation(innovation, calibration, anew)
    p_value, smallest = _p_value(linear), _smallest(linear, conditions)
    if p_value <= FALSE_ALARM and not conditions.noise_known:
        p_value = _p_value_of_day(linear, innovation, p_value)
    misfit = innovation.misfit
    if p_value <= FALSE_ALARM:
        linear, left = _about_the_best(linear, innovation, calibration, anew)
        _refuse_foreign(calibration, misfit, left)
    day = DayNoise(1.0, np.inf) if conditions.noise_known else linear.day_noise(innovation)
    chi_square, linear = float(linear.r @ linear.r), linear.scattering(day)
    judged = _judge_causes(linear)
    if innovation.allows and p_value > FALSE_ALARM:
        plain = Innovation.from_observations(calibration, rows, known, noise, counts=counts)
        judged = _with_summed_changes(judged, _Linear.from_innovation(plain, calibration, anew))
    causes = _possible_causes(linear, judged) if p_value <= FALSE_ALARM else ()
    return Check(
        _verdict(p_value, causes),
        causes,
        judged,
        p_value,
        chi_square,
        linear.numbers,
        innovation.poses,
        misfit,
        innovation.noise,
        smallest,
        tuple(one.cause for one in linear.hidden),
        anew,
        counts.alone,
        rows.pose_weight is not None,
        conditions,
        float(np.sqrt(day.ratio)),
    )


def absorb_frame_increments(calibration: Calibration) -> Calibration:
    """The same calibration with the increments of its frames in the frames."""
    model, values = calibration.model.absorb_frame_increments(calibration.values)
    return replace(calibration, model=model, values=values)


def _verdict(p_value: float, causes: Sequence[Judged]) -> Verdict:
    if p_value > FALSE_ALARM:
        return "ok"
    return "moved" if len(causes) == 1 else "cannot_tell"


def _about_the_best(
    linear: _Linear, innovation: Innovation, calibration: Calibration, anew: tuple[Frame, ...]
) -> tuple[_Linear, float]:
    """The problem linear about what the best cause changed, and the misfit (m) that it leaves; three small steps."""
    left = innovation.misfit
    for _ in range(PASSES):
        if not linear.columns:
            break
        best = linear.columns[int(np.argmin(_bic(linear)))]
        change = best.change(linear.r)
        at, rows, factor = apply_cause(calibration, innovation.measurement.observations, best.cause, change)
        moved = innovation.with_new_prediction(at, rows, factor)
        if moved.misfit > left:  # further than derivatives reach: the step before stands
            break
        left = moved.misfit
        linear = _Linear.from_innovation(moved, at, anew).about(best.cause, change)
    return linear, left


def far_off(calibration: Calibration, misfit: float) -> bool:
    """Whether rows miss a version by so much (m, rms) that they are of another arm, unless one cause explains it."""
    return misfit > FOREIGN * reach(calibration.robot)


def _refuse_foreign(calibration: Calibration, misfit: float, left: float) -> None:
    if far_off(calibration, misfit) and left > BROUGHT_NEAR * misfit:
        raise ObservationError(
            f"The rows miss what the version predicts by {mm(misfit):.4g} mm (rms), and no one cause explains it: they "
            "are of another robot, in another unit, of another tool, or of an instrument that was set up anew. Send rows "
            "of this robot with the tool of its version, or say what was set up anew (`new_setup`: base, or "
            "base and tool).",
            code=ANOTHER_ARM,
            misfit_m=misfit,
        )


def _p_value(linear: _Linear) -> float:
    """Chance of the chi-square, or of the largest gain of any cause; the two and all causes share it."""
    singles = [linear.chance(_gain(linear.r, one.span), one.span.shape[1]) for one in linear.columns]
    whole = linear.chance(float(linear.r @ linear.r), max(linear.numbers, 1))
    return min(1.0, 2.0 * whole, 2.0 * len(singles) * min(singles, default=1.0))


def _p_value_of_day(linear: _Linear, innovation: Innovation, p_value: float) -> float:
    """The chance where rows may scatter more than the version's: that by their own noise unless this shows a change too."""
    gains = np.array([_gain(linear.r, one.span) for one in linear.columns])
    ranks = np.array([float(one.span.shape[1]) for one in linear.columns])
    own = linear.day_noise(innovation).p_value(float(linear.r @ linear.r), linear.numbers, gains, ranks)
    return p_value if own <= CHANCE else own


def _gain(r: Floats, span: Floats) -> float:
    return float(np.sum((span.T @ r) ** 2))


def _bic(linear: _Linear) -> list[float]:
    total, price = float(linear.r @ linear.r), float(np.log(max(linear.numbers, 2)))
    return [total - _gain(linear.r, one.span) + one.span.shape[1] * price for one in linear.columns]


def _judge_causes(linear: _Linear) -> tuple[Judged, ...]:
    """All causes, best first."""
    if not linear.columns:
        return ()
    r, bic = linear.r, _bic(linear)
    best = linear.columns[int(np.argmin(bic))]
    found = []
    for one, value in zip(linear.columns, bic, strict=True):
        change, refuted = one.change(r), _is_cause_refuted(linear, one, best, REFUTED / len(linear.columns))
        sizes = one.size_deviations(change)
        gain = _gain(r, one.span)
        sigma = one.deviations()
        found.append(Judged(one.cause, gain, one.span.shape[1], value, change, sigma, sizes, refuted, change, sigma))
    return tuple(sorted(found, key=lambda one: (one.bic, one.cause.name)))


def _with_summed_changes(judged: Sequence[Judged], plain: _Linear) -> tuple[Judged, ...]:
    """All causes with their changes as ``plain``, the problem without an allowance for expansion, has them."""
    by_cause = {one.cause: (one.change(plain.r), one.deviations()) for one in plain.columns}
    return tuple(
        replace(one, summed=summed, summed_sigma=sigma)
        for one in judged
        for summed, sigma in (by_cause.get(one.cause, (one.change, one.sigma)),)
    )


def _is_cause_refuted(linear: _Linear, column: Column, best: Column, chance: float) -> bool:
    """Whether the best cause explains what this one leaves, more than chance does; one that contains it never is.

    The best is the best of all, so that each has its share of the chance.
    """
    left = best.span - column.span @ (column.span.T @ best.span)
    U, s, _ = np.linalg.svd(left, full_matrices=False)
    more = U[:, s > 1e-5]
    return bool(more.shape[1] and linear.chance(_gain(linear.r, more), more.shape[1], True) < chance)


def _possible_causes(linear: _Linear, judged: Sequence[Judged]) -> tuple[Judged, ...]:
    """Causes that may be it; none where even these leave more than chance does, for then there are several or another."""
    total = float(linear.r @ linear.r)
    kept = []
    for one in judged:
        freedom = linear.numbers - one.rank
        if not one.refuted and (freedom < 1 or linear.chance(total - one.gain, freedom) > REFUTED):
            kept.append(one)
    return tuple(kept)


def _smallest(linear: _Linear, conditions: Conditions) -> dict[str, float]:
    """Smallest change of each cause that raises the alarm with 95 %, by its own likelihood ratio."""
    out = {}
    for one in linear.columns:
        shown = one.white[:, :3] if one.cause.frame else one.white
        least = float(np.linalg.svd(shown, compute_uv=False)[-1])
        if least > SEEN_LEAST * float(np.linalg.norm(shown)):
            rank, count = one.span.shape[1], len(linear.columns)
            power = required_noncentrality(rank, count, linear.freedom)
            if not conditions.noise_known:  # against what is left, too
                power = max(power, required_noncentrality(rank, count, max(linear.numbers - rank, 1.0), CHANCE))
            out[one.cause.name] = float(np.sqrt(power)) / least
    return out


def required_noncentrality(rank: int, causes: int, freedom: float = np.inf, false_alarm: float = FALSE_ALARM) -> float:
    """Noncentrality with which the likelihood ratio of a cause of some rank is seen, one of so many."""
    chance = false_alarm / (2.0 * causes)
    threshold = chdtri(rank, chance) if freedom > EXACT else rank * fdtri(rank, freedom, 1.0 - chance)
    return float(chndtrinc(threshold, rank, 1.0 - POWER))
