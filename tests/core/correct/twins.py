"""Arms of several makes with errors that a calibration knows exactly; where they go is Pinocchio's answer."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.model import Calibration, RobotModel
from tests.core.campaigns import table_errors
from tests.core.truth import Arm, Step, dh_steps, ur10

Floats = NDArray[np.float64]
H = math.pi / 2.0
TOOL = pin.SE3(np.eye(3), np.array([0.05, 0.02, 0.12]))
SCARA = (
    Step("tz", 0.4, name="z"), Step("rz", 0.0, 0, name="one"), Step("tx", 0.35, name="a_1"), Step("ry", name="b_1"),
    Step("rz", 0.0, 1, name="two"), Step("tx", 0.3, name="a_2"), Step("rx", name="c_2"), Step("ry", name="b_2"),
    Step("tz", 0.0, 2, name="lift"), Step("rz", 0.0, 3, name="four"), Step("tz", -0.1, name="d_4"),
)  # fmt: skip
ARMS = {
    "ur": ur10(tool=TOOL, limits=(-2.8, 2.8)),
    "six": Arm(
        dh_steps(
            [(0.45, 0.15, -H), (0.0, 0.6, 0.0), (0.0, 0.12, -H), (0.62, 0.0, H), (0.0, 0.0, -H), (0.1, 0.0, 0.0)]
        ),
        6, tool=TOOL, limits=(-2.2, 2.2),
    ),
    "seven": Arm(
        dh_steps(
            [(0.36, 0.0, -H), (0.0, 0.0, H), (0.42, 0.0, H), (0.0, 0.0, -H), (0.4, 0.0, -H), (0.0, 0.0, H), (0.126, 0.0, 0.0)]
        ),
        7, tool=TOOL, limits=(-1.8, 1.8),
    ),
    "scara": Arm(SCARA, 4, tool=TOOL, limits=(-1.6, 1.6)),
    "five": Arm(
        dh_steps([(0.3, 0.05, -H), (0.0, 0.4, 0.0), (0.0, 0.35, 0.0), (0.0, 0.0, H), (0.1, 0.0, 0.0)]),
        5, tool=TOOL, limits=(-1.8, 1.8),
    ),
    "elbow": Arm(dh_steps([(0.3, 0.0, H), (0.0, 0.5, 0.0), (0.0, 0.45, 0.0)]), 3, tool=TOOL, limits=(-1.8, 1.8)),
}  # fmt: skip


@dataclass(frozen=True)
class Twin:
    """An arm as it should be, as it is, and what a calibration knows of it."""

    ideal: Arm
    real: Arm
    calibration: Calibration

    def left(self, corrected: Floats, q: Floats) -> tuple[Floats, Floats]:
        """What is left of the tool's error (N, 3) m in the base frame, and its angle (N,)."""
        (p, R), (wanted, W) = self.real.poses(corrected), self.ideal.poses(q)
        turned = np.array([np.linalg.norm(pin.log3(a.T @ b)) for a, b in zip(R, W, strict=True)])
        return p - wanted, turned

    def poses(self, count: int, seed: int = 1) -> Floats:
        """Joints (N, n) in 90 % of the range."""
        lower, upper = self.ideal.limits
        q = np.random.default_rng(seed).uniform(0.9 * lower, 0.9 * upper, (count, self.ideal.n))
        return np.asarray(q)


def twin(name: str, seed: int = 0, errors: dict[str, float] | None = None) -> Twin:
    """An arm with errors of 0.2 mm and 0.4 mrad in every step of its table, or with those that are given."""
    ideal = ARMS[name]
    if errors is None:
        errors = table_errors(ideal, np.random.default_rng(seed), 2e-4, 4e-4)
    model = RobotModel(robot_from_document(ideal.document()))
    known = Calibration(model, model.values0() + [errors.get(key, 0.0) for key in model.names])
    return Twin(ideal, ideal.moved(errors), known)
