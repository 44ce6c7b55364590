"""Whitened derivatives at a fit: those of thousands of poses fill 100 MB, so a fit that rests can let them go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.gap.search.linear.bases import lengths
from kilter_core.gap.search.linear.settings import ProblemSettings
from kilter_core.types import Floats

MOST_BYTES = 16 << 20  # of derivatives that are kept in any case


@dataclass
class Derivatives:
    """Geometric columns ``G (R, P)`` and unit library columns ``W (R, Q)``, with the lengths (Q,) that these had.

    Made at ``values`` and again, to the last bit, where they are asked for after :meth:`release_memory`.
    """

    settings: ProblemSettings
    values: Floats
    kept: tuple[Floats, Floats] | None = None

    @staticmethod
    def evaluate_at_values(settings: ProblemSettings, values: Floats) -> tuple[Derivatives, Floats, Floats]:
        """With the whitened residual (R,) and the lengths of the library's columns (Q,)."""
        made = Derivatives(settings, values)
        r, norm = made._make()
        return made, r, norm

    @property
    def G(self) -> Floats:
        """Whitened geometric columns."""
        return self._geometry_and_library_columns()[0]

    @property
    def W(self) -> Floats:
        """Whitened library columns, each of length 1; those that move nothing are zero."""
        return self._geometry_and_library_columns()[1]

    def release_memory(self) -> None:
        """Keep nothing until it is asked for again; a few hundred poses are not worth the time."""
        if self.kept is not None and sum(part.nbytes for part in self.kept) > MOST_BYTES:
            self.kept = None

    def _geometry_and_library_columns(self) -> tuple[Floats, Floats]:
        if self.kept is None:
            self._make()
        assert self.kept is not None
        return self.kept

    def _make(self) -> tuple[Floats, Floats]:
        r, G, W = self.settings.linearise(self.values)
        norm = lengths(W)
        W /= np.where(norm > 0.0, norm, 1.0)
        self.kept = (G, W)
        return r, norm
