"""The residual learner: kept where a smooth unknown error is, left out where there is none, never given a physical name."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator

from kilter_core.arm.documents import robot_from_document
from kilter_core.effects.unknown import UnknownResidual
from kilter_core.errors import OptionError
from kilter_core.gap.search.candidates import build_library
from kilter_core.identify import Identification, IdentifyOptions, identify
from kilter_core.identify.estimate import estimate
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.campaigns import joints, measured, table_errors
from tests.core.correct.reference import CorrectOptions, correct
from tests.core.truth import ur10

Floats = NDArray[np.float64]
NOISE = 2e-5
ROBOT = robot_from_document(ur10().document())


def hidden(q: Floats) -> Floats:
    """An error of the tool (N, 3) m that no effect has the form of."""
    wave = np.sin(q[:, 1] + 0.5 * q[:, 2])
    return 4e-4 * np.stack([wave, np.cos(q[:, 0]) * wave, np.cos(q[:, 1] - q[:, 3])], axis=1)


@cache
def campaign(strange: bool, count: int = 220) -> tuple[Observations, Observations]:
    """Rows to fit and rows to predict; with or without the strange error."""
    rng = np.random.default_rng(4)
    arm = ur10().moved(table_errors(ur10(), rng))
    both = []
    for rows in (count, 300):
        seen = measured(arm, joints(arm, rows, rng), rng, NOISE)
        assert seen.position is not None
        both.append(replace(seen, position=seen.position + hidden(seen.q)) if strange else seen)
    return both[0], both[1]


@cache
def found(strange: bool, learner: bool, count: int = 220) -> Identification:
    train, held = campaign(strange, count)
    effect = {"id": "unknown_residual", "inputs": [1, 2, 3, 4]}
    return identify(ROBOT, train, held, IdentifyOptions(effects=(effect,) if learner else ()))


def held_out(result: Identification) -> float:
    return float(result.metrics["validation"]["identified"]["mean_mm"])


def test_it_is_the_gaussian_process_that_scipy_computes() -> None:
    """All poses as centres, geometry known: the fit's weights give the posterior mean of a Gaussian process."""
    rng = np.random.default_rng(1)
    q, unseen = rng.uniform(-2.0, 2.0, (40, 6)), rng.uniform(-2.0, 2.0, (50, 6))
    length, amplitude, noise = 2.0, 3e-4, 5e-5
    nominal = ur10().poses(q)[0]
    error = rng.normal(0.0, 2e-4, (40, 3))
    rows = Observations(q, position=nominal + error)
    effect = UnknownResidual(length=length, amplitude_m=amplitude, centres=tuple(map(tuple, q.tolist())))
    options = IdentifyOptions(effects=(effect.to_document(),), free=("residual_*",), base="fixed", tool="fixed",
                              noise_mm=noise * 1e3)  # fmt: skip
    start = Calibration.nominal(ROBOT, (effect.configure_for_robot(ROBOT),))
    fit = estimate(start, Measurement.from_observations(rows), options)
    learned = fit.problem.model.predict(Observations(unseen), fit.values).position - ur10().poses(unseen)[0]
    circle = [np.hstack([np.cos(x), np.sin(x)]) for x in (q, unseen)]
    process = RBFInterpolator(
        circle[0], error, kernel="gaussian", epsilon=1.0 / (np.sqrt(2.0) * length),
        smoothing=(noise / amplitude) ** 2, degree=-1,
    )  # fmt: skip
    np.testing.assert_allclose(learned, process(circle[1]), atol=2e-7)
    assert np.abs(learned).max() > 5e-5


def test_it_is_kept_where_it_predicts_poses_it_never_saw() -> None:
    plain, learned = found(True, False), found(True, True)
    assert held_out(learned) < 0.5 * held_out(plain)
    verdict = learned.to_document()["learned"]
    assert verdict["kept"]
    assert verdict["p_value"] < 0.01
    assert verdict["held_out_with_mm"] == pytest.approx(held_out(learned), rel=0.35)
    assert verdict["held_out_without_mm"] == pytest.approx(held_out(plain), rel=0.2)
    assert "learned_kept" in [w["code"] for w in learned.warnings]
    own = [name for name in learned.free_names if name not in plain.free_names]
    assert own
    assert all(name.startswith("residual_") for name in own)


def test_it_is_left_out_where_nothing_is_left_to_learn() -> None:
    plain, asked = found(False, False), found(False, True)
    assert asked.learned is not None
    assert not asked.learned.kept
    assert "learned_left_out" in [w["code"] for w in asked.warnings]
    assert asked.free_names == plain.free_names
    np.testing.assert_array_equal(asked.calibration.values, plain.calibration.values)


def test_too_few_poses_leave_it_out() -> None:
    asked = found(True, True, 25)
    assert asked.learned is not None
    assert (asked.learned.kept, asked.learned.p_value) == (False, None)
    assert "too few" in asked.warnings[-1]["message"]


def test_nobody_learns_unasked() -> None:
    train, _ = campaign(True)
    assert found(True, False).learned is None
    assert not any(c.id == "unknown_residual" for c in build_library(ROBOT, train).candidates)
    with pytest.raises(OptionError, match="learned, not searched"):
        build_library(ROBOT, train, only=("unknown_residual",))


def test_far_from_its_poses_it_says_nothing() -> None:
    effect = UnknownResidual(inputs=(0, 1), length=0.5).configure_for_robot(
        ROBOT, Observations(np.full((8, 6), 0.1) * np.arange(6))
    )
    assert len(effect.centres) == 1
    assert np.abs(effect.basis(np.array([[3.0, -3.0]]))).max() < 1e-6
    np.testing.assert_allclose(effect.basis(np.array(effect.centres)), 1.0, rtol=1e-6)


def test_a_corrected_path_leaves_out_what_was_learned() -> None:
    result = found(True, True)
    calibration, (_, held) = result.calibration, campaign(True)
    q = held.q[:60]
    done = correct(calibration, q, options=CorrectOptions("position", max_joint_rad=0.2, max_shift_m=0.1))
    wanted = calibration.nominal_in_wanted_frames().predict(Observations(q)).position
    landed = calibration.predict(Observations(done.q)).position
    good = done.converged & (done.status == 0)
    assert good.mean() > 0.8
    assert np.linalg.norm(landed - wanted, axis=1)[good].max() < 1e-6
