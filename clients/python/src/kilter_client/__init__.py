"""Client of a Kilter server: ``k = connect()``, then verbs as ``k.upload`` and ``k.identify``."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kilter_client.client import Kilter, connect
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
from kilter_files import Prepared, draft, inspect, prepare

if TYPE_CHECKING:
    from kilter_client.async_client import AsyncKilter, connect_async

__all__ = [
    "ApiError",
    "AsyncKilter",
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
    "connect",
    "connect_async",
    "draft",
    "inspect",
    "prepare",
]


def __getattr__(name: str) -> Any:
    """Return what is loaded when it is asked for: the client under asyncio, types of results (``IdentifyResult``)."""
    if name in ("AsyncKilter", "connect_async"):
        return getattr(import_module("kilter_client.async_client"), name)
    from kilter_client.typed.names import MODULE_OF

    if name not in MODULE_OF:
        raise AttributeError(f"module 'kilter' has no attribute {name!r}")
    return getattr(import_module(f"kilter_client.typed.{MODULE_OF[name]}"), name)
