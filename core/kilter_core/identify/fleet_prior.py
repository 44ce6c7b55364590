"""The prior of a type of arm, and which versions may carry it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import fdtrc

from kilter_core.arm.robot import Robot
from kilter_core.errors import CoreError
from kilter_core.identify.measured_rows import measurement_for
from kilter_core.identify.options import IdentifyOptions
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import CorrelatedPrior
from kilter_core.types import Floats, Ints

# Mean and covariance of the arms of a type from a version of each: restricted maximum likelihood, and shrinkage.
#
# Each version knows its own parameters with a covariance of its own, so what versions differ by is two things: what
# arms differ by, and what their fits do not know. Restricted likelihood (Patterson and Thompson 1971; Harville 1977)
# tells them apart without the bias of having estimated the mean, and expectation-maximisation (Laird and Ware 1982)
# climbs it without ever leaving covariances. A few arms cannot say how dozens of parameters correlate: the
# covariance is drawn towards a diagonal one, as an inverse Wishart prior of ``K`` arms would. Its variances are
# drawn towards what parameters of the same unit have in common (Smyth 2004).

ROUNDS = 500
SETTLED = 1e-4  # largest change of a standard deviation, as a share of it, that ends the climb
COMMON = 4.0  # arms that what parameters of one unit have in common counts for
FLOOR = 1e-6  # of the width of its ordinary prior that a parameter spreads by at least: arms are never exactly alike


@dataclass(frozen=True)
class Population:
    """Arms of a type: ``mean (K,)``, how well it is known ``mean_covariance (K, K)``, and ``between (K, K)``, their spread."""

    mean: Floats
    mean_covariance: Floats
    between: Floats

    @property
    def of_another(self) -> Floats:
        """Covariance (K, K) of one more arm about the mean."""
        return self.between + self.mean_covariance


def population(values: Floats, within: Floats, groups: Ints, strength: float | None = None) -> Population:
    """Estimate a type from ``values (n, K)`` of n arms and the covariances ``within (n, K, K)`` of their fits.

    All are in widths of ordinary priors. ``groups (K,)`` number the units; ``strength`` is the number of arms that the
    diagonal target counts for, K when None; 0 leaves plain restricted likelihood.
    """
    count, size = values.shape
    weight = float(size) if strength is None else strength
    between = np.diag(np.maximum(np.var(values, axis=0, ddof=1), FLOOR**2))
    for _ in range(ROUNDS):
        before = np.sqrt(np.diag(between))
        between = _shrunk(_expected_scatter(values, within, between), count, groups, weight)
        after = np.sqrt(np.diag(between))
        if np.max(np.abs(after - before) / after) < SETTLED:
            break
    return Population(*_mean(values, within, between), between)


def _mean(values: Floats, within: Floats, between: Floats) -> tuple[Floats, Floats]:
    """Mean (K,) by generalised least squares, and its covariance (K, K)."""
    weights = np.linalg.inv(within + between)
    covariance = np.linalg.inv(weights.sum(axis=0))
    return np.asarray(covariance @ np.einsum("nij,nj->i", weights, values)), np.asarray(covariance)


def _expected_scatter(values: Floats, within: Floats, between: Floats) -> Floats:
    """Sum (K, K) over the arms of the expected products of their deviations, the mean's own doubt included."""
    weights: Floats = np.asarray(np.linalg.inv(within + between), dtype=np.float64)
    mean, covariance = _mean(values, within, between)
    deviations = np.einsum("ij,njk,nk->ni", between, weights, values - mean)
    unseen = (
        len(values) * between - between @ (weights.sum(axis=0) - _weights_lost_to_mean(weights, covariance)) @ between
    )
    return np.asarray(deviations.T @ deviations + unseen)


def _weights_lost_to_mean(weights: Floats, covariance: Floats) -> Floats:
    """What estimating the mean takes from the weights (K, K)."""
    return np.asarray(np.einsum("nij,jk,nkl->il", weights, covariance, weights, optimize=True))


def _shrunk(products: Floats, count: int, groups: Ints, weight: float) -> Floats:
    """Covariance (K, K) from summed products, drawn towards a diagonal whose variances are drawn towards their unit's."""
    own = np.maximum(np.diag(products) / count, FLOOR**2)
    common = (np.bincount(groups, own) / np.maximum(np.bincount(groups), 1))[groups]
    target = np.diag((count * own + COMMON * common) / (count + COMMON))
    made = (products + weight * target) / (count + weight)
    made.flat[:: len(made) + 1] = np.maximum(np.diag(made), FLOOR**2)
    return np.asarray(0.5 * (made + made.T))


FEWEST_ROBOTS = 5  # robots
KNOWN = 0.5  # of the width of its ordinary prior, within which a version tells a parameter


@dataclass(frozen=True)
class LeftOut:
    """A version that is of another gauge, and in which way."""

    robot: str
    version: str
    reason: str


@dataclass(frozen=True)
class LeftOneOut:
    """A robot as the others predict it: ``chi_square`` of its ``compared`` parameters, and the chance of one as large.

    ``explained`` is the share of its squared deviation from nominal, in widths of ordinary priors, that their mean takes off.
    """

    robot: str
    chi_square: float
    compared: int
    p_value: float
    explained: float


@dataclass(frozen=True)
class FleetPrior:
    """A type's prior, the ``versions`` that it rests on, those ``left_out``, and what each robot is to the others."""

    prior: CorrelatedPrior
    versions: tuple[FleetVersion, ...]
    left_out: tuple[LeftOut, ...] = ()
    left_one_out: tuple[LeftOneOut, ...] = ()

    def to_document(self) -> dict[str, Any]:
        """JSON-able: whose versions it rests on, and how well they predict each other."""
        return {
            "versions": [{"robot": v.robot, "version": v.version} for v in self.versions],
            "left_out": [{"robot": v.robot, "version": v.version, "reason": v.reason} for v in self.left_out],
            "left_one_out": [
                {"robot": one.robot, "chi_square": one.chi_square, "compared": one.compared, "p_value": one.p_value}
                for one in self.left_one_out
            ],
        }


def fit_fleet_prior(model: RobotModel, free: Sequence[str], versions: Sequence[FleetVersion]) -> FleetPrior:
    """The prior of a fit of the parameters ``free`` of a ``model`` from ``versions`` of other robots, one of each.

    Raises:
        CoreError: ``fleet_too_few``: fewer than five robots of the type have a version. ``fleet_gauge``: fewer than five
            have one in the gauge of this fit; names those of another.

    """
    if len(versions) < FEWEST_ROBOTS:
        raise CoreError(
            f"Prior fleet needs versions of at least {FEWEST_ROBOTS} other robots of this type, and there are {len(versions)}: "
            "identify more of them without it, or leave the option prior out.",
            code="fleet_too_few",
            robots=[v.robot for v in versions],
        )
    asked = Gauge.from_model(model, free)
    reasons = [asked.differs(version.gauge) for version in versions]
    out = tuple(LeftOut(v.robot, v.version, r) for v, r in zip(versions, reasons, strict=True) if r is not None)
    kept = tuple(v for v, r in zip(versions, reasons, strict=True) if r is None)
    if len(kept) < FEWEST_ROBOTS:
        raise CoreError(
            f"Prior fleet needs versions of at least {FEWEST_ROBOTS} other robots in the gauge of this fit, and there are "
            f"{len(kept)}. {said_left_out(out)} Identify those robots with the same effects and the same free parameters as "
            "asked here, or ask here for theirs.",
            code="fleet_gauge",
            robots=[one.robot for one in out],
        )
    return FleetPrior(*_estimate_type_prior(model, kept), left_out=out)


def said_left_out(out: Sequence[LeftOut]) -> str:
    """Which versions are of another gauge, in words."""
    return " ".join(f"Version {one.version} of {one.robot} is in another gauge: {one.reason}." for one in out)


def _estimate_type_prior(
    model: RobotModel, versions: tuple[FleetVersion, ...]
) -> tuple[CorrelatedPrior, tuple[FleetVersion, ...]]:
    names, width, groups = _shared_parameters(model, versions)
    values, within = _scale_to_priors(versions, names, width)
    found = population(values, within, groups)
    covariance = found.of_another * np.outer(width, width)
    known = np.median(np.sqrt(np.diagonal(within, axis1=1, axis2=2)), axis=0) < KNOWN
    untold = tuple(name for name, told in zip(names, known, strict=True) if not told)
    return CorrelatedPrior(tuple(names), found.mean * width, covariance, _freedom(len(versions)), untold), versions


def _freedom(robots: int) -> float:
    """Degrees of freedom of what so many robots say of their spread, with what units have in common."""
    return robots - 1 + COMMON


def left_one_out(model: RobotModel, versions: Sequence[FleetVersion]) -> tuple[LeftOneOut, ...]:
    """Each robot as the others predict it."""
    names, width, groups = _shared_parameters(model, versions)
    values, within = _scale_to_priors(versions, names, width)
    nominal = np.array([model.parameter(name).value for name in names]) / width
    out = []
    for k, version in enumerate(versions):
        rest = np.arange(len(versions)) != k
        found = population(values[rest], within[rest], groups)
        out.append(
            _compare_left_out_robot(version.robot, found, values[k], within[k], nominal, _freedom(int(rest.sum())))
        )
    return tuple(out)


def _compare_left_out_robot(
    robot: str, found: Population, values: Floats, within: Floats, nominal: Floats, freedom: float
) -> LeftOneOut:
    away = values - found.mean
    square = float(away @ np.linalg.solve(found.of_another + within, away))
    before = float(np.sum((values - nominal) ** 2))
    explained = 1.0 - float(away @ away) / before if before > 0.0 else 0.0
    return LeftOneOut(robot, square, len(values), float(fdtrc(len(values), freedom, square / len(values))), explained)


def _shared_parameters(model: RobotModel, versions: Sequence[FleetVersion]) -> tuple[list[str], Floats, Ints]:
    """Names (K) of the type that every version was fitted for, the widths (K,) of their ordinary priors, their units (K,)."""
    names = [name for name in of_the_type(model) if all(name in version.names for version in versions)]
    parameters = [model.parameter(name) for name in names]
    units = sorted({p.unit for p in parameters})
    groups = np.array([units.index(p.unit) for p in parameters], dtype=np.int64)
    return names, np.array([p.prior_sigma for p in parameters]), groups


def _scale_to_priors(versions: Sequence[FleetVersion], names: Sequence[str], width: Floats) -> tuple[Floats, Floats]:
    """Values (n, K) and covariances (n, K, K) in widths of ordinary priors."""
    values, within = [], []
    for version in versions:
        own = [version.names.index(name) for name in names]
        values.append(version.values[own] / width)
        within.append(version.covariance[np.ix_(own, own)] / np.outer(width, width))
    return np.array(values), np.array(within)


def of_its_type(
    begin: Calibration, train: Observations, options: IdentifyOptions, versions: Sequence[FleetVersion] | None
) -> tuple[Calibration, FleetPrior | None]:
    """The calibration to fit from, whose model knows its type by ``versions`` of other robots; and that prior.

    Raises:
        CoreError: ``fleet_too_few``, ``fleet_gauge``: no prior from these versions.

    """
    if options.prior is None:
        return begin, None
    found = fit_fleet_prior(begin.model, free_parameter_names(begin, train, options), versions or ())
    found = replace(found, left_one_out=left_one_out(begin.model, found.versions))
    return replace(begin, model=replace(begin.model, of_type=found.prior)), found


def free_parameter_names(begin: Calibration, train: Observations, options: IdentifyOptions) -> list[str]:
    """Names of what a fit of these rows frees; views place base and tool by cameras and boards, which is the same gauge."""
    measurement = measurement_for(train, options, begin.marker_points)
    rotation, base = measurement.observes_orientation, measurement.observes_base
    free = options.free_parameters(begin.model, observes_orientation=rotation, observes_base=base)
    names = [begin.names[k] for k in free]
    return [*names, *(f"{frame}x" for frame in FRAMES)] if measurement.tool.places_itself else names


FRAMES = ("base_", "tool_")


@dataclass(frozen=True)
class Gauge:
    """What must agree for parameters to mean the same: the ``effects`` that were fitted, the ``frames`` that could take up
    what the chain has, the ``free`` parameters of chain and effects, and their ``units``.
    """

    effects: tuple[str, ...]
    frames: tuple[str, ...]
    free: frozenset[str]
    units: Mapping[str, str] = field(default_factory=dict)

    @staticmethod
    def from_model(model: RobotModel, free: Sequence[str]) -> Gauge:
        """Gauge of a fit of these parameters of a model; what only the measurement or the load has is left out."""
        own = set(of_the_type(model))
        effects = tuple(sorted(repr(e.to_document()) for e in model.effects if _of_the_arm(e)))
        frames = tuple(frame for frame in FRAMES if any(name.startswith(frame) for name in free))
        units = {p.name: p.unit for p in model.parameters if p.name in own}
        return Gauge(effects, frames, frozenset(own & set(free)), units)

    def differs(self, other: Gauge) -> str | None:
        """In which way another gauge differs from this one, in words; None where it does not."""
        if self.effects != other.effects:
            return "other effects were fitted, or with other options"
        for frame in FRAMES:
            if (frame in self.frames) != (frame in other.frames):
                there, here = ("fitted", "held") if frame in other.frames else ("held", "fitted")
                return f"the {frame[:-1]} was {there} there and is {here} here"
        for name in sorted(self.free & other.free):
            if self.units[name] != other.units[name]:
                return f"{name} is in {other.units[name]} there and in {self.units[name]} here"
        more, fewer = sorted(other.free - self.free), sorted(self.free - other.free)
        if more or fewer:
            said = [f"{_format_names(more)} {'was' if len(more) == 1 else 'were'} fitted there alone"] if more else []
            said += [f"{_format_names(fewer)} {'was' if len(fewer) == 1 else 'were'} not fitted there"] if fewer else []
            return ", ".join(said)
        return None


@dataclass(frozen=True)
class FleetVersion:
    """A version of another arm: ``values (K,)`` and ``covariance (K, K)`` SI of the parameters ``names`` it was fitted for."""

    robot: str
    version: str
    names: tuple[str, ...]
    values: Floats
    covariance: Floats
    gauge: Gauge

    @staticmethod
    def from_calibration(
        robot: str, version: str, calibration: Calibration, covariance: Mapping[str, Any]
    ) -> FleetVersion:
        """The version ``version`` of a ``robot`` from its calibration and the covariance that is stored with it."""
        names = tuple(covariance.get("names") or ())
        value = dict(zip(calibration.names, calibration.values, strict=True))
        matrix = np.array(covariance.get("matrix") or np.zeros((0, 0)), dtype=np.float64)
        values = np.array([float(value.get(name, 0.0)) for name in names])
        return FleetVersion(robot, version, names, values, matrix, Gauge.from_model(calibration.model, names))


def same_type(robot: Robot, other: Robot) -> bool:
    """Whether two robots are nominally one arm: the same joints on the same chain; base, tool and limits are their own."""
    return bool(
        [joint.kind for joint in robot.joints] == [joint.kind for joint in other.joints]
        and list(_chain(robot)) == list(_chain(other))
    )


def of_the_type(model: RobotModel) -> list[str]:
    """Parameters of a model that arms of a type share: where an arm stands and what it carries are its own."""
    names = list(model.names[6 : model.n_geometric - 6])
    for effect, where in model.effects_with_slices:
        names += model.names[where] if _of_the_arm(effect) else ()
    return names


def _of_the_arm(effect: Any) -> bool:
    return effect.stage != "measurement" and not effect.nuisance


def _chain(robot: Robot) -> Iterator[tuple[Any, ...]]:
    for e in robot.chain.elements:
        yield e.axis, e.joint, e.name, e.ratio, round(float(e.value), 9)


def _format_names(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
