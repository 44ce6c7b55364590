"""Errors that the core raises: each carries a code, a sentence and a context, and knows nothing of HTTP."""

from __future__ import annotations

from typing import Any, ClassVar


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
