"""What the contract says of effects, from the core's: the API process must say what they are without numpy."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Any

from kilter_core.effects import EFFECTS, Effect
from kilter_core.motion.effects import MOTION_EFFECTS, MotionEffect
from tools.contract.options import describe_option

JOINTS = next(f.metadata["text"] for f in fields(Effect) if f.name == "joints")


def effects_data() -> str:
    """Return the data that the contract makes its models of: JSON, an option a line."""
    lines = [*(_lines(kind) for kind in EFFECTS.values()), *(_line_of_torques(effect) for effect in MOTION_EFFECTS)]
    return "[\n" + ",\n".join(lines) + "\n]\n"


def _line_of_torques(effect: MotionEffect) -> str:
    return _json(
        {
            "id": effect.id,
            "model": f"{effect.id.title().replace('_', '')}Effect",
            "summary": f"{effect.label[0].upper()}{effect.label[1:]}, in logs of torques.",
            "at_joints": True,
            "joints": JOINTS,
            "options": [],
        }
    )


def _lines(kind: type[Effect]) -> str:
    said = {
        "id": kind.id,
        "model": f"{kind.__name__}Effect",
        "summary": f"{kind.summary[0].upper()}{kind.summary[1:]}.",
        "at_joints": kind.at_joints,
        "joints": JOINTS if kind.at_joints else "Null: the effect does not act at joints.",
    }
    declared = (describe_option(one, one.name in kind.counted) for one in fields(kind) if one.name != "joints")
    options = ",".join(f"\n  {_json(one)}" for one in declared)
    return f'{_json(said)[:-1]}, "options": [{options}]}}'


def _json(said: dict[str, Any]) -> str:
    return json.dumps(said, ensure_ascii=False)
