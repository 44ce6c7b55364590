"""What an exporter receives and returns."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from kilter_service.contract.versions import Version

if TYPE_CHECKING:
    from kilter_core.model import Calibration
    from kilter_service.robots.store import StoredRobot


@dataclass(frozen=True)
class Exportable:
    """A version: its robot as stored, the version as the API shows it, and core's calibration document (SI)."""

    arm: StoredRobot
    version: Version
    document: dict[str, Any]

    @property
    def robot(self) -> dict[str, Any]:
        """The robot as posted."""
        return self.arm.document

    @cached_property
    def calibration(self) -> Calibration:
        """Core's calibration."""
        from kilter_core.model import Calibration  # loads compiled kernels: not at the start of the API process

        return Calibration.from_document(self.arm.robot(), self.document)


class Written(NamedTuple):
    """A file's text, or its bytes where it is none, and notes on what it leaves out of the version."""

    text: str | bytes
    notes: tuple[str, ...] = ()
