"""How far a calibrated arm may be from where its calibration says: 95 % intervals of the tool position, row by row.

Three things add up: what is not known of everything that was fitted (J C Jᵀ), what the fit leaves beyond the noise, for the
model is not the arm, and, where a single measurement is predicted, its noise.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import fdtri

from kilter_core.arm.chain import increment
from kilter_core.identify.fit.least_squares import Fit, freedom_by_group
from kilter_core.identify.measured_rows import Repeats
from kilter_core.identify.options import FRAME_NAMES
from kilter_core.identify.uncertainty.structure import Structure
from kilter_core.measurement import Measurement
from kilter_core.measurement.camera.pixels import PixelsAlone
from kilter_core.measurement.contacts import Contacts
from kilter_core.measurement.kind import POINTS
from kilter_core.model import Calibration, workspace
from kilter_core.observations import Observations
from kilter_core.parameters import indices
from kilter_core.transforms import inverse
from kilter_core.types import QUANTILE, Bools, Floats, Ints

CHANCE = 0.05  # that what is left is taken to be beyond the noise although both only scatter; F test
EXACT = 10_000  # freedom of a noise that is stated
SLICE = 4096  # rows whose Jacobians are held at once
NOT_COORDINATES = (PixelsAlone.name, Contacts.name)  # kinds whose noise is not that of a coordinate of the tool

POSES = 1000
# What a pose is measured as says nothing of the pose; what it is driven under does.
MEASURED: dict[str, Any] = dict.fromkeys(
    (
        "position",
        "rotation",
        "markers",
        "tip",
        "link_q",
        "sigma",
        "socket",
        "plane",
        "bar",
        "bar_length",
        "setup",
        "tilt",
    )
)


@dataclass(frozen=True)
class Predictive:
    """What a version knows of itself: ``covariance (K, K)`` SI of the parameters ``names``, and standard deviations (m) of
    a coordinate: ``inadequacy``, what its fit left beyond the noise, and ``noise``. Where nothing shows them apart all that
    is left counts as inadequacy, and ``noise`` is 0. All of them were scaled by what the fit left, which has that ``freedom``;
    infinite where nobody says it. ``noise_of`` is the kind of measurement that was fitted, empty where nobody says it.
    ``inadequacy_turn`` rad is what a fit to views left of a coordinate of the tool's rotation; None where nobody says it.
    """

    names: tuple[str, ...]
    covariance: Floats
    inadequacy: float
    noise: float
    freedom: float = float("inf")
    noise_of: str = ""
    inadequacy_turn: float | None = None

    @staticmethod
    def from_document(known: Mapping[str, Any], report: Mapping[str, Any] | None = None) -> Predictive | None:
        """Read a version's covariance; None where it has none. Older versions say in their ``report`` what they left."""
        if not known.get("names"):
            return None
        matrix = np.array(known["matrix"], dtype=np.float64)
        if known.get("inadequacy_m") is not None:
            found = float(known["inadequacy_m"]), float(known["noise_m"])
        else:
            found = _of_report(report or {})
        kind = known.get("noise_of") or ("pixels" if (report or {}).get("pixels") else "")
        freedom, turn = float(known.get("freedom") or "inf"), known.get("inadequacy_rad")
        return Predictive(tuple(known["names"]), matrix, *found, freedom, kind, None if turn is None else float(turn))

    def to_document(self) -> dict[str, Any]:
        """JSON-able, SI."""
        return {
            "names": list(self.names),
            "matrix": self.covariance.tolist(),
            "units": "SI",
            "inadequacy_m": self.inadequacy,
            "noise_m": self.noise,
            "freedom": self.freedom if np.isfinite(self.freedom) else None,
            "noise_of": self.noise_of or None,
            "inadequacy_rad": self.inadequacy_turn,
        }

    def judging(self, measurement: Measurement) -> Predictive | None:
        """The same with the noise of what is measured there; None where that is of another kind and nobody says its noise.

        How far off a corner or a ball in its socket is tells nothing of how readings of a tracker scatter: of those only
        what is stated of them and their own repeats do.
        """
        if self.noise_of not in NOT_COORDINATES or not measurement.observes_places:
            return self
        own = noise_of_rows(measurement.observations)
        return None if own is None else replace(self, noise=own, noise_of=measurement.tool.name)

    def of_the_tool(self, calibration: Calibration, rows: Observations, axes: Floats | None = None) -> Floats:
        """Half widths (N, 3) m for where the tool is when the joints are at ``rows``, along the axes (3, 3) of a frame.

        Without ``axes`` they are those of the measurements. Effects whose columns the rows lack, and those that are only
        of the measurement, are left out.
        """
        arm = acting(calibration, rows)
        free, C = self._known_covariance(arm.names)
        out = np.empty((len(rows), 3))
        for part in _slices(len(rows)):
            J = arm.model.jacobian(rows.select(part), arm.values, free, False)[1][:, :3]
            out[part] = _widths(J if axes is None else np.einsum("ji,njp->nip", axes, J), C, self.inadequacy**2)
        return out

    def of_measured(self, calibration: Calibration, measurement: Measurement, refit: Sequence[str] = ()) -> Floats:
        """Half widths (N, 3) m for the error of each measured row: mean of its markers, or its point; noise included.

        ``refit`` frames were fitted to these rows: what they take up is no longer uncertain.
        """
        frames = {f"{frame}_{k}" for frame in refit for k in FRAME_NAMES}
        free, C = self._known_covariance(calibration.names, frames)
        noise = self.noise**2 + self.inadequacy**2
        if refit:
            J = np.concatenate([part for _, part in _mean_jacobians(calibration, measurement, free)])
            J, lever = _project_out_frames(J, np.array([calibration.names[k] in frames for k in free]))
            return _widths(J, C, noise * (1.0 - lever))
        out = np.empty((len(measurement.observations), 3))
        for where, J in _mean_jacobians(calibration, measurement, free):
            out[where] = _widths(J, C, noise)
        return out

    def variance_parts(self, calibration: Calibration, measurement: Measurement, refit: Sequence[str] = ()) -> Parts:
        """What the covariance contributes to each measured row, told apart by frames and everything else.

        Where the frames are is known only together with the other parameters, for a base can take up what a first link does.
        So ``registration`` is what frames leave where all others are known, and ``model`` the rest, with the frames following
        the others: the two do not correlate. ``refit`` frames were fitted to these rows: what noise and inadequacy leave of
        them there.
        """
        fitted = {f"{frame}_{k}" for frame in refit for k in FRAME_NAMES}
        frames = {f"{frame}_{k}" for frame in ("base", "tool") for k in FRAME_NAMES}
        free, C = self._known_covariance(calibration.names, fitted)
        J = np.concatenate([part for _, part in _mean_jacobians(calibration, measurement, free)])
        again = np.zeros(J.shape[:2])
        if refit:
            J, lever = _project_out_frames(J, np.array([calibration.names[k] in fitted for k in free]))
            again = (self.noise**2 + self.inadequacy**2) * lever
        own = np.array([calibration.names[k] in frames for k in free], dtype=bool)
        total, alone = _quadratic(J, C), _quadratic(J[:, :, own], _conditional_covariance(C, own))
        apart = _quadratic(J[:, :, own], C[np.ix_(own, own)]), _quadratic(J[:, :, ~own], C[np.ix_(~own, ~own)])
        return Parts(alone + again, np.maximum(total - alone, 0.0), _correlation(total, *apart))

    def _known_covariance(self, names: Sequence[str], more: Collection[str] = ()) -> tuple[Ints, Floats]:
        """Where the known of these names are, with ``more`` that count as known exactly, and their covariance."""
        free = [k for k, name in enumerate(names) if name in self.names or name in more]
        place = [c for c, k in enumerate(free) if names[k] in self.names]
        own = [self.names.index(names[free[c]]) for c in place]
        C = np.zeros((len(free), len(free)))
        C[np.ix_(place, place)] = self.covariance[np.ix_(own, own)]
        return np.array(free, dtype=np.int64), C


UNSEEN_SHARE = 0.05  # of the scatter of a tool coordinate, below which what moves together does not show at the tool
LEVER_M = 0.1  # at which a rotation of the tool counts


def restrict_to_what_moves_the_tool(
    calibration: Calibration, names: Sequence[str], covariance: Floats, tool_sigma: float
) -> Floats:
    """Covariance (K, K) without the combinations of parameters ``names`` that leave the tool where it is all over the reach.

    A base that rises as the first link shortens is one: no pose tells it, so its prior is wide, and a draw that goes far
    along it moves the tool after all, by what is not linear. ``tool_sigma`` m is that of a measured coordinate. Rotations of
    the tool count where the fit knows them. Effects whose columns a pose by itself lacks are kept as they are.
    """
    rows = workspace(calibration.robot)
    arm = acting(calibration, rows)
    place = [k for k, name in enumerate(names) if name in arm.names]
    free = indices(arm.names, [names[k] for k in place])
    J = arm.model.jacobian(rows, arm.values, free, False)[1]
    J = np.concatenate([J[:, :3], LEVER_M * J[:, 3:6]], axis=1) if "tool_rx" in names else J[:, :3]
    sigma = np.sqrt(np.diag(covariance))
    moved = (J * sigma[place]).reshape(-1, len(place))
    squares, axes = np.linalg.eigh(moved.T @ moved / len(moved))
    unseen = axes[:, squares < (UNSEEN_SHARE * tool_sigma) ** 2]
    project = np.eye(len(names))
    project[np.ix_(place, place)] -= unseen @ unseen.T
    scaled = np.where(sigma > 0.0, sigma, 1.0)
    correlation = project @ (covariance / np.outer(scaled, scaled)) @ project
    return np.asarray(correlation * np.outer(scaled, scaled))


@dataclass(frozen=True)
class Parts:
    """Variances (N, 3) m² of rows by frames and by all other parameters, and how both correlated before that."""

    registration: Floats
    model: Floats
    correlation: float


def acting(calibration: Calibration, rows: Observations) -> Calibration:
    """The calibration with the effects that act on the arm and whose columns the rows have."""
    available = frozenset({"moments"} | set(rows._present()))
    effects = [e for e in calibration.model.effects if e.stage != "measurement" and not e.missing(available)]
    return calibration if len(effects) == len(calibration.model.effects) else calibration.with_effects(effects)


def predictive(
    fit: Fit,
    repeats: Repeats,
    stated: float | None = None,
    structure: Structure | None = None,
    by_views: float | None = None,
) -> Predictive:
    """What a clustered ``fit`` knows, with the noise of its ``repeats``, or as ``stated`` (m) for a coordinate.

    The noise tells what is left beyond it, and the ``structure`` of what is left which part follows the joints: the larger
    counts, since a noise from few repeats hides much. Where no noise is known the structure alone tells; as soon as it shows
    that the model lacks something, all that is left counts, for what is rough in it looks like noise; beside views no more of
    that than these say that the tool is off (``by_views`` m of a coordinate).
    """
    of_noise = freedom_by_group(fit).get(POINTS, fit.freedom or np.inf)
    left, freedom, kind = residual_sigma(fit), repeats.freedom, fit.problem.measurement.tool.name
    sigma = fit.problem.measurement.observations.sigma
    noise = stated if stated is not None else repeats.between
    if noise is None and sigma is not None:
        noise = float(np.sqrt(np.mean(sigma**2)))
    if noise is None:
        rough = np.inf if by_views is None or left <= 0.0 else (by_views / left) ** 2
        share = 1.0 if structure is None else structure.at_most(rough)
        inadequacy = _reaching(share * left**2, left, structure)
        return Predictive(fit.names, fit.covariance, inadequacy, left * (1.0 - share) ** 0.5, of_noise, kind)
    known = EXACT if stated is not None or repeats.between is None else freedom
    by_chance = noise**2 * float(fdtri(max(fit.freedom or 1.0, 1.0), known, 1.0 - CHANCE))
    beyond = left**2 - noise**2 if left**2 > by_chance else 0.0
    smooth = 0.0 if structure is None else structure.share * left**2
    inadequacy = _reaching(max(beyond, smooth), left, structure)
    return Predictive(fit.names, fit.covariance, inadequacy, noise, of_noise, kind)


def noise_of_rows(rows: Observations) -> float | None:
    """Standard deviation (m) of a coordinate by the rows' own repeats, or as stated with them; None where neither tells."""
    between = Repeats.from_observations(rows).between
    if between is not None or rows.sigma is None:
        return between
    return float(np.sqrt(np.nanmean(rows.sigma**2)))


def _reaching(variance: float, left: float, structure: Structure | None) -> float:
    """Standard deviation of a normal error that reaches as far as errors of this ``variance`` do: their tails are wider."""
    if structure is None:
        return float(np.sqrt(variance))
    return float(np.sqrt(variance + structure.lacking * (structure.reach**2 - 1.0) * left**2))


def residual_sigma(fit: Fit) -> float:
    """Standard deviation (m) of a coordinate about the fit, corrected for what the parameters took from the poses."""
    problem, points = fit.problem, fit.residual.points
    groups = problem.measurement.observations.pose_groups()
    if problem.loss != "linear" or len(points) != len(groups) or len(problem.measurement.kinds) > 1:
        return float(np.mean(problem.weights.points))
    flat = points.reshape(len(points), -1)
    seen = ~np.isnan(flat)
    count = np.maximum(np.stack([np.bincount(groups, weights=c) for c in seen.T], axis=1), 1.0)
    filled = np.where(seen, flat, 0.0)
    mean = (np.stack([np.bincount(groups, weights=c) for c in filled.T], axis=1) / count)[groups]
    poses = len(count) * problem.measurement.equations_per_pose
    lost = poses / max(poses - fit.effective, 1.0)
    square = np.sum(seen * ((filled - mean) ** 2 + lost * mean**2))
    return float(np.sqrt(square / max(seen.sum(), 1)))


def _of_report(report: Mapping[str, Any]) -> tuple[float, float]:
    """Inadequacy and noise (m) of a version that does not say them, from its errors on the rows it was fitted to."""
    found = ((report.get("metrics") or {}).get("train") or {}).get("identified") or {}
    left = float(found.get("rms_mm") or 0.0) * 1e-3 / np.sqrt(3.0)
    noise = float(report.get("noise_mm") or 0.0) * 1e-3 if report.get("noise_source") == "repeats" else 0.0
    return float(np.sqrt(max(left**2 - noise**2, 0.0))), noise


def _mean_jacobians(calibration: Calibration, measurement: Measurement, free: Ints) -> Iterator[tuple[slice, Floats]]:
    """Jacobians (n, 3, F) of the mean of the markers that a row shows, or of its point, slice by slice."""
    for part in _slices(len(measurement.observations)):
        here = replace(measurement, observations=measurement.observations.select(part))
        found = here.residual(*calibration.model.jacobian(here.observations, calibration.values, free))
        assert found.d_points is not None
        seen = ~np.isnan(found.points).any(axis=2)
        share = seen / np.maximum(seen.sum(axis=1, keepdims=True), 1)
        yield part, np.einsum("nmip,nm->nip", found.d_points, share)


def _widths(J: Floats, C: Floats, more: float | Floats) -> Floats:
    return np.asarray(QUANTILE * np.sqrt(np.maximum(_quadratic(J, C), 0.0) + more))


def _quadratic(J: Floats, C: Floats) -> Floats:
    return np.asarray(np.einsum("nip,nip->ni", J @ C, J))


def _conditional_covariance(C: Floats, own: Bools) -> Floats:
    """Covariance of some parameters where all others are known: their Schur complement, scaled so that it can be computed."""
    size = np.sqrt(np.maximum(np.diag(C), 0.0))
    size = np.where(size > 0.0, size, 1.0)
    R = C / np.outer(size, size)
    cross = R[np.ix_(own, ~own)]
    left = R[np.ix_(own, own)] - cross @ np.linalg.pinv(R[np.ix_(~own, ~own)], hermitian=True) @ cross.T
    values, vectors = np.linalg.eigh((left + left.T) / 2.0)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(size[own], size[own]))


def _correlation(total: Floats, first: Floats, second: Floats) -> float:
    """Coefficient of two parts of a sum, by the means of its variance and of theirs."""
    both = float(np.sqrt(np.mean(first) * np.mean(second)))
    covariance = 0.5 * float(np.mean(total) - np.mean(first) - np.mean(second))
    return float(np.clip(covariance / both, -1.0, 1.0)) if both > 0.0 else 0.0


def _slices(count: int) -> Iterator[slice]:
    for start in range(0, count, SLICE):
        yield slice(start, min(start + SLICE, count))


def _project_out_frames(J: Floats, frames: Bools) -> tuple[Floats, Floats]:
    """Jacobian (N, 3, P) of what frames fitted to the same rows leave, and their leverage (N, 3)."""
    flat = J.reshape(-1, J.shape[2])
    Q = np.linalg.qr(flat[:, frames])[0]
    left = np.where(frames, 0.0, flat - Q @ (Q.T @ flat))
    return left.reshape(J.shape), np.sum(Q**2, axis=1).reshape(J.shape[:2])


@dataclass(frozen=True)
class Workspace:
    """Tool points (N, 3) m of random poses in the robot's base frame, and the widest half interval (N,) m of each.

    ``measured (K, 3)`` m is where the tool was in the rows that were fitted.
    """

    points: Floats
    u95: Floats
    measured: Floats

    @staticmethod
    def from_calibration(calibration: Calibration, known: Predictive, rows: Observations, seed: int = 0) -> Workspace:
        """Half widths of the 95 % interval of a coordinate of the tool point, noise of the instrument not among them.

        Poses are drawn evenly within the limits of the joints, of a joint without limits where ``rows`` had it; loads,
        directions and temperatures are those of rows drawn by chance.
        """
        rng = np.random.default_rng(seed)
        low, high = bounds(calibration, rows)
        drawn = rows.select(rng.integers(0, len(rows), POSES))
        poses = replace(drawn, q=rng.uniform(low, high, (POSES, len(low))), **MEASURED)
        u95 = known.of_the_tool(calibration, poses).max(axis=1)
        return Workspace(_tool(calibration, poses), u95, _tool(calibration, replace(rows, **MEASURED)))

    def worst_last(self) -> Workspace:
        """The same poses, those that are known least last: plotted one over the other these stay visible."""
        order = np.argsort(self.u95, kind="stable")
        return Workspace(self.points[order], self.u95[order], self.measured)


def bounds(calibration: Calibration, rows: Observations) -> tuple[Floats, Floats]:
    """Lowest and highest joint readings (n,): the limits, and what was driven where there is none."""
    low, high = calibration.robot.limits.T
    return (
        np.where(np.isfinite(low), low, rows.q.min(axis=0)),
        np.where(np.isfinite(high), high, rows.q.max(axis=0)),
    )


def _tool(calibration: Calibration, rows: Observations) -> Floats:
    """Tool points (N, 3) m in the robot's base frame."""
    base = inverse(calibration.model.T_base @ increment(calibration.values[:6]))
    return np.asarray(acting(calibration, rows).predict(rows).position @ base[:3, :3].T + base[:3, 3])
