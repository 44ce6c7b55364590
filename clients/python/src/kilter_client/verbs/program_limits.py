"""Which joints of a target are beyond their limits, or held at them by a correction, in words."""

from __future__ import annotations

from collections.abc import Sequence

from kilter_client.requests.steps import Document

AT_LIMIT_DEG = 1e-6  # what is held stands at the limit, but for the last digits


def at_limits(robot: Document, taught_deg: Sequence[float], new_deg: Sequence[float]) -> str:
    """Name each joint with its angle and the limit, by the robot's joints; empty: none is at one.

    ``taught_deg`` are the joints of the target, ``new_deg`` the corrected ones, NaN where it was refused.
    """
    said = []
    for k, (joint, taught, new) in enumerate(zip(robot["joints"], taught_deg, new_deg, strict=True), 1):
        name = joint.get("name") or f"joint {k}"
        lower, upper = joint.get("limits_deg") or (None, None)
        for limit, side in ((lower, -1.0), (upper, 1.0)):
            if limit is None:
                continue
            if side * (taught - limit) > 0.0:
                said.append(f"{name} at {taught:.6g} deg is beyond its limit of {limit:g} deg")
            elif side * (new - limit) > -AT_LIMIT_DEG:
                said.append(f"{name} at {taught:.6g} deg is held at its limit of {limit:g} deg")
    return ", ".join(said)
