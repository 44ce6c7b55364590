"""What rows are to an identification: their kind, the influence of the parameters on them, and their errors.

Influence of the parameters on the tool point (thesis 3.5), pose by pose.

Kinds see different things: encoders on the links see no geometry, the tool mixes up what they tell apart. Where several
are fitted together, the report names what none of them tells alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.effects import Effect
from kilter_core.errors import OptionError
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.identifiability import identifiable
from kilter_core.identify.measurement_noise import pooled_columns
from kilter_core.identify.options import IdentifyOptions
from kilter_core.measurement import Measurement
from kilter_core.measurement.kind import Kind
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter, display_unit_and_scale, indices, mm
from kilter_core.types import Bools, Floats

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
