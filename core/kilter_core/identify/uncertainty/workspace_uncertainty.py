"""Whether poses that know the tool well among themselves know it elsewhere: the uncertainty over the joint limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.identify.fit.least_squares import Fit
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from kilter_core.parameters import mm
from kilter_core.types import Floats, Ints

SAMPLES = 200
TOO_ALIKE = 10.0  # uncertainty over the limits, as a multiple of that in the poses, from which it is said


@dataclass(frozen=True)
class WorkspaceUncertainty:
    """Standard deviation m of a coordinate of the tool point, by the identified geometry: ``here`` in the poses,
    ``elsewhere`` over the joint limits; ``narrow`` is the joint that used least of its range, ``used`` that share.
    """

    here: float
    elsewhere: float
    narrow: str
    used: float

    @property
    def too_alike(self) -> bool:
        """Whether the poses show too little about others."""
        return self.elsewhere > TOO_ALIKE * self.here

    def warning(self) -> dict[str, Any]:
        """The same in words."""
        return {
            "code": "poses_ill_conditioned",
            "here_mm": mm(self.here),
            "elsewhere_mm": mm(self.elsewhere),
            "message": f"The result knows the tool to {mm(self.here):.3g} mm in these poses but only to "
            f"{mm(self.elsewhere):.3g} mm over the joint limits: the poses are too alike ({self.narrow} used "
            f"{self.used:.0%} of its range). Measure poses that spread all joints (`kilter plan --purpose identify`), or "
            "use the result near these poses only.",
        }


def workspace_uncertainty(fit: Fit) -> WorkspaceUncertainty | None:
    """Spread of a fit's poses; None where no instrument saw the tool in a frame of its own, or the chain was held."""
    problem = fit.problem
    if not problem.measurement.observes_base:
        return None
    return estimate_workspace_spread(
        problem.model, problem.free, fit.covariance, fit.values, problem.measurement.observations.q
    )


def estimate_workspace_spread(
    model: RobotModel, free: Ints, covariance: Floats, values: Floats, q: Floats
) -> WorkspaceUncertainty | None:
    """Spread of the poses ``q (N, n)`` of a fit with parameters ``free (F,)`` of the model's ``values (P,)``."""
    n = model.n_geometric
    geometric = np.flatnonzero(free < n)
    if not np.any((free >= 6) & (free < n - 6)):
        return None
    lower, upper = within_a_turn(model.robot, q)
    bare = replace(model, effects=())
    known = covariance[np.ix_(geometric, geometric)]

    def sigma(rows: Floats) -> float:
        _, J = bare.jacobian(Observations(rows), values[:n], free[geometric])
        return float(np.sqrt(max(np.sum((J[:, :3] @ known) * J[:, :3]), 0.0) / (3 * len(rows))))  # rounding

    some = q[np.linspace(0, len(q) - 1, min(len(q), SAMPLES)).astype(np.int64)]
    elsewhere = np.random.default_rng(0).uniform(lower, upper, (SAMPLES, len(lower)))
    used = np.ptp(q, axis=0) / np.maximum(upper - lower, 1e-12)
    k = int(np.argmin(used))
    return WorkspaceUncertainty(sigma(some), sigma(elsewhere), model.robot.joints[k].name, float(used[k]))


def within_a_turn(robot: Robot, q: Floats) -> tuple[Floats, Floats]:
    """Limits within one turn; a prismatic joint without limits keeps the range it was measured over."""
    revolute = np.array([joint.kind == "revolute" for joint in robot.joints])
    lower, upper = robot.limits.T
    lower = np.where(revolute, np.maximum(lower, -np.pi), np.where(np.isfinite(lower), lower, q.min(axis=0)))
    upper = np.where(revolute, np.minimum(upper, np.pi), np.where(np.isfinite(upper), upper, q.max(axis=0)))
    # Limits that lie outside one turn altogether are taken as they are.
    wrong = lower >= upper
    return np.where(wrong, robot.limits[:, 0], lower), np.where(wrong, robot.limits[:, 1], upper)
