"""What a few measurements say beyond a version: measured minus predicted, in units of what was to be expected."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from kilter_core.effects import make_effect
from kilter_core.errors import ObservationError, OptionError, TooFewPosesError
from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.measurement import Measurement
from kilter_core.measurement.poses import beside_rotation
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.observations.groups import evenly, subtract_group_means
from kilter_core.types import Bools, Floats, Ints
from kilter_core.watch.sockets import Measured

MOST_K = 15.0  # beyond the temperatures of the fit: what a check then lets pass for expansion hides most changes
GROWTH = 15e-6  # 1/K, standard deviation of the expansion of an arm: steel has 12, aluminium 23
ZEROS = 8e-6  # rad/K or m/K, standard deviation of what each zero moves with the temperature
UNSTATED_K = 5.0  # between an arm and its fit where nobody stated how warm either was: a hall by day and by night
REFERENCE_C = 20.0  # of the growth, whose derivative it does not change


@dataclass(frozen=True)
class Conditions:
    """What a check takes for granted of what nobody stated; the defaults are those of a check whose conditions all are stated.

    ``within_k`` is by how much (K) the arm may differ from its temperature at the fit where that of the rows or of the fit is
    not stated. ``setup`` is the standard deviation (m) with which the set-up repeats: a coordinate of the place of the
    instrument. ``noise_known``: the noise of the day is that of the version or the one stated; else the rows may scatter by
    more, as far as they show it themselves.
    """

    within_k: float = 0.0
    setup: float = 0.0
    noise_known: bool = True

    def of_rows(
        self, calibration: Calibration, rows: Observations, fitted_c: tuple[float, float] | None, placed: bool = True
    ) -> Conditions:
        """What is open of these rows: nothing of the temperature where rows and fit state theirs, or the version models it,
        and nothing of the set-up unless they are ``placed`` where the instrument stands.
        """
        stated = fitted_c is not None and rows.temperature_c is not None
        within = 0.0 if stated or "temperature_c" in calibration.model.needs else self.within_k
        return replace(self, within_k=within, setup=self.setup if placed else 0.0)


STATED = Conditions()


def refuse_another_tool(calibration: Calibration, rows: Observations) -> None:
    """Refuse markers where the version knows a point of the tool, and points where it knows markers.

    Raises:
        ObservationError: nobody says where on the tool the rows were measured.

    """
    marked = rows.markers is not None
    if marked == (calibration.marker_points is not None):
        return
    if marked:
        said = "The rows have markers, and the version does not know where on the tool they are"
        remedy = "Measure the point that the version was identified with (x_mm, y_mm, z_mm)"
    else:
        said = "The rows have a point, and the version knows the tool by its markers alone"
        remedy = "Measure these markers (m1x_mm ...)"
    raise ObservationError(
        f"{said}: nobody says where on the tool was measured. {remedy}, or identify a version with this tool.",
        code="tool_not_stated",
    )


def allowance(
    calibration: Calibration, rows: Observations, fitted_c: tuple[float, float] | None, conditions: Conditions
) -> Floats | None:
    """Displacements (N, 6, K) of one standard deviation each that the conditions explain: temperature and set-up; None of none.

    Raises:
        ObservationError: more than 15 K outside of the temperatures of the fit (lowest, highest).

    """
    parts = [expansion(calibration, rows, fitted_c, conditions.of_rows(calibration, rows, fitted_c).within_k)]
    if conditions.setup > 0.0:
        parts.append(setup_motions(calibration, rows, conditions.setup))
    made = [one for one in parts if one is not None]
    return np.concatenate(made, axis=2) if made else None


def setup_motions(calibration: Calibration, rows: Observations, sigma: float) -> Floats:
    """Displacements (N, 6, 6) of the measured places by an instrument set up again ``sigma`` m (one standard deviation) off.

    Three shifts, and three rotations about the middle of the rows, which move a place at their rms distance by as much.
    """
    position = calibration.predict(rows).position
    arm = position - position.mean(axis=0)
    lever = max(float(np.sqrt(np.mean(np.sum(arm**2, axis=1)))), sigma)
    out = np.zeros((len(rows), 6, 6))
    out[:, :3, :3] = sigma * np.eye(3)
    out[:, 3:, 3:] = sigma / lever * np.eye(3)
    out[:, :3, 3:] = -np.cross(arm[:, None, :], out[:, 3:, 3:], axis=2).transpose(0, 2, 1)
    return out


def expansion(
    calibration: Calibration, rows: Observations, fitted_c: tuple[float, float] | None, within_k: float = 0.0
) -> Floats | None:
    """Displacements (N, 6, K) of one standard deviation each that the temperature of rows explains beyond that of the fit,
    (lowest, highest): growth of the arm about its base, of each link by itself, and its zeros. Where nobody knows the
    temperatures they are ``within_k`` of each other; None where they are not beyond, and where the version models them.

    Raises:
        ObservationError: more than 15 K outside.

    """
    if "temperature_c" in calibration.model.needs:
        return None
    if fitted_c is None or rows.temperature_c is None:
        return within_k * _per_kelvin(calibration, rows) if within_k > 0.0 else None
    low, high = fitted_c
    beyond = rows.temperature_c - np.clip(rows.temperature_c, low, high)
    worst = int(np.abs(beyond).argmax())
    if abs(beyond[worst]) > MOST_K:
        between = f"{low:.4g} deg C" if high - low < 0.05 else f"{low:.4g} to {high:.4g} deg C"
        raise ObservationError(
            f"Row {worst + 1} was measured at {rows.temperature_c[worst]:.4g} deg C, and the version at {between}: at more "
            f"than {MOST_K:g} K of difference an arm expands by more than what a check looks for. Measure at the temperature "
            "of the version, or identify one with thermal_growth and thermal_drift from rows of several temperatures.",
            code="another_temperature",
            row=worst + 1,
            column="temperature_c",
            fitted_c=[low, high],
        )
    if not beyond.any():
        return None
    return _per_kelvin(calibration, rows) * beyond[:, None, None]


def _per_kelvin(calibration: Calibration, rows: Observations) -> Floats:
    """Displacements (N, 6, K) of one standard deviation each by one kelvin."""
    found, motions = calibration.model.joint_jacobian(rows, calibration.values)
    grown = np.zeros((len(rows), 6, 1))
    grown[:, :3, 0] = GROWTH * (found.position - calibration.model.T_base[:3, 3])
    links = GROWTH * _growth_of_links(calibration, rows)
    return np.concatenate([grown, links, ZEROS * motions], axis=2)


def _growth_of_links(calibration: Calibration, rows: Observations) -> Floats:
    """Derivatives (N, 6, K) of the tool by the growth of each link that has a length."""
    model = calibration.model
    try:
        grown = replace(model, effects=(*model.effects, make_effect("link_growth", reference_c=REFERENCE_C)))
    except OptionError:  # no link has a length
        return np.zeros((len(rows), 6, 0))
    at = np.arange(len(model.names), len(grown.names))
    warmer = replace(rows, temperature_c=np.full(len(rows), REFERENCE_C + 1.0))
    return grown.jacobian(warmer, np.append(calibration.values, np.zeros(len(at))), at)[1]


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
