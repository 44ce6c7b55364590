"""Which columns of a set are independent: the scan for what to add and the criterion of the whole set say the same."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from kilter_core.gap.kernels.independent import rooted
from kilter_core.gap.search.candidates import JOINT, Candidate
from kilter_core.gap.search.gram import VISIBLE, Gram
from kilter_core.gap.search.scan import Scorer
from kilter_core.gap.search.select import Selector

CRITICAL = 1e-6
LENGTHS_M = np.array([0.5, 0.4, 0.2])


def tip(q, lengths=LENGTHS_M):
    """Place (N, 2) of the tip of three links in a plane, by joint angles (N, 3)."""
    angle = np.cumsum(q, axis=1)
    return np.stack([np.cos(angle) @ lengths, np.sin(angle) @ lengths], axis=1)


def moved(q, joint, curve, step=1e-6):
    """What an error ``curve (N,)`` of a joint moves of the tip, by differences: (2 N,)."""
    ahead = q.copy()
    ahead[:, joint] += step * curve
    return ((tip(ahead) - tip(q)) / step).reshape(-1)


CURVES = {
    "scale": lambda a: [a],
    "eccentricity": lambda a: [np.sin(a), np.cos(a)],
    "second": lambda a: [np.sin(2 * a), np.cos(2 * a)],
    "third": lambda a: [np.sin(3 * a), np.cos(3 * a)],
    "cubic": lambda a: [a**3],
}


def world(span, seed):
    """Error curves of joints that turn within ``span`` rad: over so little all of them are nearly the first few powers."""
    rng = np.random.default_rng(seed)
    q = np.array([0.3, -0.8, 0.9]) + span * rng.uniform(-1.0, 1.0, (150, 3))
    geometry = [moved(q, j, np.ones(len(q))) for j in range(3)]
    geometry += [(tip(q, LENGTHS_M + 1e-6 * np.eye(3)[j]) - tip(q)).reshape(-1) / 1e-6 for j in range(3)]
    geometry += [np.tile([1.0, 0.0], len(q)), np.tile([0.0, 1.0], len(q))]
    made = [(name, j, moved(q, j, curve)) for j in range(3) for name in CURVES for curve in CURVES[name](q[:, j])]
    W = np.stack([column / np.linalg.norm(column) for *_, column in made], axis=1)
    U = np.linalg.qr(np.stack(geometry, axis=1))[0]
    y = rng.normal(size=2 * len(q)) + W @ (3e3 * rng.normal(size=W.shape[1]) * (rng.random(W.shape[1]) < 0.3))
    W, y = W - U @ (U.T @ W), y - U @ (U.T @ y)
    names = sorted({(j, name) for name, j, _ in made})
    places = {of: tuple(k for k, (name, j, _) in enumerate(made) if (j, name) == of) for of in names}
    candidates = [Candidate(name, (j,), places[j, name], JOINT, False, False, "joint", ()) for j, name in names]
    gram = Gram(W.T @ W, W.T @ y, float(y @ y), float(len(y) - U.shape[1]))
    return gram, Selector(Scorer.of(candidates, True, np.inf), len(y), np.full(W.shape[1], np.inf))


@pytest.mark.parametrize("span", [0.04, 0.08, 0.15, 0.3, 0.6])
def test_what_the_scan_promises_is_what_the_criterion_of_the_whole_set_gains(span):
    """Over 0.04 to 0.3 rad the curves of one joint pass from dependent to independent, one after another."""
    for seed in range(4):
        gram, selector = world(span, seed)
        every = range(len(selector.scorer.candidates))
        for rest in itertools.chain([()], itertools.combinations(every, 1), itertools.combinations(every, 2)):
            taken = selector.columns(rest)
            scores = selector.scorer.scores(gram.given(taken))
            for k in set(every) - set(rest):
                both = selector.columns((*rest, k))
                gained = gram.reduction(both) - gram.reduction(taken)
                assert scores.S[k] == pytest.approx(gained, rel=1e-4, abs=1e-3), (seed, rest, k)
                more = gram.degrees(both) - gram.degrees(taken)
                assert scores.d[k] == (pytest.approx(more, abs=5e-3) if more > 0.5 else 0.0), (seed, rest, k)


@pytest.mark.parametrize("span", [0.08, 0.15, 0.3])
def test_every_exchange_raises_the_criterion(span):
    for seed in range(8):
        gram, selector = world(span, seed)
        chosen = (0, 5, 10)
        variance = selector.variance(gram, chosen)
        path = [chosen]
        for _ in range(12):
            after = selector._exchanged(gram, path[-1], CRITICAL)
            if after == path[-1]:
                break
            values = [selector.criterion(gram, one, selector.variance(gram, path[-1])) for one in (path[-1], after)]
            assert values[1] > values[0]
            assert set(after) not in [set(one) for one in path], "a circle"
            path.append(after)
        assert selector.criterion(gram, path[-1], variance) >= selector.criterion(gram, chosen, variance)


def test_a_nearly_dependent_pair_is_one_column_for_scan_criterion_and_basis():
    """Two columns that differ by less than the least that counts of either: the second adds nothing, in either order."""
    rng = np.random.default_rng(3)
    W = rng.normal(size=(60, 3))
    W /= np.linalg.norm(W, axis=0)
    W[:, 1] = W[:, 0] + 0.1 * np.sqrt(VISIBLE) * W[:, 2]
    y = 30.0 * W[:, 2] + 100.0 * W[:, 0]
    gram = Gram(W.T @ W, W.T @ y, float(y @ y), 60.0)
    scorer = Scorer.of([Candidate("one", (k,), (k,), JOINT, False, False, "joint", ()) for k in range(3)], True, np.inf)
    assert gram.rank([0, 1]) == 1
    assert gram.rank([0, 1, 2]) == 2
    for first, second in ((0, 1), (1, 0)):
        given = scorer.scores(gram.given([first]))
        assert given.d[second] == 0
        assert given.p[second] == 1.0
        assert given.d[2] == 1
    assert gram.reduction([0, 1]) == pytest.approx(gram.reduction([0]), rel=2e-3)


@pytest.mark.parametrize("size", [1, 4, 23])
def test_the_kernel_agrees_with_a_plain_twin(size):
    rng = np.random.default_rng(size)
    W = rng.normal(size=(40, size)) * 10.0 ** rng.uniform(-2, 0, size)
    W = np.column_stack([W, W @ rng.normal(size=(size, 2))])  # two more that depend on all
    A, half = W.T @ W, np.empty((size + 2,) * 2)
    rooted(A, VISIBLE, half)
    assert half @ half.T == pytest.approx(np.linalg.inv(A + VISIBLE * np.eye(size + 2)), rel=1e-5, abs=1.0)
    gram = Gram(A, W.T @ rng.normal(size=40), 40.0, 40.0)
    assert gram.rank(range(size + 2)) == size
    assert gram.reduction(range(size + 2)) == pytest.approx(gram.reduction(range(size)), rel=1e-4)
