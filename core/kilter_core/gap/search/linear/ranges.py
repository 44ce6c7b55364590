"""Physical ranges of what a search fits: no refit leaves an amplitude beyond them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from kilter_core.gap.search.sources.source import Source
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


def ends(source: Source, free: Sequence[int]) -> tuple[Floats, Floats]:
    """Lowest and highest values (P + F,) of the geometry, counted from its priors, and of the library columns ``free``; SI.

    Only amplitudes of effects have ends: what is known of a geometry is in its priors, as what is known of the loads is.
    """
    model, library = source.model, library_parameters(source)
    effects = {p.name: p for p in model.parameters[model.n_geometric :]}
    size = len(source.prior_mean)
    out = np.full((size + len(free), 2), (-np.inf, np.inf))
    for k, (name, soft) in enumerate(zip(source.fitted_names(), source.soft, strict=True)):
        if name in effects and not soft:
            p, mean = effects[name], source.prior_mean[k]
            out[k] = p.lower - mean, p.upper - mean
    for n, k in enumerate(free, size):
        out[n] = library[k].lower, library[k].upper
    low, high = out.T
    return low, high


def exactly_within(source: Source, values: Floats, free: Sequence[int]) -> Floats:
    """Values whose library columns ``free`` end exactly where their ranges do: rounding left a compliance of -1e-22."""
    library, known = source.library(values).copy(), library_parameters(source)
    for k in free:
        library[k] = min(max(library[k], known[k].lower), known[k].upper)
    return source.apply_step(values, np.zeros(len(source.prior_mean)), library)


def library_parameters(source: Source) -> tuple[Parameter, ...]:
    """The parameters of the library's columns, in their order: the last of the model's."""
    parameters = source.model.parameters
    return tuple(parameters[len(parameters) - source.n_library :])
