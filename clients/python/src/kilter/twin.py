"""``kilter.twin``: the step that an exported or patched model of MuJoCo takes beside its elements, and its readings."""

from __future__ import annotations

from kilter_client.twin.motion_step import read_joints as read_joints
from kilter_client.twin.step import apply as apply

__all__ = ["apply", "read_joints"]
