"""A version whose loads hang on the fitted chain: the corrector lands where the whole model says that it should."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.robot import Link
from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.correct.reference import CorrectOptions, correct
from tests.corrector.test_runtime_effects import BASE_TILT, OF_ARMS, TEMPERATURE_C, calibration_with, landing

LOADS = (
    "axial_compliance", "radial_compliance", "clearance_tilt", "backlash_load", "hardening", "strain_wave", "reading_tilt",
    "link_bending", "base_compliance", "link_torsion", "tool_sag",
)  # fmt: skip
SIGNED = ("clearance_tilt", "backlash_load")
OPTIONS = CorrectionOptions(least_softening_nm=0.0, temperature_c=TEMPERATURE_C, iterations=30)


def on_its_own_chain(*effects: str, tool_m: float = 4e-3) -> Calibration:
    """A UR10 with zeros half a degree off, a link that no joint moves, and loads on the chain as it stands."""
    found = calibration_with(*effects)
    pillar = Link(0, 30.0, np.array([0.05, -0.08, 0.1]))
    robot = replace(found.robot, links=(pillar, *found.robot.links))
    values = found.values.copy()
    for k, name in enumerate(found.names):
        if name.startswith("theta_offset"):
            values[k] += np.radians(0.5) * (-1.0) ** k
    values[found.model.n_geometric - 6] = tool_m
    model = replace(found.model, robot=robot)
    return Calibration(model.with_loads_at_values(values), values)


@pytest.mark.parametrize("effect", LOADS)
@pytest.mark.parametrize("payload_kg", [0.0, 4.0])
def test_the_corrector_takes_loads_on_the_chain_of_the_version(effect: str, payload_kg: float) -> None:
    calibration = on_its_own_chain(effect)
    options = replace(OPTIONS, payload_kg=payload_kg, largest_rad=0.1, farthest_m=0.1, largest_m=0.1)
    program = compile_program(calibration, options)
    for dynamic in (False, True):
        missed = landing(calibration, program, dynamic, payload_kg)
        # Signs stand still after a few rounds, so that one near zero cannot flip back and forth.
        assert (np.quantile(missed, 0.95) if effect in SIGNED else missed.max()) < 1e-6


@pytest.mark.parametrize("hanging", [False, True])
def test_links_that_bend_and_twist_share_their_loads(hanging: bool) -> None:
    """Two effects that read the load on the end of one link, and curves, which evaluate them once more."""
    calibration = on_its_own_chain("link_bending", "link_torsion", "eccentricity")
    if not hanging:
        chain = replace(calibration.model.load_chain, effects=None)
        calibration = replace(calibration, model=replace(calibration.model, load_chain=chain))
    options = replace(OPTIONS, payload_kg=4.0, largest_rad=0.1, farthest_m=0.1, largest_m=0.1)
    program = compile_program(calibration, options)
    for dynamic in (False, True):
        assert landing(calibration, program, dynamic, 4.0).max() < 1e-7


def test_all_effects_at_once_and_through_a_document() -> None:
    calibration = on_its_own_chain(*OF_ARMS)
    document = json.loads(json.dumps(calibration.to_document()))
    calibration = Calibration.from_document(calibration.robot, document)
    options = replace(OPTIONS, largest_rad=0.1, farthest_m=0.1, largest_m=0.1, base_tilt=BASE_TILT)
    program = compile_program(calibration, options)
    assert np.quantile(landing(calibration, program, True), 0.95) < 2e-6
    drawn = replace(calibration, model=replace(calibration.model, load_chain=None))
    q = np.random.default_rng(3).uniform(-1.3, 1.3, (40, 6))
    apart = compile_program(drawn, options).correct_rows(q).q - program.correct_rows(q).q
    assert np.abs(apart).max() > 1e-6


def test_the_stream_and_the_readable_twin_agree() -> None:
    """A stream looks ahead from its last corrections, and takes the same loads as rows that stand alone."""
    calibration = on_its_own_chain("axial_compliance", "radial_compliance", "base_compliance")
    program = compile_program(calibration, replace(OPTIONS, largest_rad=0.1, farthest_m=0.1, largest_m=0.1))
    t = np.arange(400) * 0.002
    q = np.array([0.3, -1.2, 1.4, -0.5, 0.9, 0.2]) + 0.3 * np.sin(3.0 * t)[:, None]
    done, out, _, _ = Track(program, settled=True).follow(q, 1, np.full(len(t), 0.002))
    assert done == len(q)
    assert np.abs(out - program.correct_rows(q).q).max() < 1e-8
    twin = correct(calibration, q[::40], options=CorrectOptions(max_joint_rad=0.1, max_shift_m=0.1))
    actual = calibration.predict(Observations(out[::40])).position
    np.testing.assert_allclose(actual, calibration.predict(Observations(twin.q)).position, atol=2e-8)
