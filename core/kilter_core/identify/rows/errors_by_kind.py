"""What each kind of measurement says in a fit: its noise, its errors, and the parameters that are known because of it.

Kinds see different things: encoders on the links see no geometry, the tool mixes up what they tell apart. Where several
are fitted together, the report names what none of them tells alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kilter_core.identify.fit.least_squares import Fit
from kilter_core.identify.identifiable.identifiability import identifiable
from kilter_core.identify.rows.noise import pooled_columns
from kilter_core.measurement import Measurement
from kilter_core.measurement.kind import Kind
from kilter_core.model import Calibration
from kilter_core.parameters import display_unit_and_scale
from kilter_core.types import Bools, Floats

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
