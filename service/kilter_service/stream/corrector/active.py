"""The version in use of a robot, as the processes of the corrector hand it to each other and announce it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

from kilter_service.ground.core import core_correct
from kilter_service.ground.wire import to_deg, to_mm

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
