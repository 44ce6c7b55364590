"""Data and columns with the geometry taken off: what the data know of it by themselves is projected off, the rest is noise
that its priors state.
"""

from __future__ import annotations

import numpy as np

from kilter_core.gap.search.linear.bases import split_geometry_directions
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.gap.search.linear.soft import Soft
from kilter_core.types import Bools, Floats


def less_geometry(
    settings: ProblemSettings, values: Floats, G: Floats, y: Floats, carried: Bools
) -> tuple[Soft, Floats, Floats]:
    """Whitening by what priors know, an orthonormal basis (R, p) of what data know after it, and ``y (R,)`` less both.

    ``G (R, P)`` are the whitened derivatives by the geometry at ``values``; of those held by priors ``carried (P,)`` move.
    """
    source, hard = settings.source, settings.hard
    prior, away = source.prior.select_parameters(carried), source.prior.standardized_deviation(source.geometry(values))
    held, free = prior.columns(G[:, carried]), (G * source.prior_sigma)[:, hard]
    firm, weak = split_geometry_directions(Soft.from_columns(held)(free))
    B = np.hstack([held, free @ weak])
    soft = Soft.from_columns(B)
    U = np.linalg.qr(soft(free @ firm))[0]
    # Taken back into the data: a prior is about what was stated, not about the last fit.
    y = soft(y + B @ np.concatenate([prior.whiten_deviation(away[carried]), weak.T @ away[hard]]))
    return soft, U, y - U @ (U.T @ y)
