"""What moves with time: base or instrument that drifts, settles or walks, links that lengthen, zeros that creep."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import BASE, TWIST, Effect, Local, frame_rates, frame_twists, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.laws import LawOfTime, settled_share, span_of_clock, time_constants
from kilter_core.effects.physical import JOINT_ZERO, LINK_LENGTH, STATION, Separator
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.observations.clock import applicable_time_mask, on_shared_clock
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class Drift(LawOfTime):
    """The base frame moves at constant rates: a twist of six rates times t − t0, in its own axes.

    ``t0_s`` is when the base is where the geometry says; without it the first row's time, once rows are known.
    """

    id = "drift"
    summary = "slow motion of the base or of the instrument with time"
    physical = STATION
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "ISO 9283, drift of pose characteristics; Barfoot, State Estimation for Robotics, 7.1"
    stage = "base"
    aliases = ("thermal_growth", "session_shift")
    remedy = "revisit a reference pose during the campaign, and visit the others in random order"
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rates along x, y, z, m/s, then about them, rad/s."""
        return frame_rates("drift", "s", 1e-6, 1e-4)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by the rates."""
        moved = np.eye(6)[:, None, :] * self.elapsed_time(batch)[:, None]
        return frame_twists(batch, values, BASE, moved)


USUAL = 0.2  # of the campaign, when no time constant is given


@dataclass(frozen=True)
class Settling(LawOfTime):
    """The base frame moves by a twist times 1 − exp(−(t − t0)/τ), in its own axes.

    ``tau_s`` is τ, a fifth of the rows' time when not given; a gap job tries several. ``t0_s`` is when the base is
    where the geometry says; without it the first row's time, once rows are known.
    """

    id = "settling"
    summary = "base or instrument settles exponentially"
    physical = STATION
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "ISO 230-3, thermal distortion after start-up: first-order response; ISO 9283, drift"
    stage = "base"
    aliases = ("drift", "random_walk", "zero_drift", "session_shift")
    remedy = "revisit a reference pose often at the beginning, and let robot and instrument warm up first"
    at_joints = False

    tau_s: float | None = option(None, "Time constant, s, above 0; null: a fifth of the rows' time.", above=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tau_s is not None and not self.tau_s > 0.0:
            raise OptionError(f"settling has tau_s {self.tau_s!r}: give a time in s above 0.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """At several paces, where rows have a time."""
        if rows.t is None or not len(rows):
            return super().candidate_configurations(robot, rows)
        return [{"tau_s": tau} for tau in time_constants(float(np.ptp(rows.t)))]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Start at the earliest row, with a time constant in proportion to the rows' time."""
        law = super().configure_for_robot(robot, rows)
        if law.tau_s is not None or rows is None or rows.t is None or not len(rows):
            return law
        first, last = span_of_clock(rows.t)
        return replace(law, tau_s=time_constants(last - first, (USUAL,))[0])

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """What is left to settle at t0 along x, y, z, m, and about them, rad; named with τ, for a model may have several.

        Raises:
            OptionError: no time constant, and no rows to take it from.

        """
        if self.tau_s is None:
            raise OptionError(
                "settling needs tau_s: give the time constant in s, or rows with t_s to take it from.", effect=self.id
            )
        stem = f"settling_{self.tau_s:g}s"
        return tuple(
            Parameter(f"{stem}_{k}", unit, 0.0, 2e-4, -5e-3, 5e-3, f"settling of the base's {k}") for k, unit in TWIST
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by the amounts."""
        if self.tau_s is None:
            raise OptionError("settling needs tau_s: give its time constant in s.", effect=self.id)
        settled = settled_share(self.elapsed_time(batch), self.tau_s)
        moved = np.eye(6)[:, None, :] * settled[:, None]
        return frame_twists(batch, values, BASE, moved)


PIECES = 6
FEW_PIECES = (2, 3)
MOST_PIECES = 50
SPREAD = 2e-6  # m per root of a second: 0.12 mm in an hour


@dataclass(frozen=True)
class RandomWalk(Effect):
    """The base frame moves along its axes, straight on between the times ``knots_s``; it is at rest at the first of them.

    The steps from knot to knot are the parameters, independent of one another, each with a prior whose variance grows
    with the time it takes, as of a Wiener process. Without ``knots_s`` there are ``pieces`` that hold as many rows each;
    a gap job tries few and many, because a slow walk shows in few, and each piece costs what three parameters cost.
    """

    id = "random_walk"
    summary = "base or instrument wanders with time"
    physical = STATION
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "Wiener process as prior of a pose; Barfoot, State Estimation for Robotics, 3.4"
    needs = frozenset({"t"})
    clock = "t"
    stage = "base"
    aliases = ("drift", "settling", "session_shift")
    remedy = "revisit a reference pose between the others, and visit those in random order"
    at_joints = False
    supple = True

    knots_s: tuple[float, ...] = option(
        (),
        "Times between which the base goes straight on, s; empty: as many pieces as `pieces` says, with as many rows each.",
    )
    pieces: int = option(PIECES, "How many pieces, 1 to 50.", low=1, high=MOST_PIECES)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 1 <= self.pieces <= MOST_PIECES:
            raise OptionError(f"random_walk has pieces {self.pieces}: give 1 to {MOST_PIECES}.", effect=self.id)
        if len(self.knots_s) == 1 or any(b <= a for a, b in pairwise(self.knots_s)):
            raise OptionError("random_walk needs two or more knots_s, each later than the one before.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """In few pieces and in many."""
        return [{"pieces": n} for n in (*FEW_PIECES, PIECES)]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Put the knots where the rows are."""
        if self.knots_s or rows is None or rows.t is None or not np.ptp(rows.t) > 0.0:
            return self
        shared = on_shared_clock(rows.t)
        own = rows.t[shared] if shared.any() else rows.t
        knots = np.unique(np.quantile(own, np.linspace(0.0, 1.0, self.pieces + 1)))
        return replace(self, knots_s=tuple(float(t) for t in knots))

    @property
    def informative_row_share(self) -> float:
        """Of many pieces a step is told by its own. Few are a bent line, which all rows tell as they do a rate of drift."""
        return 1.0 / max(len(self.knots_s) - 1, 1) if self.pieces >= PIECES else 1.0

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Steps along x, y, z, m, piece by piece.

        Raises:
            OptionError: no knots, and no rows to take them from.

        """
        if not self.knots_s:
            raise OptionError(
                "random_walk needs knots_s: give times in s, or rows whose t_s differ to take them from.",
                effect=self.id,
            )
        stem = "walk" if self.pieces == PIECES else f"walk{self.pieces}"
        made = []
        for n, (begin, end) in enumerate(pairwise(self.knots_s), 1):
            sigma = SPREAD * math.sqrt(end - begin)
            text = f"step of the base in piece {n} along "
            made += [
                Parameter(f"{stem}_{n}_{k}", "m", 0.0, sigma, -10.0 * sigma, 10.0 * sigma, text + k) for k in "xyz"
            ]
        return tuple(made)

    @property
    def time_span(self) -> tuple[float, float | None] | None:
        """First and last knot, s."""
        return (self.knots_s[0], self.knots_s[-1]) if self.knots_s else None

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the base and its derivatives by the steps."""
        first, last = self.knots_s[0], self.knots_s[-1]
        t = np.asarray(self.column(batch, "t"), dtype=np.float64)
        t = np.where(applicable_time_mask(t, first, last), t, first)
        done = [np.clip((t - begin) / (end - begin), 0.0, 1.0) for begin, end in pairwise(self.knots_s)]
        moved = [axis * part[:, None] for part in done for axis in np.eye(6)[:3]]
        return frame_twists(batch, values, BASE, moved)


@dataclass(frozen=True)
class LinkLengthening(LawOfTime):
    """The link after joint i lengthens by r (t − t0) of its length or, with ``tau_s`` τ, by e (1 − exp(−(t − t0)/τ)).

    With a thermometer in the link it is ``link_growth``; one at the base does not follow the link's time constant.
    """

    id = "link_lengthening"
    summary = "length of one link changes with time"
    physical = LINK_LENGTH
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "ISO 230-3, thermal distortion after start-up; Yin et al. 2014: links beside motors warm up alone"
    aliases = ("settling", "link_growth", "zero_drift", "drift")
    remedy = "put a thermometer on the link, and revisit poses with it stretched out and folded back"

    tau_s: float | None = option(None, "Time constant, s, above 0; null: at a constant rate.", above=0.0)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """At a constant rate and, where rows have a time, settling at several paces."""
        if rows.t is None or not len(rows):
            return super().candidate_configurations(robot, rows)
        return [{}, *({"tau_s": tau} for tau in time_constants(float(np.ptp(rows.t))))]

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Begin at the earliest row, at the links that have a length."""
        return super().configure_for_robot(robot, rows).restrict_to_long_links(robot)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rate r per link, 1/s, or strain e in the end, named with τ; 5e-4 is aluminium that warms by 20 K."""
        if self.tau_s is None:
            return self.per_joint(robot, "link_rate", "1/s", 1e-8, -1e-6, 1e-6, "rate of the link's strain")
        stem = f"link_strain_{self.tau_s:g}s"
        return self.per_joint(robot, stem, "1", 5e-5, -5e-4, 5e-4, "strain of the link in the end")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of each joint's frame along its link, and the derivative."""
        elapsed = self.elapsed_time(batch)
        return self.along_links(batch, values, elapsed if self.tau_s is None else settled_share(elapsed, self.tau_s))


@dataclass(frozen=True)
class ZeroDrift(LawOfTime):
    """dq = r (t − t0) per joint.

    ``t0_s`` is when the zero is that of the geometry; without it the first row's time, once rows are known. At a joint
    whose axis is fixed in the base, as the first one's does, it is one of the motions of ``drift``.
    """

    id = "zero_drift"
    summary = "zero of a joint moves with time"
    physical = JOINT_ZERO
    separated_by = (Separator.ORDER, Separator.SENSOR)
    source = "Yin et al. 2014, joint by joint warm-up: which parameters move; ISO 9283, drift of pose characteristics"
    aliases = ("drift", "zero_thermal", "settling")
    remedy = "revisit poses during the campaign that move this joint's zero differently from the base, in random order"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Rate r per joint, rad/s."""
        return self.per_joint(robot, "zero_drift", "rad/s", 1e-7, -1e-5, 1e-5, "rate of the joint's zero")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by the rate."""
        return self.joint_angle(batch, values, np.broadcast_to(self.elapsed_time(batch)[:, None], batch.q.shape))
