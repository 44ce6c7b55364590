"""The presets: robot documents kept as data files beside this module."""

from __future__ import annotations

import json
from importlib.resources import files
from typing import Any

from kilter_core.errors import RobotError


def preset_names() -> tuple[str, ...]:
    """Names of the presets, sorted."""
    return tuple(sorted(f.name.removesuffix(".json") for f in files(__package__).iterdir() if f.name.endswith(".json")))


def preset_document(name: str) -> dict[str, Any]:
    """Document of a preset, in the format of ``robot.json``.

    Raises:
        RobotError: there is no such preset; the existing ones are listed.

    """
    if name not in preset_names():
        raise RobotError(
            f"There is no preset {name!r}. There are: {', '.join(preset_names())}.", field="preset", value=name
        )
    document: dict[str, Any] = json.loads((files(__package__) / f"{name}.json").read_text(encoding="utf-8"))
    return document
