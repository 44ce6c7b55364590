"""Columns of thousands of rows less what geometry explains, made some rows at a time: whole they fill the memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from kilter_core.gap.search.linear.gram import VISIBLE
from kilter_core.types import Floats

AT_ONCE = 400_000  # numbers of the columns that are made at a time: 3 MB, which the processor's cache holds
MOST_AT_ONCE = 4_000_000  # the same of columns that are kept: 32 MB

FIRM = 30.0  # data sigmas that one prior sigma of a geometric direction moves, from which its prior adds nothing to the data
UNFELT = 1e-3  # the same, below which nothing shows it


@dataclass(frozen=True)
class Projection:
    """The columns ``W (R, Q)`` less ``taken (R, t)`` times ``by (t, Q)``."""

    W: Floats
    taken: Floats
    by: Floats

    @staticmethod
    def from_columns(soft: Soft, U: Floats, W: Floats) -> Projection:
        """Columns whitened by what is soft, then with the basis ``U (R, p)`` projected off."""
        along = soft.shrink[:, None] * (soft.Q.T @ W)
        return Projection(W, np.hstack([soft.Q, U]), np.vstack([-along, U.T @ W + (U.T @ soft.Q) @ along]))

    def less(self, basis: Floats) -> Projection:
        """The same with another ``basis (R, b)`` projected off."""
        return Projection(self.W, np.hstack([self.taken, basis]), np.vstack([self.by, self.under(basis.T)]))

    def under(self, X: Any) -> Floats:
        """The product of a matrix (K, R), dense or sparse, and the columns."""
        return np.asarray(X @ self.W - (X @ self.taken) @ self.by)

    def rows(self, part: slice) -> Floats:
        """Some rows of the columns."""
        out = self.taken[part] @ self.by
        return np.subtract(self.W[part], out, out=out)

    def products(self, y: Floats) -> tuple[Floats, Floats]:
        """Inner products (Q, Q) of the columns, and (Q,) with ``y (R,)``."""
        A, c = np.zeros((self.W.shape[1],) * 2), np.zeros(self.W.shape[1])
        for part in row_slices(*self.W.shape):
            P = self.rows(part)
            A += P.T @ P
            c += P.T @ y[part]
        return A, c


@dataclass(frozen=True)
class Stacked:
    """The columns ``G (R, P)`` and ``W (R, Q)`` side by side, each times its ``scale``; ``kept`` picks some.

    Rows come ``size`` to a visit.
    """

    G: Floats
    W: Floats
    scale: Floats
    size: int
    kept: tuple[int, ...] | None = None

    @property
    def width(self) -> int:
        """Number of columns."""
        return len(self.scale) if self.kept is None else len(self.kept)

    def only(self, kept: list[int]) -> Stacked:
        """Some of the columns."""
        return Stacked(self.G, self.W, self.scale, self.size, tuple(kept))

    def squares(self) -> Floats:
        """Inner products (F, F) of the columns."""
        out = np.zeros((self.width,) * 2)
        for _, columns in self.each():
            out += columns.T @ columns
        return out

    def condense_columns(self) -> Stacked:
        """Columns fewer than these that span all of them that data whitened and within priors can see.

        A fit within its priors, and what it leaves, are the same with them: a direction that a whole prior sigma does not move
        by a thousandth of the noise takes a millionth of anything.
        """
        if len(self.G) * self.width > MOST_AT_ONCE:
            return self
        w, V = np.linalg.eigh(self.squares())
        seen = V[:, w > UNFELT**2]
        made = np.concatenate([columns @ seen for _, columns in self.each()])
        return Stacked(made, made[:, :0], np.ones(made.shape[1]), self.size)

    def each(self) -> Iterator[tuple[slice, Floats]]:
        """Slices of the rows, whole visits each, and the columns there."""
        for part in row_slices(len(self.G), len(self.scale), self.size):
            X = np.hstack([self.G[part], self.W[part]]) if self.W.shape[1] else self.G[part]
            X = X if self.kept is None else X[:, list(self.kept)]
            yield part, X if self._even else X * self._scale

    @cached_property
    def _even(self) -> bool:
        """Whether no column is scaled, as of those that are condensed."""
        return bool(np.all(self._scale == 1.0))

    @property
    def _scale(self) -> Floats:
        return self.scale if self.kept is None else self.scale[list(self.kept)]


def row_slices(rows: int, columns: int, size: int = 1) -> Iterator[slice]:
    """Slices of the rows, multiples of ``size`` each."""
    count = max(1, AT_ONCE // max(1, columns) // size) * size
    yield from (slice(k, k + count) for k in range(0, rows, count))


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


def split_geometry_directions(scaled: Floats) -> tuple[Floats, Floats]:
    """Directions (P, f) of geometry, columns ``scaled (R, P)`` by prior sigmas, that the data know by themselves, and those
    (P, w) that their priors know as well, whatever else is fitted: freed of them, they would follow an effect that nearly
    imitates them to many prior sigmas.
    """
    if scaled.shape[1] == 0 or len(scaled) == 0:
        return np.zeros((scaled.shape[1], 0)), np.zeros((scaled.shape[1], 0))
    _, s, vt = np.linalg.svd(np.linalg.qr(scaled, mode="r"))
    size = np.zeros(len(vt))
    size[: len(s)] = s
    firm = size > max(FIRM, 1e-10 * float(s[0]))
    return vt[firm].T, vt[~firm & (size > UNFELT)].T


def orthonormal(W: Floats) -> Floats:
    """Orthonormal basis of columns (R, Q)."""
    u, s, _ = np.linalg.svd(W, full_matrices=False)
    return np.asarray(u[:, s > np.sqrt(VISIBLE)])


def lengths(W: Floats) -> Floats:
    """Norms (Q,) of columns, without a copy of them squared."""
    return np.asarray(np.sqrt(np.einsum("rq,rq->q", W, W)))
