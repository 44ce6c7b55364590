"""An identification in the units people read, with what it could not tell said in words.

A move along a direction that the data do not see changes its members by known amounts. What such a move leaves as it is,
one member plus a multiple of another, may be known as well as any parameter (the estimable functions of linear models:
Searle 1971, Linear Models, 5.4).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.linalg import null_space

from kilter_core.arm.robot import Robot
from kilter_core.errors import FindingDocument
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fleet_report import resting
from kilter_core.identify.identifiability import NullDirection, identifiable, own_members
from kilter_core.identify.measured_rows import Repeats
from kilter_core.identify.uncertainty.stated_noise import Intervals
from kilter_core.measurement.markers import bending
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import display_unit_and_scale, mm
from kilter_core.transforms import xyz_rpy_from_pose
from kilter_core.types import QUANTILE, Bools, Floats, Ints

_TURNS = frozenset(f"{frame}_{axis}" for frame in ("base", "tool") for axis in ("rx", "ry", "rz"))
LARGE = 0.01  # share of the workspace left after the fit that is worth a warning
STILL_RAD = 1e-6  # a joint whose readings stay within this never moved


def parameter_rows(calibration: Calibration, fit: Fit, intervals: Intervals | None = None) -> list[dict[str, Any]]:
    """Every free parameter as {name, value, nominal, change, unit, sigma, identifiable, plausible} in mm and degrees.

    Base and tool are given as x, y, z and rx, ry, rz of the whole frame (URDF order Rz Ry Rx); their sigmas are those
    of small increments along the frame's own axes. ``intervals`` add lower and upper, a prior of the type from_prior.
    """
    model = calibration.model
    unobservable = unobservable_names(fit.problem.model, fit.problem.measurement.observations)
    known = identifiable(fit.sigma, fit.problem.prior_sigma) & ~np.isin(fit.names, list(unobservable))
    rows = build_parameter_rows(calibration, fit.names, fit.sigma, known)
    if fit.problem.model.of_type is not None:
        rows = [{**row, "from_prior": bool(rests)} for row, rests in zip(rows, resting(fit), strict=True)]
    if intervals is not None:
        ends = zip(rows, intervals.lower, intervals.upper, intervals.stands_in, strict=True)
        for row, below, above, stands_in in ends:
            scale = display_unit_and_scale(model.parameter(row["name"]).unit)[1]
            row["lower"], row["upper"] = row["value"] + float(below) * scale, row["value"] + float(above) * scale
            row["interval_from"] = "sigma" if stands_in else intervals.kind
    return rows


def build_parameter_rows(
    calibration: Calibration, names: Sequence[str], sigma: Floats, known: Bools
) -> list[dict[str, Any]]:
    """One row for each of the parameters ``names``, with its ``sigma (F,)`` SI and whether it is ``known (F,)``."""
    values, nominal = _absolute(calibration), _nominal(calibration)
    rows: list[dict[str, Any]] = []
    for name, spread, seen in zip(names, sigma, known, strict=True):
        parameter = calibration.model.parameter(name)
        unit, scale = display_unit_and_scale(parameter.unit)
        rows.append(
            {
                "name": name,
                "value": values[name] * scale,
                "nominal": nominal[name] * scale,
                "change": _change(name, values[name] - nominal[name]) * scale,
                "unit": unit,
                "sigma": float(spread) * scale,
                "identifiable": bool(seen),
                "plausible": parameter.plausible(values[name]),
            }
        )
    return rows


def _change(name: str, change: float) -> float:
    """What a value differs from nominal; rotations of base and tool by the smaller angle."""
    turns = name in _TURNS
    return math.remainder(change, 2.0 * math.pi) if turns else change


def known_parameters(calibration: Calibration, names: Sequence[str], covariance: Floats, prior_sigma: Floats) -> Known:
    """What is known of the free parameters ``names`` of a calibration, for the sums of :func:`null_rows`."""
    model, every = calibration.model, _absolute(calibration)
    values = np.array([every.get(name, np.nan) for name in names])
    units = [display_unit_and_scale(model.parameter(name).unit) for name in names]
    axes = {frame: T[:3, :3] for frame, T in (("base", model.T_base), ("tool", model.T_tool))}
    return Known(names, values, units, covariance, prior_sigma, axes)


def known_of_fit(calibration: Calibration, fit: Fit) -> Known:
    """The same of all that was free in the fit of a calibration."""
    return known_parameters(calibration, fit.names, fit.covariance, fit.problem.prior_sigma)


def null_rows(directions: Sequence[NullDirection], known: Known) -> list[dict[str, Any]]:
    """Directions that the data cannot tell, in words and by their members, with the sums of members that they do know."""
    rows = []
    for d, sums in zip(directions, known.sums(directions), strict=True):
        rows.append(
            {
                "parameters": [{"name": name, "weight": weight} for name, weight in d.weights],
                "structural": d.structural,
                "sums": sums,
                "sentence": " ".join([d.sentence(), *(one["sentence"] for one in sums)]),
            }
        )
    return rows


def fit_warnings(fit: Fit, train: Observations, repeats: Repeats) -> Iterator[FindingDocument]:
    """What a metrologist should know before trusting the result."""
    for j in still_joints(train):
        name = fit.problem.model.robot.joints[j].name
        yield FindingDocument.make(
            "joint_never_moves",
            f"Joint {name} never moves: nothing about it can be identified. Vary it, or fix its parameters.",
            joint=name,
        )
    spread = workspace_uncertainty(fit)
    if spread is not None and spread.too_alike:
        yield spread.warning()
    if fit.problem.measurement.observes_base and (train.position is not None or train.markers is not None):
        points = fit.problem.model.predict(fit.problem.batch, fit.values).position
        yield from large_residual(_rms(fit.residual.points), points)
    bent = None if train.markers is None else bending(train.markers, repeats.shots or repeats.between)
    if bent is not None:
        yield FindingDocument.make(
            "markers_not_rigid",
            f"The distance of markers {bent[0]} and {bent[1]} varies by {mm(bent[2]):.2f} mm (standard "
            "deviation): the set bends, or one of them is loose. Fasten them; until then errors below that mean little.",
            markers=list(bent[:2]),
        )
    yield from _repeat_warnings(repeats)
    loaded = [e.id for e in fit.problem.model.effects if "moments" in e.needs]
    if loaded and not np.any(fit.problem.batch.wrench):
        yield FindingDocument.make(
            "no_load",
            f"{', '.join(loaded)} need load moments, but neither link masses nor a payload are known: "
            "give links with mass_kg and com_mm, or payload_kg.",
        )


def _repeat_warnings(repeats: Repeats) -> Iterator[FindingDocument]:
    """What repeats of poses say of the noise, and which of them are copies or wrong."""
    if repeats.between is None:
        only = "No pose was repeated"
        if repeats.shots is not None:
            only = "Poses were only shot several times without motion between, which does not show how the arm comes to rest"
        yield FindingDocument.make(
            "no_repeats",
            f"{only}, so the noise is that of the fit itself, model errors included. "
            "Come back to a few poses to know what cannot be predicted.",
        )
    if len(repeats.copies):
        yield FindingDocument.make(
            "repeats_identical",
            f"{len(repeats.copies)} rows measured exactly what an earlier row of their pose did; the first is row "
            f"{repeats.copies[0] + 1} of the rows fitted. Without scatter they are copies, held readings or simulated, and "
            "say nothing of noise. Upload every row once, or measure the poses again.",
            rows=(repeats.copies + 1).tolist(),
        )
    if len(repeats.wrong):
        yield FindingDocument.make(
            "repeats_differ",
            f"{len(repeats.wrong)} rows stand too far from the repeats of their pose to be noise; the first is row "
            f"{repeats.wrong[0] + 1} of the rows fitted. Backlash does that too, and `kilter gap` finds it. Wrong rows: remove "
            "them, or identify with loss tukey, which lets them go.",
            rows=(repeats.wrong + 1).tolist(),
        )


def large_residual(rms_m: float, points: Floats) -> Iterator[FindingDocument]:
    """Say when much of the error is left, measured against the workspace: what that comes from it does not know."""
    spread = float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
    if rms_m > LARGE * spread:
        yield FindingDocument.make(
            "large_residual",
            f"{mm(rms_m):.3g} mm are left over a workspace of {mm(spread):.3g} mm. No swapped, reversed or "
            "otherwise read joints, no unit and no change of tool explain that; the nominal geometry, loads or poor "
            "measurements may. Check the robot's description, and look for what is missing with `kilter gap`.",
        )


def still_joints(observations: Observations) -> list[int]:
    """Joints whose reading never changes."""
    return [int(j) for j in np.flatnonzero(np.ptp(observations.q, axis=0) < STILL_RAD)]


def _rms(points: Floats) -> float:
    """Rms size of errors (N, m, 3), unseen markers left out."""
    return float(np.sqrt(np.nanmean(np.sum(points**2, axis=-1))))


def unobservable_names(model: RobotModel, observations: Observations) -> Iterator[str]:
    """Parameters of the joint elements that never move: their columns alias their neighbours'."""
    still = set(still_joints(observations))
    for e in model.robot.chain.elements:
        if e.joint in still and e.name:
            yield e.name


def _absolute(calibration: Calibration) -> dict[str, float]:
    model = calibration.model
    values = dict(zip(calibration.names, (float(v) for v in calibration.values), strict=True))
    robot = calibration.robot
    return values | _frame("base", model.T_base, robot.T_base) | _frame("tool", model.T_tool, robot.T_tool)


def _nominal(calibration: Calibration) -> dict[str, float]:
    robot = calibration.robot
    values = {p.name: p.value for p in calibration.model.parameters}
    return values | _frame("base", robot.T_base, robot.T_base) | _frame("tool", robot.T_tool, robot.T_tool)


def _frame(which: str, T: Floats, nominal: Floats) -> dict[str, float]:
    """A frame's numbers, of its angles those next to the nominal ones."""
    xyz, rpy = xyz_rpy_from_pose(T, xyz_rpy_from_pose(nominal)[1])
    return dict(zip([f"{which}_{k}" for k in ("x", "y", "z", "rx", "ry", "rz")], map(float, [*xyz, *rpy]), strict=True))


SUREST = 1e-6  # of the unit: no more digits are written
SMALL = 1e-6  # of a prior sigma: a coefficient that is rounding
AXES = ("x", "y", "z")
FRAMES = ("base", "tool")
# The angles of a frame do not add, and what an angle does to its place is not linear: sums of lengths are told alone.
FRAME_TURNS = frozenset(f"{frame}_r{axis}" for frame in FRAMES for axis in AXES)
ALONG = 1e-9  # part of a frame's place that counts in a sum


@dataclass(frozen=True)
class Known:
    """What a fit says of its free parameters ``names``: ``values (F,)``, ``covariance (F, F)`` and ``prior_sigma (F,)``, SI.

    ``units`` are those of reports, each with how many of it one SI unit is. Covariances of base and tool are of increments
    along their own axes, their values are places: ``axes`` has the rotation (3, 3) of each frame that is not straight.
    ``fitted`` says whether there was a fit, or only a look at poses, whose values say nothing.
    """

    names: Sequence[str]
    values: Floats
    units: Sequence[tuple[str, float]]
    covariance: Floats
    prior_sigma: Floats
    axes: Mapping[str, Floats] = field(default_factory=dict)
    fitted: bool = True

    def sums(self, directions: Sequence[NullDirection]) -> list[list[dict[str, Any]]]:
        """Sums that the directions leave as they are, if the data know them; each stands at the last it has to do with.

        In units of reports: {parameters: [{name, coefficient}], value, unit, sigma, lower, upper, sentence}.
        """
        out: list[list[dict[str, Any]]] = [[] for _ in directions]
        for group in _group_by_shared_members(directions):
            names = sorted({n for k in group for n, _ in directions[k].weights}, key=self.names.index)
            if len(names) == len(group):
                continue
            at = [self.names.index(name) for name in names]
            moves = np.zeros((len(group), len(names)))
            for row, k in zip(moves, group, strict=True):
                members = [names.index(name) for name, _ in directions[k].weights]
                row[members] = np.array(directions[k].amounts) / self.prior_sigma[at][members]
            for g in own_members(null_space(moves).T):
                out[group[-1]] += self._sum(names, g / self.prior_sigma[at])
        return out

    def _sigma(self, at: Sequence[int], g: Floats) -> float:
        """Standard deviation of a sum. What the members cancel may leave less than rounding does, so roots are added."""
        scale = self.prior_sigma[at]
        roots, vectors = np.linalg.eigh(self.covariance[np.ix_(at, at)] / np.outer(scale, scale))
        return float(np.linalg.norm(np.sqrt(np.clip(roots, 0.0, None)) * (vectors.T @ (g * scale))))

    def _sum(self, names: Sequence[str], g: Floats) -> Iterator[dict[str, Any]]:
        kept = np.flatnonzero(np.abs(g) * self.prior_sigma[[self.names.index(n) for n in names]] > SMALL)
        names, g = [names[int(k)] for k in kept], g[kept] / g[kept[0]]
        at = [self.names.index(name) for name in names]
        sigma, prior = self._sigma(at, g), float(np.linalg.norm(g * self.prior_sigma[at]))
        if len(names) < 2 or not identifiable(np.array([sigma]), np.array([prior]))[0]:
            return
        if any(map(of_a_frame, names)) and (
            not FRAME_TURNS.isdisjoint(names) or len({self.units[k][0] for k in at}) > 1
        ):
            return
        unit, scale = self.units[at[0]]
        names, g = self._of_places(names, g)
        if not set(names) <= set(self.names):  # a coordinate of the place is held, and no longer written
            return
        at = [self.names.index(name) for name in names]
        value = float(g @ self.values[at])
        if not np.isfinite(value):
            return
        coefficients = [float(x) * scale / self.units[k][1] for x, k in zip(g, at, strict=True)]
        value, sigma = value * scale, sigma * scale
        lower, upper = value - QUANTILE * sigma, value + QUANTILE * sigma
        terms = " ".join(_term(name, x) for name, x in zip(names, coefficients, strict=True)).removeprefix("+ ")
        yield {
            "parameters": [{"name": n, "coefficient": x} for n, x in zip(names, coefficients, strict=True)],
            "value": value,
            "unit": unit,
            "sigma": sigma,
            "lower": lower,
            "upper": upper,
            "sentence": self._sentence(terms, value, sigma, unit),
        }

    def _of_places(self, names: Sequence[str], g: Floats) -> tuple[list[str], Floats]:
        """A sum of increments along the axes of base and tool, as one of the coordinates of their places."""
        out = dict(zip(names, map(float, g), strict=True))
        for frame in [f for f in FRAMES if f in self.axes and any(name.startswith(f"{f}_") for name in names)]:
            increments = np.array([out.pop(f"{frame}_{axis}", 0.0) for axis in AXES])
            along = np.asarray(self.axes[frame]) @ increments
            places = {f"{frame}_{a}": float(x) for a, x in zip(AXES, along, strict=True) if abs(x) > ALONG}
            out = {**places, **out} if frame == "base" else {**out, **places}
        return list(out), np.array(list(out.values()))

    def _sentence(self, terms: str, value: float, sigma: float, unit: str) -> str:
        said = _as_sure_as(sigma)
        if not self.fitted:
            return f"Together these poses tell them: {terms} to {said(QUANTILE * sigma)} {unit} (95 %)."
        lower, upper = value - QUANTILE * sigma, value + QUANTILE * sigma
        return f"Together they are known: {terms} = {said(value)} {unit} (95 %: {said(lower)} to {said(upper)})."


def of_a_frame(name: str) -> bool:
    """Whether a parameter is of base or tool."""
    return name.startswith(tuple(f"{frame}_" for frame in FRAMES))


def _as_sure_as(sigma: float) -> Callable[[float], str]:
    """How to write numbers of which a standard deviation is known: with its first two digits."""
    places = max(0, 1 - int(np.floor(np.log10(max(sigma, SUREST)))))
    return lambda value: f"{value:.{places}f}"


def _term(name: str, coefficient: float) -> str:
    # A frame may stand metres away: of its place more digits count.
    digits = 6 if of_a_frame(name) else 3
    size, sign = f"{abs(coefficient):.{digits}g}", "+" if coefficient > 0.0 else "-"
    return f"{sign} {name}" if size == "1" else f"{sign} {size} {name}"


def _group_by_shared_members(directions: Sequence[NullDirection]) -> list[list[int]]:
    """Places of directions that share members, together."""
    groups: list[tuple[set[str], list[int]]] = []
    for k, direction in enumerate(directions):
        names, places = {name for name, _ in direction.weights}, [k]
        for one in [group for group in groups if group[0] & names]:
            groups.remove(one)
            names, places = names | one[0], one[1] + places
        groups.append((names, sorted(places)))
    return [places for _, places in groups]


SAMPLES = 200
TOO_ALIKE = 10.0  # uncertainty over the limits, as a multiple of that in the poses, from which it is said


@dataclass(frozen=True)
class WorkspaceUncertainty:
    """Standard deviation m of a coordinate of the tool point, by the identified geometry: ``here`` in the poses,
    ``elsewhere`` over the joint limits; ``narrow`` is the joint that used least of its range, ``used`` that share.
    """

    here: float
    elsewhere: float
    narrow: str
    used: float

    @property
    def too_alike(self) -> bool:
        """Whether the poses show too little about others."""
        return self.elsewhere > TOO_ALIKE * self.here

    def warning(self) -> FindingDocument:
        """The same in words."""
        return FindingDocument.make(
            "poses_ill_conditioned",
            f"The result knows the tool to {mm(self.here):.3g} mm in these poses but only to "
            f"{mm(self.elsewhere):.3g} mm over the joint limits: the poses are too alike ({self.narrow} used "
            f"{self.used:.0%} of its range). Measure poses that spread all joints (`kilter plan --purpose identify`), or "
            "use the result near these poses only.",
            here_mm=mm(self.here),
            elsewhere_mm=mm(self.elsewhere),
        )


def workspace_uncertainty(fit: Fit) -> WorkspaceUncertainty | None:
    """Spread of a fit's poses; None where no instrument saw the tool in a frame of its own, or the chain was held."""
    problem = fit.problem
    if not problem.measurement.observes_base:
        return None
    return estimate_workspace_spread(
        problem.model, problem.free, fit.covariance, fit.values, problem.measurement.observations.q
    )


def estimate_workspace_spread(
    model: RobotModel, free: Ints, covariance: Floats, values: Floats, q: Floats
) -> WorkspaceUncertainty | None:
    """Spread of the poses ``q (N, n)`` of a fit with parameters ``free (F,)`` of the model's ``values (P,)``."""
    n = model.n_geometric
    geometric = np.flatnonzero(free < n)
    if not np.any((free >= 6) & (free < n - 6)):
        return None
    lower, upper = within_a_turn(model.robot, q)
    bare = replace(model, effects=())
    known = covariance[np.ix_(geometric, geometric)]

    def sigma(rows: Floats) -> float:
        _, J = bare.jacobian(Observations(rows), values[:n], free[geometric])
        return float(np.sqrt(max(np.sum((J[:, :3] @ known) * J[:, :3]), 0.0) / (3 * len(rows))))  # rounding

    some = q[np.linspace(0, len(q) - 1, min(len(q), SAMPLES)).astype(np.int64)]
    elsewhere = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, len(lower)))
    used = np.ptp(q, axis=0) / np.maximum(upper - lower, 1e-12)
    k = int(np.argmin(used))
    return WorkspaceUncertainty(sigma(some), sigma(elsewhere), model.robot.joints[k].name, float(used[k]))


def within_a_turn(robot: Robot, q: Floats) -> tuple[Floats, Floats]:
    """Limits within one turn; a prismatic joint without limits keeps the range it was measured over."""
    revolute = np.array([joint.kind == "revolute" for joint in robot.joints])
    lower, upper = robot.limits.T
    lower = np.where(revolute, np.maximum(lower, -np.pi), np.where(np.isfinite(lower), lower, q.min(axis=0)))
    upper = np.where(revolute, np.minimum(upper, np.pi), np.where(np.isfinite(upper), upper, q.max(axis=0)))
    # Limits that lie outside one turn altogether are taken as they are.
    wrong = lower >= upper
    return np.where(wrong, robot.limits[:, 0], lower), np.where(wrong, robot.limits[:, 1], upper)
