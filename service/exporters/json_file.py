"""A version as one JSON document: the robot as posted, the report in mm and degrees, and core's calibration in SI."""

from __future__ import annotations

import json
from typing import Any

from service.versions.schemas import Version


def json_file(robot: dict[str, Any], version: Version, calibration: dict[str, Any]) -> str:
    """Write the document; floating-point numbers keep all their digits."""
    document = {
        "format": "kilter-version/1",
        "robot": robot,
        "version": version.model_dump(mode="json"),
        "calibration_si": calibration,
    }
    return json.dumps(document, indent=1)
