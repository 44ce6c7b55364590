"""Errors before and after in mm, on what was fitted and what was not: validation rows, or poses left out in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.stats import binom, norm, t

from kilter_core.gap.evidence.fits.final_fit import Posterior, inflation, widening
from kilter_core.gap.evidence.fits.intervals import interval_width
from kilter_core.gap.evidence.held_out.adequacy import gain, left_out_errors, left_out_floor
from kilter_core.gap.noise.visits import blocks, motion_blocks
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.linear.linearized import (
    cholesky_root,
    fit_nonlinear_values,
    fit_rms,
    noise_rms,
    rms_error_at_values,
)
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.outliers import along_one_motion
from kilter_core.gap.search.prepare import Prepared, average_motion_rows
from kilter_core.gap.search.sources.source import Source, rounding_document
from kilter_core.observations import Observations
from kilter_core.observations.groups import is_trajectory
from kilter_core.parameters import DEG, display_unit_and_scale
from kilter_core.types import Bools, Floats, Ints

# Whether held-out poses erred as an effect predicted: their errors without it, against what it changes there.
#
# The drop of squared errors alone has little power, because it counts the noise of every pose twice: an effect of
# non-centrality λ on the held-out poses is √λ / 2 deviations outside it, and √λ out of the regression on what was
# predicted. The prediction comes from other poses, so without an effect the slope is zero, whatever was chosen.

MOST_LEVERAGE = 0.99


def surely_predicted(without: Floats, with_: Floats, group: Ints) -> float:
    """Slope of the errors without an effect on the change that it predicts, in standard normal deviations.

    Args:
        without: whitened errors (V, m) of held-out rows by the fit without the effect.
        with_: the same by the fit with it.
        group: pose (V,) of each row; poses are independent, rows of one are not.

    The standard error is the jackknife's over poses (HC3; MacKinnon and White 1985, J. Econometrics 29), its tail
    Student's with one degree per pose.

    """
    change = without - with_
    number = np.unique(group, return_inverse=True)[1].reshape(-1)
    along = np.bincount(number, np.sum(change * without, axis=1))
    size = np.bincount(number, np.sum(change**2, axis=1))
    whole = float(size.sum())
    if len(along) < 2 or whole <= 0.0:
        return 0.0
    slope = float(along.sum()) / whole
    left = (along - slope * size) / (1.0 - np.minimum(size / whole, MOST_LEVERAGE))
    error = float(np.sqrt(np.sum(left**2))) / whole
    if error <= 0.0:
        return float("inf") if slope > 0.0 else 0.0
    freedom = len(along) - 1
    deviations = float(norm.isf(t.sf(abs(slope) / error, freedom))) if slope / error < 1e3 else slope / error
    return float(np.copysign(deviations, slope))


SPIKE = 8.0  # noise standard deviations, under the model before and after, at which a held-out row is not a measurement
SPIKES = 0.02  # share of such rows, or that of the search, above which the model cannot predict them: all then count
SURE_GAP = (
    3.0  # standard deviations of the noise's own mean square by which errors before exceed it, or no share is told
)
DRAWS = 999  # of the held-out poses, behind the interval of their error
FEWEST_DRAWN = 5  # poses below which drawing them again says too little
SPIKES_SURE = 0.99  # chance that so many visits with interrupted laser beams at that share are no more than counted


@dataclass(frozen=True)
class HeldOut:
    """Whitened errors (V, m) by the fits before and after, and how they came about.

    ``lower (m, m)`` converts them back to m or rad; ``floor`` is the variance a perfect model's would have, in units of
    noise: a little above 1, since the model was estimated. ``set_aside`` rows were left out as spikes; ``every`` are the
    errors after with them, None where there are none. Whitening correlated samples took ``inflation`` off their
    variance too.
    """

    before: Floats
    after: Floats
    lower: Floats
    floor: float
    how: str
    set_aside: int = 0
    inflation: float = 1.0
    predictive: dict[str, Any] | None = None
    every: Floats | None = None


class HoldoutEvaluator:
    """Predicts held-out poses by any set of library columns, fitted to the training rows only.

    ``fit`` is what the data say of all that was fitted: how far predictions of other poses may be off for it.
    """

    def __init__(
        self, search: SearchResult, prepared: Prepared, validation: Observations | None, fit: Posterior | None = None
    ) -> None:
        self.search, self.prepared, self.fit = search, prepared, fit
        self._given = np.zeros(0, dtype=np.int64) if validation is None else np.flatnonzero(validation.tool_seen)
        if validation is not None and not validation.tool_seen.all():
            validation = validation.select(validation.tool_seen)
        self.rows = validation
        self.moving = prepared.moving and validation is not None and is_trajectory(validation)
        if self.moving and validation is not None:
            source, values = on_rows(search.problem.settings.source, validation, search, search.problem.values)
            self.rows = average_motion_rows(validation, source, values, prepared.width)
        self._known: dict[tuple[int, ...], Floats] = {}
        self._values: dict[tuple[int, ...], Floats] = {}

    def errors(self, columns: Sequence[int]) -> Floats:
        """Whitened errors (V, m) of the held-out poses; each set of columns is fitted once."""
        key = tuple(columns)
        if key not in self._known:
            self._known[key] = self._errors(columns)
        return self._known[key]

    def _errors(self, columns: Sequence[int]) -> Floats:
        if self.rows is None:
            problem = self.search.problem if len(columns) else self.prepared.problem
            return left_out_errors(problem, columns)[problem.settings.used]
        problem = self.search.problem
        source = on_rows(problem.settings.source, self.rows, self.search, self._fitted_values(tuple(columns)))
        r = np.nan_to_num(source[0].residual(source[1]))
        if self.moving:
            r = source[0].without_instrument_offsets(r)
        return np.asarray(r @ np.linalg.inv(self._lower()).T)

    def _fitted_values(self, columns: tuple[int, ...]) -> Floats:
        """Values of the rows searched, fitted with a set of columns once."""
        if columns not in self._values:
            problem = self.search.problem
            begin = problem if columns else self.prepared.problem
            self._values[columns] = fit_nonlinear_values(problem.settings, begin.values, columns)
        return self._values[columns]

    def taken_off(self, place: int) -> float:
        """What one chosen candidate takes off the rms error (m; rad of a joint) of the rows searched, all else fitted again.

        Scores would say less of a large one: they project off what the priors hold.
        """
        rest = self.search.selector.columns([k for k in self.search.chosen if k != place])
        problem = self.search.problem
        return rms_error_at_values(problem.settings, self._fitted_values(tuple(rest))) - fit_rms(problem)

    def rms(self, columns: Sequence[int]) -> float:
        """Rms error (m; rad of a joint) of the held-out rows that are measurements, by a set of columns."""
        source = self.search.problem.settings.source
        return source.rms(self.errors(columns)[self.valid_row_mask] @ self._lower().T)

    def rms_interval(self, columns: Sequence[int]) -> tuple[float, float] | None:
        """95 % interval (m; rad of a joint) of that error, by drawing whole poses again; None with too few poses."""
        group = np.unique(self._groups()[self.valid_row_mask], return_inverse=True)[1]
        errors, count = self.errors(columns)[self.valid_row_mask] @ self._lower().T, np.bincount(group)
        if len(count) < FEWEST_DRAWN:
            return None
        source = self.search.problem.settings.source
        order = np.split(np.argsort(group, kind="stable"), np.cumsum(count)[:-1])
        squares = np.array([source.rms(errors[own]) ** 2 for own in order])
        rng, means = np.random.default_rng(0), np.zeros(DRAWS)
        for k in range(DRAWS):  # one after the other: all at once would take memory by poses times draws
            drawn = rng.integers(0, len(count), len(count))
            means[k] = np.sum((squares * count)[drawn]) / np.sum(count[drawn])
        low, high = np.sqrt(np.quantile(means, (0.025, 0.975)))
        return float(low), float(high)

    @property
    def poses(self) -> int:
        """Held-out poses (of motions blocks) that took no part in choosing."""
        return 0 if self.rows is None else len(np.unique(self._groups()))

    def _lower(self) -> Floats:
        """Root (m, m) of the noise covariance by which errors are whitened: of a held-out row, or of a visit left out."""
        settings = self.search.problem.settings
        if self.rows is None:
            return cholesky_root(np.mean(settings.of_visit[settings.used], axis=0) * settings.inflation)
        return cholesky_root(settings.of_row * (settings.inflation if self.moving else 1.0))

    def report(self) -> HeldOut:
        """Geometry only, and everything named."""
        before, after = self.errors([]), self.errors(self.search.columns)
        problem, columns = self.search.problem, self.search.columns
        if self.rows is None:
            floor = left_out_floor(problem, columns)
            return HeldOut(before, after, self._lower(), floor, "leave one pose out", 0, problem.settings.inflation)
        spike = ~self.valid_row_mask
        spread = self._spread()
        floor = 1.0 + (problem.U.shape[1] + len(columns)) / max(problem.rows, 1)
        if spread is not None:
            floor = _floor(spread[~spike] / widening(self.search) ** 2, self._lower())
        floor -= 1.0 - self._left_share
        how = "validation observations"
        if self.moving and not problem.settings.source.observes_tool:
            how += ", with the encoder offsets of each motion fitted to it"
        if not problem.settings.source.observes_places:
            how += " of other placements, with contacts and ball fitted to them"
        grown = problem.settings.inflation if self.moving else 1.0
        told = None if spread is None else self._predictive(after, spread, ~spike)
        every = after if spike.any() else None
        return HeldOut(before[~spike], after[~spike], self._lower(), floor, how, int(np.sum(spike)), grown, told, every)

    @cached_property
    def valid_row_mask(self) -> Bools:
        """Held-out rows that are measurements: all but spikes, unless those are more than interrupted laser beams explain.

        A share alone would call one interrupted laser beam among thirty rows structure, and let it decide what the
        others cannot. Where more of the rows of the search were wrong, as many are to be expected here. What disturbs one
        row of a visit disturbs all of it, so visits are counted.
        """
        before, after = self.errors([]), self.errors(self.search.columns)
        spike = np.minimum(np.abs(before).max(axis=1), np.abs(after).max(axis=1)) > SPIKE * max(1.0, _scale(after))
        share = max(SPIKES, 1.0 - float(np.mean(self.search.problem.settings.used)))
        if self.rows is None:
            return np.ones(len(spike), dtype=bool)
        visit = np.arange(len(spike)) if self.moving else np.unique(self.rows.visits(), return_inverse=True)[1]
        spike &= ~self._of_the_arm(after, spike, visit)
        if len(np.unique(visit[spike])) > binom.ppf(SPIKES_SURE, visit.max() + 1, share):
            return np.ones(len(spike), dtype=bool)
        return np.asarray(~spike)

    def _of_the_arm(self, after: Floats, spike: Bools, visit: Ints) -> Bools:
        """Which spikes (N,) are off as one joint moves the tool, together with the visits that the search set aside."""
        problem, rows = self.search.problem, self.rows
        settings, none = problem.settings, np.zeros_like(spike)
        if rows is None or self.moving or not spike.any() or not settings.source.observes_tool:
            return none
        aside, first = ~settings.used, np.flatnonzero(spike)[np.unique(visit[spike], return_index=True)[1]]
        other, values = on_rows(settings.source, rows, self.search, self._fitted_values(tuple(self.search.columns)))
        here, there = settings.source.joint_columns(problem.values), other.joint_columns(values)
        back, size = np.linalg.inv(self._lower()).T, after.shape[1]

        def motion(joint: int) -> Floats:
            return np.vstack([settings.whitening.residual(here(joint)).reshape(-1, size), there(joint) @ back])

        left = np.vstack([problem.raw.reshape(-1, size)[aside], after[first]])
        which = np.concatenate([np.flatnonzero(aside), len(aside) + first])
        found = along_one_motion(left, which, motion, rows.q.shape[1])[int(aside.sum()) :]
        return np.asarray(spike & np.isin(visit, visit[first[found]]))

    @property
    def set_aside(self) -> Ints:
        """Rows of the validation that was given that were left out as spikes; none of a motion, which counts by windows."""
        return np.zeros(0, dtype=np.int64) if self.moving or self.rows is None else self._given[~self.valid_row_mask]

    def _spread(self) -> Floats | None:
        """Covariance (N, m, m) of the predictions of the held-out rows: of the fit, and of signs that nobody knows.

        None for joint data.
        """
        source, problem = self.search.problem.settings.source, self.search.problem
        if self.rows is None or self.fit is None or not source.observes_tool:
            return None
        other, values = on_rows(source, self.rows, self.search, problem.values)
        return predicted_covariance(other, values, self.fit) + other.doubt(values)

    @property
    def _left_share(self) -> float:
        if self.rows is None:
            return 1.0
        source = self.search.problem.settings.source
        return on_rows(source, self.rows, self.search, self.search.problem.values)[0].left_share

    def _predictive(self, after: Floats, spread: Floats, kept: Bools) -> dict[str, Any]:
        """How many held-out coordinates lie in their 95 % intervals: fit, noise, and what the noise does not explain.

        Where rows were set aside, how many do with them too.
        """
        lower, grown = self._lower(), max(1.0, inflation(self.search))
        noise = lower @ lower.T * grown**2
        sigma = np.sqrt(np.diagonal(spread + noise, axis1=1, axis2=2))
        seen, kept = np.isfinite(self._held_out_residuals()), kept[:, None]
        inside = (np.abs(after @ lower.T) <= interval_width(self.search) * sigma) & seen
        group = np.unique(self._groups(), return_inverse=True)[1]
        by_pose = [np.bincount(group, np.sum(m, axis=1)).astype(int).tolist() for m in (inside & kept, seen & kept)]
        poses = [list(pose) for pose in zip(*by_pose, strict=True) if pose[1]]
        told = {"inside": int((inside & kept).sum()), "of": int((seen & kept).sum()), "poses": poses}
        return told if kept.all() else {**told, "inside_all": int(inside.sum()), "of_all": int(seen.sum())}

    @property
    def valid_reading_mask(self) -> Bools:
        """Which numbers (N, m) of the held-out rows that are measurements were read."""
        return np.isfinite(self._held_out_residuals())[self.valid_row_mask]

    def _held_out_residuals(self) -> Floats:
        """Residuals (N, m) of the held-out rows, NaN where nothing was seen."""
        assert self.rows is not None
        source, values = on_rows(
            self.search.problem.settings.source, self.rows, self.search, self.search.problem.values
        )
        return source.residual(values)

    def by_pose(self) -> tuple[Floats, Floats]:
        """Rms errors (G,) m or rad of the held-out poses by geometry alone and by everything named, as they are printed."""
        group = np.unique(self._groups()[self.valid_row_mask], return_inverse=True)[1]
        own = np.split(np.argsort(group, kind="stable"), np.cumsum(np.bincount(group))[:-1])
        source, lower = self.search.problem.settings.source, self._lower()
        before, after = (
            np.array([source.rms(e[pose] @ lower.T) for pose in own])
            for e in (self.errors([])[self.valid_row_mask], self.errors(self.search.columns)[self.valid_row_mask])
        )
        return before, after

    def effect_gain(self, place: int) -> tuple[float, float, float]:
        """Gain by one chosen candidate beyond the others, its standard error, and how surely it was predicted."""
        rest = self.search.selector.columns([k for k in self.search.chosen if k != place])
        without, with_ = self.errors(rest)[self.valid_row_mask], self.errors(self.search.columns)[self.valid_row_mask]
        group = self._groups()[self.valid_row_mask]
        return (*gain(without, with_, group), surely_predicted(without, with_, group))

    def _groups(self) -> Ints:
        """Pose of each held-out row; of motions the block."""
        settings = self.search.problem.settings
        if self.rows is None:
            return settings.group[settings.used]
        if self.moving:
            return motion_blocks(self.rows, settings.inflation)
        if settings.inflation > 1.0:  # a part of the poses in the order they were measured
            share = len(self.rows) / (len(self.rows) + len(settings.used))
            return blocks(len(self.rows), share * settings.inflation)
        return self.rows.pose_groups()


def predicted_covariance(source: Source, values: Floats, fit: Posterior) -> Floats:
    """Covariance (N, m, m) of a model's predictions of its rows, by the covariance of what was fitted."""
    J, names = source.all_columns(values, fit.names)
    own = [fit.names.index(name) for name in names]
    return np.asarray(J @ fit.covariance[np.ix_(own, own)] @ J.transpose(0, 2, 1))


def _floor(spread: Floats, lower: Floats) -> float:
    """Variance of held-out errors in units of noise when the model is perfect: the noise, and its estimation."""
    back = np.linalg.inv(lower)
    white = back @ spread @ back.T
    return 1.0 + float(np.mean(np.trace(white, axis1=1, axis2=2))) / len(lower)


def on_rows(source: Source, rows: Observations, search: SearchResult, fitted: Floats) -> tuple[Source, Floats]:
    """The fitted model on other rows: only the effects in use, so that only their columns are needed."""
    effects = tuple(e for k in search.chosen for e in search.selector.scorer.candidates[k].effects)
    return source.with_effects(rows, effects, fitted)


def noise_document(settings: ProblemSettings) -> dict[str, Any]:
    """The noise: standard deviations of a coordinate, and the covariance of a single row (of poses mm, then deg)."""
    noise, joint = settings.noise, settings.source.unit == "rad"
    unit, scale = display_unit_and_scale("rad" if joint else "m")
    scales = np.full(len(noise.row), scale)
    scales[noise.lengths or len(scales) :] = DEG
    return {
        "source": noise.source,
        "absolute": noise.absolute,
        "freedom": float(noise.freedom) if np.isfinite(noise.freedom) else None,
        f"within_visit_{unit}": None if noise.within is None else noise.within * scale,
        f"re_approach_{unit}": None if noise.between is None else noise.between * scale,
        "covariance": (noise.row * np.outer(scales, scales)).tolist(),
        "correlated_samples": settings.inflation,
        "drift": None if noise.drift is None else noise.drift.to_document(unit, scale),
        **rounding_document(settings.rounding, settings.source),
    }


def gap_document(prepared: Prepared, search: SearchResult, held: HeldOut) -> dict[str, Any]:
    """The gap before and after in mm (rms of the 3-D error), on training and held-out poses, beside the noise.

    ``noise_mm`` is the standard deviation of one coordinate of a row, as everywhere. ``noise_rms_mm`` and
    ``validation_noise_rms_mm`` are what the noise alone would give for before and after: lengths in space.
    ``validation_after_all_mm`` counts the held-out rows that were set aside too; it is there where some were. By views
    (``lengths``) all of them are beside the rotation of the tool, as sure as those of a typical view.
    """
    problem = search.problem
    size = problem.settings.whitener.shape[-1]
    source = problem.settings.source
    joint = source.unit == "rad"
    coordinate = problem.settings.noise.coordinate
    noise = noise_rms(problem.settings)
    r0, r1 = source.rms(held.before @ held.lower.T), source.rms(held.after @ held.lower.T)
    sigma = source.rms(np.eye(size) * np.sqrt(size * held.floor) @ (held.lower / np.sqrt(held.inflation)).T)
    if not problem.settings.trusted:
        # The scatter of the first fit holds the gap itself: the floor is that of the last fit.
        last = problem.gram.condition_on_columns(search.columns)
        share = np.sqrt(last.yy / max(last.nu, 1.0))
        coordinate, noise, sigma = coordinate * share, noise * share, sigma * share
    # Against a noise that was read from the fit itself, a closed gap means nothing; nor does it as a share of nothing.
    apart = SURE_GAP * np.sqrt(2.0 / max(held.before.size, 1))
    known = problem.settings.noise.absolute and r0**2 > (1.0 + apart) * sigma**2 and bool(search.chosen)
    closure = (r0**2 - r1**2) / (r0**2 - sigma**2) if known else None
    numbers = {
        "before": fit_rms(prepared.problem),
        "after": fit_rms(problem),
        "noise": coordinate,
        "noise_rms": noise,
        "validation_before": r0,
        "validation_after": r1,
        "validation_noise_rms": sigma,
    }
    if held.every is not None:
        numbers["validation_after_all"] = source.rms(held.every @ held.lower.T)
    unit, scale = display_unit_and_scale("rad" if joint else "m")
    out: dict[str, Any] = {f"{k}_{unit}": v * scale for k, v in numbers.items()}
    out["lengths"] = None if joint else "at_tool" if source.observations.pose_weight is None else "by_views"
    if joint:
        out |= {f"{k}_mm": None for k in ("before", "after", "noise", "validation_before", "validation_after")}
    steps = [{"names": list(s.names), "chi2_per_freedom": s.chi2_per_freedom} for s in search.steps]
    return out | {
        "closure": closure,
        "held_out": held.how,
        "held_out_set_aside": held.set_aside,
        "predictive": held.predictive,
        "steps": steps,
    }


def _scale(errors: Floats) -> float:
    return float(np.median(np.abs(errors)) / 0.6745)
