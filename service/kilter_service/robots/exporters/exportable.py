"""What an exporter receives and returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from kilter_service.contract.versions import Version
from kilter_service.ground.core import core_model

if TYPE_CHECKING:
    from kilter_core.arm import Robot


class Arm(Protocol):
    """A robot as it is stored: the document it was posted as, and the chain that represents it."""

    @property
    def document(self) -> dict[str, Any]:
        """The robot as posted."""

    @property
    def chain(self) -> dict[str, Any] | None:
        """The resolved chain (SI); None for a robot from before the chains that no longer resolves."""

    def robot(self) -> Robot:
        """Build core's robot from the chain."""


@dataclass(frozen=True)
class Exportable:
    """A version: its robot as stored, the version as the API shows it, and core's calibration document (SI)."""

    arm: Arm
    version: Version
    document: dict[str, Any]
    rules: dict[str, Any] | None = None  # that it was activated under

    @property
    def robot(self) -> dict[str, Any]:
        """The robot as posted."""
        return self.arm.document

    @cached_property
    def calibration(self) -> core_model.Calibration:
        """Core's calibration."""
        return core_model.Calibration.from_document(self.arm.robot(), self.document)


class Written(NamedTuple):
    """A file's text, its bytes where it is none, or what makes either, and notes on what it leaves out of the version."""

    text: str | bytes | Callable[[], str | bytes]
    notes: tuple[str, ...] = ()
