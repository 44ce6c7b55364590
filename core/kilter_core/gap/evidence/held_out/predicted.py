"""Whether held-out poses erred as an effect predicted: their errors without it, against what it changes there.

The drop of squared errors alone has little power, because it counts the noise of every pose twice: an effect of
non-centrality λ on the held-out poses is √λ / 2 deviations outside it, and √λ out of the regression on what was
predicted. The prediction comes from other poses, so without an effect the slope is zero, whatever was chosen.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm, t

from kilter_core.types import Floats, Ints

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
