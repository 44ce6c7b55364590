"""What the hunt fits as geometry is what an identification fits: a name must not be confirmed for filling a difference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kilter_core.arm.robot import Robot
from kilter_core.gap import GapOptions
from kilter_core.gap.search.linear.linearized import fit_rms
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.gap.search.sources.tool_source import ToolSource
from kilter_core.identify import identify
from kilter_core.measurement.frames import Errors
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.blind.generator import generate
from tests.blind.generator.cases import Hidden, cases
from tests.blind.to_core import observations_of, robot_of
from tests.core.gap.simulated import campaign, katana
from tests.core.real import WITH_TOOL, real_campaign

NEAR = 0.02
MOST = 600  # rows: enough to weigh, few enough to wait for


def geometry_only(robot: Robot, rows: Observations) -> tuple[float, float, float]:
    """Rms errors (m) of the geometry alone on the hunt's own rows: by the hunt, as the hunt reports it, by identify."""
    ready = prepare_data(Calibration.nominal(robot), rows, GapOptions(effects=("encoder_scale",)))
    problem = ready.problem
    source = problem.settings.source
    assert isinstance(source, ToolSource)
    used = ready.visits.observations.select(problem.settings.used)
    own = source.with_measurement(replace(source.measurement, observations=used))
    size = 3 * (source.measurement.marker_points is None or len(source.measurement.marker_points))
    points = own.residual(problem.values)[:, :size].reshape(-1, 3)
    hunted = float(np.sqrt(np.nanmean(np.sum(points**2, axis=1))))
    found = identify(robot, used)
    errors = Errors.from_calibration(found.calibration, found.fit.problem.measurement).points
    return hunted, fit_rms(problem), float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def agree(robot: Robot, rows: Observations) -> None:
    hunted, reported, identified = geometry_only(robot, rows)
    assert hunted == pytest.approx(identified, rel=NEAR)
    assert reported == pytest.approx(identified, rel=NEAR)


@pytest.mark.parametrize("name", WITH_TOOL)
def test_on_real_campaigns(shared_data: Path, name: str) -> None:
    robot, rows = real_campaign(shared_data, name)
    agree(robot, rows.select(slice(0, None, max(1, len(rows) // MOST))))


@pytest.mark.parametrize("see", ["position", "pose", "markers"])
@pytest.mark.parametrize("revisits", [0, 20])
def test_on_an_arm_with_much_play(see: str, revisits: int) -> None:
    robot = katana()
    agree(robot, campaign(robot, [("backlash", (1,), (2e-3,))], measured=see, poses=90, revisits=revisits))


@pytest.mark.parametrize("arm", ["katana", "elbow", "seven"])
def test_on_the_blind_benchmark(arm: str) -> None:
    case = next(c for c in cases(7, 25, (60,)) if c.hidden)
    bent = (Hidden("axial_compliance", (1,)),)
    made = generate(replace(case, robot=arm, hidden=bent, lam=(4000.0,), undecidable=()))
    agree(robot_of(made), observations_of(made.columns))
