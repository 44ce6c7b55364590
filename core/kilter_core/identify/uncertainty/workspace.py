"""How well a fit knows where the tool is over the whole workspace: the uncertainty at poses within the joint limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.frames import increment
from kilter_core.identify.uncertainty.predictive import Predictive, acting
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.transforms import inverse
from kilter_core.types import Floats

POSES = 1000
# What a pose is measured as says nothing of the pose; what it is driven under does.
MEASURED: dict[str, Any] = dict.fromkeys(
    (
        "position",
        "rotation",
        "markers",
        "tip",
        "link_q",
        "sigma",
        "socket",
        "plane",
        "bar",
        "bar_length",
        "setup",
        "tilt",
    )
)


@dataclass(frozen=True)
class Workspace:
    """Tool points (N, 3) m of random poses in the robot's base frame, and the widest half interval (N,) m of each.

    ``measured (K, 3)`` m is where the tool was in the rows that were fitted.
    """

    points: Floats
    u95: Floats
    measured: Floats

    @staticmethod
    def from_calibration(calibration: Calibration, known: Predictive, rows: Observations, seed: int = 0) -> Workspace:
        """Half widths of the 95 % interval of a coordinate of the tool point, noise of the instrument not among them.

        Poses are drawn evenly within the limits of the joints, of a joint without limits where ``rows`` had it; loads,
        directions and temperatures are those of rows drawn by chance.
        """
        rng = np.random.default_rng(seed)
        low, high = bounds(calibration, rows)
        drawn = rows.select(rng.integers(0, len(rows), POSES))
        poses = replace(drawn, q=rng.uniform(low, high, (POSES, len(low))), **MEASURED)
        u95 = known.of_the_tool(calibration, poses).max(axis=1)
        return Workspace(_tool(calibration, poses), u95, _tool(calibration, replace(rows, **MEASURED)))

    def worst_last(self) -> Workspace:
        """The same poses, those that are known least last: plotted one over the other these stay visible."""
        order = np.argsort(self.u95, kind="stable")
        return Workspace(self.points[order], self.u95[order], self.measured)


def bounds(calibration: Calibration, rows: Observations) -> tuple[Floats, Floats]:
    """Lowest and highest joint readings (n,): the limits, and what was driven where there is none."""
    low, high = calibration.robot.limits.T
    return (
        np.where(np.isfinite(low), low, rows.q.min(axis=0)),
        np.where(np.isfinite(high), high, rows.q.max(axis=0)),
    )


def _tool(calibration: Calibration, rows: Observations) -> Floats:
    """Tool points (N, 3) m in the robot's base frame."""
    base = inverse(calibration.model.T_base @ increment(calibration.values[:6]))
    return np.asarray(acting(calibration, rows).predict(rows).position @ base[:3, :3].T + base[:3, 3])
