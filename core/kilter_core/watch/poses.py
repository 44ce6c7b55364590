"""The few poses of a check: those that show, and tell apart, the causes that are hardest to see.

Every cause has a size that should be seen, and every other cause that could stand for it. What the poses show of the one
beyond the other, in chi-square, is its power. Exchanges of poses raise the powers that an alarm still lacks, each in
proportion: of a cause alone, and of a cause beyond the one that looks most like it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.driving_order import driving_order, joint_ranges
from kilter_core.errors import RobotError
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.model.region import Region
from kilter_core.observations import Observations
from kilter_core.observations.groups import last_motion, with_neutral_conditions
from kilter_core.parameters import degrees, mm
from kilter_core.types import Floats, Ints, Progress
from kilter_core.watch.arm_check import Check, check, required_noncentrality
from kilter_core.watch.causes import Cause, derivatives

POOL = 400
STARTS = 3
SWEEPS = 6
ZERO = float(np.radians(0.03))  # rad, a step of a zero that should be seen; a sag as much at its largest load
SLIDE = 5e-5  # m, of a prismatic joint
SHIFT = 1e-4  # m, of a base or a tool
STRETCH = 1e-4  # of the scale
COARSE = float(np.radians(0.25))  # rad, of a zero that a check must show, or it is not worth its name
ALIKE = 1e-5  # of what the pool shows of a cause, what another leaves of it where no poses tell them apart
RIDGE = 1e-12
NAMED = 3.0  # how often naming a cause counts beside seeing it
SETTLED = 1e-3  # of the score
TINY = 1e-12  # of a chi-square, so that it has a logarithm


@dataclass(frozen=True)
class CheckPlan:
    """Poses ``q (count, n)`` in the order of short moves, and ``found``, what they show of an arm that has not moved.

    ``faint`` are the zeros of which a step of 0.03 deg or 0.05 mm does not alarm in 95 % of the checks.
    """

    q: Floats
    found: Check
    faint: tuple[Faint, ...]


@dataclass(frozen=True)
class Faint:
    """A zero that poses show from a change ``seen`` (rad or m) on only, None: from none.

    The measured point is at most ``lever`` m off that axis; a step that should be seen needs ``needed`` m, or ``poses``, as
    many as these and such. None for a prismatic joint, and where no number of poses is enough.
    """

    cause: Cause
    seen: float | None
    lever: float | None
    needed: float | None
    poses: int | None


def check_poses(
    calibration: Calibration,
    known: Predictive,
    count: int,
    region: Region,
    *,
    noise: float | None = None,
    without: Sequence[int] = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> CheckPlan:
    """Choose poses in a region that tell zeros, sag of loaded joints, base, tool and scale apart.

    ``without`` are joints (from 1) whose zeros need not be seen. ``noise`` m of a coordinate, the version's when None.

    Raises:
        RobotError: hardly a pose is in the region, or the measured point is on the axis of a joint.

    """
    rng = np.random.default_rng(seed)
    pool = _simulate_rows(calibration, region.draw(POOL, rng))
    sigma = float(np.hypot(known.noise if noise is None else noise, known.inadequacy))
    shown = _Shown.from_pool(calibration, pool, sigma, without)
    _refuse_on_axis(calibration, pool, sigma, count, without)
    best, power = np.arange(count), -np.inf
    for start in range(STARTS):
        picked, found = _exchange_poses(shown, rng.choice(len(pool), count, replace=False))
        best, power = (picked, found) if found > power else (best, power)
        if progress is not None:
            progress((start + 1) / STARTS, "choosing poses")
    q = pool.q[best]
    rows = _simulate_rows(calibration, q[driving_order(q, joint_ranges(calibration.robot))])
    shows = check(calibration, rows, known, noise=noise)
    return CheckPlan(rows.q, shows, _faint(calibration, pool, shows))


@dataclass(frozen=True)
class _Shown:
    """What each of P poses shows: ``gram (P, K, K)`` of all numbers, each by the size that should be seen; ``places`` says
    which numbers are whose, and ``pairs`` which cause (by place) must be seen beyond which other (None: the noise).
    """

    gram: Floats
    places: tuple[slice, ...]
    pairs: tuple[tuple[int, int | None], ...]
    enough: float

    @staticmethod
    def from_pool(calibration: Calibration, pool: Observations, sigma: float, without: Sequence[int]) -> _Shown:
        prediction = calibration.predict(pool)
        measurement = Measurement.from_observations(pool, calibration.marker_points).of_tool()
        causes, parts, places, at = [], [], [], 0
        for cause, J in derivatives(calibration, pool, prediction):
            d = measurement.residual(prediction, J).d_points
            assert d is not None
            part = d.reshape(len(pool), -1, J.shape[2]) / sigma * _size(cause, J)
            causes.append(cause)
            parts.append(part)
            places.append(slice(at, at + J.shape[2]))
            at += J.shape[2]
        X = np.concatenate(parts, axis=2)
        gram = np.einsum("prk,prl->pkl", X, X)
        every = _Shown(gram, tuple(places), (), required_noncentrality(1, len(causes)))
        wanted = [k for k, cause in enumerate(causes) if not (cause.kind == "zero" and cause.joint in without)]
        return replace(every, pairs=every._tellable(wanted))

    def _tellable(self, wanted: Sequence[int]) -> tuple[tuple[int, int | None], ...]:
        """Pairs that all poses together tell apart."""
        whole = self.gram.sum(axis=0)[None]
        alone = {a: float(self._beyond(whole, a, None)[0]) for a in wanted}
        seen = [a for a in wanted if alone[a] > ALIKE * max(alone.values())]
        others = [(a, b) for a in seen for b in range(len(self.places)) if a != b]
        told = [(a, b) for a, b in others if float(self._beyond(whole, a, b)[0]) > ALIKE * alone[a]]
        return (*((a, None) for a in seen), *told)

    def score(self, gram: Floats) -> Floats:
        """How much sets of poses with these Gram matrices (M, K, K) show, (M,).

        Each cause counts alone, and beyond whatever looks most like it, by the logarithm of what share of the power that an
        alarm needs there is. What no poses show better, as a zero whose axis is near, then holds up nothing else, and what
        is seen well enough adds nothing.
        """
        alone: dict[int, Floats] = {}
        beyond: dict[int, Floats] = {}
        for a, b in self.pairs:
            power = np.maximum(self._beyond(gram, a, b), TINY)
            told = np.log(power / (power + self.enough))
            if b is None:
                alone[a] = told
            else:
                beyond[a] = np.minimum(beyond.get(a, told), told)
        return np.asarray(sum(alone.values()) + NAMED * sum(beyond.values()))

    def _beyond(self, gram: Floats, a: int, b: int | None) -> Floats:
        """Chi-square (M,) of a cause beyond another; of a frame that of a shift in the direction that shows least."""
        own = self.places[a]
        left = gram[:, own, own]
        if b is not None:
            other = self.places[b]
            D = gram[:, other, other]
            size = np.maximum(np.trace(D, axis1=1, axis2=2), 1e-300)
            cross = gram[:, other, own]
            solved = np.linalg.solve(D + RIDGE * size[:, None, None] * np.eye(D.shape[1]), cross)
            left = left - np.einsum("mba,mbc->mac", cross, solved)
        if left.shape[1] == 1:
            return np.asarray(left[:, 0, 0])
        return np.asarray(np.linalg.eigvalsh(left[:, :3, :3])[:, 0])


def _size(cause: Cause, J: Floats) -> float:
    """The change of each number of a cause that should be seen."""
    if cause.frame:
        return SHIFT
    if cause.kind == "scale":
        return STRETCH
    step = SLIDE if cause.slides else ZERO
    if cause.kind == "zero":
        return step
    moved = float(np.linalg.norm(J[:, :3, 0], axis=1).max())  # by the sag of 1 at the largest load
    return step / max(moved, 1e-300)


def _exchange_poses(shown: _Shown, picked: Ints) -> tuple[Ints, float]:
    """Exchange one pose after the other for the best of the pool, until none is better."""
    picked = picked.copy()
    power = float(shown.score(shown.gram[picked].sum(axis=0)[None])[0])
    for _ in range(SWEEPS):
        before = power
        for place in range(len(picked)):
            others = np.delete(picked, place)
            found = shown.score(shown.gram[others].sum(axis=0) + shown.gram)
            found[others] = -np.inf
            best = int(found.argmax())
            if found[best] > power:
                picked[place], power = best, float(found[best])
        if power <= before + SETTLED:
            break
    return picked, power


def _simulate_rows(calibration: Calibration, q: Floats) -> Observations:
    """Rows in which an arm that has not moved, and drives to them in this order, is seen exactly where it is."""
    rows = Observations(q, direction=last_motion(q))
    load = calibration.robot.load
    rows = rows if load is None else rows.carrying(load.mass, load.com)
    rows = with_neutral_conditions(rows, calibration.model.needs)
    found = calibration.predict(rows)
    if calibration.marker_points is None:
        return replace(rows, position=found.position)
    markers = found.position[:, None, :] + np.einsum("nij,mj->nmi", found.rotation, calibration.marker_points)
    return replace(rows, markers=markers)


def _refuse_on_axis(
    calibration: Calibration, pool: Observations, sigma: float, count: int, without: Sequence[int]
) -> None:
    """Refuse a measured point so near the axis of a joint that no pose shows a coarse change of its zero."""
    far = float(np.sqrt(required_noncentrality(1, 2 * len(calibration.robot.joints)) / count)) * sigma / COARSE
    levers = _levers(calibration, pool)
    for k, joint in enumerate(calibration.robot.joints):
        if joint.kind != "revolute" or k + 1 in without or levers[k] >= far:
            continue
        raise RobotError(
            f"The measured point is {mm(levers[k]):.3g} mm off the axis of joint {k + 1}: {count} poses at "
            f"{mm(sigma):.3g} mm do not show that its zero changed by {degrees(COARSE):g} deg. Mount the reflector, "
            f"and state the tool, at least {mm(far):.3g} mm off that axis, {mm(far * COARSE / ZERO):.3g} mm for "
            f"{degrees(ZERO):.2g} deg; or plan without that joint (`without_joints` {k + 1}).",
            code="tool_on_axis",
            field="tool",
            joint=k + 1,
            lever_m=float(levers[k]),
            needed_m=far,
        )


def _faint(calibration: Calibration, pool: Observations, found: Check) -> tuple[Faint, ...]:
    """Zeros of which a step is not seen, in the order of the joints."""
    out = []
    for k, (joint, lever) in enumerate(zip(calibration.robot.joints, _levers(calibration, pool), strict=True)):
        turns = joint.kind == "revolute"
        cause, step = Cause("zero", k + 1, not turns), ZERO if turns else SLIDE
        seen = found.smallest.get(cause.name)
        if seen is not None and seen <= step:
            continue
        more = None if seen is None else seen / step
        out.append(
            Faint(
                cause,
                seen,
                float(lever) if turns else None,
                float(lever) * more if turns and more else None,
                None if more is None else int(np.ceil(found.poses * more**2)),
            )
        )
    return tuple(out)


def _levers(calibration: Calibration, pool: Observations) -> Floats:
    """Largest distance (n,) m of what is measured from the axis of each revolute joint, root mean square over the points."""
    measurement = Measurement.from_observations(pool, calibration.marker_points).of_tool()
    prediction, motions = calibration.model.joint_jacobian(pool, calibration.values)
    d = measurement.residual(prediction, motions).d_points
    assert d is not None
    return np.asarray(np.sqrt(np.einsum("nmik,nmik->nk", d, d)).max(axis=0))
