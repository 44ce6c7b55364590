"""Inner products of data and candidates, conditioned on one set of columns, and that set less a few of them.

Rank is decided once, for every set alike: :data:`RIDGE` is added to the square of each column that enters, as if its
amount had been measured to be zero, hardly surely. So every set has an inverse, what a set takes never becomes less with
more columns, and a direction that the data do not see counts for nothing, smoothly: a set has as many directions as the
trace of its fit, to the nearest whole number.

An exchange asks what every candidate does beside a set without one or two of its members, for each of them. What these
columns take back is a matrix of as many directions as they have; the rest of the set stays projected off.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Iterator, Sequence
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


@dataclass(frozen=True)
class Fewer:
    """Parts of the set ``columns (t,)`` on the inner products ``gram``, of which nothing is taken."""

    gram: Gram
    columns: Sequence[int]

    @cached_property
    def conditioned_gram(self) -> Gram:
        """Conditioned on all of them."""
        return self.gram.condition_on_columns(self.columns)

    @cached_property
    def schur_complement_and_copies(self) -> tuple[Floats, Floats]:
        """What is left of all columns (Q, Q) beside the set, and how it imitates each (Q, t).

        Its own columns imitate themselves, and leave nothing but the ridge, which whoever takes them out adds again.
        """
        A, own = self.conditioned_gram.A.copy(), list(self.columns)
        A[own, own] = -RIDGE
        K = np.zeros((len(self.gram.c), 0)) if self.conditioned_gram.K is None else self.conditioned_gram.K.copy()
        K[own] = np.eye(len(own))
        return A, K

    @cached_property
    def _inverse(self) -> Floats:
        return self.gram.inverse(self.columns)[0]

    @cached_property
    def _amounts(self) -> Floats:
        return self._inverse @ self.gram.c[list(self.columns)]

    def without_columns(self, out: Collection[int]) -> Rest:
        """The set without the columns ``out``."""
        gone = set(out)
        at = np.array([n for n, k in enumerate(self.columns) if k in gone], dtype=np.int64)
        stay = np.array([n for n, k in enumerate(self.columns) if k not in gone], dtype=np.int64)
        of_gone = self._inverse[at]
        own = np.linalg.inv(of_gone[:, at])  # what the others leave of the columns that go
        own, cross = 0.5 * (own + own.T), of_gone[:, stay]
        copied = own @ cross
        short = float(np.sum(self._inverse.diagonal()[stay])) - float(np.sum(cross * copied))
        amounts = self._amounts[at]
        b = own @ amounts
        rank = round(len(stay) - RIDGE * short)
        return Rest(self, at, stay, own, copied, b, self.conditioned_gram.yy + float(b @ amounts), rank)


@dataclass(frozen=True)
class Rest:
    """Columns ``stay`` of a set (their places in it) without those ``at``: the chi-square ``yy`` they leave, and their rank.

    ``own`` is the block of the others beside them, whose data ``b`` are; ``copied`` how they imitate these.
    """

    of: Fewer
    at: Ints
    stay: Ints
    own: Floats
    copied: Floats
    b: Floats
    yy: float
    rank: int

    @cached_property
    def conditioned_gram(self) -> Gram:
        """Everything conditioned on them: made where it is asked for, since few exchanges can win."""
        if not len(self.at):
            return self.of.conditioned_gram
        whole, copies = self.of.schur_complement_and_copies
        along, before = np.ascontiguousarray(copies[:, self.at]), self.of.conditioned_gram
        return replace(
            before,
            whole=whole,
            c=before.c + along @ self.b,
            yy=self.yy,
            nu=self.of.gram.nu - self.rank,
            taken=tuple(self.of.columns[n] for n in self.stay),
            K=-(along @ self.own),
            along=along,
            copies=copies[:, self.stay] + along @ self.copied,
            exchanges={},
        )


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
