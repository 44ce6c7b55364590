"""Inverses of candidates' own blocks and conditioning on sets: those of numpy's own least squares, by whichever way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap.search.linear.gram import RIDGE, VISIBLE, Fewer, Gram, Recent
from kilter_core.gap.search.scan import Scorer
from kilter_core.types import Floats
from tests.core.gap.test_reach import world


def with_eigenvalues(values: Floats, seed: int = 0) -> Floats:
    """A symmetric matrix with these eigenvalues, in random directions."""
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal((len(values), len(values))))[0]
    A = (Q * values) @ Q.T
    return 0.5 * (A + A.T)


def gram_of(A: Floats) -> Gram:
    return Gram(A, np.arange(1.0, len(A) + 1.0), 1.0, 100.0)


@pytest.mark.parametrize("smallest", [1e-2, 1e-4, 1e-5])
def test_an_inverse_is_that_of_a_pseudo_inverse(smallest: float) -> None:
    A = with_eigenvalues(np.r_[smallest, np.linspace(0.1, 3.0, 30)])
    inverse, rank = gram_of(A).inverse(range(31))
    assert rank == 31
    expected = np.linalg.pinv(A, rcond=1e-12, hermitian=True)
    assert np.allclose(inverse, expected, rtol=0.0, atol=1.1 * RIDGE / smallest**2)


@pytest.mark.parametrize(("smallest", "rank"), [(1.5 * VISIBLE, 31), (0.5 * VISIBLE, 30), (0.0, 30), (-1e-12, 30)])
def test_a_direction_at_the_limit_is_judged_by_its_eigenvalue(smallest: float, rank: int) -> None:
    A = with_eigenvalues(np.r_[smallest, np.linspace(0.1, 3.0, 30)])
    assert gram_of(A).inverse(range(31))[1] == rank


@pytest.mark.parametrize("seed", range(6))
def test_a_set_takes_no_less_with_a_column_more(seed: int) -> None:
    """Where each set dropped the directions that it could not see, one column more could drop one that told."""
    gram = world(seed)[0]
    order = list(map(int, np.random.default_rng(seed).permutation(24)))
    taken = [gram.reduction(order[:n]) for n in range(25)]
    ranks = [gram.rank(order[:n]) for n in range(25)]
    assert min(np.diff(taken)) > -1e-5
    assert set(np.diff(ranks)) <= {0, 1}


@pytest.mark.parametrize("seed", range(6))
def test_a_set_less_a_few_columns_is_the_rest_of_it(seed: int) -> None:
    """Near-copies (3 and 20), copies (4 and 21), columns that stay and that go; what is scanned beside the rest, too."""
    gram, selector = world(seed)
    columns = [1, 3, 4, 9, 14, 20, 21]
    for out in ([], [9], [20], [3, 20], [4, 14], [21, 1, 3], columns):
        rest = [k for k in columns if k not in out]
        less, given = Fewer(gram, columns).without_columns(out).conditioned_gram, gram.condition_on_columns(rest)
        assert less.nu == given.nu
        assert less.yy == pytest.approx(given.yy, rel=1e-7)
        assert np.allclose(less.A, given.A, rtol=0.0, atol=1e-8)
        (S, d), (expected, degrees) = (selector.scorer.reductions(g, g.c[None]) for g in (less, given))
        assert np.array_equal(d, degrees)
        assert np.allclose(S, expected, rtol=1e-5, atol=1e-5)


def test_no_columns_have_no_inverse() -> None:
    inverse, rank = gram_of(np.eye(3)).inverse(())
    assert (inverse.shape, rank) == ((0, 0), 0)


@pytest.mark.parametrize("seed", range(8))
def test_candidates_asked_for_alone_take_what_they_take_among_all(seed: int) -> None:
    gram, selector = world(seed)
    scorer: Scorer = selector.scorer
    rng = np.random.default_rng(seed)
    for taken in ((), (3, 9), (0, 14, 20)):
        given = gram.condition_on_columns(taken)
        for _ in range(4):
            among = rng.random(len(scorer.candidates)) < 0.3
            few = scorer.reductions(given.with_data(given.c, given.yy), given.c[None], among)
            every = Gram(gram.whole, gram.c, gram.yy, gram.nu).condition_on_columns(taken)
            S, d = scorer.reductions(every, every.c[None])
            assert np.array_equal(few[0][:, among], S[:, among])
            assert np.array_equal(few[1][among], d[among])


@pytest.mark.parametrize("taken", [(), (3, 9), (0, 14, 20)])
def test_candidates_take_what_least_squares_says(taken: tuple[int, ...]) -> None:
    """Projections of numpy's own least squares, of candidates independent of what is taken and of others."""
    rng = np.random.default_rng(5)
    W, y = rng.standard_normal((120, 24)), 5.0 * rng.standard_normal(120)
    W[:, 21] = W[:, 4]
    selector = world(1)[1]
    given = Gram(W.T @ W, W.T @ y, float(y @ y), 120.0).condition_on_columns(taken)
    S, d = selector.scorer.reductions(given, given.c[None])

    def left(columns: list[int]) -> float:
        X = W[:, columns]
        return float(np.sum((y - X @ np.linalg.lstsq(X, y, rcond=1e-6)[0]) ** 2)) if columns else float(y @ y)

    for k, candidate in enumerate(selector.scorer.candidates):
        both = sorted({*taken, *candidate.columns})
        ranks = [np.linalg.matrix_rank(W[:, c], tol=1e-6) if c else 0 for c in (both, list(taken))]
        assert d[k] == ranks[0] - ranks[1]
        signed = selector.scorer.one_sided[k] and S[0, k] == 0.0  # against its known sign it takes nothing
        assert signed or S[0, k] == pytest.approx(left(list(taken)) - left(both), abs=1e-5)


@pytest.mark.parametrize("seed", range(8))
def test_a_member_beside_the_others_is_as_sure_as_a_scan_of_them_says(seed: int) -> None:
    gram, selector = world(seed)
    rng = np.random.default_rng(seed)
    for count in (1, 3, 5):
        chosen = tuple(map(int, rng.choice(len(selector.scorer.candidates), count, replace=False)))
        for k, p in zip(chosen, selector.tails(gram, chosen), strict=True):
            rest = gram.condition_on_columns(selector.columns([m for m in chosen if m != k]))
            expected = selector.scorer.scores(rest).p[k] if selector.has_plausible_sign(gram, chosen, k) else 1.0
            assert p == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("smallest", [1e-2, 1e-5, 1.5 * VISIBLE, 0.5 * VISIBLE, 1e-9, 0.0, -1e-12])
def test_one_data_set_is_scanned_as_many_are(smallest: float) -> None:
    """A loop over small triangles, and numpy's eigenvalues of many matrices: with directions near the limit, and taken ones."""
    selector = world(2)[1]
    A = with_eigenvalues(np.r_[smallest, np.linspace(0.1, 3.0, 23)], seed=3)
    data = np.random.default_rng(4).standard_normal((3, 24)) @ np.linalg.cholesky(A + 1e-9 * np.eye(24)).T
    for taken in ((), (2,), (0, 7, 11, 19)):
        given = Gram(A, data[0], 30.0, 100.0).condition_on_columns(taken)
        S, d = selector.scorer.reductions(given, data)
        for one, each in zip(data, S, strict=True):
            alone, degrees = selector.scorer.reductions(given, one[None])
            assert np.array_equal(degrees, d)
            assert np.allclose(alone[0], each, rtol=1e-6, atol=1e-9)


def test_scans_push_no_inverse_out() -> None:
    """A scan takes many times the bytes of an inverse, which every comparison of two sets asks for again."""
    made, selector = world(5)
    gram = replace(made, cache=Recent(most=10_000))
    kept = gram.inverse([2, 5, 9])[0]
    for k in range(24):
        selector.scorer.scores(gram.condition_on_columns([k]))
    assert gram.inverse([2, 5, 9])[0] is kept
    assert gram.with_data(2.0 * gram.c, 4.0 * gram.yy).inverse([2, 5, 9])[0] is kept
    assert gram.condition_on_columns([3]).inverse([2, 5, 9])[0] is not kept


@pytest.mark.parametrize("taken", [(), (4,), (1, 7, 16)])
def test_parts_are_those_of_the_whole(taken: tuple[int, ...]) -> None:
    gram = world(6)[0].condition_on_columns(taken)
    columns = np.array([[0, 3], [5, 11], [8, 2], [20, 21]])
    expected = gram.A[columns[:, :, None], columns[:, None, :]]
    assert np.allclose(gram.blocks(columns), expected, rtol=0.0, atol=1e-12)
