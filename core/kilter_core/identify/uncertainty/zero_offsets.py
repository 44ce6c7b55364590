"""How well the zeros of a closest table are known: what a controller or a servo is given should say so."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kilter_core.identify.uncertainty.predictive import Predictive
from kilter_core.model import Calibration
from kilter_core.model.table_fit import ClosestTable, zero_names
from kilter_core.types import QUANTILE, Bools, Floats


class KnownZeros(NamedTuple):
    """Half widths (n,) of the 95 % intervals of joints' zeros, rad (m of a prismatic joint).

    ``held (n,)``: the joint's own zero was not identified, by convention or because nobody asked for it, or it shares with
    the base or the tool what it is, so that an interval says nothing of it.
    """

    half_width: Floats
    held: Bools


def known_zeros(calibration: Calibration, table: ClosestTable, known: Predictive) -> KnownZeros | None:
    """Propagate a version's covariance to the zeros of its closest table, to first order.

    A zero of the table is not the parameter of that name alone: links whose lengths are not known either rotate it, which a
    covariance of all of them has. Parameters that were not identified count as exact. None where the table has rows of
    another form than the nominal ones, whose zeros then mean something else.
    """
    if table.zeros is None:
        return None
    J = table.zeros.derivatives(calibration, known.names)
    variance = np.einsum("jp,pq,jq->j", J, known.covariance, J)
    own = zero_names(calibration.robot)
    held = np.array([name in calibration.names and name not in known.names for name in own], dtype=bool)
    return KnownZeros(QUANTILE * np.sqrt(np.maximum(variance, 0.0)), held | ~table.zeros.identifiable_zeros())
