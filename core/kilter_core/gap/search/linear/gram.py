"""Inner products of data and candidates: all that a selection needs, conditioned on one set of columns after another."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from kilter_core.gap.search.linear.recent import Recent
from kilter_core.types import Floats, Ints

T = TypeVar("T")

SURELY = 0.5  # of the smallest eigenvalue that counts: what rounding may hide of a bound
VISIBLE = 1e-7  # share of a column's square left off the geometry below which it is geometry


@dataclass(frozen=True)
class Gram:
    """Inner products: ``whole (Q, Q)``, ``c (Q,)``, chi-square ``yy`` and freedom ``nu`` before any candidate enters.

    Conditioned on the columns ``taken``, A is ``whole`` less ``K (Q, t)`` times the rows taken: made where it is asked
    for, since a selection conditions on thousands of sets. What depends on A alone is kept in ``cache``, and inverses in
    ``inverses``, since scans are many times larger and would push them out; both are shared by all data on the same
    candidates: resamples cost little. ``held`` gives the same with the loads held at their values, and ``there`` are the
    columns whose effects act at the fit.
    """

    whole: Floats
    c: Floats
    yy: float
    nu: float
    cache: Recent = field(default_factory=Recent, repr=False, compare=False)
    inverses: Recent = field(default_factory=Recent, repr=False, compare=False)
    taken: tuple[int, ...] = ()
    K: Floats | None = None
    held: Callable[[], Gram] | None = field(default=None, repr=False, compare=False)
    there: frozenset[int] = frozenset()
    exchanges: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False)  # found on these very data

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
        A = self.whole - self.K @ self._rows
        return np.asarray(0.5 * (A + A.T))

    @property
    def projected(self) -> tuple[Floats, Floats]:
        """The two factors (Q, t) of what is taken, whose products are taken off ``whole``."""
        if self.K is None:
            nothing = np.empty((len(self.c), 0))
            return nothing, nothing
        return self.K, self._along

    def blocks(self, columns: Ints) -> Floats:
        """Parts (N, d, d) of A that belong to sets of columns (N, d)."""
        out = self.whole[columns[:, :, None], columns[:, None, :]]
        if self.K is not None:
            out = out - self.K[columns] @ self._along[columns].transpose(0, 2, 1)
        return np.asarray(out)

    def block(self, columns: Ints) -> Floats:
        """The same of one set (d, d): sets of a hundred columns are asked for by the thousand."""
        out = self.whole.take(columns, 0).take(columns, 1)
        if self.K is not None:
            out = out - self.K[columns] @ self._rows.take(columns, 1)
        return np.asarray(out)

    @cached_property
    def _rows(self) -> Floats:
        """Rows (t, Q) of what is taken."""
        return np.asarray(self.whole[list(self.taken)])

    @cached_property
    def _along(self) -> Floats:
        """The same by column (Q, t): those of a few columns are copied in one piece each."""
        return np.ascontiguousarray(self._rows.T)

    def kept(self, kind: Hashable, columns: Sequence[int], make: Callable[[], T]) -> T:
        """Return what ``make`` gives, which must depend on A and the columns alone."""
        return self.cache.get((self.taken, kind, tuple(columns)), make)

    def found(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what ``make`` gives, once on these very data: it may depend on them, and is small."""
        if key not in self.exchanges:
            self.exchanges[key] = make()
        known: T = self.exchanges[key]
        return known

    def inverse(self, columns: Sequence[int]) -> tuple[Floats, int]:
        """Pseudo-inverse (d, d) of the columns' own block, and its rank."""
        return self.inverses.get(
            (self.taken, *columns), lambda: _inverted(self.block(np.array(columns, dtype=np.int64)))
        )

    def solve(self, columns: Sequence[int]) -> Floats:
        """Least-squares coefficients of unit columns."""
        return np.asarray(self.inverse(columns)[0] @ self.c[list(columns)])

    def reduction(self, columns: Sequence[int]) -> float:
        """How much chi-square the columns take together."""
        return float(self.c[list(columns)] @ self.solve(columns)) if len(columns) else 0.0

    def rank(self, columns: Sequence[int]) -> int:
        """How many independent directions the columns have."""
        return self.inverse(columns)[1] if len(columns) else 0

    def given(self, columns: Sequence[int]) -> Gram:
        """Conditioned on a set of columns: their space projected off everything."""
        if not len(columns):
            return self
        index = list(columns)
        if self.taken:
            return Gram(self.A, self.c, self.yy, self.nu).given(index)
        K = self.whole[index].T @ self.inverse(index)[0]  # not kept: it is large, and soon made
        return replace(
            self, c=self.c - K @ self.c[index], yy=self.yy - self.reduction(index), nu=self.nu - self.rank(index),
            taken=tuple(index), K=K, exchanges={},
        )  # fmt: skip

    def part(self, own: Sequence[int], taken: Sequence[int]) -> tuple[Gram, Floats, Floats]:
        """The columns ``own (d,)`` alone beside others, and what is projected off them: two factors (d, t), as
        :attr:`projected`. One candidate is asked for where all of them are not.
        """
        if self.taken:
            return Gram(self.A, self.c, self.yy, self.nu).part(own, taken)
        mine, index = list(own), list(taken)
        along = np.ascontiguousarray(self.whole[index][:, mine].T)
        K = along @ self.inverse(index)[0]
        whole = np.ascontiguousarray(self.whole[mine][:, mine])
        yy, nu = self.yy - self.reduction(index), self.nu - self.rank(index)
        return Gram(whole, self.c[mine] - K @ self.c[index], yy, nu), K, along

    def with_data(self, c: Floats, yy: float) -> Gram:
        """The same candidates with other data."""
        return replace(self, c=c, yy=yy, held=None, exchanges={})


def _inverted(A: Floats) -> tuple[Floats, int]:
    """Pseudo-inverse and rank of a matrix (d, d): by its eigenvalues only where one may be too small to count."""
    root = triangular(A)
    if root is not None:
        return root.T @ root, len(A)
    return by_eigenvalues(A)


def by_eigenvalues(A: Floats) -> tuple[Floats, int]:
    """Pseudo-inverse and rank of a matrix (d, d) by its eigenvalues, several times slower."""
    w, V = np.linalg.eigh(A)
    keep = w > VISIBLE
    return (V[:, keep] / w[keep]) @ V[:, keep].T, int(keep.sum())


def triangular(A: Floats) -> Floats | None:
    """Triangle T (d, d) with T'T the inverse of a matrix; None where an eigenvalue may be as small as :data:`VISIBLE`.

    The trace of the inverse is the sum of the inverse eigenvalues, so no eigenvalue is below its own inverse.
    """
    if not A.size:
        return None
    factor, fault = dpotrf(A, lower=1, clean=1)
    # The diagonal of the inverse triangle is part of the trace: where it alone is too much nothing is inverted.
    if fault or not factor.diagonal().min() ** 2 * SURELY > VISIBLE:
        return None
    root, fault = dtrtri(factor, lower=1)
    each = root.ravel(order="K")  # a view: a selection asks tens of thousands of times
    return None if fault or not float(each @ each) < SURELY / VISIBLE else np.asarray(root)
