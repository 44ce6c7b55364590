"""Errors that no known effect explains, as shapes without a cause: by joint, in the workspace, over all angles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Any, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm, Shape
from kilter_core.effects.base import BASE, Effect, Local, frame_twists, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.curves import JointCurve, OverRange
from kilter_core.effects.physical import JOINT_CURVE, SHAPE
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class UnknownSmoothCurve(JointCurve, OverRange):
    """dq = Σ a_m P_m(u) over the ``orders`` m: Legendre polynomials of u = (q − centre)/half, −1 to 1 over the range.

    Over less than one turn q, sin q and cos q span every smooth curve, so
    that the torque of a hose or an error of a belt would pass for a scale error and an eccentricity.
    """

    id = "unknown_smooth_curve"
    summary = "smooth error curve of a joint without a known cause"
    physical = JOINT_CURVE
    source = "empirical: Legendre polynomials on the range that the joint moved"
    aliases = ("encoder_scale", "eccentricity", "second_harmonic", "gravity_spring")
    remedy = "sweep the joint alone in small steps over its whole range, best over more than one turn"
    empirical = True
    alone = False

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Order by order."""
        return [{"orders": (m,)} for m in cls().orders]

    @classmethod
    def together(cls, tried: Sequence[Self]) -> Sequence[tuple[Self, ...]]:
        """Orders 1 and 2, and so on up to all: the first alone is a scale error."""
        return [tuple(tried[:most]) for most in range(2, len(tried) + 1)]

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a_m per joint, order by order, rad."""
        sigma, wide = math.radians(0.05), math.radians(0.5)
        stems = [f"smooth{m}" for m in self.orders]
        made = (self.per_joint(robot, stem, "rad", sigma, -wide, wide, "empirical amplitude") for stem in stems)
        return tuple(p for stem in made for p in stem)

    def signals(self, q: Floats) -> Sequence[Floats]:
        """Polynomials, order by order."""
        curves = np.zeros((len(self.orders), *q.shape))
        curves[:, :, list(self.acting(q.shape[1]))] = self.shapes(q)
        return list(curves)

    def add_curves(self, form: RunTimeForm, values: Floats) -> None:
        """Add a polynomial for each joint."""
        joints = self.acting(len(form.joints))
        for place, (j, *range_of) in enumerate(zip(joints, self.centres or (), self.halves or (), strict=True)):
            powers = self.powers(values[place :: len(joints)])
            form.curve(j, Shape.POLYNOMIAL, 1.0, constants=tuple(range_of), powers=powers)


@dataclass(frozen=True)
class UnknownField(Effect):
    """The tool is shifted, along the base axes, by a polynomial of its nominal place p up to ``degree``.

    Of the linear part only the strain: its rotations belong to the base frame, as does the constant. p is divided by
    ``reach_m`` (the robot's own length when not given), so an amplitude is the shift in m at full reach.
    """

    id = "unknown_field"
    summary = "smooth error field in the workspace without a known cause"
    physical = SHAPE
    source = "empirical: strain and monomials of second degree of the tool point"
    aliases = ("measurement_scale", "thermal_growth", "base_compliance")
    remedy = "measure a grid of tool points, each reached with several postures of the arm"
    stage = "base"
    empirical = True
    at_joints = False

    degree: int = option(2, "Degree of the polynomial, 1 to 3.", low=1, high=3)
    reach_m: float | None = option(
        None, "Length by which positions are scaled, m, above 0; null: from the robot.", above=0.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.degree not in (1, 2, 3):
            raise OptionError(f"unknown_field has degree {self.degree!r}: give 1, 2 or 3.", effect=self.id)

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Measure the robot's reach: the sum of its links and tool."""
        if self.reach_m is not None:
            return self
        reach = np.linalg.norm(robot.chain.link_vectors, axis=1).sum() + np.linalg.norm(robot.T_tool[:3, 3])
        return replace(self, reach_m=float(reach) or 1.0)

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes, m: strains (``field_x_y`` is symmetric), then each component by monomial (``field_x_yz``)."""
        names = ["field_" + "xyz"[a] + "_" + "".join("xyz"[b] for b in powers) for a, powers in self._terms()]
        return tuple(Parameter(name, "m", 0.0, 5e-4, -0.01, 0.01, "shift at full reach") for name in names)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of the base frame and its derivatives by the amplitudes."""
        p = batch.tool_point / (self.reach_m or 1.0)
        shifts = np.zeros((len(self._terms()), len(batch), 6))
        for shift, (a, powers) in zip(shifts, self._terms(), strict=True):
            shift[:, a] = np.prod(p[:, powers], axis=1)
            if len(powers) == 1:
                shift[:, powers[0]] = p[:, a]
        return frame_twists(batch, values, BASE, shifts)

    def _terms(self) -> list[tuple[int, tuple[int, ...]]]:
        """Component and factors of each term."""
        strains = [(a, (b,)) for a, b in combinations_with_replacement(range(3), 2)]
        higher = [c for degree in range(2, self.degree + 1) for c in combinations_with_replacement(range(3), degree)]
        return strains + [(a, powers) for powers in higher for a in range(3)]


@dataclass(frozen=True)
class UnknownJointCurve(Effect):
    """dq = Σ a_m sin mq + b_m cos mq over the ``orders`` m, plus d sin q sin q_p when there is a ``partner`` p.

    Orders 1 and 2 have physical causes with names of their own. For the product alone give no orders: ``orders=()``.
    """

    id = "unknown_joint_curve"
    summary = "error curve of a joint without a known cause"
    physical = JOINT_CURVE
    source = "empirical: cyclic orders 3 to 6, and the product of the sines of two joints"
    aliases = ("second_harmonic", "gear_error")
    remedy = "sweep the joint alone in small steps in both directions, and look at the curve"
    empirical = True
    counted = ("joints", "partner")

    orders: tuple[int, ...] = option((3, 4, 5, 6), "Waves per revolution; empty: only the product with the partner.")
    partner: int | None = option(None, "Joint whose angle multiplies the curve, from 1; null: none.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.partner in (self.joints or ()):
            raise OptionError("unknown_joint_curve needs a partner other than the joint itself.", effect=self.id)
        if not self.orders and self.partner is None:
            raise OptionError("unknown_joint_curve needs orders, a partner, or both.", effect=self.id)

    @classmethod
    def candidate_configurations(cls, robot: Robot, rows: Observations) -> Sequence[Mapping[str, Any]]:
        """Order by order, and each product with a partner."""
        alone = [{"orders": (m,)} for m in cls().orders]
        return [*alone, *({"orders": (), "partner": p} for p in range(robot.n_joints))]

    @classmethod
    def together(cls, tried: Sequence[Self]) -> Sequence[tuple[Self, ...]]:
        """All orders at once."""
        waves = tuple(one for one in tried if one.orders)
        return [waves] if len(waves) > 1 else []

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Act on revolute joints, the partner aside."""
        if self.partner is None:
            return self.revolute(robot)
        UnknownJointCurve(joints=(self.partner,)).revolute(robot)  # the partner must exist, and be revolute
        chosen = UnknownJointCurve(joints=self.joints).revolute(robot).acting(robot.n_joints)
        return replace(self, joints=tuple(j for j in chosen if j != self.partner))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Amplitudes a_m then b_m per joint, order by order, then d; all rad."""
        stems = [f"curve_{wave}{m}" for m in self.orders for wave in ("sin", "cos")]
        stems += [] if self.partner is None else [f"curve_with{self.partner + 1}"]
        sigma, wide = math.radians(0.05), math.radians(0.5)
        made = (self.per_joint(robot, stem, "rad", sigma, -wide, wide, "empirical amplitude") for stem in stems)
        return tuple(p for stem in made for p in stem)

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivatives by the amplitudes."""
        signals = [wave(m * batch.q) for m in self.orders for wave in (np.sin, np.cos)]
        if self.partner is not None:
            signals.append(np.sin(batch.q) * np.sin(batch.q[:, [self.partner]]))
        return self.joint_angle(batch, values, *signals)

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add the waves, and the product with the partner."""
        joints = self.acting(len(form.joints))
        form.waves(joints, values, [[float(m) for m in self.orders]] * len(joints))
        if self.partner is not None:
            for j, value in zip(joints, values[len(values) - len(joints) :].tolist(), strict=True):
                form.curve(j, Shape.SINES, value, driver=self.partner)
        return True


MOST_CENTRES = 60
POSES_PER_CENTRE = 4
LEFT = 1e-4  # share of the variance at a pose below which another centre there teaches nothing
SLIDE_M = 0.3  # of a prismatic joint that moves freely: as far as a radian; else a third of its range


@dataclass(frozen=True)
class UnknownResidual(Effect):
    """The tool is shifted, along the base axes, by a Gaussian process on the joints the effect ``inputs``.

    Its kernel is exp(-d² / 2 length²), where d² sums 4 sin²(Δ/2) over revolute joints and (Δ/travel)² over prismatic joints.
    Carried by ``centres`` M of the poses (greedily those it is least sure of), it is a network of M radial basis functions
    whose weights are independent with the deviation ``amplitude_m``: the fit's priors make it the process's posterior mean.
    Far from all centres the shift returns to zero.
    """

    id = "unknown_residual"
    summary = "what no effect explains, learned from the joint angles"
    physical = SHAPE
    source = "thesis 2.3.3: radial basis functions on the joint angles; Gaussian process with few centres"
    stage = "base"
    empirical = True
    at_joints = False
    learned = True
    aliases = ("unknown_field", "unknown_joint_curve")
    remedy = "measure more poses where the arm works: what is learned holds only near the poses it was learned from"
    counted = ("joints", "inputs")

    inputs: tuple[int, ...] | None = option(None, "Joints it depends on, from 1; null: all.")
    length: float | None = option(
        None,
        "Distance over which poses are similar, rad (prismatic joints: thirds of their travel), above 0; null: half the "
        "median distance.",
        above=0.0,
    )
    amplitude_m: float = option(3e-4, "Standard deviation of the shift, m, above 0.", above=0.0)
    most_centres: int = option(MOST_CENTRES, "Most centres of the basis.", low=1)
    centres: tuple[tuple[float, ...], ...] = option(
        (),
        "Centres of the basis, a row of joint values (rad; prismatic joints in thirds of their travel) for each; empty: "
        "from the rows.",
    )
    slides_m: tuple[float, ...] = option((), "Travel that scales each prismatic joint, m; empty: from the rows.")

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("length", "amplitude_m", "most_centres"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise OptionError(f"unknown_residual has {name} {value!r}: it must be above 0.", effect=self.id)
        width = {len(centre) for centre in self.centres} | ({len(self.inputs)} if self.inputs else set())
        if len(width) > 1:
            raise OptionError("unknown_residual needs one number per input joint in every centre.", effect=self.id)

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Name the joints, take half the median distance of the poses as the length, and place the centres among them."""
        inputs = tuple(range(robot.n_joints)) if self.inputs is None else self.inputs
        self.refuse_unknown(robot, inputs)
        slides = self.slides_m or tuple(_slide(robot, j) for j in inputs)
        named = replace(self, inputs=inputs, slides_m=slides)
        if self.centres or rows is None:
            return named
        q = np.unique(rows.q[:, list(inputs)], axis=0)
        sized = named if self.length is not None else replace(named, length=0.5 * _median(named._distance2(q, q)))
        return replace(sized, centres=tuple(tuple(float(v) for v in q[k]) for k in sized._spread(q)))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Weights ``residual_<x|y|z>_<centre>``, m.

        Raises:
            OptionError: no centres are known.

        """
        if not self.centres or self.length is None:
            raise OptionError(
                "unknown_residual needs poses to place its centres: identify it from observations.", effect=self.id
            )
        wide = 20.0 * self.amplitude_m
        return tuple(
            Parameter(f"residual_{axis}_{k + 1}", "m", 0.0, self.amplitude_m, -wide, wide, "learned weight, no cause")
            for k in range(len(self.centres))
            for axis in "xyz"
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Shift of the base frame and its derivatives by the weights."""
        basis = self.basis(batch.q[:, list(self.inputs or ())])
        shifts = np.zeros((basis.shape[1], 3, len(batch), 6))
        for axis in range(3):
            shifts[:, axis, :, axis] = basis.T
        each = (shifts[k, axis] for k in range(len(shifts)) for axis in range(3))
        return frame_twists(batch, values, BASE, each)

    def basis(self, q: Floats) -> Floats:
        """Functions (N, M) of the inputs ``q (N, inputs)``, whitened: unit weights give the process unit variance."""
        centres = np.array(self.centres)
        own = self._kernel(centres, centres) + 1e-9 * np.eye(len(centres))
        whiten = np.linalg.inv(np.linalg.cholesky(own)).T
        return np.asarray(np.einsum("nm,mk->nk", self._kernel(q, centres), whiten))

    def _kernel(self, a: Floats, b: Floats) -> Floats:
        return np.asarray(np.exp(-0.5 * self._distance2(a, b) / (self.length or 1.0) ** 2))

    def _distance2(self, a: Floats, b: Floats) -> Floats:
        """Squared distances (N, M)."""
        slides = np.array(self.slides_m)
        apart = a[:, None, :] - b[None, :, :]
        turned = 2.0 * np.sin(0.5 * apart)
        return np.asarray(np.sum(np.where(slides > 0.0, apart / np.where(slides > 0.0, slides, 1.0), turned) ** 2, -1))

    def _spread(self, q: Floats) -> list[int]:
        """Poses, one after the other, at which the process knows least given those before (pivoted Cholesky)."""
        count = max(1, min(self.most_centres, len(q) // POSES_PER_CENTRE))
        left, picked = np.ones(len(q)), list[int]()
        columns = np.zeros((len(q), count))
        for k in range(count):
            best = int(np.argmax(left))
            if left[best] < LEFT:
                break
            column = self._kernel(q, q[[best]])[:, 0] - columns[:, :k] @ columns[best, :k]
            columns[:, k] = column / math.sqrt(left[best])
            left = np.maximum(left - columns[:, k] ** 2, 0.0)
            left[best] = 0.0
            picked.append(best)
        return picked


def _slide(robot: Robot, j: int) -> float:
    """Travel (m) of a prismatic joint that counts as a radian; 0 for a revolute joint."""
    if robot.joints[j].kind != "prismatic":
        return 0.0
    travel = float(np.ptp(robot.limits[j]))
    return travel / 3.0 if np.isfinite(travel) and travel > 0.0 else SLIDE_M


def _median(distance2: Floats) -> float:
    """Median distance of different poses, 1 where there is only one."""
    off = distance2[np.triu_indices(len(distance2), 1)]
    return math.sqrt(float(np.median(off))) or 1.0 if len(off) else 1.0
