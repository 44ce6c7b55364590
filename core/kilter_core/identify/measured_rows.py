"""What rows are to an identification: their kind, the influence of the parameters on them, and their errors.

Influence of the parameters on the tool point (thesis 3.5), pose by pose.

Kinds see different things: encoders on the links see no geometry, the tool mixes up what they tell apart. Where several
are fitted together, the report names what none of them tells alone.

Measurement noise from repeats of a pose, the only estimate that owes nothing to the model.

Three things are kept apart that look alike: how shots of one visit differ (the instrument), how visits of a pose differ
(the instrument and how the arm comes to rest: what a prediction cannot know), and what is not noise at all: the two sides
a pose is approached from, another payload or session, and wrong readings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.special import chdtri, fdtrc

from kilter_core.effects import Effect
from kilter_core.errors import OptionError
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.fit.robust import median_scale
from kilter_core.identify.identifiability import identifiable
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement, Residual
from kilter_core.measurement.kind import Kind
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.groups import unbiased_deviations, with_directions
from kilter_core.observations.shared_rows import identical_repeats
from kilter_core.parameters import Parameter, display_unit_and_scale, indices, mm
from kilter_core.types import Bools, Floats, Ints

STEP_RAD = math.radians(0.05)  # the deviations of thesis 3.5
STEP_M = 1e-4
STEP_SHARE = STEP_M / 0.005  # of the prior sigma, for parameters that are neither: what 0.1 mm is of a length's


@dataclass(frozen=True)
class Influence:
    """Displacement of the tool point ``moved (N, F)`` m when each of ``names`` alone deviates by its step (SI)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    steps: Floats
    moved: Floats

    @property
    def relative(self) -> Floats:
        """Influence vector k (N, F) of each pose, the largest being 1 (thesis 3.6)."""
        return relative_influence(self.moved)

    def to_document(self) -> list[dict[str, Any]]:
        """Rows {name, step, unit, mean_mm, min_mm, max_mm, mean_k, leads} in falling order of the mean.

        ``leads`` is the share of poses in which the parameter moves the tool more than any other.
        """
        k = self.relative
        first = np.bincount(np.argmax(k, axis=1), minlength=len(self.names)) / len(k)
        rows = []
        for c in np.argsort(-self.moved.mean(axis=0), kind="stable"):
            unit, scale = display_unit_and_scale(self.units[c])
            column = mm(self.moved[:, c])
            rows.append(
                {
                    "name": self.names[c],
                    "step": float(self.steps[c]) * scale,
                    "unit": unit,
                    "mean_mm": float(column.mean()),
                    "min_mm": float(column.min()),
                    "max_mm": float(column.max()),
                    "mean_k": float(k[:, c].mean()),
                    "leads": float(first[c]),
                }
            )
        return rows


def parameter_influence(calibration: Calibration, observations: Observations, names: Sequence[str]) -> Influence:
    """Impose +0.05 deg on angles and +0.1 mm on lengths, one at a time, at every pose (thesis 3.5, figure 3.8).

    Raises:
        OptionError: a name the model does not have.

    """
    model, values = calibration.model, calibration.values
    batch = model.batch(observations)
    still = model.predict(batch, values).position
    chosen = indices(model.names, names)
    steps = np.array([imposed_step(model.parameters[k]) for k in chosen])
    moved = np.empty((len(still), len(chosen)))
    for c, k in enumerate(chosen):
        there = values.copy()
        there[k] += steps[c]
        moved[:, c] = np.linalg.norm(model.predict(batch, there).position - still, axis=1)
    return Influence(tuple(names), tuple(model.parameters[k].unit for k in chosen), steps, moved)


def imposed_step(parameter: Parameter) -> float:
    """Deviation imposed on a parameter, SI."""
    return {"rad": STEP_RAD, "m": STEP_M}.get(parameter.unit, STEP_SHARE * parameter.prior_sigma)


def relative_influence(moved: Floats) -> Floats:
    """Scale displacements (N, F) so that the largest of each pose is 1; a pose that nothing moves has all zero."""
    largest = moved.max(axis=1, keepdims=True)
    return np.asarray(moved / np.where(largest > 0.0, largest, 1.0))


def measurement_for(
    observations: Observations,
    options: IdentifyOptions,
    points: Floats | None = None,
    anchor: Measurement | None = None,
) -> Measurement:
    """Measurement of rows as the options want them.

    ``points (m, 3)`` is the markers' known shape; ``anchor`` are the rows that say where contacts stand, and what encoders
    and inclinometers read at zero.

    Raises:
        ObservationError: nothing measured. OptionError: a method that does not go with these rows.

    """
    made = Measurement.from_observations(
        observations,
        points,
        relative=options.base == "removed",
        held=True,
        socket_distances=options.socket_distances,
        anchor=anchor,
    )
    for kind in made.kinds:
        if kind.plain_fits_only:
            _refuse(options, kind.summary[0].upper() + kind.summary[1:])
    return made


def between_rows(options: IdentifyOptions, rows: Observations) -> IdentifyOptions:
    """The options for some of the rows: distances to sockets that are held out are not there to be fitted."""
    known = set() if rows.socket is None else set(np.unique(rows.socket).tolist())
    kept = {p: mm for p, mm in options.socket_distances_mm.items() if {int(n) for n in p.split("-")} <= known}
    return options if len(kept) == len(options.socket_distances_mm) else replace(options, socket_distances_mm=kept)


def _refuse(options: IdentifyOptions, what: str) -> None:
    if options.method != "least_squares":
        raise OptionError(f"{what} are identified by method least_squares only.", option="method")
    if options.loss == "tukey":
        raise OptionError(f'{what} have no rows to let go one by one: take loss "huber".', option="loss")
    if options.intervals == "bootstrap":
        raise OptionError(f"{what} have no poses to resample one by one: take intervals profile.", option="intervals")
    if any(effect.id == "unknown_residual" for effect in options.make_effects()):
        raise OptionError(f"{what} cannot gate a learned effect: leave unknown_residual out.", option="effects")


def as_inputs(named: Sequence[Effect | type[Effect]], start: Calibration | None, *given: Any) -> tuple[Any, ...]:
    """What was given, its rows with the tilt of the base as a condition where an effect takes it so.

    The effects are those ``named`` and those of the ``start``.
    """
    effects = (*named, *(() if start is None else start.model.effects))
    if not any("base_tilt_x" in effect.needs for effect in effects):
        return given
    return tuple(one.with_tilt_as_condition() if isinstance(one, Observations) else one for one in given)


SHARPER = 2.0  # times more certain, from which a parameter is named
Stages = Mapping[str, Calibration]
KindErrors = dict[str, dict[str, Floats]]
"""Squared errors (K,) of each stage, by kind."""


def squared_errors_by_kind(stages: Stages, measurement: Measurement) -> KindErrors:
    """What each stage leaves of each kind."""
    return {
        kind.name: {name: np.sum(kind.errors(stage)[0] ** 2, axis=1) for name, stage in stages.items()}
        for kind in measurement.kinds
    }


def pool_kind_errors(parts: list[KindErrors]) -> KindErrors:
    """Pool folds, or set-ups."""
    names = dict.fromkeys(name for part in parts for name in part)
    return {
        name: {
            s: np.concatenate([p[name][s] for p in parts if name in p])
            for s in next(p[name] for p in parts if name in p)
        }
        for name in names
    }


@dataclass(frozen=True)
class Share:
    """What one kind brings to a fit: ``alone`` are parameters that it tells by itself, ``only`` those that are known because
    of it: without it the others do not tell them. ``sharper`` are others that it makes that many times more certain.
    """

    kind: Kind
    noise: float
    from_repeats: float | None
    alone: tuple[str, ...]
    only: tuple[str, ...]
    sharper: Mapping[str, float]


@dataclass(frozen=True)
class Shares:
    """The kinds of a fit, and the parameters that all ``together`` tell and none alone."""

    each: tuple[Share, ...]
    together: tuple[str, ...]

    @staticmethod
    def from_fit(fit: Fit, names: tuple[str, ...]) -> Shares:
        """Split the information of a fit by kind; only the parameters ``names`` are named."""
        measurement = fit.problem.measurement
        told = _information(fit)
        whole = sum(told.values(), np.zeros((len(fit.names),) * 2))
        all_known, left = _identifiable_mask(whole), _relative_sigma(whole)
        shares, alone_at_all = [], np.zeros(len(fit.names), dtype=bool)
        for kind in measurement.kinds:
            alone = _identifiable_mask(told[kind.name])
            others = sum((H for name, H in told.items() if name != kind.name), np.zeros_like(told[kind.name]))
            only = all_known & ~_identifiable_mask(others)
            alone_at_all |= alone
            more = _relative_sigma(others) / left
            named = _select_names(fit, alone, names), _select_names(fit, only, names)
            sharper = all_known & ~only & (more > SHARPER) & np.isin(fit.names, list(names))
            times = {fit.names[k]: float(more[k]) for k in np.flatnonzero(sharper)}
            shares.append(Share(kind, _noise(fit, kind), _sigma_from_repeats(fit, kind), *named, times))
        return Shares(tuple(shares), _select_names(fit, all_known & ~alone_at_all, names))

    def to_document(self, train: KindErrors, held: KindErrors) -> dict[str, Any]:
        """The ``measurements`` of the result, in mm or degrees, and what they tell together."""
        rows = []
        for share in self.each:
            unit, scale = display_unit_and_scale(share.kind.unit)
            rows.append(
                {
                    "kind": share.kind.name,
                    "unit": unit,
                    "numbers": share.kind.scalars(),
                    "noise": share.noise * scale,
                    "repeats": None if share.from_repeats is None else share.from_repeats * scale,
                    "train": _rms(train.get(share.kind.name), scale),
                    "validation": _rms(held.get(share.kind.name), scale),
                    "tells_alone": list(share.alone),
                    "known_because_of_it": list(share.only),
                    "sharpens": dict(share.sharper),
                }
            )
        return {"measurements": rows, "known_together": list(self.together)}


def _information(fit: Fit) -> dict[str, Floats]:
    """Information (F, F) of each kind, per prior sigma."""
    here = fit.problem.linearise(fit.values, fit.residual)
    scaled, start, seen, out = here.J * fit.problem.prior_sigma, 0, 0, {}
    measurement = fit.problem.measurement
    prediction = fit.problem.model.predict(fit.problem.batch, fit.values)
    for kind in measurement.kinds:
        blocks = here.residual.blocks[seen : seen + len(kind.blocks(prediction))]
        seen, size = seen + len(blocks), sum(fit.problem.block_size(block) for block in blocks)
        own = scaled[start : start + size]
        out[kind.name] = np.asarray(own.T @ own)
        start += size
    return out


def _relative_sigma(information: Floats) -> Floats:
    """Posterior over prior standard deviation (F,)."""
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(information + np.eye(len(information))))))


def _identifiable_mask(information: Floats) -> Bools:
    return identifiable(_relative_sigma(information), np.ones(len(information)))


def _select_names(fit: Fit, which: Bools, names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name, told in zip(fit.names, which, strict=True) if told and name in names)


def _groups(fit: Fit, kind: Kind) -> list[str]:
    prediction = fit.problem.model.predict(fit.problem.batch, fit.values)
    return [block.group for block in kind.blocks(prediction)]


def _noise(fit: Fit, kind: Kind) -> float:
    """Standard deviation by which the first block of the kind was weighed."""
    return float(np.mean(fit.problem.weights.group_sigma(_groups(fit, kind)[0])))


def _sigma_from_repeats(fit: Fit, kind: Kind) -> float | None:
    """The same from repeats of a pose, which owe nothing to the model; None without, and of lengths between rows."""
    rows = fit.problem.measurement.observations
    block = kind.blocks(fit.problem.model.predict(fit.problem.batch, fit.values))[0]
    if len(block.r) != len(rows):
        return None
    return pooled_columns(block.r.reshape(len(rows), -1), rows.conditions())


def _rms(stages: dict[str, Floats] | None, scale: float) -> dict[str, float] | None:
    if stages is None or not len(next(iter(stages.values()))):
        return None
    return {name: float(np.sqrt(np.mean(square))) * scale for name, square in stages.items()}


CHANCE = 0.01  # of calling one good reading of a campaign wrong
PASSES = 10
ALPHA = 0.001  # of taking chance for the two sides of a pose
FEWEST_NUMBERS = 3  # numbers a standard deviation needs to be one


@dataclass(frozen=True)
class Repeats:
    """Standard deviations (m) of a coordinate: of a reading between visits of its pose, and between shots of one visit.

    None where nothing tells. ``wrong (K,)`` are rows whose readings stand too far from their repeats to be noise, and
    ``copies (K,)`` those that repeat an earlier row to the last digit, of which nothing was read.
    """

    between: float | None
    shots: float | None
    wrong: Ints
    freedom: int = 0  # of ``between``
    copies: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @staticmethod
    def from_observations(observations: Observations, left: Residual | None = None) -> Repeats:
        """Read the repeats; from what a fit ``left`` of them where it is known, so that readings need not be equal.

        Where no column says from which side a pose was approached, the order of the rows says which way each joint moved
        last: visits are compared side by side as soon as those differ by less.
        """
        flat = _points(observations, left)
        if flat is None:
            return Repeats(None, None, np.zeros(0, dtype=np.int64))
        again = identical_repeats(observations)
        flat = np.where(again[:, None], np.nan, flat)
        found = replace(_read(observations, flat), copies=np.flatnonzero(again))
        if observations.stated_direction is not None or found.between is None:
            return found
        sided = _read(replace(with_directions(observations), directions_derived=False), flat)
        return replace(sided, copies=found.copies) if _clearly_less(sided, found) else found

    def to_document(self) -> dict[str, Any]:
        """JSON-able, mm."""
        return {
            "between_visits_mm": None if self.between is None else mm(self.between),
            "between_shots_mm": None if self.shots is None else mm(self.shots),
            "wrong_rows": len(self.wrong),
        }


def _read(observations: Observations, flat: Floats) -> Repeats:
    condition, visit = observations.conditions(), observations.visits()
    rows = np.flatnonzero(~np.isnan(flat).any(axis=1))
    shots, _, off = _pooled_sigma(flat[rows], visit[rows])
    wrong = [rows[off]]
    rows = rows[~off]
    _, first, place, count = np.unique(visit[rows], return_index=True, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(place, weights=c) for c in flat[rows].T], axis=1) / count[:, None]
    spread, freedom, off = _pooled_sigma(mean, condition[rows][first])
    wrong.append(rows[off[place]])
    between = (
        None
        if spread is None
        else float(np.hypot(spread, (shots or 0.0) * np.sqrt(_averaged_variance_share(count[~off]))))
    )
    return Repeats(between, shots, np.sort(np.concatenate(wrong)), freedom)


def with_sides_of_repeats(rows: Observations) -> Observations:
    """Return rows whose visits of a pose repeat each other from one side only, where those clearly differ by less.

    Derived directions may be of an order in which nobody measured: they part no repeats unless the repeats show them.
    """
    flat = _points(rows, None)
    if not rows.directions_derived or flat is None:
        return rows
    sided = replace(rows, directions_derived=False)
    return sided if _clearly_less(_read(sided, flat), _read(rows, flat)) else rows


def _clearly_less(sided: Repeats, found: Repeats) -> bool:
    """Whether visits from one side differ by less than visits from any (F test on what the sides add)."""
    if sided.between is None or found.between is None or not FEWEST_NUMBERS <= sided.freedom < found.freedom:
        return False
    within = sided.freedom * sided.between**2
    more, extra = found.freedom * found.between**2 - within, found.freedom - sided.freedom
    return within > 0.0 and bool(fdtrc(extra, sided.freedom, more / extra / sided.between**2) < ALPHA)


def repeat_sigma(observations: Observations) -> float | None:
    """Standard deviation (m) of a coordinate between visits of a pose, None where no pose was visited again.

    Markers count as their own points; rows with an unseen marker are left out.
    """
    return Repeats.from_observations(observations).between


def _points(observations: Observations, left: Residual | None) -> Floats | None:
    points = observations.markers if observations.markers is not None else observations.position
    if left is not None and len(left.points) == len(observations) and left.points.shape[2] == 3:
        points = left.points
    return None if points is None else points.reshape(len(points), -1)


def _averaged_variance_share(count: Ints) -> float:
    """Share of the variance of a shot that the mean of a visit has lost."""
    return float(np.mean(1.0 - 1.0 / count)) if len(count) else 0.0


def pooled_columns(values: Floats, group: Ints) -> float | None:
    """Standard deviation of a number (N, C) within groups, each column by itself, NaN where nothing was read."""
    square, freedom = 0.0, 0
    for column in values.T:
        seen = ~np.isnan(column)
        spread, free, _ = _pooled_sigma(column[seen, None], group[seen])
        if spread is not None:
            square, freedom = square + free * spread**2, freedom + free
    return float(np.sqrt(square / freedom)) if freedom else None


def _pooled_sigma(values: Floats, group: Ints) -> tuple[float | None, int, Bools]:
    """Standard deviation of a coordinate within groups, its freedom, and which values (N,) are too far off to count."""
    kept = np.ones(len(values), dtype=bool)
    width = values.shape[1] if len(values) else 1
    limit = float(np.sqrt(chdtri(width, CHANCE / max(len(values), 1))))
    for _ in range(PASSES):
        off, free = unbiased_deviations(values, group, kept)
        count = np.bincount(group[kept], minlength=int(group.max(initial=-1)) + 1)
        size = np.where(kept & (count[group] > 1), np.linalg.norm(off, axis=1), 0.0)
        told = size[kept & (count[group] > 1)]
        if not len(told):
            break
        far = size > limit * median_scale(told, width)
        if not far.any() or median_scale(told, width) == 0.0:
            break
        # Of a group the worst goes first: it drags the mean that makes the others look wrong.
        worst = np.zeros(len(count))
        np.maximum.at(worst, group, size)
        kept &= ~(far & (size >= worst[group] * (1.0 - 1e-9)))
    count = np.bincount(group[kept], minlength=int(group.max(initial=-1)) + 1)
    freedom = int(np.sum(np.maximum(count - 1, 0))) * width
    if freedom < FEWEST_NUMBERS:
        return None, freedom, ~kept
    square = (off[kept] / free[kept]) ** 2
    return float(np.sqrt(square[count[group[kept]] > 1].sum() / freedom)), freedom, ~kept
