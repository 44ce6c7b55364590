"""Masses in a search: carried beside the geometry with their priors, and as a blur of the loads where these change sign."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.effects import Effect
from kilter_core.effects.load_error import LoadError
from kilter_core.gap.search.candidates import Library
from kilter_core.gap.search.contact_source import ContactSource
from kilter_core.gap.search.source import Source
from kilter_core.gap.search.tool_source import ToolSource
from kilter_core.measurement import Measurement
from kilter_core.model import RobotModel
from kilter_core.types import Floats, Ints

NEAR = 3.0  # standard deviations from zero within which the sign of a load is in doubt


def tool_source(
    model: RobotModel, values: Floats, free: Ints, measurement: Measurement, library: Library
) -> tuple[ToolSource, Floats]:
    """The fitted ``model`` with load errors and the whole ``library`` beside its effects, and its values.

    Loads are taken on the chain that was fitted.
    """
    carried = _carried(model, measurement)
    whole = replace(model.loads_at(values), effects=(*model.effects, *carried, *library.effects))
    added = sum(len(e.parameters(model.robot)) for e in carried)
    own = np.concatenate([free, len(values) + np.arange(added)])
    source = ToolSource.of(whole, measurement, own, len(library.parameters))
    values = np.concatenate([values, np.zeros(added + len(library.parameters))])
    return (source, values) if measurement.observes_places else ContactSource.of_known_scale(source, values)


def _carried(model: RobotModel, measurement: Measurement) -> tuple[LoadError, ...]:
    """Load errors, unless the model has them already or nothing has a mass."""
    if any(e.nuisance for e in model.effects):
        return ()
    effect = LoadError().on(model.robot, measurement.observations)
    return (effect,) if effect.parameters(model.robot) else ()


def with_masses(effects: tuple[Effect, ...], source: Source) -> tuple[Effect, ...]:
    """The effects as a version keeps them: load errors where any effect reads loads, signs as soft as they were fitted."""
    if not source.soft.any():
        return effects
    softer = tuple(e.softened(source.batch) for e in effects)
    carried = tuple(e for e in source.model.effects if e.nuisance)
    reads = any("moments" in e.needs and not e.nuisance for e in effects)
    return softer if not reads or any(e.nuisance for e in effects) else (*softer, *carried)


def blurred(source: Source, values: Floats, covariance: Floats | None = None) -> Source:
    """The source with its loads as uncertain as the priors of the load errors, or their ``covariance``, make them."""
    if not source.soft.any() or source.batch.slopes is None:
        return source
    prior = np.diag(source.prior_sigma[source.soft] ** 2)
    return source.blurred(blur_of(source, values, prior if covariance is None else covariance))


def blur_of(source: Source, values: Floats, covariance: Floats) -> Floats:
    """Standard deviation (n, 2) N·m of the load across and about each joint, in the rows where its sign is in doubt."""
    batch = source.model.loaded(source.batch, source.model_values(values))
    slopes = batch.slopes
    assert slopes is not None
    effect = next(e for e in source.model.effects if e.nuisance)
    columns = effect.load_columns(slopes)
    known = [k for k, c in enumerate(columns) if c >= 0]
    kept = [columns[k] for k in known]
    C = covariance[np.ix_(known, known)]

    def near(name: str, part: int, load: Floats) -> list[float]:
        """Deviations (n,) of one component, in the rows where its sign is in doubt."""
        by = slopes.of(name, part)[kept]
        sigma = np.sqrt(np.maximum(np.einsum("knj,knj->nj", by, np.tensordot(C, by, axes=1)), 0.0))
        return [_where_near(load[:, j], sigma[:, j]) for j in range(load.shape[1])]

    across = [near("wrench", 3 + a, batch.moment[:, :, a]) for a in range(2)]
    return np.stack([np.max(across, axis=0), near("axial", 0, batch.axial)], axis=1)


def _where_near(load: Floats, sigma: Floats) -> float:
    near = np.abs(load) < NEAR * sigma
    return float(np.median(sigma[near])) if near.any() else 0.0
