"""Every export format by name. Adding one is its file and one line here."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import NamedTuple

from kilter_service.ground.errors import ServiceError
from kilter_service.robots.exporters.exportable import Exportable, Written


class Exported(NamedTuple):
    """A file: its text or bytes, media type and name, and what it leaves out."""

    text: str | bytes
    media_type: str
    name: str
    notes: tuple[str, ...]


class Format(NamedTuple):
    """Where the exporter is (its module imports numpy and scipy: not at the start of the API process), and its files."""

    exporter: str
    media_type: str
    suffix: str


RANGES = "ranges"  # which asks for versions of other robots too
FORMATS: Mapping[str, Format] = {
    "json": Format("json_file.json_file", "application/json", "json"),
    "urdf": Format("urdf_file.urdf_file", "application/xml", "urdf"),
    "mjcf": Format("mjcf_file.mjcf", "application/xml", "mjcf.xml"),
    "usd": Format("usd_file.usd", "model/vnd.usda", "usda"),
    "dh-csv": Format("table_csv.dh_csv", "text/csv", "dh.csv"),
    "mdh-csv": Format("table_csv.mdh_csv", "text/csv", "mdh.csv"),
    "ur-yaml": Format("ur_yaml.ur_yaml", "application/yaml", "yaml"),
    "matlab": Format("matlab.matlab", "text/plain", "m"),
    RANGES: Format("ranges.ranges", "application/json", "ranges.json"),
    "corrector": Format("corrector.corrector", "application/octet-stream", "klt"),
    "c": Format("corrector.c_source", "text/x-c", "c"),
    "torque-c": Format("corrector.torque_source", "text/x-c", "torque.c"),
}


def export(name: str, version: Exportable) -> Exported:
    """Export a version.

    Raises:
        ServiceError: there is no such format.
        RobotError: the format cannot describe the robot.

    """
    written = _written(name, version)
    text = written.text() if callable(written.text) else written.text
    form = FORMATS[name]
    return Exported(text, form.media_type, _file_name(version, form.suffix), written.notes)


def export_notes(name: str, version: Exportable) -> tuple[str, ...]:
    """Return what a file leaves out of a version.

    Raises:
        ServiceError: there is no such format.
        RobotError: the format cannot describe the robot.

    """
    return _written(name, version).notes


def _written(name: str, version: Exportable) -> Written:
    if name not in FORMATS:
        raise ServiceError(
            f"There is no export format {name!r}. There are: {', '.join(FORMATS)}.",
            code="export_unavailable",
            formats=list(FORMATS),
        )
    module, _, function = FORMATS[name].exporter.rpartition(".")
    exporter: Callable[[Exportable], Written] = getattr(
        import_module(f"kilter_service.robots.exporters.{module}"), function
    )
    return exporter(version)


def _file_name(version: Exportable, suffix: str) -> str:
    plain = f"{version.version.robot}-{version.version.id}"
    return f"{program_name(plain)}.m" if suffix == "m" else f"{plain}.{suffix}"


def program_name(text: str) -> str:
    """Return a name that MATLAB takes for a function."""
    name = re.sub(r"\W", "_", text, flags=re.ASCII)
    return name if name[0].isalpha() else f"robot_{name}"
