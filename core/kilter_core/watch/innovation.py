"""What a few measurements say beyond a version: measured minus predicted, in units of what was to be expected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from kilter_core.errors import ObservationError, OptionError, TooFewPosesError
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.measurement import Measurement
from kilter_core.measurement.pose_weights import beside_rotation
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.observations.groups import subtract_group_means
from kilter_core.observations.spread import evenly
from kilter_core.types import Bools, Floats, Ints
from kilter_core.watch.conditions import STATED, Conditions, allowance, refuse_another_tool
from kilter_core.watch.sockets import Measured

FEWEST_POSES = 3  # the six numbers of two positions cannot tell the place of the instrument from the arm
MOST_NUMBERS = 1500  # coordinates whose common covariance is inverted: 0.2 s
LEAST = 1e-3  # of what the model lacks, noise that tells repeats apart where none is known


@dataclass(frozen=True)
class Innovation:
    """The whitened innovation ``r (R,)`` of rows, and what whitens the derivatives of their prediction; ``noise`` m of them.

    ``lower (R, R)`` is the Cholesky factor of the covariance of noise and version, ``seen`` tells which of the coordinates
    (N, m, 3) were measured; of views these are six numbers of the tool's position and rotation.
    ``poses`` are those that count; of a large campaign some, evenly chosen. ``freedom`` is that of
    the scale of the covariance: a fit of few rows does not know well what it left. ``counts`` says what of the coordinates
    does: of rows that sockets held, their differences. ``allows``: the covariance has what the temperature or the set-up
    explains.
    """

    measurement: Measurement
    prediction: Prediction
    r: Floats
    lower: Floats
    seen: Bools
    poses: int
    freedom: float
    noise: float
    counts: Measured
    allows: bool

    @staticmethod
    def from_observations(
        calibration: Calibration,
        rows: Observations,
        known: Predictive,
        noise: float | None = None,
        fitted_c: tuple[float, float] | None = None,
        counts: Measured | None = None,
        conditions: Conditions = STATED,
    ) -> Innovation:
        """Innovation of rows against a version; ``noise`` m of a coordinate, when None that of the version's fit, or of the
        rows themselves where the fit was to what a camera or a contact measured.

        ``fitted_c`` are the lowest and highest temperature of the rows it was fitted to, None where nobody knows; what is
        open of these and of the set-up, ``conditions`` say. What
        ``counts`` is every coordinate when None.

        Raises:
            ObservationError: no positions, another tool or temperature. OptionError: no noise known.
            TooFewPosesError: fewer than three distinct poses.

        """
        refuse_another_tool(calibration, rows)
        measurement = Measurement.from_observations(rows, calibration.marker_points).of_tool()
        _refuse_few(measurement)
        measurement = _thin_poses(measurement)
        at = [k for k, name in enumerate(calibration.names) if name in known.names]
        places = [known.names.index(calibration.names[k]) for k in at]
        prediction, J = calibration.model.jacobian(
            measurement.observations, calibration.values, np.array(at, dtype=np.int64)
        )
        left, slopes = _numbers(measurement, prediction, J)
        seen = ~np.isnan(left)
        slope = slopes[seen]
        covariance = slope @ known.covariance[np.ix_(places, places)] @ slope.T
        weight = measurement.observations.pose_weight
        if weight is not None:
            noise, own = 1.0, beside_rotation(weight)
            covariance += _lacking(weight, measurement.observations.pose_groups(), known) + np.eye(len(covariance))
        else:
            own = _noise(known, measurement) if noise is None else noise
            covariance += _noise_and_model_covariance(measurement, seen, known.inadequacy, own)
        allowed = allowance(calibration, measurement.observations, fitted_c, conditions)
        if allowed is not None:
            more = _numbers(measurement, prediction, allowed)[1][seen]
            covariance += more @ more.T
        counts = counts or Measured()
        lower = np.asarray(np.linalg.cholesky(counts.covariance(covariance)), dtype=np.float64)
        r = solve_triangular(lower, counts.observable_part(left[seen]), lower=True)
        freedom = _freedom(lower, known.freedom, noise)
        return Innovation(
            measurement, prediction, r, lower, seen, measurement.poses, freedom, own, counts, allowed is not None
        )

    def with_new_prediction(self, calibration: Calibration, rows: Observations, factor: float) -> Innovation:
        """The innovation against the same rows predicted otherwise; what was to be expected stays as it is."""
        measurement, found = replace(self.measurement, observations=rows), calibration.predict(rows)
        prediction = replace(found, position=factor * found.position)
        left = _numbers(measurement, prediction)[0][self.seen]
        r = solve_triangular(self.lower, self.counts.observable_part(left), lower=True)
        return replace(self, measurement=measurement, prediction=prediction, r=r)

    @property
    def misfit(self) -> float:
        """Root mean square (m) of the length by which measured and predicted points differ; of views beside their rotation."""
        weight = self.measurement.observations.pose_weight
        if weight is not None:
            apart = self.measurement.residual(self.prediction).points[:, 0]
            beside = np.linalg.solve(weight[:, :3, :3], apart[:, :, None])
            return float(np.sqrt(np.mean(np.sum(beside**2, axis=(1, 2)))))
        left = self.counts.observable_part(self.measurement.residual(self.prediction).points[self.seen])
        return float(np.sqrt(3.0 * np.mean(left**2)))

    @property
    def numbers_of_noise(self) -> float:
        """How many of the whitened numbers are noise: all, but for the share of what version and conditions leave open."""
        unit = self.noise if self.measurement.observations.pose_weight is None else 1.0
        inverse = solve_triangular(self.lower, np.eye(len(self.lower)), lower=True)
        return min(float(len(self.r)), unit**2 * float(np.sum(inverse**2)))

    def within_pose_scatter(self) -> tuple[float, float]:
        """Sum of squares of the shots of each pose about their mean, in units of the noise, and how many numbers it has."""
        alone = self.counts.alone or self.noise <= 0.0
        if alone or self.seen.sum() != len(self.r):
            return 0.0, 0.0
        left = self.lower @ self.r
        _, group = np.unique(_number_coordinates(self.measurement, self.seen), return_inverse=True)
        unit = self.noise if self.measurement.observations.pose_weight is None else 1.0
        away = subtract_group_means(left[:, None], group)
        return float(np.sum(away**2)) / unit**2, float(len(left) - group.max() - 1)

    def white(self, J: Floats) -> Floats:
        """Whitened columns (R, K) of a derivative ``J (N, 6, K)`` of the tool's position and rotation vector."""
        J = self.counts.at_places(J, self.prediction.position)
        found = _numbers(self.measurement, self.prediction, J)[1][self.seen]
        return np.asarray(solve_triangular(self.lower, self.counts.columns(found), lower=True))

    @property
    def places(self) -> Floats:
        """Where the tool (N, 3) is by the version, in one place for all rows of a socket."""
        return self.counts.places(self.prediction.position)


def _numbers(measurement: Measurement, prediction: Prediction, J: Floats | None = None) -> tuple[Floats, Floats]:
    """What counts of the rows (N, m, 3), and its derivatives (N, m, 3, K), none without ``J``.

    Coordinates m; of rows that weigh themselves position and rotation, in deviations.
    """
    left = measurement.residual(prediction, J)
    blocks = left.blocks[:1] if measurement.observations.pose_weight is None else left.blocks[:2]
    slopes = [block.J for block in blocks if block.J is not None]
    values = np.concatenate([block.r for block in blocks], axis=1)
    return values, np.concatenate(slopes, axis=1) if slopes else np.zeros((*values.shape, 0))


def _lacking(weight: Floats, groups: Ints, known: Predictive) -> Floats:
    """Covariance (6 N, 6 N) of what the model lacks of poses with a ``weight (N, 6, 6)``, which rows of a pose share.

    A version that does not say how far the tool may be rotated has that in its places. One that says 0 was fitted to views that
    scatter by no more than chance: it lacks nothing, and the likeliest width, which is above 0, would hide a part of a change.
    """
    place = 0.0 if known.inadequacy_turn == 0.0 else known.inadequacy
    each = weight * np.repeat([place, known.inadequacy_turn or 0.0], 3)
    out = np.einsum("nij,mkj->nimk", each, each) * (groups[:, None] == groups[None, :])[:, None, :, None]
    return np.asarray(out.reshape(6 * len(groups), -1))


def _refuse_few(measurement: Measurement) -> None:
    if not measurement.observes_places:
        raise ObservationError("A check needs rows that say where the tool is: upload x_mm, y_mm, z_mm or markers.")
    rows, poses = len(measurement.observations), measurement.poses
    if poses < FEWEST_POSES:
        counted = "one pose" if poses == 1 else f"{poses} poses"
        had = f"the {rows} rows repeat {counted}" if rows > poses else f"this is {counted}"
        raise TooFewPosesError(
            f"A check needs {FEWEST_POSES} distinct poses, better five: {had}. Measure poses that differ in every joint.",
            poses=poses,
            needed=FEWEST_POSES,
        )


def _thin_poses(measurement: Measurement) -> Measurement:
    """Rows of so many poses, evenly chosen, that their coordinates can be looked at together."""
    rows = measurement.observations
    a_row = measurement.tool.scalars() / len(rows)
    most = max(FEWEST_POSES, int(MOST_NUMBERS / a_row))
    if len(rows) <= most:
        return measurement
    kept = np.zeros(len(rows), dtype=bool)
    groups = rows.pose_groups()
    poses = np.unique(groups)
    share = max(FEWEST_POSES, int(most * len(poses) / len(rows)))
    chosen = poses[evenly(len(poses), share)]
    for pose in chosen:  # of a pose that was repeated without end, the first rows
        kept[np.flatnonzero(groups == pose)[: max(1, most // len(chosen))]] = True
    return Measurement.from_observations(rows.select(kept), measurement.marker_points).of_tool()


def _noise(known: Predictive, measurement: Measurement) -> float:
    judging = known.judging(measurement)
    if judging is None:
        raise OptionError(
            f"The version was fitted to {known.noise_of}, whose noise says nothing of how these rows scatter: state the noise "
            "of the instrument per coordinate, larger than zero, or measure some poses twice.",
            option="noise",
        )
    return judging.noise


def _noise_and_model_covariance(measurement: Measurement, seen: Bools, inadequacy: float, noise: float) -> Floats:
    """Covariance (R, R) of noise, each coordinate's own, and of what the model lacks, which repeats of a pose share."""
    if not (np.isfinite(noise) and noise >= 0.0) or noise**2 + inadequacy**2 == 0.0:
        raise OptionError(
            "The noise of the instrument is not known: state it, larger than zero, per coordinate.", option="noise"
        )
    place = _number_coordinates(measurement, seen)
    alike = place[:, None] == place[None, :]
    least = (LEAST * inadequacy) ** 2  # of a version that says no noise apart: repeats would be one number
    return np.asarray(inadequacy**2 * alike + max(noise**2, least) * np.eye(len(place)))


def _number_coordinates(measurement: Measurement, seen: Bools) -> Ints:
    """Number the measured coordinates (R,): the same one of the same pose has the same number."""
    count = np.arange(seen.shape[1] * 3).reshape(1, seen.shape[1], 3)
    return np.asarray((measurement.observations.pose_groups()[:, None, None] * count.size + count)[seen])


def _freedom(lower: Floats, fitted: float, stated: float | None) -> float:
    """Freedom of the scale of a covariance, of which a noise that is stated for these rows has no part (Satterthwaite)."""
    if stated is None or not np.isfinite(fitted):
        return fitted
    inverse = solve_triangular(lower, np.eye(len(lower)), lower=True)
    exact = min(1.0, stated**2 * float(np.mean(np.sum(inverse**2, axis=1))))
    return fitted / max(1.0 - exact, LEAST) ** 2
