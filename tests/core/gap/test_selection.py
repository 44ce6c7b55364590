"""Moves of the search on linear worlds made of plain columns: families against two others, pairs under unknown noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.effects import EFFECTS
from kilter_core.gap.search.candidates import FAMILY, JOINT, WHOLE, Candidate
from kilter_core.gap.search.linear.gram import Gram
from kilter_core.gap.search.scan import Scorer
from kilter_core.gap.search.select import Selector

CRITICAL = 1e-4


def candidate(name, columns, level=JOINT, joints=None):
    return Candidate(name, joints, tuple(columns), level, False, False, "joint", ())


def selector(candidates, gram, rows, absolute):
    return Selector(Scorer.from_candidates(candidates, absolute, np.inf), rows, np.full(len(gram.A), np.inf))


def gram_of(W, y):
    return Gram(W.T @ W, W.T @ y, float(y @ y), float(len(y)))


def test_a_family_that_imitates_two_others_gives_way_to_them():
    """Five joints explain what one of them and a column bending explain together, at the price of three parameters more."""
    rng = np.random.default_rng(2)
    W = rng.standard_normal((90, 5))
    other = W[:, 1:] @ np.array([0.9, 0.8, -0.7, 0.9]) + 0.05 * rng.standard_normal(90)
    W = np.column_stack([W, other])
    y = 3.0 * W[:, 0] + 2.0 * other + rng.standard_normal(90)
    singles = [candidate("compliance", (j,), joints=(j,)) for j in range(5)]
    family = candidate("compliance", range(5), FAMILY, tuple(range(5)))
    gram = gram_of(W, y)
    search = selector([*singles, family, candidate("bending", (5,), WHOLE)], gram, 90, absolute=True)
    assert set(search.improve_selection(gram, (5,), CRITICAL)) == {0, 6}


def test_a_family_whose_joints_all_show_stays_a_family():
    rng = np.random.default_rng(3)
    W = rng.standard_normal((90, 6))
    y = W[:, :5] @ np.array([2.0, -2.0, 2.0, 2.0, -2.0]) + rng.standard_normal(90)
    singles = [candidate("compliance", (j,), joints=(j,)) for j in range(5)]
    family = candidate("compliance", range(5), FAMILY, tuple(range(5)))
    gram = gram_of(W, y)
    search = selector([*singles, family, candidate("bending", (5,), WHOLE)], gram, 90, absolute=True)
    assert search.improve_selection(gram, (5,), CRITICAL) == (5,)


def test_a_family_does_not_give_way_to_two_others_that_take_more_directions():
    """They explain more because they have more; a real arm's one family became twelve names that way."""
    rng = np.random.default_rng(4)
    W = rng.standard_normal((200, 8))
    y = W @ np.array([9.0, 9.0, 4.0, 4.0, 4.0, 4.0, 4.0, 4.0]) + rng.standard_normal(200)
    W[:, 2] += 2.0 * W[:, 0]
    W[:, 5] += 2.0 * W[:, 1]
    family = candidate("compliance", (0, 1), FAMILY, (0, 1))
    others = [candidate("curve", (2, 3, 4), WHOLE), candidate("field", (5, 6, 7), WHOLE)]
    gram = gram_of(W, y)
    search = selector([family, *others], gram, 200, absolute=True)
    variance = search.variance(gram, (0,))
    assert search.criterion(gram, (1, 2), variance) > search.criterion(gram, (0,), variance)
    assert search.split_families(gram, (0,), CRITICAL) == (0,)


def hiding(strength, seed):
    """Two columns alike, of which the data hold the difference: alone either leaves nearly everything."""
    rng = np.random.default_rng(seed)
    W = rng.standard_normal((40, 30))
    W[:, 1] = W[:, 0] + 0.15 * rng.standard_normal(40)
    W /= np.linalg.norm(W, axis=0)
    apart = W[:, 0] - W[:, 1]
    y = strength * apart / np.linalg.norm(apart) + rng.standard_normal(40)
    return gram_of(W, y), [candidate("one", (k,), joints=(k,)) for k in range(30)]


def test_two_that_hide_each_other_are_found_where_the_noise_is_unknown():
    gram, candidates = hiding(60.0, 4)
    search = selector(candidates, gram, 40, absolute=False)
    assert search.entry(gram, (), CRITICAL)[0] is None
    assert set(search.better(gram, (), CRITICAL, 4)) == {0, 1}


def test_of_noise_of_unknown_size_no_pair_is_named():
    """The best of 435 pairs on nothing, two hundred times; a name that one pair alone would earn at one in ten thousand."""
    named = 0
    for seed in range(200):
        gram, candidates = hiding(0.0, seed)
        search = selector(candidates, gram, 40, absolute=False)
        named += search.pair(gram, (), CRITICAL) is not None
    assert named <= 1


@pytest.mark.parametrize("seed", range(20))
def test_exchanges_that_run_in_a_circle_end_where_they_would_without_doing_one_twice(seed):
    rng = np.random.default_rng(seed)
    states = [(a, b, c) for a in range(3) for b in range(3, 6) for c in range(6, 8)]
    following = {state: states[k] for state, k in zip(states, rng.integers(0, len(states), len(states)), strict=True)}
    done = []

    class Circling(Selector):
        def _exchange_members(self, gram, chosen, critical):
            done.append(chosen)
            return following[chosen]

    W = rng.standard_normal((20, 8))
    gram = gram_of(W, W[:, 0])
    plain = selector([candidate("column", (k,)) for k in range(8)], gram, 20, absolute=True)
    end = states[0]
    for _ in range(3 * len(end)):
        end = following[end]
    assert Circling(plain.scorer, plain.rows, plain.limits).swap_members(gram, states[0], CRITICAL) == end
    assert len(done) == len(set(done))


def three_families(present, seed):
    """Three effects of seven joints each, of which those ``present`` act, and two effects of the whole arm that do not."""
    rng = np.random.default_rng(seed)
    W = rng.standard_normal((300, 23))
    W /= np.linalg.norm(W, axis=0)
    y = W[:, present] @ (8.0 * rng.choice([-1.0, 1.0], len(present))) + rng.standard_normal(300)
    candidates = []
    for k, name in enumerate(("compliance", "play", "clearance")):
        columns = range(7 * k, 7 * k + 7)
        candidates += [candidate(name, (c,), joints=(c - 7 * k,)) for c in columns]
        candidates.append(candidate(name, columns, FAMILY, tuple(range(7))))
    candidates += [candidate("bending", (21,), WHOLE), candidate("growth", (22,), WHOLE)]
    return selector(candidates, gram_of(W, y), 300, absolute=True), gram_of(W, y)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_joints_of_one_effect_are_one_name_of_those_allowed(seed):
    present = [0, 2, 4, 5, 7, 8, 10, 14, 16, 17, 20]
    search, gram = three_families(present, seed)
    found = search.select_candidates(gram, CRITICAL, 3)
    assert search.columns(found) == present
    assert search.names(found) == 3


def test_a_name_beyond_those_allowed_stays_out_and_a_joint_of_one_that_is_in_does_not():
    present = [0, 2, 7, 21, 22]
    search, gram = three_families(present, 4)
    assert search.columns(search.select_candidates(gram, CRITICAL, 8)) == present
    found = search.select_candidates(gram, CRITICAL, 2)
    assert search.names(found) == 2
    everything = search.select_candidates(gram, CRITICAL, 1)
    assert {search.scorer.candidates[k].id for k in everything} in ({"compliance"}, {"bending"}, {"growth"}, {"play"})


def imitating(seed):
    """Three joints of one effect, which seven of another imitate but for a trace, and four joints of a third."""
    rng = np.random.default_rng(seed)
    W = rng.standard_normal((300, 21))
    W[:, [0, 2, 4]] = W[:, 7:14] @ rng.standard_normal((7, 3)) / np.sqrt(7.0) + 0.25 * W[:, [0, 2, 4]]
    W /= np.linalg.norm(W, axis=0)
    present = [0, 2, 4, 8, 10, 14, 16, 17, 20]
    y = W[:, present] @ (np.array([16.0] * 3 + [25.0] * 6)) + rng.standard_normal(300)
    candidates = []
    for k, name in enumerate(("compliance", "clearance", "play")):
        columns = range(7 * k, 7 * k + 7)
        candidates += [candidate(name, (c,), joints=(c - 7 * k,)) for c in columns]
        candidates.append(candidate(name, columns, FAMILY, tuple(range(7))))
    gram = gram_of(W, y)
    return selector(candidates, gram, 300, absolute=False), gram, present


@pytest.mark.parametrize("seed", range(12))
def test_families_that_imitate_each_other_end_at_the_joints_that_have_them(seed):
    """Without whole families tried beside the set, and joints that noise could be let go, a third ended at a family."""
    search, gram, present = imitating(seed)
    assert search.columns(search.select_candidates(gram, CRITICAL, 8)) == present


def test_no_family_is_asked_where_each_effect_acts_at_one_joint():
    search, gram, _ = imitating(0)
    single = [k for k, c in enumerate(search.scorer.candidates) if c.level == JOINT and c.columns[0] in (2, 9, 17)]
    assert search.faint_families(gram, single) == []
    assert search.faint_families(gram, [*single, single[0] + 1]) != []


def alike(seed, apart, second):
    """Two joints of one effect and another effect that imitates the second; the data hold the first and the ``second``.

    The imitation leaves ``apart`` points of chi-square between the two explanations.
    """
    rng = np.random.default_rng(seed)
    W = rng.standard_normal((90, 3))
    W /= np.linalg.norm(W, axis=0)
    W[:, 2] = W[:, 1] + np.sqrt(apart) / 10.0 * W[:, 2]
    W[:, 2] /= np.linalg.norm(W[:, 2])
    y = 10.0 * (W[:, 0] + W[:, second]) + rng.standard_normal(90)
    candidates = [candidate("bending", (j,), joints=(j,)) for j in range(2)]
    candidates += [candidate("bending", (0, 1), FAMILY, (0, 1)), candidate("tilt", (2,), joints=(1,))]
    gram = gram_of(W, y)
    search = selector(candidates, gram, 90, absolute=True)
    return {search.scorer.candidates[k].id for k in search.select_candidates(gram, CRITICAL, 8)}


def test_of_two_explanations_alike_the_one_with_fewer_names_is_said():
    """Nothing but noise decides between two effects and one effect at two joints: the second is the simpler statement."""
    named = [alike(seed, 1.0, second=1) for seed in range(40)]
    assert sum(one == {"bending"} for one in named) >= 36


def test_another_effect_is_named_where_the_data_prefer_it():
    assert all(alike(seed, 60.0, second=2) == {"bending", "tilt"} for seed in range(20))


def of_library(effect_id, columns, j):
    return Candidate(effect_id, (j,), tuple(columns), JOINT, effects=(EFFECTS[effect_id](joints=(j,)),))


def test_loads_are_held_where_what_is_there_is_kept_by_neither_set():
    """Their errors act through the compliance at the fit: not where torsion has stood for it, nor where both have left."""
    W, y = np.eye(5), np.ones(5)
    held = gram_of(W, 2.0 * y)
    gram = replace(gram_of(W, y), held=lambda: held, there=frozenset({0, 3}))
    ids = ("axial_compliance", "link_torsion", "direction_compliance", "encoder_scale")
    chosen = [of_library(effect_id, (k,), 2) for k, effect_id in enumerate(ids)]
    payload = Candidate("payload_error", None, (4,), WHOLE, effects=(EFFECTS["payload_error"](),))
    search = selector([*chosen, payload], gram, 5, absolute=True)
    assert search.comparison_gram(gram, (1, 2), (0, 3)) is gram
    assert search.comparison_gram(gram, (3,), (0,)) is gram  # no load acts through a scale
    assert search.comparison_gram(gram, (0,), (3,)) is held
    assert search.comparison_gram(gram, (1, 2), (3,)) is held
    assert search.comparison_gram(gram, (0, 4), ()) is gram  # such an error is what the comparison is about


def test_of_explanations_as_good_the_common_one_is_named():
    """A link twists about the axis of the next joint; gears do it in every arm, and are named, the link beside them."""
    rng = np.random.default_rng(6)
    W = rng.standard_normal((90, 1))
    W = np.column_stack([W[:, 0] + 0.001 * rng.standard_normal(90), W[:, 0]])
    y = W[:, 0] + W[:, 1] + rng.standard_normal(90)
    gram = gram_of(W, y)
    for ids in (("link_torsion", "axial_compliance"), ("axial_compliance", "link_torsion")):
        search = selector([of_library(effect_id, (k,), 2) for k, effect_id in enumerate(ids)], gram, 90, absolute=True)
        first, _ = search.entry(gram, (), CRITICAL)
        assert ids[first] == "axial_compliance"


def test_a_piece_of_a_walk_costs_what_its_rows_tell():
    six, two = (EFFECTS["random_walk"](knots_s=tuple(map(float, range(n + 1))), pieces=n) for n in (6, 2))
    walks = [Candidate("random_walk", None, tuple(range(3 * e.pieces)), WHOLE, effects=(e,)) for e in (six, two)]
    assert Scorer.from_candidates(walks, True, np.inf).paid == pytest.approx([-18.0 * np.log(6.0), 0.0])
