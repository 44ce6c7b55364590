"""Loads on the fitted chain: zeros that are degrees off must not pass for stiffness, nor leave an error behind."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.identify import IdentifyOptions, identify
from kilter_core.identify.estimate import estimate
from kilter_core.identify.methods.fit import model_with_updated_loads
from kilter_core.measurement import Measurement
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.off_zero import ZEROS_DEG, soft_elbow

COMPLIANCE = ((1, 2), (4e-6, 6e-6))  # rad/(N m)
TILT = ((0, 1, 2, 3, 4), (4e-4,) * 5)  # rad
PLAY = ((1, 2, 3, 4), (6e-4, 5e-4, 8e-4, 8e-4))  # rad
# Amplitudes, their names, how many standard deviations the drawn chain's loads put them off, held-out error it adds.
CASES = {
    "axial_compliance": (COMPLIANCE, "compliance", 6.0, 1.15),
    "clearance_tilt": (TILT, "clearance", 3.0, 1.8),
    "backlash_load": (PLAY, "backlash_load", 3.0, 1.8),
}


def asked(effects) -> IdentifyOptions:
    named = tuple({"id": e, "joints": [j + 1 for j in js]} for e, (js, _) in effects.items())
    return IdentifyOptions(effects=named, masses="as_stated")  # they are right here


def left_m(calibration: Calibration, rows: Observations) -> float:
    error = calibration.predict(rows).position - rows.position
    return float(np.sqrt(np.mean(error**2)))


def on_the_drawn_chain(twin, rows: Observations, options: IdentifyOptions):
    """The fit that takes its loads on the chain as drawn."""
    start = Calibration.nominal(
        twin.robot, tuple(e.configure_for_robot(twin.robot, rows) for e in options.make_effects())
    )
    return estimate(start, Measurement.from_observations(rows), options)


@pytest.mark.parametrize("effect", CASES)
def test_zeros_degrees_off_pass_for_no_effect(effect: str) -> None:
    """The drawn chain's loads give wrong parameters and leave errors; the fitted chain's do neither."""
    (joints, truth), stem, off, worse = CASES[effect]
    effects = {effect: (joints, truth)}
    twin, options = soft_elbow(**effects), asked(effects)
    rows, unseen = twin.rows(120, 1), twin.rows(60, 2)
    plain = on_the_drawn_chain(twin, rows, options)
    found = identify(twin.robot, rows, options=options)
    names = [f"{stem}_{j + 1}" for j in joints]

    def apart(fit) -> np.ndarray:
        at = [fit.names.index(name) for name in names]
        return np.abs(fit.values[fit.problem.free][at] - truth) / fit.sigma[at]

    assert apart(plain).max() > off
    assert apart(found.fit).max() < 3.0
    one = left_m(Calibration(plain.problem.model, plain.values), unseen)
    assert one > worse * left_m(found.calibration, unseen)


def test_the_loads_stand_where_the_fit_ended() -> None:
    effects = {"axial_compliance": COMPLIANCE}
    twin = soft_elbow(**effects)
    found = identify(twin.robot, twin.rows(80, 3), options=asked(effects))
    chain = found.calibration.model.load_chain
    assert chain is not None
    names = found.calibration.model.names[6:-6][: len(chain.values)]
    values = dict(zip(found.calibration.names, found.calibration.values, strict=True))
    fitted = [values[name] for name in names]
    np.testing.assert_allclose(chain.values, fitted, atol=1e-4)
    at = [names.index(f"theta_offset_{j}") for j in (2, 3)]
    drawn = [e.value for e in twin.robot.chain.elements if e.name in ("theta_offset_2", "theta_offset_3")]
    np.testing.assert_allclose(np.degrees(chain.values[at] - drawn), ZEROS_DEG[1:3], atol=0.05)
    assert model_with_updated_loads(found.fit) is None


def test_an_arm_that_is_as_drawn_keeps_its_loads_on_the_drawn_chain() -> None:
    """Where nothing moves that counts, the version is the one that it was before loads were taken anew."""
    effects = {"axial_compliance": COMPLIANCE}
    twin = soft_elbow(**effects)
    rows = twin.rows(80, 4)
    geometry = identify(twin.robot, rows)
    assert geometry.calibration.model.load_chain is None
    stiff = IdentifyOptions(effects=asked(effects).effects, fix=("theta_offset_*", "d_*", "a_*", "alpha_*", "beta_*"))
    held = identify(twin.robot, rows, options=stiff)
    assert held.calibration.model.load_chain is None


@pytest.mark.parametrize(
    "more", [{"method": "kalman"}, {"loss": "tukey"}, {"loss": "huber"}, {"tilt_first": True}, {"method": "influence"}]
)
def test_every_way_to_fit_takes_them(more) -> None:
    effects = {"axial_compliance": ((1, 2), (2e-5, 3e-5))}
    twin = soft_elbow(**effects)
    options = IdentifyOptions(effects=asked(effects).effects, **more)
    found = identify(twin.robot, twin.rows(80, 5), options=options)
    assert found.calibration.model.load_chain is not None
