"""Bodies on mimic joints at run time: the corrector equals the stated reference and lands where the model says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_core.effects import make_effect
from kilter_core.model import Calibration, RobotModel
from tests.core.correct.reference import CorrectOptions, correct
from tests.core.palletiser import said
from tests.core.truth import Arm, Step, ur10, with_bodies
from tests.corrector.test_runtime_effects import landing

EFFECTS = ("axial_compliance", "radial_compliance", "base_compliance", "hardening", "backlash_load", "load_error")
FREE = CorrectionOptions(least_softening_nm=0.0, largest_rad=0.2, farthest_m=0.1, largest_m=0.1, iterations=30)


def coupled() -> Arm:
    """A UR10 whose third axis follows the second backwards (a parallelogram), with bodies on all moving axes."""
    arm = ur10()
    at = next(k for k, step in enumerate(arm.steps) if step.joint == 2)
    steps = (*arm.steps[:at], Step("rz", 0.0, 1, -0.6, "follower"), *arm.steps[at:])
    made = with_bodies(replace(arm, steps=steps), np.random.default_rng(0), followers=True)
    return replace(made, gravity=(0.0, 0.0, -9.80665), base=pin.SE3.Identity())


def knowing(*names: str, drive: str | None = None) -> Calibration:
    robot = robot_from_document(said(coupled(), drive))
    model = RobotModel(robot, tuple(make_effect(name) for name in names))
    values, rng = model.values0(), np.random.default_rng(1)
    for k in range(model.n_geometric, len(values)):
        p = model.parameters[k]
        values[k] = np.clip(p.prior_sigma * rng.uniform(0.1, 0.4), p.lower, p.upper)
    return Calibration(model, values)


@pytest.mark.parametrize("drive", [None, "linkage"])
@pytest.mark.parametrize("dynamic", [False, True])
@pytest.mark.parametrize("names", [*((name,) for name in EFFECTS[:-1]), ("axial_compliance", "load_error"), EFFECTS])
def test_the_corrector_equals_the_stated_reference(names: tuple[str, ...], dynamic: bool, drive: str | None) -> None:
    calibration = knowing(*names, drive=drive)
    if "load_error" in names:
        assert "link_mass_7" in calibration.names
    rng = np.random.default_rng(3)
    q = np.array([0.2, -1.2, 1.3, -0.6, 0.9, 0.3]) + rng.uniform(-0.5, 0.5, (20, 6))
    motion = {"qd": rng.normal(size=q.shape), "qdd": 3.0 * rng.normal(size=q.shape)} if dynamic else {}
    program = compile_program(calibration, FREE)
    assert not program.unsupported
    ours = program.correct_rows(q, **motion)
    theirs = correct(calibration, q, **motion, options=CorrectOptions(max_joint_rad=0.2, max_shift_m=0.1))
    good = theirs.converged & (theirs.status == 0)
    assert good.mean() > 0.8
    assert np.median(np.abs(ours.q - theirs.q)[good]) < 1e-9
    np.testing.assert_allclose(ours.error_removed[good], theirs.error_removed[good], rtol=0, atol=1e-11)
    assert np.abs(ours.q - q).max() > 1e-6


@pytest.mark.parametrize("dynamic", [False, True])
def test_a_linkage_loads_the_gear_that_drives_it(dynamic: bool) -> None:
    """Through a linkage the same compliance asks for another correction, and the tool lands where the model says."""
    calibration = knowing("axial_compliance", drive="linkage")
    program = compile_program(calibration, FREE)
    assert landing(calibration, program, dynamic).max() < 1e-6
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.0, 1.0, (20, 6))
    motion = {"qd": rng.normal(size=q.shape), "qdd": rng.normal(size=q.shape)} if dynamic else {}
    other = compile_program(knowing("axial_compliance"), FREE).correct_rows(q, **motion).q
    assert np.abs(program.correct_rows(q, **motion).q - other).max() > 1e-5


def test_the_model_lands_and_the_body_of_the_mimic_joint_counts() -> None:
    calibration = knowing("axial_compliance", "radial_compliance")
    program = compile_program(calibration, FREE)
    for dynamic in (False, True):
        assert landing(calibration, program, dynamic).max() < 1e-6
    robot = replace(calibration.robot, links=calibration.robot.links[:6])
    bare = replace(calibration, model=replace(calibration.model, robot=robot))
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (20, 6))
    assert np.abs(compile_program(bare, FREE).correct_rows(q).q - program.correct_rows(q).q).max() > 1e-5
