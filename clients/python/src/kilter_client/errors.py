"""Every exception of the client. Answers of the server come back as the class of their ``code``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar


class KilterError(Exception):
    """Something that went wrong, with a stable ``code``, a sentence (``detail``) and a ``context``."""

    default_code: ClassVar[str] = "kilter_error"
    default_title: ClassVar[str] = "Kilter error"

    def __init__(self, detail: str, *, code: str | None = None, status: int | None = None, **context: Any) -> None:
        super().__init__(detail)
        self.detail = detail
        self.code = code or self.default_code
        self.title = self.default_title
        self.status = status
        self.context: dict[str, Any] = context
        self.request_id: str | None = None

    def to_document(self) -> dict[str, Any]:
        """Return the error as a problem document (RFC 9457), as the server writes them."""
        return {
            "type": f"urn:kilter:problem:{self.code}",
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
            "code": self.code,
            "context": self.context,
            "request_id": self.request_id,
        }


class ServerUnreachableError(KilterError):
    """No server answers, or none could be found."""

    default_code = "server_unreachable"
    default_title = "Server unreachable"


class FileError(KilterError):
    """A file that cannot be read as measurements; names file, line, column and remedy."""

    default_code = "file_invalid"
    default_title = "File not understood"


class MissingPackageError(KilterError):
    """A file format, an array or a frame that needs a package which is not installed."""

    default_code = "package_missing"
    default_title = "Package missing"


class UsageError(KilterError):
    """Options of the command line, or arguments of a verb, that do not go together."""

    default_code = "usage"
    default_title = "Wrong usage"


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
    """A job that did not end within the caller's time; it goes on at the server."""

    default_code = "job_timeout"
    default_title = "Job still running"


BY_CODE: Mapping[str, type[ApiError]] = {
    "robot_invalid": RobotError,
    "observations_invalid": ObservationError,
    "too_few_poses": TooFewPosesError,
    "option_invalid": OptionError,
}

BY_STATUS: Mapping[int, type[ApiError]] = {
    400: CalibrationError,
    401: NotAuthorisedError,
    403: NotAuthorisedError,
    404: NotFoundError,
    409: ConflictError,
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
