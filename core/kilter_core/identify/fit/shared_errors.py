"""Errors that visits share: those of one rounded reading are the same at every visit of its pose."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from kilter_core.types import Floats, Ints

SEEN = 1e-9  # of a noise sigma: directions in which less is shared are left alone


@dataclass(frozen=True)
class SharedErrors:
    """Whitening by (I + S S')^(-1/2) of whitened rows, block by block: ``S`` are a block's columns of one sigma each.

    ``blocks`` are the rows (r,), an orthonormal basis (r, d) of S, and by how much each direction shrinks (d,), less 1.
    """

    blocks: tuple[tuple[Ints, Floats, Floats], ...]

    @staticmethod
    def from_blocks(blocks: Iterable[tuple[Ints, Floats]]) -> SharedErrors:
        """From the rows (r,) and columns (r, n) of each block."""
        made = []
        for rows, S in blocks:
            Q, s, _ = np.linalg.svd(S, full_matrices=False)
            kept = s > SEEN
            made.append((rows, Q[:, kept], 1.0 / np.sqrt(1.0 + s[kept] ** 2) - 1.0))
        return SharedErrors(tuple(made))

    def apply(self, X: Floats) -> Floats:
        """Whiten rows (R,) or (R, K) in their place."""
        for rows, Q, shrink in self.blocks:
            X[rows] += (Q * shrink) @ (Q.T @ X[rows])
        return X

    def undo(self, X: Floats) -> Floats:
        """What whitened rows stand for, in another array."""
        out = X.copy()
        for rows, Q, shrink in self.blocks:
            out[rows] += (Q * (1.0 / (1.0 + shrink) - 1.0)) @ (Q.T @ X[rows])
        return out
