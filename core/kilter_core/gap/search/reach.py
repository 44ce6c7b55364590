"""What exchanges could reach at most, from scans already made: of those that cannot win nothing is computed.

Whatever a candidate explains beside some of a set, all of the set and the candidate explain too. So a scan beside more
members bounds what the same candidate can do beside fewer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from kilter_core.gap.search.linear.fewer import Fewer
from kilter_core.gap.search.linear.gram import Gram
from kilter_core.gap.search.scan import Scorer
from kilter_core.types import Bools, Floats, Ints

ROUNDING = 0.2  # criterion points that rounded values, and rounding errors, may hide


@dataclass
class Reach:
    """Bounds of one exchange after another, on one linearised problem at one noise ``variance``.

    ``whole`` is the set whose members go. ``scans`` are, for sets of library columns, what every candidate (K,) beside them
    reaches less its own price: infinite where a scan says nothing of smaller sets, because a sign was held against it.
    """

    scorer: Scorer
    whole: Fewer
    variance: float
    price: Floats  # of a direction, then beyond directions of each candidate (1 + K,)
    now: float  # the criterion of the set as it is
    scans: dict[frozenset[int], Floats] = field(default_factory=dict)

    @property
    def gram(self) -> Gram:
        """The linearised problem."""
        return self.whole.gram

    def record_scan(self, columns: Sequence[int], given: Gram, S: Floats, d: Ints) -> None:
        """Remember a scan: chi-square ``S (K,)`` that candidates take beside the columns in ``d (K,)`` directions."""
        reaches = (self.gram.yy - given.yy + S) / self.variance - d * self.price[0] - self.price[1:]
        self.scans[frozenset(columns)] = np.where(self.scorer.one_sided & (S == 0.0), np.inf, reaches)

    def able(self, columns: list[int], price: Floats, least: float) -> Bools:
        """Candidates (K,) that beside these columns, where the whole costs ``price (K,)`` besides, may come to ``least``."""
        own = frozenset(columns)
        most = np.full(len(self.scorer.candidates), np.inf)
        for beside, reaches in self.scans.items():
            if own <= beside:
                np.minimum(most, reaches, out=most)
        return np.asarray(most - price >= least - ROUNDING)
