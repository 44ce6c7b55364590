"""Curves that hold in the range where they were measured: as before in it, their mean far beyond, and no step between."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import compile_program
from kilter_core.effects import make_effect
from kilter_core.effects.curves import FADE
from kilter_core.errors import OptionError
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from tests.core.correct.c_corrector import built
from tests.core.correct.reference import CorrectOptions, correct
from tests.core.correct.test_c_corrector import compare

ROBOT = robot_from_document({"name": "arm", "convention": "preset", "preset": "ur10"})
LOW, HIGH = -0.5, 0.4
CURVES: dict[str, dict[str, Any]] = {
    "eccentricity": {},
    "encoder_scale": {},
    "second_harmonic": {},
    "encoder_curve": {"orders": (1, 2, 3, 4)},
    "gravity_spring": {"arms_m": (0.4, 0.1), "angle_rad": 0.6},
    "unknown_smooth_curve": {"centres": (0.0,), "halves": (0.45,)},
}


def version_of(name: str, measured: tuple[tuple[float, float], ...] | None) -> Calibration:
    model = RobotModel(ROBOT, (make_effect(name, joints=(3,), measured=measured, **CURVES[name]),))
    values = model.values0()
    values[model.n_geometric :] = 5e-5 * np.arange(1, 1 + len(values) - model.n_geometric)
    return Calibration(model, values)


def swept(count: int = 601) -> np.ndarray:
    q = np.tile([0.1, -1.0, 1.2, 0.0, 0.7, 0.1], (count, 1))
    q[:, 3] = np.linspace(-1.5, 1.5, count)
    return q


@pytest.mark.parametrize("name", CURVES)
def test_a_curve_gives_way_to_its_mean_beyond_its_range(name: str) -> None:
    q = swept()
    bounded, endless = version_of(name, ((LOW, HIGH),)), version_of(name, None)
    inside = (q[:, 3] >= LOW) & (q[:, 3] <= HIGH)
    turned = [one.predict(Observations(q)).position - Calibration.nominal(ROBOT).predict(Observations(q)).position
              for one in (bounded, endless)]  # fmt: skip
    np.testing.assert_allclose(turned[0][inside], turned[1][inside], atol=1e-15)
    found = compile_program(bounded).correct_rows(q)
    # What the kernel takes off joint 4 is the curve: by the mean over the range beyond, without a step on the way.
    step = np.abs(np.diff(found.q[:, 3] - q[:, 3]))
    assert step.max() < 0.25 * np.ptp(found.q[inside, 3] - q[inside, 3])
    far = (q[:, 3] < LOW - FADE) | (q[:, 3] > HIGH + FADE)
    within = swept()
    within[:, 3] = np.linspace(LOW, HIGH, len(within))
    mean = np.mean(compile_program(endless).correct_rows(within).q[:, 3] - within[:, 3])
    np.testing.assert_allclose((found.q - q)[far, 3], mean, atol=2e-6)
    ideal = correct(bounded, q, options=CorrectOptions())
    np.testing.assert_allclose(found.q, ideal.q, atol=1e-7)
    again = Calibration.from_document(ROBOT, bounded.to_document())
    np.testing.assert_allclose(
        again.predict(Observations(q)).position, bounded.predict(Observations(q)).position, atol=1e-12
    )


def test_the_c_corrector_bounds_curves_as_the_kernels_do(tmp_path: Any) -> None:
    library: ctypes.CDLL = built(tmp_path)
    assert compare(library, compile_program(version_of("eccentricity", ((-0.1, 0.0),)))) < 1e-9


def test_ranges_that_are_not_those_of_the_joints_are_refused() -> None:
    with pytest.raises(OptionError, match="give lowest and highest of 1 joints"):
        version_of("eccentricity", ((0.0, 1.0), (0.0, 1.0))).predict(Observations(swept(3)))
