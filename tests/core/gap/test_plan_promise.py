"""Planned poses are measured by a simulated arm that shares no code with Kilter: what they promised must come true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, plan_separation
from kilter_core.gap.report.next_poses import _Question
from kilter_core.gap.report.separation import _find_candidate
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.blind.generator import Options, tracker
from tests.blind.generator.arm import Arm, Deflection, built
from tests.blind.generator.arms import ARMS

COMPLIANCE = 2e-6  # rad / N m
POSES, REPEATS = 30, 3
READINGS = Options(repeats=REPEATS)
STATED = GapOptions(noise_mm=0.015)


def measured(arm: Arm, q: np.ndarray, payload: np.ndarray, first: int, rng: np.random.Generator) -> Observations:
    """Three readings at each pose of an arm whose second joint gives way to its load."""
    d = Deflection.none(len(q), arm.n)
    d.dq[:, 1] = COMPLIANCE * arm.load(q, payload).moment[:, 1, 2]
    readings, _ = tracker.read(arm.positions(q, d), READINGS, rng)
    count = len(q) * REPEATS
    return Observations(
        q=np.repeat(q, REPEATS, axis=0), position=readings.reshape(-1, 3), payload_kg=np.repeat(payload, REPEATS),
        t=30.0 * first + 10.0 * np.arange(count), pose_id=np.repeat(first + np.arange(len(q)), REPEATS),
        temperature_c=np.full(count, 21.0), direction=np.ones((count, arm.n)),
    )  # fmt: skip


def information(start: Calibration, rows: Observations, amount: float) -> float:
    """What rows say of the compliance of joint 2 when the bending of link 2 is free as well."""
    options = replace(STATED, effects=("axial_compliance", "link_bending"))
    prepared = prepare_data(start, rows, options)
    target = _find_candidate(prepared.library, ("axial_compliance", (1,)))
    rival = _find_candidate(prepared.library, ("link_bending", (1,)))
    question = _Question(prepared.problem, target, rival.columns, (), np.array([amount]))
    return float(1.0 / np.linalg.inv(question.information())[0, 0])


@pytest.mark.parametrize("kind", ["new", "repeat"])
def test_the_information_promised_is_the_information_got(kind: str) -> None:
    rng = np.random.default_rng(7)
    drawn = ARMS["elbow"]()
    arm = built(drawn, rng)
    q = rng.uniform(*np.array(drawn.limits).T, (POSES, arm.n))
    rows = measured(arm, q, np.full(POSES, 5.0), 0, rng)
    robot = robot_from_document(drawn.document(drawn.mass))
    start = Calibration.nominal(robot)
    made = plan_separation(robot, rows, ("axial_compliance", (1,)), ("link_bending", (1,)), count=16, options=STATED)
    proposal = next(p for p in made.proposals if p.kind == kind)
    assert proposal.rows.payload_kg is not None
    new = measured(arm, proposal.rows.q, proposal.rows.payload_kg, POSES, rng)
    both = Observations.concatenate([rows, new])
    before, after = information(start, rows, 1e-6), information(start, both, 1e-6)
    promised = proposal.after[-1] / proposal.before
    assert promised > 1.2
    assert promised - 1.0 == pytest.approx(after / before - 1.0, rel=0.25)
