"""What an instrument's maximum permissible error (MPE) says of one coordinate that it measures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.types import Floats

RECTANGULAR = 3.0**0.5  # half width over standard deviation: JCGM 100:2008 (GUM), 4.3.7, equation (7)


@dataclass(frozen=True)
class PermissibleError:
    """MPE of a length L, m: ``fixed`` + ``per_length`` L, as ISO 10360-10:2021 and 10360-12:2016 state E_Uni,MPE."""

    fixed: float
    per_length: float = 0.0

    def half_width(self, length: Floats) -> Floats:
        """MPE (N,) m of lengths (N,) m."""
        return np.asarray(self.fixed + self.per_length * length)

    def standard(self, length: Floats) -> Floats:
        """Standard uncertainty (N,) m of a coordinate at these lengths.

        Type B. Nothing is known but that the error is within the MPE, so it is as likely anywhere there: rectangular. The MPE
        of a length counts whole for each coordinate of its end, which is more than its share.
        """
        return np.asarray(self.half_width(length) / RECTANGULAR)
