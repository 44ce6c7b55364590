"""``kilter.twin``: the step of an exported or patched model of MuJoCo, its readings, and what a model lacks by logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kilter_client.twin.motion_step import read_joints as read_joints
from kilter_client.twin.step import apply as apply
from kilter_files.ground.later import later

with later(__name__):  # it has the core, which a client alone does without
    from kilter_client.twin import servo_gap

__all__ = ["apply", "find_servo_gap", "read_joints"]


def find_servo_gap(
    model: Path | str, logs: Sequence[Path | str], held: Sequence[Path | str] = (), joints: Sequence[str] = ()
) -> tuple[dict[str, Any], str]:
    """Find what the joints of a model of MuJoCo lack by logs of commands and readings.

    ``held`` are logs that only judge; ``joints`` names those of the logs, by default all that have an actuator.

    Returns:
        What was found, as ``kilter gap --model --json`` has it, and the XML of a copy that has it.

    """
    found, copy = servo_gap.find_servo_gap(model, logs, held, servo_gap.LogOptions(joints))
    return found, copy.text
