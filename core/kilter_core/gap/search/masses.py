"""Masses in a search: carried beside the geometry with their priors, and as a blur of the loads where these change sign."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.effects import Effect
from kilter_core.effects.load_error import LoadError
from kilter_core.gap.search.candidates import Library
from kilter_core.gap.search.sources.contact_source import ContactSource
from kilter_core.gap.search.sources.source import Source
from kilter_core.gap.search.sources.tool_source import ToolSource
from kilter_core.measurement import Measurement
from kilter_core.model import RobotModel
from kilter_core.model.load_errors import load_sign_blur as shared_blur
from kilter_core.types import Floats, Ints


def tool_source(
    model: RobotModel, values: Floats, free: Ints, measurement: Measurement, library: Library
) -> tuple[ToolSource, Floats]:
    """The fitted ``model`` with load errors and the whole ``library`` beside its effects, and its values.

    Loads are taken on the chain that was fitted.
    """
    carried = _load_error_effects(model, measurement)
    whole = replace(model.with_loads_at_values(values), effects=(*model.effects, *carried, *library.effects))
    added = sum(len(e.parameters(model.robot)) for e in carried)
    own = np.concatenate([free, len(values) + np.arange(added)])
    source = ToolSource.from_model(whole, measurement, own, len(library.parameters))
    values = np.concatenate([values, np.zeros(added + len(library.parameters))])
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
    prior = np.diag(source.prior_sigma[source.of_loads] ** 2)
    return source.with_load_blur(source_load_blur(source, values, prior if covariance is None else covariance))


def source_load_blur(source: Source, values: Floats, covariance: Floats) -> Floats:
    """Standard deviation (n, 2) N·m of the load across and about each joint, in the rows where its sign is in doubt."""
    batch = source.model.apply_load_errors(source.batch, source.model_values(values))
    return shared_blur(source.model.effects, batch, covariance)
