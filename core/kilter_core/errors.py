"""Errors that the core raises, and findings that it reports: each carries a code and a context, and knows nothing of HTTP."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

Sentences = Mapping[str, Callable[[Mapping[str, Any]], str]]
"""The sentence of a finding of each code, from what the finding says."""


class CoreError(Exception):
    """A calibration problem with a stable code, a sentence that names the place and the remedy, and its context."""

    default_code: ClassVar[str] = "core_error"

    def __init__(self, message: str, *, code: str | None = None, **context: Any) -> None:
        super().__init__(message)
        self.code = code or self.default_code
        self.message = message
        self.context = context


class RobotError(CoreError):
    """A robot description that cannot be a serial arm."""

    default_code = "robot_invalid"


class ObservationError(CoreError):
    """Measurements that cannot be what their columns say."""

    default_code = "observations_invalid"


class OptionError(CoreError):
    """An option that does not exist or does not fit the robot or the data."""

    default_code = "option_invalid"


class TooFewPosesError(CoreError):
    """Fewer distinct poses than the free parameters need."""

    default_code = "too_few_poses"


class NotConvergedError(CoreError):
    """An estimator that stopped before it found a minimum."""

    default_code = "not_converged"


class CancelledError(CoreError):
    """The caller asked a long computation to stop."""

    default_code = "cancelled"


class FindingDocument(dict[str, Any]):
    """A finding as it is stored and sent: its code, its context by name, and its sentence as ``message``."""

    @staticmethod
    def make(code: str, message: str, **context: Any) -> FindingDocument:
        """Return the document of a finding; the class itself is called as ``dict`` is, by ``asdict`` and copies."""
        return FindingDocument(code=code, **context, message=message)


@dataclass(frozen=True)
class Finding:
    """A warning, objection or remark: a stable code and what it says, by name. Decisions are made from these.

    ``context`` is stored with it. ``only_said`` are names and numbers that only its sentence has, which the table of its
    room makes of both at the edge.
    """

    code: str
    context: Mapping[str, Any]
    only_said: Mapping[str, Any] = field(default_factory=dict)

    def message(self, sentences: Sentences) -> str:
        """Return its sentence."""
        return sentences[self.code]({**self.context, **self.only_said})

    def to_document(self, sentences: Sentences) -> FindingDocument:
        """Return it as it is stored and sent, with its sentence."""
        return FindingDocument.make(self.code, self.message(sentences), **self.context)
