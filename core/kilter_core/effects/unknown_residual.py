"""Residual learner: whatever no effect explains, as a smooth function of the joint angles. A shape, never a cause."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import BASE, Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import SHAPE
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

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
        return linear(batch, values, [Derivative(k, BASE, xi=xi) for k, xi in enumerate(each)])

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
