"""Inner products of data and candidates: all that a selection needs, conditioned on one set of columns after another.

Nearly dependent columns fade out by one rule: ``VISIBLE`` is added to the square of each. What a set takes is then what a
part of it takes and what the rest takes given that part, to rounding, and so is the number of its directions: the scan for
what to add and the criterion of the whole set cannot disagree. With a limit on eigenvalues they did: the scan saw directions
that the whole set did not see, took their columns in for a gain that was none, and exchanges ran in a circle.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from kilter_core.gap.kernels.independent import rooted
from kilter_core.gap.search.recent import Recent
from kilter_core.types import Floats, Ints

T = TypeVar("T")

VISIBLE = 1e-7  # share of a column's square left off geometry and others at which it is one of them
PLACES = 3  # decimals of a number of directions: beyond, all of what is left of a column counts


@dataclass(frozen=True)
class Gram:
    """Inner products: ``whole (Q, Q)``, ``c (Q,)``, chi-square ``yy`` and freedom ``nu`` before any candidate enters.

    Conditioned on the columns ``taken``, A is ``whole`` less ``K (Q, t)`` times the rows taken: made where it is asked
    for, since a selection conditions on thousands of sets. What depends on A alone is kept in ``cache``, shared by all
    data on the same candidates: resamples cost little. ``held`` gives the same with the loads held at their values, and
    ``there`` are the columns whose effects act at the fit.
    """

    whole: Floats
    c: Floats
    yy: float
    nu: float
    cache: Recent = field(default_factory=Recent, repr=False, compare=False)
    taken: tuple[int, ...] = ()
    K: Floats | None = None
    held: Callable[[], Gram] | None = field(default=None, repr=False, compare=False)
    there: frozenset[int] = frozenset()

    @property
    def firm(self) -> Gram:
        """With the loads held at their values: for sets without an effect through which the errors of loads act.

        Errors of the loads imitate a compliance that is there, because they scale it; one that is taken out, they cannot.
        """
        return self if self.held is None or self.taken else self.held()

    @cached_property
    def A(self) -> Floats:
        """Inner products (Q, Q) of the candidates, what is taken projected off."""
        if self.K is None:
            return self.whole
        A = self.whole - self.K @ self.whole[list(self.taken)]
        return np.asarray(0.5 * (A + A.T))

    def block(self, columns: Sequence[int]) -> Floats:
        """Part (d, d) of A that belongs to a set of columns."""
        index = list(columns)
        out = self.whole[np.ix_(index, index)]
        if self.K is not None:
            out = out - self.K[index] @ self.whole[np.ix_(self.taken, index)]
        return np.asarray(out)

    @property
    def factors(self) -> tuple[Floats, Floats, Ints]:
        """``whole``, ``K`` and ``taken`` as the kernel reads them."""
        K = np.zeros((len(self.whole), 0)) if self.K is None else self.K
        return self.whole, K, np.array(self.taken, dtype=np.int64)

    def kept(self, kind: Hashable, columns: Sequence[int], make: Callable[[], T]) -> T:
        """Return what ``make`` gives, which must depend on A and the columns alone."""
        return self.cache.get((self.taken, kind, tuple(columns)), make)

    def root(self, columns: Sequence[int]) -> Floats:
        """Root (d, d) of the inverse of the columns' own block, ``VISIBLE`` added to their squares."""

        def made() -> Floats:
            half = np.empty((len(columns),) * 2)
            rooted(np.ascontiguousarray(self.block(columns)), VISIBLE, half)
            return half

        return self.kept("root", columns, made)

    def inverse(self, columns: Sequence[int]) -> tuple[Floats, int]:
        """Pseudo-inverse (d, d) of the columns' own block, and its rank."""

        def made() -> tuple[Floats, int]:
            w, V = np.linalg.eigh(self.block(columns))
            rank = self.rank(columns)
            w, V = w[len(w) - rank :], V[:, len(w) - rank :]
            return (V / w) @ V.T, rank

        return self.kept("inverse", columns, made)

    def solve(self, columns: Sequence[int]) -> Floats:
        """Least-squares coefficients of unit columns."""
        return np.asarray(self.inverse(columns)[0] @ self.c[list(columns)])

    def reduction(self, columns: Sequence[int]) -> float:
        """How much chi-square the columns take together."""
        return float(np.sum((self.c[list(columns)] @ self.root(columns)) ** 2)) if len(columns) else 0.0

    def degrees(self, columns: Sequence[int]) -> float:
        """How many independent directions the columns have; of one of which hardly more is left than counts, a part."""
        return round(len(columns) - VISIBLE * float(np.sum(self.root(columns) ** 2)), PLACES) if len(columns) else 0.0

    def rank(self, columns: Sequence[int]) -> int:
        """The same as a whole number."""
        return round(self.degrees(columns))

    def given(self, columns: Sequence[int]) -> Gram:
        """Conditioned on a set of columns: their space projected off everything."""
        if not len(columns):
            return self
        index = list(columns)
        if self.taken:
            return Gram(self.A, self.c, self.yy, self.nu).given(index)
        half = self.root(index)
        K = self.kept("given", index, lambda: self.whole[:, index] @ (half @ half.T))
        return replace(
            self, c=self.c - K @ self.c[index], yy=self.yy - self.reduction(index), nu=self.nu - self.degrees(index),
            taken=tuple(index), K=K,
        )  # fmt: skip

    def with_data(self, c: Floats, yy: float) -> Gram:
        """The same candidates with other data."""
        return replace(self, c=c, yy=yy, held=None)
