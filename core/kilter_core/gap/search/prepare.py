"""From rows to the first linearised problem: visits, the robust geometry fit, noise, outliers, the library."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import scipy.linalg

from kilter_core.effects import Effect
from kilter_core.effects.masses import LoadError
from kilter_core.errors import FindingDocument, NotConvergedError, ObservationError, TooFewPosesError
from kilter_core.gap.noise.from_repeats import add_approach_noise, fit_noise, spikes
from kilter_core.gap.noise.visits import (
    Visits,
    average_visits,
    average_windows,
    blocks,
    correlation_length,
    motion_blocks,
    split_into_windows,
)
from kilter_core.gap.options import Budget, GapOptions
from kilter_core.gap.search.candidates import Library, build_library
from kilter_core.gap.search.events import place_events, under, without_wrong
from kilter_core.gap.search.linear.linearized import LinearizedProblem, Tick, ignore_step, refit
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.noise_reader import (
    JUDGED_AGAIN,
    REPEATS_SET_ASIDE,
    NoiseReader,
    noise_warnings,
    outlier_warnings,
    rounding_warnings,
)
from kilter_core.gap.search.sources.contact_source import ContactSource
from kilter_core.gap.search.sources.link_source import LinkSource
from kilter_core.gap.search.sources.source import Source, rounding
from kilter_core.gap.search.sources.tool_source import ToolSource
from kilter_core.identify.estimate import estimate
from kilter_core.identify.estimate import prepare_problem as start_of
from kilter_core.identify.fit.least_squares import Fit, build_fit
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import has_contacts
from kilter_core.model import Calibration, RobotModel
from kilter_core.model.prediction import load_sign_blur as shared_blur
from kilter_core.observations import Observations
from kilter_core.observations.groups import FEWEST_ROWS, is_trajectory
from kilter_core.observations.shared_rows import identical_repeats
from kilter_core.types import Bools, Floats, Ints, Progress, unheard

NOT_FITTED = "geometry_not_fitted"
DOMINATES = 10.0  # times the noise that geometry leaves, from which its shape is not that of the noise
LIKE_NEIGHBOURS = 1.5  # correlation length, in poses, from which poses in a row are not independent
NESTS = " Of a pose that was visited with a reflector in several nests the first row has them all."
SPARE = 6  # scalars beyond the geometry below which nothing can be tested


@dataclass(frozen=True)
class Prepared:
    """All that the search starts from. ``kept (N,)`` marks the rows used of those given, before averaging."""

    problem: LinearizedProblem
    library: Library
    visits: Visits
    given: Observations
    rows: Observations
    kept: Bools
    outlying: Ints  # rows set aside, as spikes or with their visit, of those given
    moving: bool
    width: int  # rows in a window of a motion
    warnings: tuple[FindingDocument, ...]

    def update_noise_and_outliers(self, found: LinearizedProblem) -> Prepared:
        """The same with noise and outliers as the search judged them at its end, the geometry fitted to what is left."""
        if found.settings is self.problem.settings:
            return self
        found.resting()  # of ten thousand poses the derivatives of both fits are 200 MB
        problem = under(found.settings, self.problem)
        joint = problem.settings.source.unit == "rad"
        said = (
            *(w for w in self.warnings if w["code"] not in JUDGED_AGAIN),
            *noise_warnings(problem.settings.noise, joint),
        )
        outlying = np.setdiff1d(self.outlying, _outlying(self.kept, self.visits, self.problem))
        outlying = np.union1d(outlying, _outlying(self.kept, self.visits, problem)).astype(np.int64)
        return replace(self, problem=problem, outlying=outlying, warnings=(*said, *outlier_warnings(problem)))


def prepare_data(
    start: Calibration,
    rows: Observations,
    options: GapOptions,
    progress: Progress = unheard,
    budget: Budget | None = None,
) -> Prepared:
    """Visits, the robust fit of the geometry, noise, outliers and library: all that the search begins with.

    The search for wrong readings ends with its share of the ``budget``.

    Raises:
        TooFewPosesError: not enough poses for the geometry and a test. ObservationError: nothing measured.

    """
    return _Preparation(start, rows, options, progress, budget or Budget()).run()


@dataclass
class _Preparation:
    """Steps of the preparation, in order; each leaves what the next needs."""

    start: Calibration
    rows: Observations
    options: GapOptions
    progress: Progress
    budget: Budget
    warnings: list[FindingDocument] = field(default_factory=list)

    def run(self) -> Prepared:
        kept = self._without_copies()
        rows = self.rows.select(kept)
        moving = is_trajectory(rows)
        self.progress(0.02, "fitting the geometry")
        spiked = np.zeros(0, dtype=np.int64)
        windows = split_into_windows(rows)
        visits = average_visits(rows.select(windows.middle) if moving else rows)
        source, values, library = self._source(visits)
        if moving:
            rows = self._average_motion_rows(rows, source, values)
            visits = average_visits(replace(rows, pose_id=np.arange(len(rows))))
        else:
            residual = source.residual_of_rows(values, rows, ignore_step)
            spiky = spikes(residual, visits)
            if spiky.any():
                spiked = np.flatnonzero(kept)[spiky]
                kept[spiked] = False
                rows = rows.select(~spiky)
                visits = average_visits(rows)
        source = blur_load_signs(source.on_rows(visits.observations), values)
        self.progress(0.3, "noise from repeats")
        noise = NoiseReader(source, values, rows, visits, library, self.options, self.warnings).read()
        one, held = (None, False) if moving else rounding(source, values, rows.q, visits, noise)
        self.warnings += rounding_warnings(one, source, held)
        left, every = source.residual(values), np.ones(len(visits), dtype=bool)
        settings = ProblemSettings(
            source,
            add_approach_noise(noise, left, every, source.geometry_freedom_share(left.size)),
            every,
            visits.pose,
            trusted=noise.absolute,
            rounding=None if held else one,
        )
        problem = self._enough(refit(settings, values, [], partial(self.progress, 0.45, "fitting the geometry again")))
        problem = _refit_with_equal_weights(place_events(problem, library.candidates)[0])
        self.progress(0.6, "looking for outliers")
        problem = (
            self._refit_with_correlation(problem, visits)
            if moving
            else without_wrong(problem, self.budget, self.progress)
        )
        if not moving and not problem.settings.trusted and len(visits) >= FEWEST_ROWS:
            problem = self._in_order(problem, visits)
        outlying = np.union1d(spiked, _outlying(kept, visits, problem)).astype(np.int64)
        told = problem.settings.noise.repeats is not None
        self.warnings += [REPEATS_SET_ASIDE] if noise.repeats is not None and not told else []
        drift = noise_warnings(problem.settings.noise if told else noise, source.unit == "rad")
        said = (*self.warnings, *drift, *outlier_warnings(problem))
        return Prepared(problem, library, visits, self.rows, rows, kept, outlying, moving, windows.width, said)

    def _without_copies(self) -> Bools:
        """Rows that are not exact copies of an earlier one: a copy would make the noise look like nothing."""
        o = self.rows
        columns = (o.position, o.markers, o.link_q, o.t, o.socket, o.plane, o.bar, o.bar_length)
        measured = [v.reshape(len(o), -1) for v in columns if v is not None]
        whole = np.nan_to_num(np.hstack([o.q, *measured]), nan=-1e300)
        seen = np.flatnonzero(o.tool_seen)
        first = seen[np.unique(whole[seen], axis=0, return_index=True)[1]]
        kept = np.zeros(len(o), dtype=bool)
        kept[first] = True
        if len(seen) < len(o):
            self._warn(
                "rows_without_tool",
                f"{len(o) - len(seen)} rows do not measure the tool and were left out: a search compares whole visits. "
                f"An identification uses them.{NESTS if o.markers is not None else ''}",
            )
        if len(first) < len(seen):
            self._warn(
                "copied_rows",
                f"{len(seen) - len(first)} rows are exact copies of others and were left out: a copy does not count as a "
                "repeat.",
            )
        return self._without_identical(kept)

    def _without_identical(self, kept: Bools) -> Bools:
        """The same for repeats that measured exactly what an earlier one did, at another time: no instrument does that."""
        rows = self.rows.select(kept)
        again = np.zeros(len(rows), dtype=bool) if is_trajectory(rows) else identical_repeats(rows)
        if again.any():
            self._warn(
                "repeats_identical",
                f"{int(again.sum())} repeats measured exactly what an earlier row of their pose did (first in row "
                f"{int(np.flatnonzero(kept)[again][0]) + 1}) and were left out: without scatter they are copies, held "
                "readings or simulated, and say nothing of noise. Measure the poses again.",
            )
            kept[np.flatnonzero(kept)[again]] = False
        return kept

    def _source(self, visits: Visits) -> tuple[Source, Floats, Library]:
        rows = visits.observations
        if rows.link_q is not None and rows.position is None and rows.markers is None and not has_contacts(rows):
            return self._link_source(rows)
        options = self.options
        identify = IdentifyOptions(
            loss="huber", free=options.free, fix=options.fix, base=options.base, tool=options.tool
        )
        measurement = Measurement.from_observations(rows, self.start.marker_points, held=True)
        fit = self._geometry(measurement, identify)
        model = fit.problem.model
        library = build_library(self.start.robot, rows, model.names, options.effects)
        source, values = tool_source(model, fit.values, fit.problem.free, measurement, library)
        names = source.fitted_names()
        for held_back in (name for k in fit.problem.free if (name := model.names[k]) not in names):
            self._warn(
                "scale_held",
                f"Contacts do not show how large the arm is: {held_back}, its longest length, was held where an identification "
                "leaves it, and all other lengths are relative to it. A ball bar, or an instrument, would show it.",
            )
        return source, values, library

    def _geometry(self, measurement: Measurement, options: IdentifyOptions) -> Fit:
        """Robust fit of the geometry, a plain one where that has no end, else base and tool registered to start from."""
        for loss in ("huber", "linear"):
            try:
                return estimate(self.start, measurement, replace(options, loss=loss))
            except NotConvergedError as error:
                why = error.message
        self._warn(
            NOT_FITTED,
            f"The geometry could not be fitted at once ({why}) The search fits it from base and tool registered; compare "
            "what it leaves with an identification.",
        )
        problem, values = start_of(self.start, measurement, options)
        return build_fit(problem, values, problem.linearise(values, None), 0)

    def _link_source(self, rows: Observations) -> tuple[Source, Floats, Library]:
        model = self.start.model
        library = build_library(self.start.robot, rows, model.names, self.options.effects)
        whole = replace(model, effects=(*model.effects, *library.effects))
        source = LinkSource.from_model(whole, rows, len(library.parameters))
        if not source.live.any():
            raise ObservationError("Every link-side encoder is constant: the channels are dead, upload others.")
        dead = [j + 1 for j in np.flatnonzero(~source.live)]
        if dead:
            joints = ", ".join(str(j) for j in dead)
            self._warn("dead_encoder", f"The link-side encoder of joint {joints} is constant and was left out.")
        values = np.concatenate([source.prior_mean, np.zeros(len(library.parameters))])
        return source, values, library

    def _average_motion_rows(self, rows: Observations, source: Source, values: Floats) -> Observations:
        now = partial(self.progress, 0.15, f"averaging {len(rows)} samples of a motion")
        now()
        return average_motion_rows(rows, source, values, tick=now)

    def _enough(self, problem: LinearizedProblem) -> LinearizedProblem:
        if problem.nu < SPARE:
            poses = int(problem.settings.group.max()) + 1
            raise TooFewPosesError(
                f"{poses} poses determine the geometry and leave {problem.nu:.0f} numbers to test anything with: "
                "measure at least twice as many poses as the geometry needs.",
                poses=poses,
            )
        return problem

    def _refit_with_correlation(self, problem: LinearizedProblem, visits: Visits) -> LinearizedProblem:
        """Noise and its correlation from what the whole library could not explain; blocks instead of poses."""
        rest = _unexplained_residual(problem)
        length = correlation_length(rest)
        group = motion_blocks(visits.observations, length)
        self._warn(
            "correlated",
            f"The rows are samples of a motion; one in {length:.0f} counts as independent, and blocks of "
            f"{int(np.bincount(group).max())} are shuffled and held out together.",
        )
        return self._refit_with_inflated_noise(problem, visits, rest, group, length)

    def _in_order(self, problem: LinearizedProblem, visits: Visits) -> LinearizedProblem:
        """The same for poses without repeats whose errors resemble those of the poses measured before and after."""
        rest = _unexplained_residual(problem)
        t = visits.observations.t
        order = np.arange(len(rest)) if t is None else np.argsort(t, kind="stable")
        length = correlation_length(rest[order])
        if length < LIKE_NEIGHBOURS:
            return problem
        group = np.empty(len(rest), dtype=np.int64)
        group[order] = blocks(len(rest), length)
        self._warn(
            "correlated",
            f"What no effect explains is alike from one pose to the next; one pose in {length:.1f} counts as "
            f"independent, and {int(np.bincount(group).max())} poses in a row are shuffled together.",
        )
        return self._refit_with_inflated_noise(problem, visits, rest, group, length)

    def _refit_with_inflated_noise(
        self, problem: LinearizedProblem, visits: Visits, rest: Floats, group: Ints, length: float
    ) -> LinearizedProblem:
        """Re-fit with noise from ``rest``, its variance times the correlation ``length``."""
        settings = problem.settings
        noise = fit_noise(settings.whitening.back(rest), visits, settings.used, 0.0)
        settings = replace(settings, noise=settings.source.even(noise), group=group, inflation=length, trusted=True)
        return refit(
            settings, problem.values, [], partial(self.progress, 0.8, "fitting with the noise of correlated rows")
        )

    def _warn(self, code: str, message: str) -> None:
        self.warnings.append(FindingDocument.make(code, message))


def average_motion_rows(
    rows: Observations, source: Source, values: Floats, width: int | None = None, tick: Tick = ignore_step
) -> Observations:
    """Rows of motions averaged over windows, by the residuals they have at ``values``."""
    return average_windows(
        rows, source.residual_of_rows(values, rows, tick), split_into_windows(rows, width), source.live
    )


def _refit_with_equal_weights(problem: LinearizedProblem) -> LinearizedProblem:
    """The same with equal weights for all coordinates where the error of the model, not the noise, is what is left.

    The repeats of an arm that errs by twenty times their scatter say nothing of the shape of that error: see
    :meth:`~kilter_core.gap.noise.from_repeats.Noise.even`.
    """
    settings = problem.settings
    even = replace(settings, noise=settings.source.even(settings.noise))
    if not settings.noise.absolute or problem.chi2 < DOMINATES**2 * problem.nu:
        return problem
    return refit(even, problem.values, [])


def _unexplained_residual(problem: LinearizedProblem) -> Floats:
    """Whitened residual (V, m) off geometry and the whole library, every parameter within its prior."""
    settings = problem.settings
    y, X = problem.within_priors()
    H, b = np.eye(X.width), np.zeros(X.width)
    for part, columns in X.each():
        H += columns.T @ columns
        b += columns.T @ y[part]
    beta = scipy.linalg.solve(H, b, assume_a="pos")
    r = np.concatenate([y[part] - columns @ beta for part, columns in X.each()])
    return np.asarray(r.reshape(-1, settings.whitener.shape[-1]))


def _outlying(kept: Bools, visits: Visits, problem: LinearizedProblem) -> Ints:
    """Rows (of those given) set aside with their visit."""
    aside = np.zeros(len(kept), dtype=bool)
    if len(visits.visit) == kept.sum():
        aside[kept] = ~problem.settings.used[visits.visit]
    return np.flatnonzero(aside).astype(np.int64)


def tool_source(
    model: RobotModel, values: Floats, free: Ints, measurement: Measurement, library: Library
) -> tuple[ToolSource, Floats]:
    """The fitted ``model`` with load errors and the whole ``library`` beside its effects, and its values.

    Loads are taken on the chain that was fitted.
    """
    carried = _load_error_effects(model, measurement)
    whole = replace(model.with_loads_at_values(values), effects=(*model.effects, *carried, *library.effects))
    added = np.array([p.value for e in carried for p in e.parameters(model.robot)])
    own = np.concatenate([free, len(values) + np.arange(len(added))])
    source = ToolSource.from_model(whole, measurement, own, len(library.parameters))
    values = np.concatenate([values, added, np.zeros(len(library.parameters))])
    return (source, values) if measurement.observes_places else ContactSource.of_known_scale(source, values)


def _load_error_effects(model: RobotModel, measurement: Measurement) -> tuple[LoadError, ...]:
    """Load errors, unless the model has them already or nothing has a mass."""
    if any(e.nuisance for e in model.effects):
        return ()
    effect = LoadError().configure_for_robot(model.robot, measurement.observations)
    return (effect,) if effect.parameters(model.robot) else ()


def with_masses(effects: tuple[Effect, ...], source: Source) -> tuple[Effect, ...]:
    """The effects as a version keeps them: load errors where any effect reads loads, signs as soft as they were fitted."""
    if not source.of_loads.any():
        return effects
    softer = tuple(e.with_softened_signs(source.batch) for e in effects)
    carried = tuple(e for e in source.model.effects if e.nuisance)
    reads = any("moments" in e.needs and not e.nuisance for e in effects)
    return softer if not reads or any(e.nuisance for e in effects) else (*softer, *carried)


def blur_load_signs(source: Source, values: Floats, covariance: Floats | None = None) -> Source:
    """The source with its loads as uncertain as the priors of the load errors, or their ``covariance``, make them."""
    if not source.of_loads.any() or source.batch.slopes is None:
        return source
    prior = source.prior.select_parameters(source.of_loads).covariance
    return source.with_load_blur(source_load_blur(source, values, prior if covariance is None else covariance))


def source_load_blur(source: Source, values: Floats, covariance: Floats) -> Floats:
    """Standard deviation (n, 2) N·m of the load across and about each joint, in the rows where its sign is in doubt."""
    batch = source.model.apply_load_errors(source.batch, source.model_values(values))
    return shared_blur(source.model.effects, batch, covariance)
