"""Sets of candidates on a linearised problem: their columns, the noise beside them, and amounts that physics allows."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kilter_core.gap.search.candidates import FAMILY, JOINT
from kilter_core.gap.search.linear.gram import RIDGE, Gram
from kilter_core.gap.search.linear.settings import tail
from kilter_core.gap.search.scan import Scorer
from kilter_core.types import Floats, Ints

TRACE = 1e-3  # chance below which a family is tried beside what may imitate it; above it a joint may be noise
CLEARLY_WRONG = 2.0  # standard deviations below zero at which a positive parameter contradicts physics


@dataclass(frozen=True)
class CandidateSets:
    """A set is a tuple of places in ``scorer.candidates``.

    ``rows`` is the number of measured scalars N in the price d ln N of d parameters; ``limits (Q,)`` the largest
    plausible amplitude of each library column, in units of unit columns.
    """

    scorer: Scorer
    rows: int
    limits: Floats

    def shapes(self, chosen: Sequence[int]) -> bool:
        """Whether a set holds an empirical term."""
        return any(self.scorer.candidates[k].empirical for k in chosen)

    @cached_property
    def _name_indices(self) -> Ints:
        """The name (K,) that each candidate is: an effect at several joints is one, a shape each of its places."""
        shared: dict[str, set[int]] = {}
        for c in self.scorer.candidates:
            if c.level == FAMILY:  # one of each pace at which it was tried
                shared.setdefault(c.id, set()).update(c.columns)
        known: dict[Hashable, int] = {}
        out = []
        for k, c in enumerate(self.scorer.candidates):
            member = c.level in (JOINT, FAMILY) and shared.get(c.id, set()).issuperset(c.columns)
            out.append(known.setdefault(c.id if member else k, len(known)))
        return np.array(out, dtype=np.int64)

    def names(self, chosen: Sequence[int]) -> int:
        """How many names a set takes of those allowed."""
        return len(set(self._name_indices[list(chosen)].tolist()))

    def another_name(self, chosen: Sequence[int]) -> Floats:
        """1 for each candidate (K,) that beside a set is a name more, 0 for one whose effect is in it at other joints."""
        another = np.ones(len(self._name_indices))  # as many names there are at most
        another[self._name_indices[list(chosen)]] = 0.0
        return np.asarray(another[self._name_indices])

    def faint_families(self, gram: Gram, chosen: Sequence[int]) -> list[int]:
        """Families that a set, of which an effect acts at several joints, may lack, the clearest first.

        Seven joints of one effect imitate a few of another so well that these leave a trace that is not significant, or,
        where some of them are named, none. Where single joints were enough no family is asked.
        """
        named = [self.scorer.candidates[k] for k in chosen]
        acting = [c.id for c in named for _ in c.joints or () if c.level in (JOINT, FAMILY)]
        if len(set(acting)) == len(acting):
            return []
        whole = {c.id for c in named if c.level == FAMILY}
        part = set(acting) - whole if whole else set[str]()
        p = self.scorer.scores(gram.condition_on_columns(self.columns(chosen))).p
        able = [k for k, c in enumerate(self.scorer.candidates) if c.level == FAMILY and c.id not in whole]
        return sorted(
            (k for k in able if p[k] < TRACE or self.scorer.candidates[k].id in part), key=lambda k: float(p[k])
        )

    def too_many(self, chosen: Sequence[int], most: int) -> list[int]:
        """Candidates with which a set would have more names than ``most``."""
        if self.names(chosen) < most:
            return []
        return [k for k in range(len(self.scorer.candidates)) if self.names((*chosen, k)) > most]

    def rounds(self, chosen: Sequence[int], most: int) -> int:
        """Changes that a search may make on its way: names enter one by one, and so do joints."""
        return 2 * max(most, len(chosen))

    def columns(self, chosen: Sequence[int]) -> list[int]:
        """Library columns of a set, each once."""
        return sorted({k for c in chosen for k in self.scorer.candidates[c].columns})

    @cached_property
    def _bearing(self) -> frozenset[int]:
        """Library columns of effects through which errors of the loads act."""
        return frozenset(k for c in self.scorer.candidates if c.bears for k in c.columns)

    def comparison_gram(self, gram: Gram, out: Collection[int], kept: Collection[int]) -> Gram:
        """Where sets that share the ``kept`` are to be compared, ``out`` being in one of them only.

        Errors of the loads act through effects that are there at the fit. They are held where one of these is not kept, also
        where another has stood for it since: they would imitate what neither set has. If such an error is itself among those
        that leave, it is what the comparison is about: loads held would presume its answer.
        """
        if any(self.scorer.candidates[k].changes_loads for k in out):
            return gram
        return gram if (gram.there & self._bearing).issubset(self.columns(tuple(kept))) else gram.firm

    def remaining_set_and_gram(
        self, gram: Gram, chosen: Sequence[int], out: Collection[int]
    ) -> tuple[tuple[int, ...], Gram]:
        """What stays of a set without some members, and where it is compared with others beside it."""
        rest = tuple(k for k in chosen if k not in out)
        return rest, self.comparison_gram(gram, out, rest)

    def variance(self, gram: Gram, chosen: Sequence[int]) -> float:
        """Noise variance for comparisons at a set: 1 for repeats, more when structure is left."""
        columns = self.columns(chosen)
        free = max(gram.nu - gram.rank(columns), 1.0)
        return float(self.scorer.variance(np.asarray((gram.yy - gram.reduction(columns)) / free), free))

    def tails(self, gram: Gram, chosen: tuple[int, ...]) -> list[float]:
        """Tail probability of each member given the others; 1 where its sign contradicts physics."""
        return [self._tail(gram, chosen, k) if self.has_plausible_sign(gram, chosen, k) else 1.0 for k in chosen]

    def _tail(self, gram: Gram, chosen: tuple[int, ...], place: int) -> float:
        """Tail probability of one member given the others: from the inverse of the whole set.

        What a member takes beside the others is its coefficients in the inverse of its part of that inverse, so nothing is
        projected off anything.
        """
        kept, gram = self.remaining_set_and_gram(gram, chosen, (place,))
        columns, rest = self.columns(chosen), self.columns(kept)
        inverse, others = gram.inverse(columns)[0], set(rest)
        own = [n for n, k in enumerate(columns) if k not in others]
        beta = inverse[own] @ gram.c[columns]
        if not own or (self.scorer.one_sided[place] and beta[0] < 0.0):
            return 1.0
        stay = [n for n, k in enumerate(columns) if k in others]
        apart, cross = inverse[np.ix_(own, own)], inverse[np.ix_(own, stay)]
        solved = np.linalg.solve(apart, np.column_stack([beta, cross]))
        taken, within = float(beta @ solved[:, 0]), gram.yy - gram.reduction(columns)
        diagonal, copied = inverse.diagonal(), float(np.sum(cross * solved[:, 1:]))
        count = round(len(own) - RIDGE * (float(np.sum(diagonal[own])) + copied))
        others_rank = round(len(stay) - RIDGE * (float(np.sum(diagonal[stay])) - copied))
        return self.scorer.tail_of_ratio(place, count, within + taken, within, gram.nu - others_rank)

    def members_above_noise(self, gram: Gram, rest: Sequence[int], members: Sequence[int]) -> tuple[int, ...]:
        """Of joints beside the ``rest`` those that leave a trace, the faintest let go first; one at least.

        A joint that is there and not significant speaks for its family; one that noise could be speaks for nothing.
        """
        left = tuple(members)
        while len(left) > 1 and max(tails := self.tails(gram, (*rest, *left))[len(rest) :]) >= TRACE:
            left = tuple(k for n, k in enumerate(left) if n != int(np.argmax(tails)))
        return left

    def among_pairs(self, given: Gram, pair: tuple[int, int], critical: float) -> bool:
        """Whether two together take more than the best of all pairs would of noise of unknown size."""
        if self.scorer.absolute:
            return True
        columns = self.columns(pair)
        d, S = given.rank(columns), given.reduction(columns)
        free = max(given.nu - d, 1.0)
        p = float(tail(S / max((given.yy - S) / free, 1e-12), d, free))
        return p * len(self.scorer.candidates) < critical

    def plausible(self, gram: Gram, chosen: Sequence[int], place: int) -> bool:
        """Whether no parameter comes out clearly negative against its known sign, or beyond what is plausible."""
        return self.is_within_limits(gram, chosen, place) and self.has_plausible_sign(gram, chosen, place)

    def is_within_limits(self, gram: Gram, chosen: Sequence[int], place: int) -> bool:
        """Whether no parameter of a member comes out clearly larger than is plausible."""
        amount, sigma = self._amounts(gram, chosen, place)
        limits = self.limits[list(self.scorer.candidates[place].columns)]
        return not np.any(np.abs(amount) > limits + CLEARLY_WRONG * sigma)

    def has_plausible_sign(self, gram: Gram, chosen: Sequence[int], place: int) -> bool:
        """Whether no parameter of a member comes out clearly negative against its known sign."""
        if not self.scorer.candidates[place].positive:
            return True
        amount, sigma = self._amounts(gram, chosen, place)
        return bool(np.all(amount > -CLEARLY_WRONG * sigma))

    def _amounts(self, gram: Gram, chosen: Sequence[int], place: int) -> tuple[Floats, Floats]:
        columns = self.columns(chosen)
        index = [columns.index(k) for k in self.scorer.candidates[place].columns]
        return gram.solve(columns)[index], np.sqrt(np.diag(gram.inverse(columns)[0]))[index]
