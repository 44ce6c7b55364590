"""The file that describes cameras and boards, as `kilter measure see` writes it beside its views."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from kilter_client.errors import UsageError

CAMERA = (
    "name",
    "mount",
    "width_px",
    "height_px",
    "fx_px",
    "fy_px",
    "cx_px",
    "cy_px",
    "distortion_model",
    "distortion",
    "intrinsics",
    "sigmas_px",
)
BOARD = ("name", "mount", "corners_mm", "scale_sigma_percent")


def rig_conditions(file: Path) -> dict[str, Any]:
    """Return the conditions ``cameras`` and ``boards`` of a campaign.

    Raises:
        UsageError: not such a file.

    """
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        cameras = [_known_fields(one, CAMERA) for one in document["cameras"]]
        boards = [_known_fields(one, BOARD) for one in document["boards"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(
            f"--cameras {file}: does not describe cameras and boards ({error}): give the JSON that `kilter measure see` writes."
        ) from error
    if not cameras or not boards:
        what = "boards" if cameras else "cameras"
        raise UsageError(f"--cameras {file}: names no {what}: state the intrinsics when you run `kilter measure see`.")
    return {"cameras": cameras, "boards": boards}


def _known_fields(one: dict[str, Any], known: tuple[str, ...]) -> dict[str, Any]:
    return {name: one[name] for name in known if one.get(name) is not None}
