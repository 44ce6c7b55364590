"""Every export format by name. Adding one is its file and one line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from service.errors import ServiceError
from service.exporters.json_file import json_file
from service.versions.schemas import Version

Exporter = Callable[[dict[str, Any], Version, dict[str, Any]], str]


class Exported(NamedTuple):
    """A file: its text, media type and name."""

    text: str
    media_type: str
    name: str


# format -> exporter, media type, file suffix
FORMATS: Mapping[str, tuple[Exporter, str, str]] = {"json": (json_file, "application/json", "json")}


def export(name: str, robot: dict[str, Any], version: Version, calibration: dict[str, Any]) -> Exported:
    """Export a version.

    Raises:
        ServiceError: there is no such format.

    """
    if name not in FORMATS:
        raise ServiceError(
            f"There is no export format {name!r}. There are: {', '.join(FORMATS)}.",
            code="export_unavailable",
            formats=list(FORMATS),
        )
    exporter, media_type, suffix = FORMATS[name]
    return Exported(exporter(robot, version, calibration), media_type, f"{version.robot}-{version.id}.{suffix}")
