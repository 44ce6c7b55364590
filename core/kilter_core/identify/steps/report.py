"""The result of an identification: what each step found, and the document that people read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from kilter_core.errors import FindingDocument
from kilter_core.identify.carried_masses import beside_masses, describe_masses
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fit.robust import RowErrors, set_aside
from kilter_core.identify.fleet_prior import FleetPrior
from kilter_core.identify.fleet_report import prior_document
from kilter_core.identify.holdout import Learned
from kilter_core.identify.identifiability import STRUCTURAL, NullDirection, load_rows, null_directions
from kilter_core.identify.measured_rows import Repeats, Shares, parameter_influence, squared_errors_by_kind
from kilter_core.identify.options import IdentifyOptions
from kilter_core.identify.reference import frame_sources
from kilter_core.identify.registry import METHODS
from kilter_core.identify.report import known_of_fit, null_rows, parameter_rows
from kilter_core.identify.setup_frames import OwnFrame
from kilter_core.identify.steps.findings import Outcome, list_findings
from kilter_core.identify.uncertainty.predictive import Predictive, residual_sigma
from kilter_core.identify.uncertainty.stated_noise import BeyondNoise, Intervals
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import degrees, mm
from kilter_core.types import Floats, Ints

INFLUENCE_ROWS = 500

CORRELATED = 0.9  # absolute correlation from which two parameters are said to go together


@dataclass(frozen=True)
class Identification:
    """Result of an identification; ``metrics`` as in the contract, ``covariance (F, F)`` SI."""

    calibration: Calibration
    fit: Fit
    metrics: dict[str, Any]
    noise_m: float
    noise_source: str
    repeats: Repeats
    predictive: Predictive
    null_directions: tuple[NullDirection, ...]
    warnings: tuple[FindingDocument, ...]
    method: str = "least_squares"
    influence: list[dict[str, Any]] | None = None
    intervals: Intervals | None = None
    learned: Learned | None = None
    masses: dict[str, Any] | None = None  # how they were taken, where an effect follows the load
    own_frames: tuple[OwnFrame, ...] = ()
    inside: Ints | None = None  # rows of those given that were fitted, all when None
    fitted_rows: RowErrors | None = None
    kinds: dict[str, Any] = field(default_factory=dict)  # what each kind of measurement says
    beyond: BeyondNoise | None = None  # more than the stated noise is left
    views: dict[str, Any] = field(default_factory=dict)  # cameras and boards, and what their views say of the tool
    fleet: FleetPrior | None = None  # what was known of the type, whether it was believed or not
    held_rows: RowErrors | None = None  # of the validation when that is rows of its own, else of those given

    @property
    def scale(self) -> tuple[float, float]:
        """Standard deviations (m, rad) of points and rotations by which residuals were weighted."""
        return float(np.mean(self.fit.problem.weights.points)), float(np.mean(self.fit.problem.weights.turns))

    @property
    def set_aside(self) -> list[dict[str, Any]]:
        """Rows of those given, counted from 0, that count less than half in the fit."""
        found = set_aside(self.fit)
        return found if self.inside is None else [{**one, "row": int(self.inside[one["row"]])} for one in found]

    @property
    def load_model(self) -> list[dict[str, Any]]:
        """Masses and centres as stated and as found, where load errors were carried."""
        return load_rows(self.calibration, self.fit.names, self.fit.sigma, self.fit.problem.prior_sigma)

    @property
    def covariance(self) -> Floats:
        """Posterior covariance of the free parameters, SI."""
        return self.fit.covariance

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of the covariance."""
        return self.fit.names

    def to_document(self) -> dict[str, Any]:
        """The identify result of the contract: mm, degrees, names, units."""
        by_views = "pixels" in self.views  # their noise is in px: the length that weighs them means nothing
        return {
            "parameters": parameter_rows(self.calibration, self.fit, self.intervals),
            "scale": {"point_mm": mm(self.scale[0]), "turn_deg": float(degrees(self.scale[1]))},
            "set_aside": self.set_aside,
            "null_directions": null_rows(self.null_directions, known_of_fit(self.calibration, self.fit)),
            "metrics": self.metrics,
            "noise_mm": None if by_views else mm(self.noise_m),
            "noise_source": None if by_views else self.noise_source,
            "noise": {
                "residuals_mm": None if by_views else mm(residual_sigma(self.fit)),
                "inadequacy_mm": mm(self.predictive.inadequacy),
                **self.repeats.to_document(),
            },
            "warnings": list(self.warnings),
            "iterations": self.fit.iterations,
            "method": {"name": self.method, **self.fit.report},
            "influence": self.influence,
            "intervals": None if self.intervals is None else self.intervals.kind,
            "learned": None if self.learned is None else self.learned.to_document(),
            "load_model": self.load_model,
            "masses": self.masses,
            **_describe_observability(self.fit),
            **self.kinds,
            **{
                f"{which}_refitted": [frame.to_document() for frame in self.own_frames if frame.which == which]
                for which in ("base", "tool")
            },
            "reference": frame_sources(self.calibration),
            "prior": None if self.fleet is None else prior_document(self.fleet, self.fit),
            **self.views,
        }


def assemble_identification(outcome: Outcome, metrics: dict[str, Any]) -> Identification:
    """The result with all that is said about it."""
    study, fitted, held, known = outcome.study, outcome.fitted, outcome.held, outcome.known
    arm, fit, measurement, options = fitted.arm, known.arm_fit, fitted.measurement, study.options
    rows = _influence_rows(study.train, options)
    by_kind = squared_errors_by_kind(fitted.stages, measurement)
    by_row = RowErrors.from_stages(fitted.stages, measurement, np.arange(len(study.train)))
    frames = () if study.frames is None else study.frames.fitted_frames(fitted.stages["identified"])
    sigma = known.repeats.between
    return Identification(
        calibration=arm,
        fit=fit,
        metrics=metrics,
        noise_m=float(np.mean(fit.problem.weights.points)) if sigma is None else sigma,
        noise_source="residuals of the fit" if sigma is None else "repeats",
        repeats=known.repeats,
        predictive=known.predictive,
        null_directions=null_directions(*beside_masses(fit)),
        warnings=list_findings(outcome),
        method=options.method,
        influence=parameter_influence(arm, rows, fit.names).to_document() if fit.names else [],
        intervals=known.intervals,
        learned=fitted.learned,
        masses=describe_masses(arm.robot, arm.model.effects, options, known.masses),
        own_frames=(*frames, *held.own_frames),
        inside=study.inside,
        fitted_rows=by_row.with_row_numbers(study.inside),
        kinds=Shares.from_fit(fitted.fit, fit.names).to_document(by_kind, held.kinds),
        beyond=known.beyond,
        views=known.views,
        fleet=study.fleet,
        held_rows=held.rows,
    )


def _influence_rows(train: Observations, options: IdentifyOptions) -> Observations:
    """Rows to say the influence at: all where the method weighs by it, else so many that it costs little beside the fit."""
    if METHODS[options.method].weighs_by_influence or len(train) <= INFLUENCE_ROWS:
        return train
    return train.select(np.unique(np.linspace(0, len(train) - 1, INFLUENCE_ROWS).astype(int)))


def _describe_observability(fit: Fit) -> dict[str, Any]:
    """Observability of the poses, per prior sigma and in mm, and the parameters that go together."""
    millimetre = mm(float(np.mean(fit.problem.weights.points)))
    poses = int(fit.problem.measurement.observations.pose_groups().max()) + 1
    groups = correlated_groups(fit.covariance, fit.names)
    J, _, prior_sigma = beside_masses(fit)
    return {
        "observability": observability(J * prior_sigma * millimetre, poses).to_document(),
        "correlated_groups": [{"parameters": list(g.names), "correlation": g.strongest} for g in groups],
    }


@dataclass(frozen=True)
class Observability:
    """Indices O1 to O5 of the singular values of the Jacobian that are not zero, ``rank`` of ``parameters`` of them."""

    o1: float
    o2: float
    o3: float
    o4: float
    o5: float
    rank: int
    parameters: int

    def to_document(self) -> dict[str, float | int]:
        """Numbers by name; O1, O3, O4 and O5 in the unit of the Jacobian."""
        return {
            "O1": self.o1,
            "O2": self.o2,
            "O3": self.o3,
            "O4": self.o4,
            "O5": self.o5,
            "rank": self.rank,
            "parameters": self.parameters,
        }


def observability(J: Floats, poses: int) -> Observability:
    """Indices of a Jacobian (R, P) whose columns are scaled to be comparable.

    With singular values s_1 >= ... >= s_L and m poses: O1 = (s_1 ... s_L)^(1/L) / sqrt(m) (Borm and Menq),
    O2 = s_L / s_1 (Driels and Pathre), O3 = s_L and O4 = s_L² / s_1 (Nahvi and Hollerbach),
    O5 = 1 / (1/s_1 + ... + 1/s_L) (Sun and Hollerbach). Structural zeros are left out, for they would make all indices
    zero whatever the poses; ``rank`` says how many remain.
    """
    s = np.linalg.svd(np.linalg.qr(J, mode="r") if len(J) > J.shape[1] else J, compute_uv=False)
    seen = s[s > STRUCTURAL * max(float(s.max(initial=0.0)), np.finfo(float).tiny)]
    if len(seen) == 0:
        return Observability(0.0, 0.0, 0.0, 0.0, 0.0, 0, J.shape[1])
    first, last = float(seen[0]), float(seen[-1])
    return Observability(
        o1=float(np.exp(np.mean(np.log(seen)))) / poses**0.5,
        o2=last / first,
        o3=last,
        o4=last**2 / first,
        o5=1.0 / float(np.sum(1.0 / seen)),
        rank=len(seen),
        parameters=J.shape[1],
    )


@dataclass(frozen=True)
class CorrelatedGroup:
    """Parameters linked by correlations of at least ``CORRELATED``; ``strongest`` is the largest of them in size."""

    names: tuple[str, ...]
    strongest: float


def correlated_groups(covariance: Floats, names: Sequence[str], limit: float = CORRELATED) -> list[CorrelatedGroup]:
    """Groups of two or more parameters of a covariance (P, P), the most strongly linked first."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(sigma > 0.0, sigma, 1.0)
    correlation = covariance / np.outer(safe, safe)
    np.fill_diagonal(correlation, 0.0)
    count, label = connected_components(np.abs(correlation) >= limit, directed=False)
    groups = []
    for group in range(count):
        inside = [int(k) for k in np.flatnonzero(label == group)]
        if len(inside) > 1:
            part = correlation[np.ix_(inside, inside)]
            strongest = float(part.reshape(-1)[np.argmax(np.abs(part))])
            groups.append(CorrelatedGroup(tuple(names[k] for k in inside), strongest))
    return sorted(groups, key=lambda g: -abs(g.strongest))
