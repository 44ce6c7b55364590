"""A version as one JSON document: the robot as posted, the report in mm and degrees; chain and calibration in SI."""

from __future__ import annotations

import json

from kilter_service.robots.exporters.exportable import Exportable, Written


def json_file(version: Exportable) -> Written:
    """Write the document; floating-point numbers keep all their digits."""
    document = {
        "format": "kilter-version/1",
        "robot": version.robot,
        "robot_chain_si": version.arm.chain,
        "version": version.version.model_dump(mode="json"),
        "calibration_si": version.document,
    }
    return Written(json.dumps(document, indent=1))
