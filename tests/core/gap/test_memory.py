"""How much memory a hunt takes: counted on results that are kept, and on a whole hunt in a process of its own."""

from __future__ import annotations

import gc
import subprocess
import sys
import weakref
from dataclasses import replace

import numpy as np
import pytest

from kilter_core.gap.options import GapOptions
from kilter_core.gap.search.linear import settings
from kilter_core.gap.search.linear.gram import Recent, Soft
from kilter_core.gap.search.linear.linearized import LinearizedProblem, refit
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.model import Calibration
from tests.core.gap.simulated import campaign, katana

HUNT = """
import resource
from kilter_core.gap import GapOptions, find_gap
from tests.blind.generator import Case, Hidden, Options, generate
from tests.blind.to_core import observations_of, robot_of

shapes = [("clearance_tilt", 1), ("encoder_scale", 2), ("local_bump", 3), ("third_harmonic", 4), ("third_harmonic", 5)]
hidden = tuple(Hidden(name, (joint,)) for name, joint in shapes)
campaign = generate(Case("many", "seven", hidden, (800.0,) * 5, 60, Options(), "named", 5))
rows, robot = observations_of(campaign.columns), robot_of(campaign)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
report = find_gap(robot, rows, GapOptions(next_poses=1, resamples=40))
print(len(report.effects), (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""
MOST_MB = 150.0  # that a hunt adds to a process of some 220 MB; the sets it kept made that grow without end


def test_what_is_kept_stays_within_its_bytes() -> None:
    recent = Recent(most=100_000)
    made = []

    def once(k: int) -> np.ndarray:
        made.append(k)
        return np.full(1000, float(k))

    for k in range(40):
        assert recent.get(k, lambda k=k: once(k))[0] == k
        recent.get(0, lambda: once(0))
        assert recent.bytes <= 100_000
    assert made == list(range(40))  # the one in use was never made again
    assert recent.get(1, lambda: once(1))[0] == 1  # forgotten, made anew
    assert made[-1] == 1


def test_a_result_larger_than_the_limit_is_used_but_not_accounted_twice() -> None:
    recent = Recent(most=1000)
    for k in range(3):
        assert len(recent.get(k, lambda: np.zeros(1000))) == 1000
    assert recent.bytes < 2 * 8300


@pytest.fixture(scope="module")
def problem() -> LinearizedProblem:
    options = GapOptions(effects=("axial_compliance", "backlash"))
    return prepare_data(Calibration.nominal(katana()), campaign(katana(), seed=2), options).problem


def test_a_fit_at_rest_has_the_same_derivatives_when_asked_again(
    problem: LinearizedProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(settings, "MOST_BYTES", 0)
    G, W = problem.G.copy(), problem.W_raw.copy()
    problem.resting()
    assert problem.derivatives.kept is None
    assert np.array_equal(problem.G, G)
    assert np.array_equal(problem.W_raw, W)
    assert problem.derivatives.kept is not None


def test_what_was_found_rests_while_the_geometry_is_fitted_under_its_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(settings, "MOST_BYTES", 0)
    options = GapOptions(effects=("axial_compliance", "backlash"))
    prepared = prepare_data(Calibration.nominal(katana()), campaign(katana(), seed=2), options)
    found = refit(replace(prepared.problem.settings), prepared.problem.values, [0])
    assert found.derivatives.kept is not None
    after = prepared.update_noise_and_outliers(found)
    assert after.problem.settings is found.settings
    assert found.derivatives.kept is None
    assert after.update_noise_and_outliers(found) is after
    assert after.problem.derivatives.kept is not None


def test_a_few_poses_never_rest(problem: LinearizedProblem) -> None:
    kept = problem.W_raw
    problem.resting()
    assert problem.W_raw is kept


def test_a_fit_is_gone_with_its_last_reference(problem: LinearizedProblem) -> None:
    """Its inner products, made and asked with loads held, do not refer back to it: no circle keeps 100 MB alive."""
    made = replace(problem, soft=Soft.from_columns(problem.G[:, :1]))  # as if masses were known with errors
    assert made.gram.firm is not made.gram
    gone = weakref.ref(made)
    gc.disable()
    try:
        del made
        assert gone() is None
    finally:
        gc.enable()


@pytest.mark.slow
def test_a_hunt_that_ends_with_many_terms_takes_little_memory() -> None:
    out = subprocess.run([sys.executable, "-c", HUNT], check=True, capture_output=True, text=True, timeout=600)
    effects, grown_mb = out.stdout.split()
    assert int(effects) >= 4
    assert float(grown_mb) < MOST_MB
