"""The linear world against plain least squares, and the chance of a false name against what it should be."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from kilter_core.gap.evidence.similarity.similarity import correlation, correlations
from kilter_core.gap.evidence.similarity.testability import testability as judged
from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.candidates import with_testable
from kilter_core.gap.search.forward_selection import search
from kilter_core.gap.search.linear.gram import Gram
from kilter_core.gap.search.linear.linearized import estimate_linear_parameters, refit
from kilter_core.gap.search.linear.settings import tail
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.gap.search.scan import Scorer, null_distribution, residual_given
from kilter_core.gap.search.select import Selector
from kilter_core.model import Calibration
from tests.core.gap.simulated import campaign, katana


@pytest.fixture(scope="module")
def prepared():
    robot = katana()
    return prepare_data(Calibration.nominal(robot), campaign(robot, seed=5), GapOptions())


@pytest.fixture(scope="module")
def scorer(prepared):
    able = judged(prepared.problem, prepared.library).able
    return Scorer.from_candidates(with_testable(prepared.library, able), True, prepared.problem.settings.noise.freedom)


def test_conditioning_is_a_projection():
    rng = np.random.default_rng(0)
    W, y = rng.normal(size=(60, 6)), rng.normal(size=60)
    gram = Gram(W.T @ W, W.T @ y, float(y @ y), 60.0)
    given = gram.condition_on_columns([1, 4])
    basis = np.linalg.qr(W[:, [1, 4]])[0]
    other, rest = W - basis @ (basis.T @ W), y - basis @ (basis.T @ y)
    np.testing.assert_allclose(given.A, other.T @ other, atol=1e-10)
    np.testing.assert_allclose(given.c, other.T @ rest, atol=1e-10)
    assert given.yy == pytest.approx(rest @ rest)
    assert given.nu == 58.0


def test_correlations_of_all_pairs_are_those_of_each():
    """Against principal angles; the sixth column is another one's double, the seventh is nothing."""
    rng = np.random.default_rng(3)
    W = rng.normal(size=(50, 6))
    W = np.column_stack([W, W[:, 2], np.zeros(50)])
    spaces = [(0,), (1, 2), (6,), (2, 6), (3, 4, 5), (7,)]
    found = correlations(W.T @ W, spaces)
    for i, one in enumerate(spaces):
        for j, other in enumerate(spaces):
            a, b = (one, other) if len(one) <= len(other) else (other, one)
            angles = scipy.linalg.subspace_angles(W[:, a], W[:, b]) if 7 not in (*a, *b) else []
            rank = np.linalg.matrix_rank(W[:, a])
            expected = np.sqrt(np.sum(np.cos(angles) ** 2) / rank) if len(angles) else 0.0
            assert found[i, j] == pytest.approx(expected, abs=1e-7), (one, other)
            assert correlation(W.T @ W, one, other) == pytest.approx(expected, abs=1e-7)


def test_conditioning_twice_is_conditioning_once():
    """The thin factor, the blocks made from it, and sets conditioned one after another agree with the whole matrix."""
    rng = np.random.default_rng(0)
    W, y = rng.normal(size=(80, 12)), rng.normal(size=80)
    gram = Gram(W.T @ W, W.T @ y, float(y @ y), 80.0)
    Q = np.linalg.qr(W[:, [1, 4, 7]])[0]
    left, r = W - Q @ (Q.T @ W), y - Q @ (Q.T @ y)
    for given in (gram.condition_on_columns([1, 4, 7]), gram.condition_on_columns([1]).condition_on_columns([4, 7])):
        assert pytest.approx(left.T @ left, abs=1e-6) == given.A
        assert given.c == pytest.approx(left.T @ r, abs=1e-6)
        assert (given.yy, given.nu) == (pytest.approx(float(r @ r)), 77.0)
        blocks = given.blocks(np.array([[0, 2], [3, 5]]))
        assert blocks[1] == pytest.approx((left.T @ left)[np.ix_([3, 5], [3, 5])], abs=1e-6)


def test_scores_are_those_of_a_fit_with_each_candidate(prepared, scorer):
    problem = prepared.problem
    S, _ = scorer.reductions(problem.gram, problem.c[None])
    for place in (0, 17, 40, len(scorer.candidates) - 1):
        columns = list(scorer.candidates[place].columns)
        if scorer.one_sided[place] and problem.c[columns[0]] < 0:
            assert S[0, place] == 0.0
            continue
        u, size, _ = np.linalg.svd(problem.W[:, columns], full_matrices=False)
        assert S[0, place] == pytest.approx(np.sum((u[:, size**2 > 1e-7].T @ problem.y) ** 2), rel=1e-5)


@pytest.mark.parametrize(("d", "freedom"), [(1, 20), (4, 20), (2, np.inf)])
def test_tails_are_those_of_draws(d, freedom):
    """A variance from twenty numbers makes large ratios a hundred times as frequent as chi-square says."""
    rng = np.random.default_rng(1)
    ratio = rng.chisquare(d, 400_000)
    if np.isfinite(freedom):
        ratio /= rng.chisquare(freedom, len(ratio)) / freedom
    for share in (0.1, 1e-3):
        assert tail(np.quantile(ratio, 1.0 - share), d, freedom) == pytest.approx(share, rel=0.15)


def test_noise_alone_is_named_once_in_a_hundred(prepared, scorer):
    """300 draws of pure noise with its size estimated anew; 99.9 % of such counts at 1 % stay below 10."""
    problem = prepared.problem
    critical = null_distribution(problem, scorer, [], 1999, 0).critical(0.01)
    selector = Selector(scorer, problem.rows, np.full(len(problem.A), np.inf))
    rng = np.random.default_rng(8)
    freedom = problem.settings.noise.freedom
    names = 0
    for _ in range(300):
        e = rng.standard_normal(len(problem.y)) / np.sqrt(rng.chisquare(freedom) / freedom)
        r = e - problem.U @ (problem.U.T @ e)
        k, _ = selector.entry(problem.gram.with_data(problem.W.T @ r, float(r @ r)), (), critical)
        names += k is not None
    assert names <= 10


def test_refit_recovers_an_amplitude_and_its_uncertainty():
    robot = katana()
    true = 3e-4
    pulls = []
    for seed in range(8):
        rows = campaign(robot, [("backlash", (2,), (true,))], seed=seed, poses=60)
        p = prepare_data(Calibration.nominal(robot), rows, GapOptions())
        column = [k for k, x in enumerate(p.library.parameters) if x.name == "backlash_3"]
        value, covariance = estimate_linear_parameters(refit(p.problem.settings, p.problem.values, column), column)
        pulls.append((value[0] - true) / np.sqrt(covariance[0, 0]))
    assert np.abs(np.mean(pulls)) < 1.2
    assert 0.4 < np.std(pulls) < 1.9


def test_two_effects_are_found_whole_and_leave_only_noise(prepared, scorer):
    problem = prepared.problem
    rng = np.random.default_rng(1)
    wanted = [k for k, c in enumerate(scorer.candidates) if c.label in ("backlash j4", "eccentricity j3")]
    selector = Selector(scorer, problem.rows, np.full(len(problem.A), np.inf))
    columns = selector.columns(wanted)
    e = 14.0 * (problem.W_raw[:, columns] @ np.ones(len(columns))) + rng.standard_normal(len(problem.y))
    r = e - problem.U @ (problem.U.T @ e)
    found = selector.select_candidates(problem.gram.with_data(problem.W.T @ r, float(r @ r)), 1e-4, 6)
    assert {scorer.candidates[k].label for k in found} == {"backlash j4", "eccentricity j3"}


def test_a_family_is_named_as_a_family():
    robot = katana()
    rows = campaign(robot, [("backlash", None, (3e-4, 2e-4, 3e-4, 4e-4, 3e-4))], seed=2)
    p = prepare_data(Calibration.nominal(robot), rows, GapOptions())
    able = judged(p.problem, p.library).able
    candidates = with_testable(p.library, able)
    limits = np.array([max(abs(x.lower), abs(x.upper)) for x in p.library.parameters])
    found = search(
        p.problem.settings,
        p.problem,
        Scorer.from_candidates(candidates, True, p.problem.settings.noise.freedom),
        limits,
        GapOptions(),
        lambda f, s: None,
    )
    assert [candidates[k].label for k in found.chosen] == ["backlash all"]
    assert float(np.mean(residual_given(found.problem, found.columns) ** 2)) < 1.3
