"""What an exporter gets and gives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from service.contract.versions import Version
from service.robots.documents import core_document

if TYPE_CHECKING:
    from core.model import Calibration


@dataclass(frozen=True)
class Exportable:
    """A version: the robot as posted, the version as the API shows it, and core's calibration document (SI)."""

    robot: dict[str, Any]
    version: Version
    document: dict[str, Any]

    @cached_property
    def calibration(self) -> Calibration:
        """Core's calibration."""
        from core.model import Calibration  # loads compiled kernels: not at the start of the API process
        from core.robots import robot_from_document

        return Calibration.from_document(robot_from_document(core_document(self.robot).document), self.document)


class Written(NamedTuple):
    """A file's text, and what it does not say of the version, in words."""

    text: str
    notes: tuple[str, ...] = ()
