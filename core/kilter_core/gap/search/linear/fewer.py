"""Conditioned on a set less a few of its columns: from the inverse of the whole set, without another.

An exchange asks what every candidate does beside a set without one or two of its members, for each of them. What these
columns take back is a matrix of as many directions as they have; the rest of the set stays projected off.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kilter_core.gap.search.linear.gram import RIDGE, Gram
from kilter_core.types import Floats, Ints


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
