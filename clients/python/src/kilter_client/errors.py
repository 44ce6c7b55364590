"""Every exception of the client. Answers of the server come back as the class of their ``code``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_files.ground import FileError, KilterError, MissingPackageError, UsageError

__all__ = [
    "ApiError",
    "CalibrationError",
    "ConflictError",
    "FileError",
    "JobCancelledError",
    "JobFailedError",
    "JobTimeoutError",
    "KilterError",
    "MissingPackageError",
    "NotAuthorisedError",
    "NotFoundError",
    "ObservationError",
    "OptionError",
    "PayloadError",
    "RobotError",
    "ServerUnreachableError",
    "TooFewPosesError",
    "UsageError",
    "from_problem",
]


class ServerUnreachableError(KilterError):
    """No server answers, or none could be found."""

    default_code = "server_unreachable"
    default_title = "Server unreachable"
    lost = False  # whether it was there before, so that the same request may have an answer soon
    unsent = False  # whether it cannot have seen the request


class ApiError(KilterError):
    """An answer of the server that refuses the request."""

    default_code = "api_error"
    default_title = "Request refused"


class NotAuthorisedError(ApiError):
    """The token is missing or wrong."""


class NotFoundError(ApiError):
    """No such robot, campaign, job or version."""


class ConflictError(ApiError):
    """The state of the server does not allow it."""


class PayloadError(ApiError):
    """The shape of the request is wrong (unknown field, wrong type)."""


class CalibrationError(ApiError):
    """Data that cannot be calibrated; the detail says what is missing."""


class RobotError(CalibrationError):
    """A robot description that cannot be a serial arm."""


class ObservationError(CalibrationError):
    """Measurements that are not what their columns say; nothing of the upload is stored."""


class TooFewPosesError(CalibrationError):
    """Fewer distinct poses than the free parameters need."""


class OptionError(CalibrationError):
    """An option that does not exist or does not fit the robot or the data."""


class JobFailedError(KilterError):
    """A job that ended without a result; ``job`` is its document."""

    default_code = "job_failed"
    default_title = "Job failed"

    def __init__(self, detail: str, *, job: Mapping[str, Any], code: str | None = None) -> None:
        super().__init__(detail, code=code, job_id=job.get("id"), state=job.get("state"))
        self.job = dict(job)


class JobCancelledError(JobFailedError):
    """A job that was cancelled."""

    default_code = "cancelled"
    default_title = "Job cancelled"


class JobTimeoutError(KilterError):
    """A job that did not end within the caller's time; it continues at the server."""

    default_code = "job_timeout"
    default_title = "Job still running"


BY_CODE: Mapping[str, type[ApiError]] = {
    "robot_invalid": RobotError,
    "observations_invalid": ObservationError,
    "foreign_observations": ObservationError,
    "markers_swapped": ObservationError,
    "too_few_poses": TooFewPosesError,
    "option_invalid": OptionError,
}

BY_STATUS: Mapping[int, type[ApiError]] = {
    400: CalibrationError,
    401: NotAuthorisedError,
    403: NotAuthorisedError,
    404: NotFoundError,
    409: ConflictError,
    412: ConflictError,
    422: PayloadError,
}


def from_problem(problem: Mapping[str, Any], status: int) -> ApiError:
    """Rebuild the exception of a problem document: the class by ``code``, else by ``status``."""
    code = str(problem.get("code") or ApiError.default_code)
    kind = BY_CODE.get(code) or BY_STATUS.get(status, ApiError)
    detail = str(problem.get("detail") or problem.get("title") or f"The server answered {status}.")
    error = kind(detail, code=code, status=status)
    error.title = str(problem.get("title") or error.title)
    error.context = dict(problem.get("context") or {})
    error.request_id = problem.get("request_id")
    return error
