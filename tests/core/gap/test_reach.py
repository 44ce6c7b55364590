"""Exchanges that cannot win are not computed, and a set is looked at once: the same exchanges win as where all are tried."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap.search.candidates import JOINT, Candidate
from kilter_core.gap.search.linear.gram import Gram
from kilter_core.gap.search.scan import Scorer
from kilter_core.gap.search.select import Selector

CRITICAL = 1e-3
SIZES = (1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 6, 6)


class Tried(Selector):
    """Tries every exchange, and computes every candidate in it."""

    def _best_instead(self, gram, rest, variance, critical, taken, least=-np.inf, reach=None):
        return super()._best_instead(gram, rest, variance, critical, taken, least)


def world(seed: int) -> tuple[Gram, Selector]:
    """Columns alike in groups, some of them the same but for 1e-5, some the same; the data hold five of them."""
    rng = np.random.default_rng(seed)
    shared = rng.standard_normal((120, 8))
    W = shared @ rng.standard_normal((8, 24)) + 0.7 * rng.standard_normal((120, 24))
    W[:, 20] = W[:, 3] + 1e-5 * rng.standard_normal(120)
    W[:, 21] = W[:, 4]
    W /= np.linalg.norm(W, axis=0)
    y = W[:, [0, 3, 9, 14, 20]] @ rng.uniform(6.0, 14.0, 5) + rng.standard_normal(120)
    candidates = [
        Candidate(
            f"c{k}", None, tuple(sorted(rng.choice(24, size, replace=False))), JOINT, k % 4 == 0, k % 5 == 0, "", ()
        )
        for k, size in enumerate(SIZES)
    ]
    gram = Gram(W.T @ W, W.T @ y, float(y @ y), 120.0)
    return gram, Selector(Scorer.from_candidates(candidates, seed % 2 == 0, np.inf), 120, np.full(24, np.inf))


@pytest.mark.parametrize("seed", range(30))
def test_the_same_exchange_wins_as_where_all_are_tried(seed: int) -> None:
    gram, selector = world(seed)
    tried = Tried(selector.scorer, selector.rows, selector.limits)
    rng = np.random.default_rng(seed)
    for count in (1, 2, 4, 5):
        chosen = tuple(map(int, rng.choice(len(SIZES), count, replace=False)))
        fresh = replace(gram, exchanges={})
        assert selector._exchange_members(gram, chosen, CRITICAL) == tried._exchange_members(fresh, chosen, CRITICAL)
    assert selector.select_candidates(gram, CRITICAL, 6) == tried.select_candidates(
        replace(gram, exchanges={}), CRITICAL, 6
    )


def test_bounds_keep_whatever_may_win_and_leave_some_of_the_rest() -> None:
    kept = every = 0
    for seed in range(20):
        gram, selector = world(seed)
        chosen = selector.select_candidates(gram, CRITICAL, 6)
        reach = selector._reach(gram, chosen)
        for out in chosen:
            rest = tuple(k for k in chosen if k != out)
            columns, price = selector.columns(rest), selector.price(rest, [gram.rank(selector.columns(rest))])
            able = reach.able(columns, price, reach.now)
            S, d = selector.scorer.reductions(
                gram.condition_on_columns(columns), gram.condition_on_columns(columns).c[None]
            )
            without = selector.criterion(gram, rest, reach.variance)
            value = without + S[0] / reach.variance - d * np.log(selector.rows) - selector.extra
            assert able[value >= reach.now].all()
            kept, every = kept + int(able.sum()), every + len(able)
    assert kept < every


def test_a_set_in_another_order_is_not_looked_at_again() -> None:
    looked: list[frozenset[int]] = []

    class Counting(Selector):
        def _exchange(self, gram, chosen, critical):
            looked.append(frozenset(chosen))
            return super()._exchange(gram, chosen, critical)

    gram, plain = world(3)
    selector = Counting(plain.scorer, plain.rows, plain.limits)
    one, other = (selector._exchange_members(gram, chosen, CRITICAL) for chosen in ((1, 2, 5), (5, 1, 2)))
    assert set(one) == set(other)
    assert len(looked) == 1
    selector._exchange_members(
        gram.with_data(2.0 * gram.c, 4.0 * gram.yy), (1, 2, 5), CRITICAL
    )  # other data: looked at anew
    selector._exchange_members(gram, (1, 2, 5), 0.5 * CRITICAL)  # and under another limit
    assert len(looked) == 3


def test_one_tail_is_that_of_the_scan() -> None:
    gram, selector = world(4)
    scores = selector.scorer.scores(gram.condition_on_columns([2, 9]))
    for given, beside in ((gram.condition_on_columns([2, 9]), ()), (gram, (2, 9))):
        tails = [selector.scorer.tail_probability(given, k, beside) for k in range(len(SIZES))]
        np.testing.assert_allclose(tails, scores.p, rtol=1e-9)
