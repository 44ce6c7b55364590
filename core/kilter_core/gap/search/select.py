"""Selection on the linearised problem: enter the best, swap, drop, and write a family as a family.

Forward selection alone leaves wrong extra names: an effect that replaced two real ones stays. After each entry comes
a swap pass (one for one, and two for one) and a backward pass; and an effect that most joints share is named once.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from kilter_core.gap.search.candidate_sets import CandidateSets
from kilter_core.gap.search.candidates import FAMILY, JOINT
from kilter_core.gap.search.linear.gram import Fewer, Gram
from kilter_core.gap.search.linear.linearized import Tick, ignore_step
from kilter_core.gap.search.scan import Scorer, Scores
from kilter_core.types import Bools, Floats, Ints

# What exchanges could reach at most, from scans already made: of those that cannot win nothing is computed.
#
# Whatever a candidate explains beside some of a set, all of the set and the candidate explain too. So a scan beside
# more members bounds what the same candidate can do beside fewer.

ROUNDING = 0.2  # criterion points that rounded values, and rounding errors, may hide


@dataclass
class Reach:
    """Bounds of one exchange after another, on one linearised problem at one noise ``variance``.

    ``whole`` is the set whose members go. ``scans`` are, for sets of library columns, what every candidate (K,) beside them
    reaches less its own price: infinite where a scan says nothing of smaller sets, because a sign was held against it.
    """

    scorer: Scorer
    whole: Fewer
    variance: float
    price: Floats  # of a direction, then beyond directions of each candidate (1 + K,)
    now: float  # the criterion of the set as it is
    scans: dict[frozenset[int], Floats] = field(default_factory=dict)

    @property
    def gram(self) -> Gram:
        """The linearised problem."""
        return self.whole.gram

    def record_scan(self, columns: Sequence[int], given: Gram, S: Floats, d: Ints) -> None:
        """Remember a scan: chi-square ``S (K,)`` that candidates take beside the columns in ``d (K,)`` directions."""
        reaches = (self.gram.yy - given.yy + S) / self.variance - d * self.price[0] - self.price[1:]
        self.scans[frozenset(columns)] = np.where(self.scorer.one_sided & (S == 0.0), np.inf, reaches)

    def able(self, columns: list[int], price: Floats, least: float) -> Bools:
        """Candidates (K,) that beside these columns, where the whole costs ``price (K,)`` besides, may come to ``least``."""
        own = frozenset(columns)
        most = np.full(len(self.scorer.candidates), np.inf)
        for beside, reaches in self.scans.items():
            if own <= beside:
                np.minimum(most, reaches, out=most)
        return np.asarray(most - price >= least - ROUNDING)


MARGIN = 6.0  # criterion points (2 log of a Bayes factor of 20) within which two explanations count as equal
FAMILY_MARGIN = 3.0  # of a family against some of its joints, and what each name costs: fewer of either are simpler
MOST_JOINTS = 0.6
MOST_OF_IT = 0.5  # of what is left, from which an addition is tried plain when what it was improved to failed
TRIED = 4
SMALLEST_GAIN = 0.2  # criterion points: below this two explanations are one, and the library's order decides
BROAD = 4  # parameters from which an effect imitates two of others: a base that drifts in all ways, one that bends and a zero
SAME = 1e-6  # criterion points that are rounding errors
HIDING = 3.0  # standard deviations of chi-square above its freedom at which effects may hide one another
PAIRED = 25
TIME_FIRST = ("time_offset", "tracking_lag")


@dataclass(frozen=True)
class Selector(CandidateSets):
    """A search over sets of candidates."""

    closed: frozenset[int] = frozenset()  # candidates that may not enter
    pairs: bool = True  # whether two that hide each other are looked for
    tick: Tick = field(default=ignore_step, compare=False)  # called before every exchange; may raise

    @property
    def causes(self) -> Selector:
        """The same search among physical candidates only."""
        return replace(self, closed=frozenset(np.flatnonzero(self.scorer.empirical).tolist()))

    def price(self, places: Sequence[int], degrees: Sequence[int]) -> float:
        """What parameters and names cost; an empirical term must beat every physical one by the margin."""
        beyond = float(np.sum(self.extra[list(places)])) + FAMILY_MARGIN * self.names(places)
        return float(sum(degrees)) * float(np.log(self.rows)) + beyond

    @cached_property
    def extra(self) -> Floats:
        """What a candidate (K,) costs beside its parameters: a shape the margin, an event its choice of a place."""
        return np.asarray(MARGIN * self.scorer.empirical + self.scorer.paid)

    def criterion(self, gram: Gram, chosen: Sequence[int], variance: float) -> float:
        """Chi-square taken over the noise variance, less the price."""
        columns = self.columns(chosen)
        return gram.reduction(columns) / variance - self.price(chosen, [gram.rank(columns)])

    def entry(
        self, gram: Gram, chosen: Sequence[int], critical: float, banned: Sequence[int] = ()
    ) -> tuple[int | None, Scores]:
        """Best candidate to add, None when the best is no better than noise; ``banned`` ones were tried without success."""
        given = gram.condition_on_columns(self.columns(chosen))
        scores = self.scorer.scores(given)
        if not len(scores.p):
            return None, scores
        ranked = self.penalised_reductions(given, scores, chosen)
        able = (scores.p < critical) & (scores.d > 0)
        able[list(banned)] = False
        k, _ = self._best_allowed_candidate(gram, tuple(chosen), ranked, able)
        return (None if k is None else self._time_first(k, scores, able)), scores

    def _best_allowed_candidate(
        self, gram: Gram, chosen: tuple[int, ...], value: Floats, able: Bools
    ) -> tuple[int | None, float]:
        """Best of the ``able`` whose sign is possible, and its value; one of an implausible amount is worth less by the
        margin. It is not banned: another name would then be given for what it explains, and be wrong.
        """
        best, worth = None, -np.inf
        for k in map(int, np.argsort(-np.where(able, value, -np.inf), kind="stable")):
            if not able[k] or value[k] <= worth:
                break
            if k not in self.closed and self.has_plausible_sign(gram, (*chosen, k), k):
                its = float(value[k]) - (0.0 if self.is_within_limits(gram, (*chosen, k), k) else MARGIN)
                best, worth = (k, its) if its > worth else (best, worth)
        return best, worth

    def penalised_reductions(self, given: Gram, scores: Scores, chosen: Sequence[int]) -> Floats:
        """S over the noise left, less the price (K,) beside a set, to a tenth: equal explanations keep the library's order."""
        free = np.maximum(given.nu - scores.d, 1.0)
        variance = float(np.min(self.scorer.variance((given.yy - scores.S) / free, free)))
        return np.asarray(np.round(scores.S / variance - scores.d * np.log(self.rows) - self._beyond(chosen), 1))

    def _beyond(self, chosen: Sequence[int]) -> Floats:
        """What each candidate (K,) costs beside a set, beyond its parameters."""
        return np.asarray(self.extra + FAMILY_MARGIN * self.another_name(chosen))

    def improve_selection(self, gram: Gram, chosen: tuple[int, ...], critical: float) -> tuple[int, ...]:
        """Swap, merge and drop until nothing improves."""
        seen = {chosen}
        while True:
            after = chosen
            for step in (
                self.swap_members,
                self.split_families,
                self.merge_into_families,
                self.drop_members,
            ):  # each looks at a set once
                after = gram.cached_for_data(
                    self._key(step.__name__, after, critical), partial(step, gram, after, critical)
                )
            if after == chosen or after in seen:
                return after
            seen.add(after)
            chosen = after

    def swap_members(self, gram: Gram, chosen: tuple[int, ...], critical: float) -> tuple[int, ...]:
        """Replace one or two members by one outside as long as the criterion grows, at most three times for each.

        It may go in a circle, since each set is judged at its own noise: no step is done twice.
        """
        path = [chosen]
        for left in reversed(range(3 * len(chosen))):
            after = self._exchange_members(gram, path[-1], critical)
            if after == path[-1]:
                break
            if after in path:
                circle = path[path.index(after) :]
                return circle[left % len(circle)]
            path.append(after)
        return path[-1]

    def _exchange_members(self, gram: Gram, chosen: tuple[int, ...], critical: float) -> tuple[int, ...]:
        """Replace the one or two members by the one outside with which the criterion grows most, if it does.

        Sets come back in other orders, entry after entry: each is looked at once.
        """
        make = partial(self._exchange, gram, chosen, critical)
        out, entered = gram.cached_for_data(self._key("exchange", frozenset(chosen), critical), make)
        return chosen if entered is None else (*(m for m in chosen if m not in out), entered)

    def _key(self, step: str, chosen: Collection[int], critical: float) -> Hashable:
        return step, self.scorer.number, self.closed, self.rows, critical, chosen

    def _exchange(self, gram: Gram, chosen: tuple[int, ...], critical: float) -> tuple[tuple[int, ...], int | None]:
        """Which members leave, and which candidate enters, None where nothing does."""
        best: tuple[tuple[int, ...], int | None] = ((), None)
        gain = SMALLEST_GAIN
        reaches: list[Reach] = []
        for out in [(m,) for m in chosen] + list(itertools.combinations(chosen, 2)):
            self.tick()
            rest, problem = self.remaining_set_and_gram(gram, chosen, out)
            reach = next((one for one in reaches if one.gram is problem), None)
            if reach is None:
                reach = self._reach(problem, chosen)
                reaches.append(reach)
            k, value = self._best_instead(problem, rest, reach.variance, critical, set(chosen), reach.now + gain, reach)
            if k is not None and value - reach.now > gain:
                best, gain = (out, k), value - reach.now
        return best

    def _reach(self, gram: Gram, chosen: tuple[int, ...]) -> Reach:
        """Bounds of exchanges by what every candidate would do beside all that is chosen."""
        variance = self.variance(gram, chosen)
        price, now = np.r_[np.log(self.rows), self.extra], self.criterion(gram, chosen, variance)
        reach = Reach(self.scorer, Fewer(gram, self.columns(chosen)), variance, price, now)
        given = reach.whole.conditioned_gram
        S, d = self.scorer.reductions(given, given.c[None])
        reach.record_scan(reach.whole.columns, given, S[0], d)
        return reach

    def split_families(self, gram: Gram, chosen: tuple[int, ...], critical: float) -> tuple[int, ...]:
        """Replace a family, or another of many parameters, by two others that together explain more with no more directions:
        it imitates both. More for more is what entries look for; shapes imitate anything, and replace no cause; nor do
        amounts that are not plausible one that is: no disc is 7 degrees off its centre, as a magnet may be.
        """
        all_ = self.scorer.candidates
        for family in (k for k in chosen if all_[k].level == FAMILY or len(all_[k].columns) >= BROAD):
            rest, problem = self.remaining_set_and_gram(gram, chosen, (family,))
            variance = self.variance(problem, chosen)
            directions, now = problem.rank(self.columns(chosen)), self.criterion(problem, chosen, variance)
            among, taken = self if self.scorer.empirical[family] else self.causes, set(chosen)
            for _ in range(TRIED):  # what comes nearest alone may itself stand for both
                first, _ = among._best_instead(problem, rest, variance, critical, taken)
                if first is None:
                    break
                taken.add(first)
                second, value = among._best_instead(problem, (*rest, first), variance, critical, taken)
                if second is None or value <= now:
                    continue
                after = (*rest, first, second)
                wider = problem.rank(self.columns(after)) > directions
                odd = self.is_within_limits(gram, chosen, family) and not all(
                    self.is_within_limits(gram, after, k) for k in after[-2:]
                )
                if not (wider or odd) and max(self.tails(gram, after)[len(rest) :]) < critical:
                    chosen = after
                    break
        return chosen

    def merge_into_families(self, gram: Gram, chosen: tuple[int, ...], critical: float) -> tuple[int, ...]:
        """Name an effect of most joints as a family, one of few joints by its joints, each significant alone."""
        for effect in sorted({self.scorer.candidates[k].id for k in chosen}):
            family = [k for k, c in enumerate(self.scorer.candidates) if c.id == effect and c.level == FAMILY]
            own = [k for k in chosen if self.scorer.candidates[k].id == effect]
            if not family or (own != family and len(own) < 2):
                continue
            rest, problem = self.remaining_set_and_gram(gram, chosen, own)
            variance = self.variance(problem, (*rest, family[0]))
            members = self.members_above_noise(gram, rest, self._members(problem, rest, family[0], variance))
            whole = self.criterion(problem, (*rest, family[0]), variance)
            better = self.criterion(problem, (*rest, *members), variance) > whole + self._family_margin(
                family[0], members
            )
            if better and max(self.tails(gram, (*rest, *members))[len(rest) :]) < critical:
                chosen = (*rest, *members)
            elif self.has_plausible_sign(gram, (*rest, family[0]), family[0]):
                chosen = (*rest, family[0])
        return chosen

    def drop_members(self, gram: Gram, chosen: tuple[int, ...], critical: float) -> tuple[int, ...]:
        """Drop members that, given the others, noise could be, or whose sign contradicts physics."""
        while chosen:
            tails = self.tails(gram, chosen)
            worst = int(np.argmax(tails))
            if tails[worst] <= critical:
                return chosen
            chosen = tuple(m for m in chosen if m != chosen[worst])
        return chosen

    def slack(self, chosen: Sequence[int]) -> float:
        """Criterion points that a family in the set may have cost against naming some of its joints."""
        families = [k for k in chosen if self.scorer.candidates[k].level == FAMILY]
        return SMALLEST_GAIN + sum(MARGIN * len(self.scorer.candidates[k].joints or ()) / 2 for k in families)

    def _family_margin(self, family: int, members: Sequence[int]) -> float:
        """How much better a part of a family must be: what most joints show, the others probably have too weakly."""
        joints = len(self.scorer.candidates[family].joints or ())
        missing = joints - len(members)
        return MARGIN * missing if missing and len(members) >= MOST_JOINTS * joints else FAMILY_MARGIN

    def select_candidates(self, gram: Gram, critical: float, most: int) -> tuple[int, ...]:
        """Whole selection on one linearised problem, for resamples.

        A shape that enters first can keep the causes out that together explain more: then they are tried alone.
        """
        chosen = self._forward_selection(gram, critical, most)
        if self.shapes(chosen):
            causes = self.causes._forward_selection(gram, critical, most)
            if causes and self.beats(gram, causes, chosen):
                return causes
        return chosen

    def _forward_selection(self, gram: Gram, critical: float, most: int) -> tuple[int, ...]:
        chosen: tuple[int, ...] = ()
        done = 0
        while done < self.rounds(chosen, most):
            after = self.better(gram, chosen, critical, most)
            if after == chosen:
                break
            chosen, done = after, done + 1
        return chosen

    def better(
        self, gram: Gram, chosen: tuple[int, ...], critical: float, most: int, seen: Collection[frozenset[int]] = ()
    ) -> tuple[int, ...]:
        """Next set: the best entry, improved, if it beats the set as it is; else the next entry; else the set improved.

        Sets only ever get better and never return to one ``seen``, so the search cannot run in circles.
        """
        banned: list[int] = []
        full = self.too_many(chosen, most)
        while len(full) < len(self.scorer.candidates) and len(banned) < TRIED:
            k, scores = self.entry(gram, chosen, critical, [*full, *banned])
            if k is None:
                break
            after = self.improve_selection(gram, (*chosen, k), critical)
            undone = (
                frozenset(after) in seen
                and scores.S[k] > MOST_OF_IT * gram.condition_on_columns(self.columns(chosen)).yy
            )
            if undone or self.names(after) > most:
                after = (*chosen, k)  # improved it is too many, or did not do what the linearised problem promised
            # A significant addition needs no better price: the price compares explanations, noise was ruled out already.
            added = set(after) > set(chosen)
            if frozenset(after) not in {frozenset(chosen), *seen} and (added or self.beats(gram, after, chosen)):
                return after
            banned.append(k)
        pair = self.pair(gram, chosen, critical) if self.names(chosen) + 2 <= most else None
        if pair is not None:
            after = self.improve_selection(gram, (*chosen, *pair), critical)
            new = frozenset(after) not in {frozenset(chosen), *seen} and self.names(after) <= most
            if new and (set(after) > set(chosen) or self.beats(gram, after, chosen)):
                return after
        after = self.with_family(gram, chosen, critical, most)
        if frozenset(after) not in {frozenset(chosen), *seen}:
            return after
        after = self.improve_selection(gram, chosen, critical)
        if not chosen or self.names(after) > most or frozenset(after) in {frozenset(chosen), *seen}:
            return chosen
        failed = max(self.tails(gram, chosen)) >= critical
        return after if failed or self.beats(gram, after, chosen) else chosen

    def with_family(self, gram: Gram, chosen: tuple[int, ...], critical: float, most: int) -> tuple[int, ...]:
        """The set with a family that another hides: whole families first, then the joints of each that show."""
        for k in self.faint_families(gram, chosen)[:TRIED]:
            self.tick()
            others = (m for m in chosen if self.scorer.candidates[m].id != self.scorer.candidates[k].id)
            after = self.improve_selection(gram, self.merge_into_families(gram, (*others, k), critical), critical)
            if self.names(after) > most or max(self.tails(gram, after), default=0.0) >= critical:
                continue
            variance = min(self.variance(gram, one) for one in (after, chosen))
            if self.criterion(gram, after, variance) - self.criterion(gram, chosen, variance) > FAMILY_MARGIN:
                return after
        return chosen

    def pair(self, gram: Gram, chosen: tuple[int, ...], critical: float) -> tuple[int, int] | None:
        """Two candidates that hide each other: alone neither is significant, because the other's share counts as noise.

        Looked for only when what is left is clearly more than noise, where that is known; where it is not, the two
        together must be significant against what they leave, as one of all pairs. Each must be significant given the
        other.
        """
        if not self.pairs:
            return None
        given = gram.condition_on_columns(self.columns(chosen))
        if self.scorer.absolute and given.yy < given.nu + HIDING * np.sqrt(2.0 * max(given.nu, 1.0)):
            return None
        scores = self.scorer.scores(given)
        if not len(scores.p):
            return None
        worth = np.where(scores.d > 0, self.penalised_reductions(given, scores, chosen), -np.inf)
        best, most = None, -np.inf
        for k in map(int, np.argsort(-worth, kind="stable")[:PAIRED]):
            self.tick()
            m, _ = self.entry(gram, (*chosen, k), critical)
            if m is None or m in (*chosen, k) or k in self.closed:
                continue
            both = (*chosen, k, m)
            value = self.criterion(gram, both, self.variance(gram, both))
            # Beside both a member may turn out to be nothing, which stood for them: it is dropped after.
            shown = max(self.tails(gram, both)[len(chosen) :]) < critical
            if value > most and shown and self.among_pairs(given, (k, m), critical):
                best, most = (k, m), value
        return best

    def beats(self, gram: Gram, one: tuple[int, ...], other: tuple[int, ...]) -> bool:
        """Whether a set's criterion is larger than another's, at the smaller noise of the two."""
        gram = self.comparison_gram(gram, set(other) ^ set(one), set(other) & set(one))
        variance = min(self.variance(gram, one), self.variance(gram, other))
        return self.criterion(gram, one, variance) > self.criterion(gram, other, variance) - self.slack(one)

    def _best_instead(
        self,
        gram: Gram,
        rest: tuple[int, ...],
        variance: float,
        critical: float,
        taken: set[int],
        least: float = -np.inf,
        reach: Reach | None = None,
    ) -> tuple[int | None, float]:
        """Best candidate to enter a set, and the criterion with it; None where no one's can be clearly above ``least``."""
        columns, able = self.columns(rest), np.ones(len(self.scorer.candidates), dtype=bool)
        able[[*taken, *self.closed]] = False
        whole = Fewer(gram, columns) if reach is None else reach.whole
        left = whole.without_columns(set(whole.columns) - set(columns))
        price = self.price(rest, [left.rank])
        if reach is not None:
            able &= reach.able(columns, price + FAMILY_MARGIN * self.another_name(rest), least)
            if not able.any():
                return None, -np.inf
        given = left.conditioned_gram
        reductions, d = self.scorer.reductions(given, given.c[None], None if reach is None else able)
        if reach is not None and len(rest) + 1 == len(taken):  # of smaller sets this says what they reach at most
            reach.record_scan(columns, given, np.where(able, reductions[0], np.inf), d)
        value = np.round(reductions[0] / variance - d * np.log(self.rows) - self._beyond(rest), 1)
        able &= d > 0
        without = (gram.yy - left.yy) / variance - price
        if without + np.max(value, where=able, initial=-np.inf) < least - SAME:  # no tail needs to be computed
            return None, -np.inf
        able &= self.scorer.scores_from_reductions(given, reductions, d).p < critical
        if without + np.max(value, where=able, initial=-np.inf) < least - SAME:  # its signs need not be looked at
            return None, -np.inf
        k, worth = self._best_allowed_candidate(gram, rest, np.asarray(value), able)
        return k, without + worth

    def _members(self, gram: Gram, rest: tuple[int, ...], family: int, variance: float) -> tuple[int, ...]:
        """Joints of a family that pay their price, by dropping the least worthy one after another."""
        effect = self.scorer.candidates[family]
        inside = [
            k
            for k, c in enumerate(self.scorer.candidates)
            if c.id == effect.id and c.level == JOINT and set(c.columns) <= set(effect.columns)
        ]
        value = self.criterion(gram, (*rest, *inside), variance)
        while len(inside) > 1:
            tried = [self.criterion(gram, (*rest, *(m for m in inside if m != k)), variance) for k in inside]
            best = int(np.argmax(tried))
            if tried[best] <= value:
                break
            value = tried[best]
            inside.pop(best)
        return tuple(inside)

    def _time_first(self, k: int, scores: Scores, able: Bools) -> int:
        """A shared time offset enters before any joint's own lag."""
        first, second = TIME_FIRST
        if self.scorer.candidates[k].id != second:
            return k
        shared = [m for m, c in enumerate(self.scorer.candidates) if c.id == first and able[m]]
        return shared[0] if shared else k
