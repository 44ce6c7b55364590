"""Client of a Kilter server."""

from __future__ import annotations

from kilter_client.client import Kilter
from kilter_client.errors import (
    ApiError,
    CalibrationError,
    ConflictError,
    FileError,
    JobCancelledError,
    JobFailedError,
    JobTimeoutError,
    KilterError,
    MissingPackageError,
    NotAuthorisedError,
    NotFoundError,
    ObservationError,
    OptionError,
    PayloadError,
    RobotError,
    ServerUnreachableError,
    TooFewPosesError,
    UsageError,
)
from kilter_files import Prepared, prepare

__all__ = [
    "ApiError",
    "CalibrationError",
    "ConflictError",
    "FileError",
    "JobCancelledError",
    "JobFailedError",
    "JobTimeoutError",
    "Kilter",
    "KilterError",
    "MissingPackageError",
    "NotAuthorisedError",
    "NotFoundError",
    "ObservationError",
    "OptionError",
    "PayloadError",
    "Prepared",
    "RobotError",
    "ServerUnreachableError",
    "TooFewPosesError",
    "UsageError",
    "prepare",
]
