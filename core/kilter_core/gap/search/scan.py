"""The scan (E5): what each candidate takes off chi-square, and what pure noise would let the best one take.

BIC is not error control: with nothing hidden "BIC improves" fires 36-61 % of the time. A name therefore needs the best
of all candidates to beat the best of all candidates on noise (max-statistic): by a parametric bootstrap that also draws
the noise estimate again, and by flipping the signs of whole poses, whichever is stricter.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from kilter_core.gap.kernels.reductions import reductions
from kilter_core.gap.noise.from_repeats import Noise
from kilter_core.gap.search.candidates import Candidate
from kilter_core.gap.search.linear.gram import RIDGE, VISIBLE, Gram, Projection, inverse_square_root
from kilter_core.gap.search.linear.linearized import LinearizedProblem
from kilter_core.gap.search.linear.settings import tail
from kilter_core.types import Bools, Floats, Ints

# Share of alpha that is spent. Whitening uses an estimated covariance, which makes noise a little wilder than the
# bootstrap's: on 220 blind campaigns with nothing hidden the full 1 % named something in 2 %.
CAUTION = 0.5
STRICTER = 1e-3  # the most that sign flips may tighten the limit of the bootstrap
FEWEST_FLIPS = 12  # poses below which sign flips cannot reach a 1 % level
_NUMBERS = itertools.count()
AT_A_TIME = 100  # flips of signs: all of thousands of poses fill the memory
ALMOST_ALL = 0.999  # leverage beyond which a residual says nothing


@dataclass(frozen=True)
class Block:
    """Candidates of equal size: their places (K,), columns (K, d), and which have one parameter of known sign."""

    place: Ints
    columns: Ints
    one_sided: Bools

    @cached_property
    def has_known_sign(self) -> bool:
        """Whether any has a known sign."""
        return bool(self.one_sided.any())


@dataclass(frozen=True)
class Scores:
    """Per candidate (K,): chi-square taken ``S``, degrees ``d``, ``T`` = S over the noise left, and its ``p``."""

    S: Floats
    d: Ints
    T: Floats
    p: Floats


@dataclass(frozen=True)
class Scorer:
    """Scores many candidates, and many data sets, at once."""

    candidates: tuple[Candidate, ...]
    blocks: tuple[Block, ...]
    absolute: bool
    freedom: float

    @staticmethod
    def from_candidates(candidates: Sequence[Candidate], absolute: bool, freedom: float) -> Scorer:
        """Sort candidates by size."""
        sizes = sorted({len(c.columns) for c in candidates})
        blocks = []
        for size in sizes:
            place = [k for k, c in enumerate(candidates) if len(c.columns) == size]
            columns = np.array([candidates[k].columns for k in place], dtype=np.int64)
            signed = np.array([candidates[k].positive and size == 1 for k in place])
            blocks.append(Block(np.array(place, dtype=np.int64), columns, signed))
        return Scorer(tuple(candidates), tuple(blocks), absolute, freedom)

    def knowing(self, noise: Noise) -> Scorer:
        """The same with the noise as well known as this one is; itself where it is."""
        freedom = noise.freedom if noise.absolute else np.inf
        return self if freedom == self.freedom else replace(self, freedom=freedom)

    @cached_property
    def number(self) -> int:
        """A number no other scorer has, unlike an address, which is given again."""
        return next(_NUMBERS)

    @cached_property
    def places(self) -> Floats:
        """How many places in time each candidate (K,) is the best of."""
        return np.array([float(c.places) for c in self.candidates])

    @cached_property
    def paid(self) -> Floats:
        """Criterion points (K,) beside log N for each parameter, and less where only some of the rows tell each of them.

        More of what is less likely beforehand: one of so many places, a cause rarer than its rivals.
        """
        rarer = np.array([max((e.rarer for e in c.effects), default=1.0) for c in self.candidates])
        rows = np.array(
            [
                len(c.columns) * np.log(max((e.informative_row_share for e in c.effects), default=1.0))
                for c in self.candidates
            ]
        )
        return np.asarray(2.0 * np.log(self.places * rarer) + rows)

    @cached_property
    def empirical(self) -> Bools:
        """Candidates (K,) of the empirical tier."""
        return np.array([c.empirical for c in self.candidates], dtype=bool)

    def reductions(self, gram: Gram, data: Floats, among: Bools | None = None) -> tuple[Floats, Ints]:
        """Chi-square taken (B, K) for data ``c (B, Q)``, and degrees (K,); zero at will where not ``among`` them."""
        if len(data) == 1:
            return self._reductions_of_dataset(gram, np.ascontiguousarray(data[0]), among)
        S = np.zeros((len(data), len(self.candidates)))
        d = np.zeros(len(self.candidates), dtype=np.int64)
        for n, block in enumerate(self.blocks):
            half, d[block.place] = self._halves(gram, n)
            z = np.matmul(data[:, block.columns].transpose(1, 0, 2), half)
            taken = np.sum(z**2, axis=2).T
            if block.has_known_sign:
                wrong = block.one_sided & (data[:, block.columns[:, 0]] < 0.0)
                taken = np.where(wrong, 0.0, taken)
            S[:, block.place] = taken
        return S, d

    def _reductions_of_dataset(self, gram: Gram, c: Floats, among: Bools | None) -> tuple[Floats, Ints]:
        """The same of one data set ``c (Q,)``: a selection asks tens of thousands of times."""
        wanted = np.ones(len(self.candidates), dtype=bool) if among is None else among
        S, d = np.zeros(len(wanted)), np.zeros(len(wanted), dtype=np.int64)
        whole = gram.whole if gram.whole.flags.c_contiguous else gram.whole.T  # symmetric, so one form is compiled
        reductions(
            np.ascontiguousarray(whole), c, *gram.projection_factors, gram.free, wanted, *self._members, RIDGE, S, d
        )
        S[self.one_sided & (c[self._first_columns] < 0.0)] = 0.0
        return S[None], d

    @cached_property
    def _members(self) -> tuple[Ints, Ints]:
        """Where the columns of each candidate begin (K + 1,), and all of them one after the other."""
        starts = np.cumsum([0, *(len(c.columns) for c in self.candidates)])
        return starts, np.array([k for c in self.candidates for k in c.columns], dtype=np.int64)

    @cached_property
    def _first_columns(self) -> Ints:
        """First column of each candidate (K,)."""
        starts, columns = self._members
        return np.asarray(columns[starts[:-1]])

    def _halves(self, gram: Gram, n: int) -> tuple[Floats, Ints]:
        """Roots (K, d, d) of the inverse of the own matrix of each candidate of block ``n``, and its rank (K,)."""
        block = self.blocks[n]
        return gram.cached_for_columns(
            ("halves", self.number, n), (), lambda: _inverse_roots_and_ranks(gram, block.columns)
        )

    def tail_probability(self, gram: Gram, place: int, beside: Sequence[int] = ()) -> float:
        """Tail probability of one candidate beside some columns, as :meth:`scores` has it: of its own columns alone."""
        own, given = self.candidates[place].columns, gram.condition_on_columns(beside)
        taken = given.reduction(own)
        wrong = taken <= 0.0 or (self.one_sided[place] and given.c[own[0]] < 0.0)
        return 1.0 if wrong else self._tail(place, given.rank(own), taken, given.yy, given.nu)

    def scores(self, gram: Gram, among: Bools | None = None) -> Scores:
        """Scores of the data themselves, of all candidates or of those that are ``among`` them."""
        return self.scores_from_reductions(gram, *self.reductions(gram, gram.c[None], among))

    def scores_from_reductions(self, gram: Gram, S: Floats, d: Ints) -> Scores:
        """The same of what :meth:`reductions` (1, K) has found."""
        T = self.scale_by_noise_variance(S, d, np.array([gram.yy]), gram.nu, np.ones(1))[0]
        return Scores(S[0], d, T, self.tail(T[None], d, gram.nu)[0])

    def scale_by_noise_variance(self, S: Floats, d: Ints, yy: Floats, nu: float, noise: Floats) -> Floats:
        """S over the noise variance: that of what is left, or pooled with that of the repeats (``noise``, about 1)."""
        free = np.maximum(nu - d, 1.0)
        left = np.maximum(yy[:, None] - S, 0.0) / free
        return np.asarray(S / self.variance(left, free, noise[:, None]))

    def variance(self, left: Floats, free: Floats | float, noise: Floats | float = 1.0) -> Floats:
        """Noise variance from what is left (``free`` degrees) and from the repeats (about 1).

        More left than the repeats scatter is structure, and counts in full. Less says that the few repeats were wild:
        then both are estimates of one variance, and are pooled.
        """
        if not self.absolute:
            return np.maximum(left, 1e-12)
        share = free / (free + self.freedom) if np.isfinite(self.freedom) else 0.0
        return np.asarray(np.maximum(left, share * left + (1.0 - share) * noise))

    def noise_freedom(self, free: Floats | float) -> Floats:
        """Numbers that the noise variance rests on: what is left (``free``), and the repeats; infinite when it is stated."""
        if not self.absolute:
            return np.asarray(free, dtype=np.float64)
        return np.asarray(free, dtype=np.float64) + self.freedom

    def tail(self, T: Floats, d: Ints, nu: float) -> Floats:
        """Tail probability (B, K) given ``nu`` numbers free, half of it where the sign is known, 1 where nothing is left."""
        p = tail(T, d, self.noise_freedom(np.maximum(nu - d, 1.0)))
        p = np.minimum(np.where(self.one_sided, 0.5 * p, p) * self.places, 1.0)
        return np.asarray(np.where((d > 0) & (T > 0.0), p, 1.0))

    def tail_of_ratio(self, place: int, d: int, without: float, within: float, nu: float) -> float:
        """Tail probability of a candidate of ``d`` directions by chi-square without and with it; ``nu`` free without."""
        return self._tail(place, d, max(without - within, 0.0), without, nu)

    def _tail(self, place: int, d: int, taken: float, yy: float, nu: float) -> float:
        """The same by the chi-square ``taken`` of ``yy``."""
        if d == 0:
            return 1.0
        T = self.scale_by_noise_variance(np.array([[taken]]), np.array([d]), np.array([yy]), nu, np.ones(1))
        p = float(tail(T, np.array([d]), self.noise_freedom(np.array([max(nu - d, 1.0)])))[0, 0])
        return min(1.0, (0.5 * p if self.one_sided[place] else p) * float(self.places[place]))

    def best_tail(self, T: Floats, d: Ints, nu: float) -> Floats:
        """Smallest tail probability (B,): the largest T of each kind decides, so few tails are computed."""
        one, places = self.one_sided, self.places
        best = np.ones(len(T))
        for kind in {(int(k), bool(o), float(n)) for k, o, n in zip(d, one, places, strict=True) if k > 0}:
            own = (d == kind[0]) & (one == kind[1]) & (places == kind[2])
            known = self.noise_freedom(max(nu - kind[0], 1.0))
            p = tail(T[:, own].max(axis=1), kind[0], known) * (0.5 if kind[1] else 1.0) * kind[2]
            best = np.minimum(best, p)
        return best

    @cached_property
    def one_sided(self) -> Bools:
        """Candidates (K,) of one parameter with a known sign."""
        return np.array([c.positive and len(c.columns) == 1 for c in self.candidates], dtype=bool)


@dataclass(frozen=True)
class Null:
    """What noise alone does: smallest tail probabilities of the bootstrap, and of the sign flips when they count.

    ``wild`` are those of flips with everything in that no chosen candidate explains: the limit of a negative control,
    whose shuffled label leaves the effect among the noise.
    """

    bootstrap: Floats
    flips: Floats | None
    wild: Floats | None = None

    def critical(self, alpha: float) -> float:
        """Tail probability that the best candidate must go below; the stricter of the two.

        A strong effect not entered yet makes flipped residuals look wild, so the flips are heeded only so far.
        """
        return self._limit(self.flips, alpha)

    def strict(self, alpha: float) -> float:
        """The same where what is to be found counts among the noise."""
        return self._limit(self.flips if self.wild is None else self.wild, alpha)

    def _limit(self, flips: Floats | None, alpha: float) -> float:
        limit = float(np.quantile(self.bootstrap, CAUTION * alpha))
        if flips is None:
            return limit
        return min(limit, max(float(np.quantile(flips, CAUTION * alpha)), STRICTER * limit))

    def family_wise(self, p: float, tests: int) -> float:
        """Family-wise p-value: counted on the bootstrap, or beyond its reach by Bonferroni."""

        def empirical_p_value(sample: Floats) -> float:
            return (1.0 + float(np.sum(sample <= p))) / (len(sample) + 1.0)

        worst = max(empirical_p_value(s) for s in (self.bootstrap, self.flips) if s is not None)
        return worst if p * tests > 1.0 / (len(self.bootstrap) + 1.0) else min(worst, max(p * tests, 1e-300))


def _inverse_roots_and_ranks(gram: Gram, columns: Ints) -> tuple[Floats, Ints]:
    """Roots (K, d, d) of the inverses of the blocks of sets of columns (K, d), and their ranks (K,), as those of a Gram.

    Whatever data say of columns that are taken is rounding.
    """
    roots = [inverse_square_root(block) for block in gram.blocks(columns)]
    degrees = np.array([gram.directions(root, own) for root, own in zip(roots, columns, strict=True)], dtype=np.int64)
    return np.array([root.T for root in roots]) * gram.free[columns][:, :, None], degrees


def warm_up() -> None:
    """Compile what a scan calls."""
    kinds = [Candidate("", None, columns, "", False, False, "", ()) for columns in ((0,), (0, 1))]
    gram = Gram(np.array([[1.0, 0.2], [0.2, 1.0]]), np.ones(2), 4.0, 9.0)
    Scorer.from_candidates(kinds, absolute=True, freedom=np.inf).scores(gram.condition_on_columns([0]))


def null_distribution(problem: LinearizedProblem, scorer: Scorer, chosen: Sequence[int], draws: int, seed: int) -> Null:
    """Null distribution of the best candidate, given the chosen columns.

    Signs of whole poses are flipped in what the best candidate would leave (ter Braak's residuals of the full model).
    In what geometry alone leaves, an effect that is not named yet is flipped with the noise, makes it look wild, and
    hides itself; without any effect the best candidate takes so little that the two agree. Of a motion, whose rows are
    correlated in time, all is flipped: what a disturbance and an effect have in common must not make the limit lenient.
    """
    rng = np.random.default_rng(seed)
    gram = problem.gram.condition_on_columns(chosen)
    known = problem.settings.inflation > 1.0 or not scorer.candidates
    best = () if known else scorer.candidates[int(np.argmin(scorer.scores(gram).p))].columns
    drawn = bootstrap(gram, scorer, draws, rng)
    flips = _Flips.from_problem(problem, gram, scorer, chosen, draws // 2)
    if flips is None:
        return Null(drawn, None, None)
    calm = flips.tails(sorted({*chosen, *best}), rng)
    return Null(drawn, calm, None if chosen else flips.tails(chosen, rng))


def bootstrap(gram: Gram, scorer: Scorer, draws: int, rng: np.random.Generator) -> Floats:
    """Smallest tail probability (draws,) on Gaussian noise whose own variance is estimated again each time."""
    w, V = np.linalg.eigh(gram.A)
    keep = w > VISIBLE
    z = rng.standard_normal((draws, int(keep.sum())))
    rest = gram.nu - z.shape[1]
    yy = np.sum(z**2, axis=1) + (rng.chisquare(rest, draws) if rest > 0 else 0.0)
    S, d = scorer.reductions(gram, (z * np.sqrt(w[keep])) @ V[:, keep].T)
    finite = np.isfinite(scorer.freedom) and scorer.freedom > 0
    noise = rng.chisquare(scorer.freedom, draws) / scorer.freedom if finite else np.ones(draws)
    return scorer.best_tail(scorer.scale_by_noise_variance(S, d, yy, gram.nu, noise), d, gram.nu)


@dataclass(frozen=True)
class _Flips:
    """Flips of the signs of whole poses: candidates' ``columns`` with the chosen ones, of ``basis``, taken out."""

    problem: LinearizedProblem
    gram: Gram
    scorer: Scorer
    draws: int
    basis: Floats
    columns: Projection

    @staticmethod
    def from_problem(
        problem: LinearizedProblem, gram: Gram, scorer: Scorer, chosen: Sequence[int], draws: int
    ) -> _Flips | None:
        if int(problem.settings.group.max()) + 1 < FEWEST_FLIPS:
            return None
        basis = problem.basis(chosen)
        return _Flips(problem, gram, scorer, draws, basis, problem.projection.less(basis))

    def tails(self, taken: Sequence[int], rng: np.random.Generator) -> Floats:
        """Smallest tail probabilities (draws,) of what the columns ``taken`` leave."""
        problem, scorer, gram = self.problem, self.scorer, self.gram
        group = problem.settings.group
        poses = int(group.max()) + 1
        full = problem.basis(taken)
        r = residual_given(problem, taken, full) / np.sqrt(1.0 - np.minimum(np.sum(full**2, axis=1), ALMOST_ALL))
        sums = grouping(group[problem.row_visit], poses, r)
        c, along = sums_under_sign_flips((self.columns.under(sums), sums @ self.basis), self.draws, rng)
        yy = float(r @ r) - np.sum(along**2, axis=1)
        S, d = scorer.reductions(gram, c)
        tails = scorer.scale_by_noise_variance(S, d, np.maximum(yy, 0.0), gram.nu, np.ones(self.draws))
        return scorer.best_tail(tails, d, gram.nu)


def residual_given(problem: LinearizedProblem, chosen: Sequence[int], basis: Floats | None = None) -> Floats:
    """Whitened residual (R,) with geometry and the chosen columns, whose ``basis`` may be known, taken out."""
    basis = problem.basis(chosen) if basis is None else basis
    return np.asarray(problem.y - basis @ (basis.T @ problem.y))


def sums_under_sign_flips(sums: Sequence[Floats], draws: int, rng: np.random.Generator) -> list[Floats]:
    """Each of the sums (G, K) over the poses, under flips of their signs (draws, K)."""
    parts = []
    for k in range(0, draws, AT_A_TIME):
        signs = rng.choice([-1.0, 1.0], size=(min(AT_A_TIME, draws - k), len(sums[0])))
        parts.append([signs @ one for one in sums])
    return [np.concatenate(own) for own in zip(*parts, strict=True)]


def grouping(group: Ints, groups: int, weight: Floats | None = None) -> csr_array:
    """What sums the rows, times their ``weight (R,)``, of each group: a sparse matrix (G, R)."""
    order = np.argsort(group, kind="stable")
    starts = np.concatenate([[0], np.cumsum(np.bincount(group, minlength=groups))])
    data = np.ones(len(group)) if weight is None else weight[order]
    return csr_array((data, order, starts), shape=(groups, len(group)))
