"""The version in use of a robot, as the processes of the corrector hand it to each other and announce it.

Active versions from Kilter's database, compiled for the kernel.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from kilter_core.errors import CoreError
from kilter_files.ground.later import later
from kilter_service.ground.backup_folder import is_migrating
from kilter_service.ground.core import core_correct
from kilter_service.ground.wire import to_deg, to_mm

with later(__name__):
    from kilter_service.ground import correction_limits, db
    from kilter_service.ground.db import database, revision
    from kilter_service.robots import compensation
    from kilter_service.robots import store as robots
    from kilter_service.versions import store

if TYPE_CHECKING:
    from kilter_core.correct import CorrectionProgram
    from kilter_core.types import Floats


@dataclass(frozen=True)
class Active:
    """A robot's active version, compiled. ``epoch`` grows with every activation; every message carries ``number``."""

    robot: str
    version_id: str
    number: int
    epoch: int
    program: CorrectionProgram
    largest_deg: float = 1.0
    largest_mm: float = 5.0
    ramp_s: float = 1.0
    joint_names: tuple[str, ...] = ()
    joint_kinds: tuple[str, ...] = ()
    unsure: tuple[str, ...] = ()  # why the version is unsure everywhere
    workspace: dict[str, int] | None = None  # poses all over the joint limits, and how many the version corrects how

    @cached_property
    def levers_mm(self) -> list[float | None]:
        """How far each joint moves the tool at most, mm per rad or per mm; None where nothing bounds it."""
        found = zip(core_correct.levers(self.program).tolist(), self.joint_kinds, strict=True)
        per_unit = (m if kind == "prismatic" else to_mm(m) for m, kind in found)
        return [round(size, 3) if size < math.inf else None for size in per_unit]

    @cached_property
    def correction_settings(self) -> dict[str, Any]:
        """Task of the correction, what it does at its limits, how fast it changes at most; null for kinds without a joint."""
        found = core_correct.read_program_limits(self.program)
        kinds = self.joint_kinds or ("revolute",) * self.program.n_joints

        def most(values: Floats, kind: str, shown: Callable[[float], float]) -> float | None:
            of_kind = [value for value, its in zip(values.tolist(), kinds, strict=True) if its == kind]
            return round(shown(max(of_kind)), 9) if of_kind else None

        return {
            "task": found.task,
            "at_limit": found.at_limit,
            "held_joints": [joint + 1 for joint in found.held_joints],
            "rate_deg_s": most(found.rate, "revolute", to_deg),
            "rate_mm_s": most(found.rate, "prismatic", to_mm),
            "acceleration_deg_s2": most(found.acceleration, "revolute", to_deg),
            "acceleration_mm_s2": most(found.acceleration, "prismatic", to_mm),
        }

    def announcement(self) -> bytes:
        """JSON that goes out on the ``active`` key."""
        document = {
            "robot": self.robot,
            "version_id": self.version_id,
            "version": f"{self.number:016x}",
            "epoch": self.epoch,
            "joints": self.program.n_joints,
            "joint_kinds": list(self.joint_kinds),
            "held_rows": list(self.program.held_rows),
            "effects": list(self.program.supported),
            "unsupported_effects": list(self.program.unsupported),
            "largest_deg": self.largest_deg,
            "largest_mm": self.largest_mm,
            "unsure": list(self.unsure),
            **self.correction_settings,
            "ramp_s": self.ramp_s,
            "levers_mm": self.levers_mm if self.joint_kinds else None,
        }
        return json.dumps(document).encode()


def workspace_counts(report: Mapping[str, Any] | None) -> dict[str, int] | None:
    """What the report of a version says of poses all over the joint limits, as numbers of poses; None where it says nothing."""
    if not report or not report.get("poses"):
        return None
    counts = {name: int(report.get(name) or 0) for name in ("poses", "ok", "damped", "limited")}
    refused = report.get("refused") or {}
    return {**counts, "refused": sum(refused.values()) if isinstance(refused, Mapping) else int(refused)}


def nothing_active(robot: str) -> bytes:
    """Announcement of a robot that has no version in use any more."""
    return json.dumps({"robot": robot, "version_id": None, "version": None, "epoch": None}).encode()


def version_number(sha256: str) -> int:
    """Version id of the messages: the first 8 bytes of the version's SHA-256."""
    return int(sha256[:16], 16)


class VersionSource(Protocol):
    """Where the versions in use come from."""

    def stamp(self) -> Hashable:
        """Something cheap that changes whenever :meth:`load` would give another answer."""
        ...

    def load(self) -> Mapping[str, Active]:
        """Versions in use by robot."""
        ...

    def close(self) -> None:
        """Close whatever is open."""
        ...


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
