"""Parameters known about as well by their priors as by the data: counted as noise that the priors state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kilter_core.types import Floats


@dataclass(frozen=True)
class Soft:
    """Whitening by (I + B B')^(-1/2), B (R, L) the columns of one prior sigma of each load error.

    Projected off, masses 10 % larger would take a compliance's own signature with them; so they count as noise that the
    priors state. ``Q (R, L)`` is an orthonormal basis of B, ``shrink (L,)`` what is left along it less 1.
    """

    Q: Floats
    shrink: Floats

    @staticmethod
    def from_columns(B: Floats) -> Soft:
        """Whitening by these columns; those that are all zero cost nothing."""
        B = B[:, np.any(B != 0.0, axis=0)]
        if not B.size:
            return Soft(np.zeros((len(B), 0)), np.zeros(0))
        Q, R = np.linalg.qr(B)
        u, s, _ = np.linalg.svd(R)
        return Soft(Q @ u[:, : len(s)], 1.0 / np.sqrt(1.0 + s**2) - 1.0)

    def __call__(self, X: Floats) -> Floats:
        """Whiten rows (R,) or (R, K)."""
        if not len(self.shrink):
            return X
        along = self.Q.T @ X
        return np.asarray(X + self.Q @ (along * (self.shrink if X.ndim == 1 else self.shrink[:, None])))
