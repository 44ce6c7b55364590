"""The noise of the day: how much more the rows of a check scatter than the version's own, as far as they show it.

Repeated shots show it by themselves. Without them it is what the best single cause leaves, so that an alarm
is what stands out of the scatter, and not the scatter itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, fdtrc

from kilter_core.types import Floats
from kilter_core.watch.innovation import Innovation

MOST = 9.0  # times the variance of the version's noise that a day's may have: three times the noise
CHANCE = 0.01  # of an alarm where the noise of the day is larger
FEWEST = 6.0  # numbers of repeated shots that tell the noise better than what a cause leaves


@dataclass(frozen=True)
class DayNoise:
    """Variance of the rows in units of the one that was expected, 1 to ``MOST``, with its ``freedom``.

    ``within`` is the part of chi-square that repeated shots have alone, of ``shots`` numbers; 0 where they do not tell it.
    """

    ratio: float
    freedom: float
    within: float = 0.0
    shots: float = 0.0

    @staticmethod
    def from_innovation(innovation: Innovation, chi_square: float, numbers: int, gain: float, rank: int) -> DayNoise:
        """Of rows with so much chi-square in so many numbers, of which the best cause takes ``gain`` by ``rank``."""
        within, shots = innovation.within_pose_scatter()
        if shots >= FEWEST:
            return DayNoise(float(np.clip(within / shots, 1.0, MOST)), shots, within, shots)
        # Numbers that the version, the temperature or the set-up may move scatter by no more where the noise is larger.
        freedom = max(innovation.numbers_of_noise - rank, 1.0)
        more = (chi_square - gain - (numbers - rank)) / freedom
        return DayNoise(float(np.clip(1.0 + more, 1.0, MOST)), freedom)

    def p_value(self, chi_square: float, numbers: int, gains: Floats, ranks: Floats) -> float:
        """Chance of the chi-square, or of the largest of the causes' ``gains (K,)``, by rows that scatter as these do."""
        singles = min((self._chance(g, r) for g, r in zip(gains, ranks, strict=True)), default=1.0)
        if self.shots:
            whole = self._chance(max(chi_square - self.within, 0.0), max(numbers - self.shots, 1.0))
        else:  # what is left of all causes says nothing of itself, unless no noise is so large
            whole = float(chdtrc(max(numbers, 1), chi_square / MOST))
        return min(1.0, 2.0 * whole, 2.0 * len(gains) * singles)

    def _chance(self, gain: float, rank: float) -> float:
        """By F against what the rows scatter, or by the largest noise there may be: what that leaves is a change anyway."""
        largest = float(chdtrc(rank, gain / MOST))
        if self.ratio >= MOST:
            return largest
        return min(largest, float(fdtrc(rank, self.freedom, gain / rank / self.ratio)))
