"""A palletiser whose forearm is kept in place by a parallelogram that joint 2 drives. Nothing here imports the core."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.core.truth import Arm, Body, Step

FOLLOWER = "follower"


def palletiser(ratio: float = -1.0) -> Arm:
    """The elbow rotates by joint 3 and, by ``ratio``, with joint 2: the forearm is read against the horizon."""
    steps = (
        Step("rz", 0.0, 0, 1.0, "theta_1"), Step("tz", 0.8, name="d_1"), Step("tx", 0.3, name="a_1"),
        Step("rx", -np.pi / 2, name="alpha_1"), Step("rz", 0.0, 1, 1.0, "theta_2"), Step("tx", 1.1, name="a_2"),
        Step("ry", 0.0, name="beta_2"), Step("rz", 0.0, 1, ratio, FOLLOWER), Step("rz", 0.0, 2, 1.0, "theta_3"),
        Step("tx", 1.3, name="a_3"), Step("rx", np.pi / 2, name="alpha_3"), Step("rz", 0.0, 3, 1.0, "theta_4"),
        Step("tz", 0.2, name="d_4"), Step("tx", 0.15, name="a_4"),
    )  # fmt: skip
    bodies = (
        Body(0, 180.0, np.array([0.0, 0.0, 0.4]), np.diag([3.0, 3.0, 2.0])),
        Body(1, 60.0, np.array([0.5, 0.0, 0.05]), np.diag([0.5, 4.0, 4.0])),
        Body(2, 55.0, np.array([0.45, 0.02, 0.0]), np.diag([0.4, 5.0, 5.0])),
        Body(3, 20.0, np.array([0.02, 0.0, 0.1]), np.diag([0.2, 0.2, 0.1])),
    )
    return Arm(steps=steps, n=4, bodies=bodies, limits=(-1.4, 1.4))


def said(arm: Arm, drive: str | None) -> dict[str, Any]:
    """The robot document of the arm, its follower with this drive."""
    document = arm.document()
    seen: set[str] = set()
    for element in document["elements"]:
        joint = element.get("joint")
        if joint in seen and drive is not None:
            element["drive"] = drive
        if joint is not None:
            seen.add(joint)
    return document
