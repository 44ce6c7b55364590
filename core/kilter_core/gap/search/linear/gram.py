"""Inner products of data and candidates: all that a selection needs, conditioned on one set of columns after another.

Rank is decided once, for every set alike: :data:`RIDGE` is added to the square of each column that enters, as if its
amount had been measured to be zero, hardly surely. So every set has an inverse, what a set takes never becomes less with
more columns, and a direction that the data do not see counts for nothing, smoothly: a set has as many directions as the
trace of its fit, to the nearest whole number.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from kilter_core.types import Bools, Floats, Ints

T = TypeVar("T")

VISIBLE = 1e-7  # share of a column's square left off the geometry below which it is geometry
RIDGE = VISIBLE  # added to the square of a column: a direction of which so much is left counts half
MOST_BYTES = 32 << 20  # a selection looks back at a few sets; without a limit a search kept gigabytes of them
EACH = 200  # bytes of an entry besides its arrays


class Recent:
    """A store of results by key that forgets those not used for longest."""

    def __init__(self, most: int = MOST_BYTES) -> None:
        self.most, self.bytes = most, 0
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()

    def __contains__(self, key: Hashable) -> bool:
        return key in self._kept

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what ``make`` gives, made again only where it was forgotten."""
        found = self._kept.get(key)
        if found is not None:
            self._kept.move_to_end(key)
            value: T = found[0]
            return value
        made = make()
        size = _size(made)
        self._kept[key] = (made, size)
        self.bytes += size
        while self.bytes > self.most and len(self._kept) > 1:
            self.bytes -= self._kept.popitem(last=False)[1][1]
        return made


def _size(value: Any) -> int:
    if isinstance(value, np.ndarray):
        return int(value.nbytes)
    if isinstance(value, tuple | list):
        return EACH + sum(_size(v) for v in value)
    return EACH


@dataclass(frozen=True)
class Gram:
    """Inner products: ``whole (Q, Q)``, ``c (Q,)``, chi-square ``yy`` and freedom ``nu`` before any candidate enters.

    Conditioned on the columns ``taken``, A is ``whole`` less ``K (Q, k)`` times ``along (Q, k)``: made where it is asked
    for, since a selection conditions on thousands of sets. ``copies (Q, t)`` is how those taken imitate each column.
    What depends on A alone is kept in ``cache``, and inverses in ``inverses``, since scans are many times larger and would
    push them out; both are shared by all data on the same candidates: resamples cost little. ``held`` gives the same with
    the loads held at their values, and ``there`` are the columns whose effects act at the fit.
    """

    whole: Floats
    c: Floats
    yy: float
    nu: float
    cache: Recent = field(default_factory=Recent, repr=False, compare=False)
    inverses: Recent = field(default_factory=Recent, repr=False, compare=False)
    taken: tuple[int, ...] = ()
    K: Floats | None = None
    along: Floats | None = None
    copies: Floats | None = None
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
        """Inner products (Q, Q) of the candidates, what is taken projected off: nothing is left of the columns taken."""
        if self.K is None or self.along is None:
            return self.whole
        A = self.whole - self.K @ self.along.T
        A[list(self.taken)] = 0.0
        A[:, list(self.taken)] = 0.0
        return np.asarray(0.5 * (A + A.T))

    @property
    def projection_factors(self) -> tuple[Floats, Floats, Floats]:
        """The two factors (Q, k) of what is taken, whose products are taken off ``whole``, and the copies (Q, t)."""
        if self.K is None or self.along is None or self.copies is None:
            nothing = np.empty((len(self.c), 0))
            return nothing, nothing, nothing
        return self.K, self.along, self.copies

    @cached_property
    def free(self) -> Bools:
        """Columns (Q,) that are not taken."""
        out = np.ones(len(self.c), dtype=bool)
        out[list(self.taken)] = False
        return out

    def blocks(self, columns: Ints) -> Floats:
        """Parts (N, d, d) of A that belong to sets of columns (N, d)."""
        out = self.whole[columns[:, :, None], columns[:, None, :]]
        if self.K is not None and self.along is not None:
            free = self.free[columns]
            out = (out - self.K[columns] @ self.along[columns].transpose(0, 2, 1)) * (
                free[:, :, None] & free[:, None, :]
            )
        return np.asarray(out)

    def block(self, columns: Ints) -> Floats:
        """The same of one set (d, d): sets of a hundred columns are asked for by the thousand."""
        out = self.whole.take(columns, 0).take(columns, 1)
        if self.K is not None and self.along is not None:
            free = self.free[columns]
            out = (out - self.K[columns] @ self.along[columns].T) * np.outer(free, free)
        return np.asarray(out)

    def cached_for_columns(self, kind: Hashable, columns: Sequence[int], make: Callable[[], T]) -> T:
        """Return what ``make`` gives, which must depend on A and the columns alone."""
        return self.cache.get((self.taken, kind, tuple(columns)), make)

    def cached_for_data(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what ``make`` gives, once on these very data: it may depend on them, and is small."""
        if key not in self.exchanges:
            self.exchanges[key] = make()
        known: T = self.exchanges[key]
        return known

    def inverse(self, columns: Sequence[int]) -> tuple[Floats, int]:
        """Inverse (d, d) of the columns' own block, zero for those taken, and how many directions it has."""
        return self.inverses.get((self.taken, *columns), lambda: self._inverse(np.array(columns, dtype=np.int64)))

    def _inverse(self, columns: Ints) -> tuple[Floats, int]:
        if not len(columns):
            return np.zeros((0, 0)), 0
        root = inverse_square_root(self.block(columns))
        rank = self.directions(root, columns)
        if self.taken:
            root[:, ~self.free[columns]] = 0.0
        return root.T @ root, rank

    def directions(self, root: Floats, columns: Ints) -> int:
        """How many directions columns (d,) add whose block has the inverse T'T: what they add to the trace of the fit.

        What is taken is held less by its own ridge where a column copies it.
        """
        each = root.ravel(order="K")  # a view: a selection asks tens of thousands of times
        short = float(each @ each)
        if self.copies is not None:
            short += float(np.sum((root @ (self.copies[columns] * self.free[columns, None])) ** 2))
        return round(len(root) - RIDGE * short)

    def solve(self, columns: Sequence[int]) -> Floats:
        """Least-squares coefficients of unit columns."""
        return np.asarray(self.inverse(columns)[0] @ self.c[list(columns)])

    def reduction(self, columns: Sequence[int]) -> float:
        """How much chi-square the columns take together."""
        return float(self.c[list(columns)] @ self.solve(columns)) if len(columns) else 0.0

    def rank(self, columns: Sequence[int]) -> int:
        """How many independent directions the columns have."""
        return self.inverse(columns)[1] if len(columns) else 0

    def condition_on_columns(self, columns: Sequence[int]) -> Gram:
        """Conditioned on a set of columns: their space projected off everything."""
        if not len(columns):
            return self
        index = list(columns)
        if self.taken:
            return Gram(self.A, self.c * self.free, self.yy, self.nu).condition_on_columns(index)
        along = np.ascontiguousarray(self.whole[index].T)
        K = along @ self.inverse(index)[0]  # not kept: it is large, and soon made
        c = self.c - K @ self.c[index]
        c[index] = 0.0
        return replace(
            self,
            c=c,
            yy=self.yy - self.reduction(index),
            nu=self.nu - self.rank(index),
            taken=tuple(index),
            K=K,
            along=along,
            copies=K,
            exchanges={},
        )

    def with_data(self, c: Floats, yy: float) -> Gram:
        """The same candidates with other data."""
        return replace(self, c=c, yy=yy, held=None, exchanges={})


def inverse_square_root(A: Floats) -> Floats:
    """T (d, d) with T'T the inverse of a block (d, d) with its ridge: a triangle, unless rounding is larger than the ridge."""
    ridged = A + RIDGE * np.eye(len(A))
    factor, fault = dpotrf(ridged, lower=1, clean=1)
    if not fault:
        root, fault = dtrtri(factor, lower=1)
        if not fault:
            return np.asarray(root)
    w, V = np.linalg.eigh(A)
    return np.asarray((V / np.sqrt(np.maximum(w, 0.0) + RIDGE)).T)
