"""Active versions from Kilter's database, compiled for the kernel."""

from __future__ import annotations

import logging
from collections.abc import Hashable, Mapping
from functools import cached_property
from pathlib import Path

from kilter_core.errors import CoreError
from kilter_files.ground.later import later
from kilter_service.ground.core import core_correct
from kilter_service.ground.files.migration_lock import is_migrating
from kilter_service.stream.corrector.active import Active, version_number, workspace_counts

with later(__name__):
    from kilter_service.ground import correction_limits, db
    from kilter_service.ground.db import database, revision
    from kilter_service.robots import compensation
    from kilter_service.robots import store as robots
    from kilter_service.versions import store

log = logging.getLogger("kilter.corrector")


class DatabaseSource:
    """Reads what is active; a version is compiled once. Its libraries are imported at the first look, not before."""

    def __init__(self, url: str, temperature_c: float | None = None, data: Path | None = None) -> None:
        self._temperature_c, self._data = temperature_c, data
        self._url = url
        self._migrated = False
        self._compiled: dict[tuple[str, int], Active] = {}

    @cached_property
    def _database(self) -> db.Database:
        return db.Database(self._url)

    @cached_property
    def _lookout(self) -> database.Lookout:
        compensated = robots.query_for_compensated(compensation.CORRECTS)
        return database.Lookout(self._database, store.query_for_active_stamp(), compensated)

    def stamp(self) -> Hashable:
        """What changes with every activation and with what controllers correct; None while the database has no tables."""
        if not self._migrated and self._data is not None and is_migrating(self._data):
            return None
        self._migrated = self._migrated or revision.current(self._database) == revision.HEAD
        return tuple(self._lookout.rows()) if self._migrated else None

    def load(self) -> Mapping[str, Active]:
        """Every robot's active version, but of those whose controllers correct: they would be corrected twice.

        One that cannot be compiled is logged and leaves the others alone.
        """
        if not self._migrated:
            return {}
        with self._database.reading() as session:
            twice = robots.robots_with_compensation(session, compensation.CORRECTS)
            names = store.robots_with_active(session)
            found = [store.active_version(session, name) for name in names if name not in twice]
        for name in twice & set(names):
            log.warning("setpoints of robot %s are not corrected: its controller corrects by itself", name)
        out = {}
        for version in found:
            if version is None:
                continue
            key = (version.robot, version.epoch)
            try:
                active = self._compiled.get(key) or _compile_active(version, self._temperature_c)
            except CoreError as error:
                log.error("version %s of robot %s cannot be streamed: %s", version.id, version.robot, error.message)
                continue
            self._compiled[key] = out[version.robot] = active
        return out

    def close(self) -> None:
        """Close the database, if it was opened."""
        if "_lookout" in self.__dict__:
            self._lookout.close()
        if "_database" in self.__dict__:
            self._database.close()


def _compile_active(version: store.ActiveVersion, temperature_c: float | None) -> Active:
    options = correction_limits.correction_options(version.limits, temperature_c, rules=version.rules)
    return Active(
        robot=version.robot,
        version_id=version.id,
        number=version_number(version.sha256),
        epoch=version.epoch,
        program=core_correct.compile_program(version.calibration, options),
        largest_deg=version.limits.max_joint_deg,
        largest_mm=version.limits.max_position_mm,
        ramp_s=options.ramp_s,
        joint_names=tuple(joint.name for joint in version.calibration.robot.joints),
        joint_kinds=tuple(joint.kind for joint in version.calibration.robot.joints),
        unsure=tuple(doubt.reason for doubt in version.calibration.doubts if doubt.whole),
        workspace=workspace_counts(version.workspace),
    )
