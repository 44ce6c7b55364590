"""What the last fit leaves of a coordinate of the tool: its noise, and what it leaves beyond that, corrected for its freedom.

A version read both from the errors on the rows that were searched, which are smaller by what the parameters took of them:
its 95 % intervals held 92 % of new coordinates where the noise was that of the fit.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import f

from kilter_core.gap.evidence.fits.intervals import scale_freedom
from kilter_core.gap.evidence.fits.posterior import Posterior
from kilter_core.gap.search.forward_selection import SearchResult
from kilter_core.identify.uncertainty.predictive import CHANCE, EXACT, Predictive
from kilter_core.measurement.kind import POINTS


def left_over(found: SearchResult, known: Posterior) -> Predictive | None:
    """What a version knows of itself; None where its rows are not single points or poses of the tool by an instrument."""
    settings = found.problem.settings
    source = settings.source
    rows = source.observations
    points = rows.position is not None and rows.markers is None and rows.pose_weight is None
    if not (points and source.observes_tool and source.observes_places) or settings.inflation > 1.0:
        return None
    left = found.problem.gram.condition_on_columns(found.columns)
    nu, ratio = max(left.nu, 1.0), left.yy / max(left.nu, 1.0)
    size = float(np.sqrt(np.mean(np.diag(settings.of_row)[:3])))
    scale = scale_freedom(found)
    if not settings.trusted:
        return Predictive(known.names, known.covariance, size * float(np.sqrt(ratio)), 0.0, scale, POINTS)
    known_by = min(max(scale, 1.0), float(EXACT))
    if ratio > f.isf(CHANCE, nu, known_by):
        return Predictive(known.names, known.covariance, size * float(np.sqrt(ratio - 1.0)), size, scale, POINTS)
    if np.isfinite(scale) and ratio > f.ppf(CHANCE, nu, known_by):
        # A dozen repeats know the noise to a fifth, and hundreds of rows that a model agrees with to some per cent.
        size *= float(np.sqrt((known_by + nu * ratio) / (known_by + nu)))
        scale += nu
    return Predictive(known.names, known.covariance, 0.0, size, scale, POINTS)
