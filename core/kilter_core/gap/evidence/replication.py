"""Was it seen again: the named effects on a campaign of another day, set-up or payload, with nothing selected there.

Base and tool are fitted to the confirmation; the chain and all other effects stay at what the search found, within their
covariance; the amplitude of one effect at a time is fitted again. Replicated is what differs from zero there at 1 % and
agrees with the search within three combined standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg
from scipy.special import chdtrc
from scipy.stats import norm

from kilter_core.arm.robot import Robot
from kilter_core.effects import Effect
from kilter_core.effects.laws import LawOfTime
from kilter_core.errors import CoreError, ObservationError, TooFewPosesError
from kilter_core.gap.evidence.fits.final_fit import Posterior
from kilter_core.gap.evidence.guarded import Guarded
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.linear.settings import tail
from kilter_core.gap.search.prepare import SPARE, Prepared, prepare_data
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import has_contacts
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.shared_rows import refuse_shared_rows
from kilter_core.parameters import display_unit_and_scale, mm
from kilter_core.types import Floats, Progress

NONZERO = 0.01  # chance of calling an effect seen again that is not there
AGREES = 3.0  # combined standard deviations within which two amplitudes are one
ELSEWHEN = "It goes with the clock of the search: a campaign on another clock does without it."
ONCE = "It happened once, in the rows of the search: another campaign cannot show it again, and comes after it."
WORSE = "It predicts the confirmation worse than the search's fit without it."
SAME_SIZE = 0.5  # share of the larger of two amplitudes by which they may differ where deviations say too little
UNEXPLAINED = 0.01  # chance below which noise does not explain what is left there
WIDE = 1e4  # prior sigmas: amplitudes are fitted again, without a prior
BALL = 3  # numbers of the ball, where contacts hold it: the base has no place
FRAMES = 9  # numbers of base and tool that a set-up has of its own, with points; three more with orientations


@dataclass(frozen=True)
class Replication:
    """What a confirmation says of one effect: amplitudes with deviations (SI), p of zero, distance in sigmas."""

    names: tuple[str, ...]
    values: Floats
    sigma: Floats
    p_value: float | None
    apart: float | None
    reason: str = ""  # why nothing can be said
    guarded: Guarded | None = None  # errors there with and without the effect
    differs: float | None = None  # share of the larger amplitude; None where noise explains all that is left there

    @property
    def testable(self) -> bool:
        """Whether the confirmation can show it at all."""
        return self.p_value is not None

    @property
    def of_other_size(self) -> bool:
        """Whether the two amplitudes cannot be one.

        Where something else is left, deviations say too little of amplitudes (the delay of a real arm, 2.9 ms in two motions,
        differed by four of them). There they are one where they differ by less than half of the larger.
        """
        return self.apart is not None and self.apart > AGREES and (self.differs is None or self.differs > SAME_SIZE)

    @property
    def is_contradicted(self) -> bool:
        """Whether the effect makes the prediction there worse; where nothing tells, or no better, whether its size differs."""
        better = self.guarded is not None and self.guarded.better
        return self.testable and (self.worse or (self.of_other_size and not better))

    @property
    def worse(self) -> bool:
        """Whether the confirmation is predicted worse with the effect than without it."""
        return self.guarded is not None and self.guarded.with_it > self.guarded.without

    @property
    def is_replicated(self) -> bool:
        """Whether the effect was seen again with the same amplitude, and predicts what was measured there better."""
        return self.p_value is not None and self.p_value < NONZERO and not self.worse and not self.of_other_size

    @property
    def certain(self) -> bool:
        """Whether it was seen again beyond chance with the same amplitude, and predicts the confirmation better.

        That another day shows it is evidence of its own, which needs neither held-out poses nor halves of the search.
        """
        return self.is_replicated and self.guarded is not None

    @property
    def outcome(self) -> str:
        """One word for it."""
        if not self.testable:
            return "not_testable"
        if self.is_contradicted:
            return "contradicted"
        return "other_size" if self.of_other_size else "replicated" if self.is_replicated else "not_seen"

    def to_document(self, robot_units: dict[str, str]) -> dict[str, Any]:
        """Wire units; ``robot_units`` are the SI units of the parameters by name."""
        rows, told = [], self.guarded if self.guarded is not None and self.guarded.length else None
        for name, value, sigma in zip(self.names, self.values, self.sigma, strict=True):
            unit, scale = display_unit_and_scale(robot_units[name])
            rows.append({"name": name, "value": float(value) * scale, "unit": unit, "sigma": float(sigma) * scale})
        return {
            "outcome": self.outcome,
            "parameters": rows,
            "p_value": self.p_value,
            "apart_sigma": self.apart,
            "reason": self.reason or (WORSE if self.worse else None),
            "with_mm": None if told is None else mm(told.with_it),
            "without_mm": None if told is None else mm(told.without),
        }


def refuse_unfit(robot: Robot, searched: Observations, confirmation: Observations) -> None:
    """Refuse a confirmation that cannot be one, before anything is searched.

    Raises:
        ObservationError: rows of another robot, or ``rows_shared``. TooFewPosesError: fewer poses than base, tool and
        an amplitude need.

    """
    if confirmation.q.shape[1] != robot.n_joints:
        raise ObservationError(
            f"The confirmation has {confirmation.q.shape[1]} joints, robot {robot.name!r} has {robot.n_joints}: name a "
            "campaign of this robot."
        )
    refuse_shared_rows(searched, confirmation, "confirmation")
    if confirmation.position is None and confirmation.markers is None and not has_contacts(confirmation):
        return
    measured = Measurement.from_observations(confirmation, held=True)
    frames = BALL if not measured.observes_places else FRAMES + 3 * measured.observes_orientation
    needed = -(-(frames + 1 + SPARE) // measured.equations_per_pose)
    if measured.numbers() < (frames + 1 + SPARE):
        raise TooFewPosesError(
            f"The confirmation has {int(confirmation.pose_groups().max()) + 1} poses: base, tool and one amplitude need "
            f"at least {needed}. Measure more, 20 or more are worth while."
        )


@dataclass(frozen=True)
class Confirmation:
    """The confirmation's rows as a linearised problem around the values of the search: whitened, base and tool taken out.

    ``r (R,)`` is what the searched model leaves, ``J (R, K)`` moves by the parameters ``names`` whose covariance of the
    search is ``covariance (K, K)``; ``nu`` numbers are free, the noise is known as well as ``freedom`` numbers know it.
    """

    r: Floats
    J: Floats
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    nu: float
    freedom: float
    poses: int

    @staticmethod
    def from_observations(
        found: Calibration, posterior: Posterior, rows: Observations, options: GapOptions, progress: Progress
    ) -> Confirmation:
        """Fit base and tool to the rows, estimate their noise, and linearise."""
        found = _computable(found, rows).for_another_campaign(rows)
        prepared = _fit_base_and_tool(found, rows, options, progress)
        problem = prepared.problem
        r, J, names = _linear(prepared, found, posterior)
        known = {name: k for k, name in enumerate(posterior.names)}
        index = [known[name] for name in names]
        at = {name: k for k, name in enumerate(found.names)}
        free = _taken_out(problem)
        r, J = r - free @ (free.T @ r), J - free @ (free.T @ J)
        noise = problem.settings.noise
        scalars = float(problem.settings.used.sum() * problem.settings.whitener.shape[-1] / problem.settings.inflation)
        return Confirmation(
            r,
            J,
            names,
            found.values[[at[name] for name in names]],
            posterior.covariance[np.ix_(index, index)],
            scalars - free.shape[1],
            noise.freedom if noise.absolute else scalars - free.shape[1],
            int(problem.settings.group.max()) + 1,
        )

    def of_parameters(self, own: tuple[str, ...], widths: Floats, positive: bool) -> Replication:
        """Fit the parameters ``own`` again, everything else within its covariance; ``widths`` are their prior sigmas."""
        k = [self.names.index(name) for name in own]
        rest = [m for m in range(len(self.names)) if m not in k]
        L = _root(self.covariance[np.ix_(rest, rest)])
        X, Z = self.J[:, k] * widths, self.J[:, rest] @ L
        inner = np.linalg.inv(np.eye(Z.shape[1]) + Z.T @ Z)
        XV = X.T - (X.T @ Z) @ inner @ Z.T  # X' V^-1 with V = I + Z Z'
        S = np.linalg.inv(XV @ X + np.eye(len(k)) / WIDE**2)
        K = S @ XV
        step = K @ self.r
        left = self.r - X @ step
        chi = float(left @ left - (left @ Z) @ inner @ (Z.T @ left))
        nu = max(self.nu - len(k), 1.0)
        grown = max(1.0, chi / nu)  # what the noise does not explain there widens everything
        C = self.covariance / np.outer(self._scales(k, widths), self._scales(k, widths))
        cross = K @ self.J[:, rest] @ self.covariance[np.ix_(rest, k)] / widths
        wide = np.asarray(S * grown, dtype=np.float64)
        both = wide + C[np.ix_(k, k)] + cross + cross.T
        values = self.values[k] / widths + step
        p = _tail(values, wide, self.freedom)
        sizes = [float(v @ np.linalg.solve(S, v)) for v in (step, values, values - step)]
        differs = float(np.sqrt(sizes[0] / max(*sizes[1:], 1e-300))) if chdtrc(nu, chi) < UNEXPLAINED else None
        p = 0.5 * p if positive and len(k) == 1 and values[0] > 0.0 else 1.0 if positive and len(k) == 1 else p
        apart = float(norm.isf(max(_tail(step, _positive(both), self.freedom), 1e-300) / 2.0))
        return Replication(own, values * widths, np.sqrt(np.diag(wide)) * widths, float(p), apart, differs=differs)

    def _scales(self, k: list[int], widths: Floats) -> Floats:
        out = np.ones(len(self.names))
        out[k] = widths
        return out


def replication(
    confirmation: Confirmation, robot: Robot, rows: Observations, candidate: Candidate, seen: tuple[int, ...] | None
) -> Replication:
    """What the confirmation says of a candidate, at the joints where the search saw it (None: it acts at none)."""
    parts = [e for e in candidate.effects if seen is None or not e.joints or set(e.joints) & set(seen)]
    parameters = [p for e in parts or candidate.effects for p in e.parameters(robot) if p.name in confirmation.names]
    names = tuple(p.name for p in parameters)
    if candidate.effects[0].event:
        return Replication((), np.zeros(0), np.zeros(0), None, None, ONCE)
    missing = _missing(candidate.effects[0], rows)
    if missing or not names:
        elsewhen = ELSEWHEN if isinstance(candidate.effects[0], LawOfTime) else "It is part of no stored model."
        why = f"The confirmation has no {' and no '.join(missing)}." if missing else elsewhen
        return Replication((), np.zeros(0), np.zeros(0), None, None, why)
    return confirmation.of_parameters(names, np.array([p.prior_sigma for p in parameters]), candidate.positive)


def _missing(effect: Effect, rows: Observations) -> list[str]:
    """Columns that an effect needs and the rows do not have."""
    return sorted(effect.needs - {"moments"} - set(rows._present()))


def _computable(found: Calibration, rows: Observations) -> Calibration:
    """The version less the effects that the rows have no columns for; what they leave widens everything else."""
    kept = tuple(e for e in found.model.effects if not _missing(e, rows))
    if len(kept) == len(found.model.effects):
        return found
    model = replace(found.model, effects=kept)
    known = dict(zip(found.names, found.values, strict=True))
    return replace(found, model=model, values=np.array([known[name] for name in model.names]))


def _fit_base_and_tool(found: Calibration, rows: Observations, options: GapOptions, progress: Progress) -> Prepared:
    """The confirmation with base and tool fitted to it, chain and effects as the search left them."""
    effects = found.names[found.model.n_geometric :]
    fixed = replace(
        options,
        free=("tool_x" if has_contacts(rows) else "base_x",),
        fix=effects,
        base="free",
        tool="free",
        reference="auto",
        effects=(),
    )
    try:
        return prepare_data(found, rows, fixed, progress)
    except CoreError as error:
        error.message = f"The confirmation cannot be used. {error.message}"
        raise


def _linear(prepared: Prepared, found: Calibration, posterior: Posterior) -> tuple[Floats, Floats, tuple[str, ...]]:
    """Whitened residual at the values of the search, derivatives by its parameters but base and tool, their names."""
    problem, source = prepared.problem, prepared.problem.settings.source
    kept = set(found.names)  # laws of time stay behind where the clock is another, and the library has them again
    G, names, moved = source.by_version(problem.values, found, [name for name in posterior.names if name in kept])
    J = problem.settings.whitening.columns(G)
    return problem.raw + J @ moved, J, tuple(names)


def _taken_out(problem: LinearizedProblem) -> Floats:
    """Orthonormal basis of what is fitted to the confirmation: base and tool, or the zeros of the instrument."""
    columns = problem.settings.source.own_zeros(problem.G)
    if columns is None:
        return problem.basis([])
    u, s, _ = scipy.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s.max(initial=1e-300)])


def _tail(values: Floats, covariance: Floats, freedom: float) -> float:
    """Chance of values so far from zero; an F tail where the noise is known from finitely many numbers."""
    return float(tail(values @ np.linalg.solve(covariance, values), len(values), freedom))


def _root(covariance: Floats) -> Floats:
    w, V = np.linalg.eigh(covariance)
    return np.asarray(V * np.sqrt(np.maximum(w, 0.0)))


def _positive(covariance: Floats) -> Floats:
    w, V = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((V * np.maximum(w, 1e-12 * max(float(w[-1]), 1e-300))) @ V.T)
