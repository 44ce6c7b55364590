"""Planned poses are measured by a simulated arm that shares no code with Kilter: what they promised must come true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from core.gap import GapOptions, plan_separation
from core.gap.next_poses import Proposal, _Question
from core.gap.plan import _found
from core.gap.prepare import Workshop
from core.model import Calibration
from core.observations import Observations
from tests.blind.generator import Options, tracker
from tests.blind.generator.arm import Arm, Deflection, built
from tests.blind.generator.arms import ARMS
from tests.blind.generator.campaign import Campaign, Truth, _columns
from tests.blind.generator.cases import Case
from tests.blind.generator.physics import LIBRARY
from tests.blind.generator.visits import Visits, plan
from tests.blind.to_core import observations_of, robot_of

COMPLIANCE = 2e-6  # rad / N m
OPTIONS = Options(payload="one", revisited=0.3)
STATED = GapOptions(noise_mm=0.015)


def measured(arm: Arm, visits: Visits, rng: np.random.Generator) -> Observations:
    d = Deflection.none(len(visits), arm.n)
    LIBRARY["axial_compliance"](arm, visits, (1,)).act(np.array([COMPLIANCE]), d)
    readings, _ = tracker.read(arm.positions(visits.q, d), OPTIONS, rng)
    return observations_of(_columns(visits, readings)[0])


def information(start: Calibration, rows: Observations, amount: float) -> float:
    """What rows say of the compliance of joint 2 when the bending of link 2 is free as well."""
    options = replace(STATED, effects=("axial_compliance", "link_bending"))
    prepared = Workshop(start, rows, options, lambda f, s: None).run()
    target = _found(prepared.library, ("axial_compliance", (1,)))
    rival = _found(prepared.library, ("link_bending", (1,)))
    question = _Question(prepared.world, target, rival.columns, (), np.array([amount]))
    return float(1.0 / np.linalg.inv(question.information())[0, 0])


@pytest.mark.parametrize("kind", ["new", "repeat"])
def test_the_information_promised_is_the_information_got(kind: str) -> None:
    rng = np.random.default_rng(7)
    drawn = ARMS["elbow"]()
    arm = built(drawn, rng)
    visits = plan(arm, 30, OPTIONS, rng)
    rows = measured(arm, visits, rng)
    case = Case("promise", "elbow", (), (), 60, OPTIONS, "named", 7)
    robot = robot_of(Campaign(case, drawn.document(drawn.mass), {}, Truth((), "", (), False, 0.0, ())))
    start = Calibration.nominal(robot)
    made = plan_separation(robot, rows, ("axial_compliance", (1,)), ("link_bending", (1,)), count=16, options=STATED)
    proposal = next(p for p in made.proposals if p.kind == kind)
    both = Observations.concatenate([rows, later(arm, proposal, rows, rng)])
    before, after = information(start, rows, 1e-6), information(start, both, 1e-6)
    promised = proposal.after[-1] / proposal.before
    assert promised > 1.2
    assert promised - 1.0 == pytest.approx(after / before - 1.0, rel=0.25)


def later(arm: Arm, proposal: Proposal, rows: Observations, rng: np.random.Generator) -> Observations:
    p = proposal.rows
    n = len(p)
    assert rows.t is not None
    assert rows.pose_id is not None
    assert p.payload_kg is not None
    side = rng.choice([-1.0, 1.0], p.q.shape)
    visits = Visits(
        p.q, side, p.payload_kg, np.full(n, 21.0), rows.t.max() + 30.0 * np.arange(1, n + 1),
        np.zeros(n, dtype=np.int64), np.arange(n), arm.load(p.q, p.payload_kg),
    )  # fmt: skip
    new = measured(arm, visits, rng)
    assert new.pose_id is not None
    return replace(new, pose_id=new.pose_id + rows.pose_id.max() + 1)
