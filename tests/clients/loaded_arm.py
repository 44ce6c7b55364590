"""A soft arm with a load on its tool, by Pinocchio alone: what a lab would measure of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# theta_offset_deg, d_mm, a_mm, alpha_deg, mass_kg, com_mm
LINKS = (
    (0.0, 300.0, 0.0, 90.0, 8.5, (0.0, -40.0, 10.0)),
    (0.0, 0.0, 500.0, 0.0, 6.25, (-230.0, 5.0, -12.0)),
    (0.0, 20.0, 400.0, 0.0, 3.125, (-180.0, 0.0, 7.0)),
)
TOOL = (30.0, 0.0, 110.0)  # mm in the flange frame
LIMITS = ((-170.0, 170.0), (-20.0, 160.0), (-140.0, 140.0))
SOFT = np.array([0.0, 4e-5, 9e-5])  # rad per N m about the joints' axes


def described(name: str, **more: Any) -> dict[str, Any]:
    """Robot document of the arm."""
    keys = ("theta_offset_deg", "d_mm", "a_mm", "alpha_deg")
    return {
        "name": name,
        "convention": "dh",
        "joints": [{"name": f"j{k}", "limits_deg": list(limits)} for k, limits in enumerate(LIMITS, 1)],
        "rows": [dict(zip(keys, link[:4], strict=True)) for link in LINKS],
        "links": [{"mass_kg": link[4], "com_mm": list(link[5])} for link in LINKS],
        "tool": dict(zip(("x_mm", "y_mm", "z_mm"), TOOL, strict=True)),
        **more,
    }


def model(payload_kg: float, com_mm: tuple[float, float, float]) -> pinocchio.Model:
    """The arm with the load as a body at ``com_mm`` of the tool frame."""
    made, parent, before = pinocchio.Model(), 0, pinocchio.SE3.Identity()
    for k, (theta, d, a, alpha, mass, com) in enumerate(LINKS):
        parent = made.addJoint(parent, pinocchio.JointModelRZ(), before, f"j{k + 1}")
        about = pinocchio.utils.rotate("z", math.radians(theta))
        turn = about @ pinocchio.utils.rotate("x", math.radians(alpha))
        before = pinocchio.SE3(turn, (about @ np.array([a, 0, 0]) + np.array([0, 0, d])) / 1e3)
        _add(made, parent, before, mass, com)
    tool = before * pinocchio.SE3(np.eye(3), np.array(TOOL) / 1e3)
    _add(made, parent, tool, payload_kg, com_mm)
    made.addFrame(pinocchio.Frame("tool", parent, tool, pinocchio.FrameType.OP_FRAME))
    made.gravity.linear = np.array([0, 0, -9.80665])
    return made


def _add(made: pinocchio.Model, joint: int, at: pinocchio.SE3, mass: float, com_mm: tuple[float, float, float]) -> None:
    made.appendBodyToJoint(joint, pinocchio.Inertia(mass, np.array(com_mm) / 1e3, np.zeros((3, 3))), at)


def tools(q: Floats, payload_kg: float, com_mm: tuple[float, float, float], soft: Floats = SOFT) -> Floats:
    """Tool points (N, 3) mm: each joint gives way by what gravity does to it at the joint readings."""
    arm = model(payload_kg, com_mm)
    data, frame, out = arm.createData(), arm.getFrameId("tool"), []
    for row in q:
        load = -pinocchio.computeGeneralizedGravity(arm, data, row)
        pinocchio.framesForwardKinematics(arm, data, row + soft * load)
        out.append(data.oMf[frame].translation * 1e3)
    return np.array(out)


def poses(count: int, seed: int) -> Floats:
    """Joint readings (count, 3) rad within the limits."""
    low, high = np.radians(LIMITS).T * 0.8
    return np.random.default_rng(seed).uniform(low, high, (count, 3))


def table(q: Floats, **columns: Floats) -> str:
    """Contract columns as CSV."""
    names = [*(f"q{k}_deg" for k in (1, 2, 3)), *columns]
    cells = np.column_stack([np.degrees(q), *columns.values()])
    return "\n".join([",".join(names), *(",".join(f"{cell:.9f}" for cell in row) for row in cells)]) + "\n"


def measured(q: Floats, load: float, com_mm: tuple[float, float, float], **more: Floats) -> str:
    """A campaign with 2 um of noise."""
    xyz = tools(q, load, com_mm) + np.random.default_rng(0).normal(0.0, 2e-3, (len(q), 3))
    return table(q, **dict(zip(("x_mm", "y_mm", "z_mm"), xyz.T, strict=True)), **more)
