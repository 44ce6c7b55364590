"""What would change by activating a version, and what its files leave out."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

from kilter_core.errors import CoreError
from kilter_service.contract.versions import Version, VersionPreview
from kilter_service.ground.db import Database
from kilter_service.page.shared.accuracy import Accuracy, accuracy_from_metrics
from kilter_service.robots import service as robots
from kilter_service.robots.compensation import sentence
from kilter_service.robots.exporters.registry import FORMATS
from kilter_service.versions import activation, service
from kilter_service.versions.if_match import tag_of_robot
from kilter_service.versions.predictions.preview import preview

log = logging.getLogger("kilter.page")

NAMES = {
    "json": "Kilter's own document",
    "urdf": "URDF",
    "mjcf": "calibrated twin for MuJoCo",
    "usd": "calibrated twin for simulators of USD",
    "dh-csv": "table of DH parameters",
    "mdh-csv": "table of modified DH parameters",
    "ur-yaml": "calibration of the Universal Robots driver",
    "matlab": "function for MATLAB",
    "corrector": "program for the corrector in C",
    "c": "corrector and program as one C file",
}
REFUSED = {
    "CORRECTION_TOO_LARGE": "the correction is larger than the version's limits",
    "JOINT_LIMIT": "the corrected joint is outside its limits",
    "RATE_LIMIT": "the correction changes too fast",
    "NOT_FINITE": "no correction is found there",
}


@dataclass(frozen=True)
class Ahead:
    """A version that may be activated, beside the one that is active; ``etag`` is the state that this was looked at in.

    ``preview`` None could not be computed; ``failed`` says so. ``controller`` is what follows from what the controller
    does by itself, empty where nothing does.
    """

    version: Version
    accuracy: Accuracy | None
    active: Version | None
    active_accuracy: Accuracy | None
    preview: VersionPreview | None
    failed: str
    where: Sequence[tuple[str, str]]
    refused: Sequence[tuple[int, str]]
    etag: str
    controller: str

    @property
    def larger(self) -> float:
        """The larger of the two errors, mm, whose unit both have."""
        return max((one.mean for one in (self.accuracy, self.active_accuracy) if one is not None), default=0.0)


@dataclass(frozen=True)
class Download:
    """A file that a version can be written as: what it leaves out, or why it cannot be."""

    format: str
    name: str
    notes: Sequence[str]
    refusal: str = ""


def correction_ahead(database: Database, version_id: str, temperature_c: float | None) -> Ahead:
    """Look at what a version would do. A preview that fails is a sentence: it decides nothing, and keeps nobody."""
    found = service.get(database, version_id)
    etag = tag_of_robot(database, found.robot)  # before the rest: what changes meanwhile is refused later
    robot = robots.get(database, found.robot)
    active = None if robot.active_version is None else service.get(database, robot.active_version)
    preview, failed = _try_preview(database, version_id, temperature_c)
    units = ["mm" if joint.kind == "prismatic" else "°" for joint in robot.joints]
    largest_at, refused = ([], {}) if preview is None else (preview.largest_at or [], preview.refused)
    angles = zip(robot.joints, largest_at, units, strict=False)
    return Ahead(
        found,
        accuracy_from_metrics(found.metrics),
        active,
        None if active is None else accuracy_from_metrics(active.metrics),
        preview,
        failed,
        [
            (joint.name, f"{value:.1f} {unit}" if unit == "mm" else f"{value:.1f}{unit}")
            for joint, value, unit in angles
        ],
        [(count, REFUSED.get(why, why.lower().replace("_", " "))) for why, count in refused.items()],
        etag,
        sentence(found.robot, robot.controller_compensation),
    )


def _try_preview(database: Database, version_id: str, temperature_c: float | None) -> tuple[VersionPreview | None, str]:
    """The preview, or why there is none."""
    try:
        return preview(database, version_id, temperature_c), ""
    except CoreError as error:
        return None, f"What it would correct could not be computed: {error.message}"
    except Exception:
        log.exception("the preview of version %s failed", version_id)
        return None, (
            "What it would correct could not be computed; the server's log has the cause. Going on does not need it: only "
            "look at a corrected path before the arm moves by it."
        )


def back(database: Database, robot: str, temperature_c: float | None) -> Ahead:
    """Look at what a roll-back would do.

    Raises:
        ServiceError: there is no version to go back to.

    """
    return correction_ahead(database, activation.rollback_target(database, robot), temperature_c)


def exports(database: Database, version_id: str) -> list[Download]:
    """Return each format with what its file leaves out."""
    return [_download(database, version_id, name) for name in FORMATS]


def _download(database: Database, version_id: str, name: str) -> Download:
    words = NAMES.get(name, name)
    try:
        return Download(name, words, service.exported_notes(database, version_id, name))
    except CoreError as error:  # a format that cannot hold this arm
        return Download(name, words, (), error.message)
