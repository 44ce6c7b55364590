"""What the data and the priors say of all that a search fitted, geometry and named effects together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.gap.evidence.fits.final_fit import jacobian_prior_covariance
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.gap.search.sources.source import Source
from kilter_core.model import Calibration
from kilter_core.parameters import indices
from kilter_core.types import Floats


@dataclass(frozen=True)
class Posterior:
    """Covariance ``(F, F)`` SI of the free parameters ``names``, in the order of the version that holds them.

    ``prior_sigma (F,)`` are the widths of their priors. ``J (R, F)`` is the whitened Jacobian, None for joint data, where
    an offset of each motion is added to every joint's zero.
    """

    names: tuple[str, ...]
    covariance: Floats
    prior_sigma: Floats
    J: Floats | None

    @property
    def sigma(self) -> Floats:
        """Standard deviations (F,)."""
        return np.sqrt(np.diag(self.covariance))


def posterior(found: SearchResult, begin: Calibration, stored: Calibration) -> Posterior:
    """Posterior at the end of a search that started at ``begin`` and stores ``stored``.

    The noise is inflated by what it leaves unexplained, as for the amplitudes.
    """
    source = found.problem.settings.source
    J, prior, covariance = jacobian_prior_covariance(found)
    names, L = _map_to_stored_parameters(source, begin, stored, found.columns)
    seen = J @ L.T if source.observes_tool else None
    return Posterior(names, L @ covariance @ L.T, np.sqrt(np.sum(prior.columns(L) ** 2, axis=1)), seen)


def _map_to_stored_parameters(
    source: Source, begin: Calibration, stored: Calibration, columns: list[int]
) -> tuple[tuple[str, ...], Floats]:
    """Names (F,) of the stored free parameters, in the stored order, and how they follow (F, P + d) from what was fitted."""
    model = source.model
    library = [model.names[len(model.names) - source.n_library + k] for k in columns]
    fitted = [*source.fitted_names(), *library]
    rows = dict(source.follows(begin, len(fitted)))
    # A version without load effects has no load errors either: what the data say of masses is then nothing.
    known = set(stored.names)
    rows |= {name: np.eye(len(fitted))[k] for k, name in enumerate(fitted) if name is not None and name in known}
    order = sorted(rows, key=lambda name: int(indices(stored.names, [name])[0]))
    return tuple(order), np.array([rows[name] for name in order]).reshape(len(order), len(fitted))
