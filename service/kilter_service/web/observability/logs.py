"""Log lines, each with the request, job and robot that it is about, as text or as JSON."""

from __future__ import annotations

import json
import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from logging.handlers import WatchedFileHandler
from types import TracebackType
from typing import Any

from kilter_service.ground.settings import Settings

log = logging.getLogger("kilter")

ABOUT = ("request_id", "job_id", "robot")
ACCESS = "kilter.access"
logging.getLogger(ACCESS).disabled = True  # until `configure` is told where it goes
TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s%(about)s"

_about: ContextVar[dict[str, str] | None] = ContextVar("about", default=None)
# Every attribute that logging itself gives a record; whatever else is on one was given with `extra`.
_PLAIN = frozenset(logging.makeLogRecord({}).__dict__) | {"message", "asctime", "taskName", "about"}


@contextmanager
def about(**ids: str) -> Iterator[None]:
    """Say what the log lines inside are about: any of ``request_id``, ``job_id``, ``robot``; empty ones are left out."""
    known = {name: ids[name] for name in ABOUT if ids.get(name)}
    token = _about.set({**(_about.get() or {}), **known})
    try:
        yield
    finally:
        _about.reset(token)


def request_id() -> str:
    """Return the identifier of the request that is being answered, empty outside of one."""
    return (_about.get() or {}).get("request_id", "")


class TextLines(logging.Formatter):
    """Lines for people; what a line is about stands at its end."""

    def __init__(self) -> None:
        super().__init__(TEXT)

    def format(self, record: logging.LogRecord) -> str:
        """Write one line."""
        found = {**(_about.get() or {}), **_extras(record)}
        record.about = "".join(f" {name}={value}" for name, value in found.items())
        return super().format(record)


class JsonLines(logging.Formatter):
    """One JSON object a line, for what collects logs."""

    def __init__(self, process: str) -> None:
        super().__init__()
        self._process = process

    def format(self, record: logging.LogRecord) -> str:
        """Write one line."""
        line: dict[str, Any] = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "logger": record.name,
            "process": self._process,
            "message": record.getMessage(),
            **(_about.get() or {}),
            **_extras(record),
        }
        if record.exc_info:
            line["exception"] = self.formatException(record.exc_info)
        return json.dumps(line, default=str)


def log_exit_reason(sentence: str) -> None:
    """Say on standard error why a command ends; a line of JSON where the log has such lines."""
    if any(isinstance(handler.formatter, JsonLines) for handler in logging.getLogger().handlers):
        log.error(sentence)
    else:
        print(f"kilterd: {sentence}", file=sys.stderr)


def _uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    if issubclass(kind, KeyboardInterrupt):
        return
    log.critical("the process ends: %s", kind.__name__, exc_info=(kind, error, trace))


def _uncaught_in_thread(found: threading.ExceptHookArgs) -> None:
    if found.exc_value is not None:
        trace = (found.exc_type, found.exc_value, found.exc_traceback)
        log.error("the thread %s ends", found.thread.name if found.thread else "", exc_info=trace)


def _extras(record: logging.LogRecord) -> dict[str, Any]:
    return {name: value for name, value in record.__dict__.items() if name not in _PLAIN}


def configure(settings: Settings, process: str) -> None:
    """Set up the logs of a process; libraries are heard from WARNING on, Kilter from INFO on.

    Raises:
        OSError: the file of the access log cannot be written.

    """
    lines: logging.Formatter = JsonLines(process) if settings.log_format == "json" else TextLines()
    handler = logging.StreamHandler()
    handler.setFormatter(lines)
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.getLogger("kilter").setLevel(logging.INFO)
    if isinstance(lines, JsonLines):  # else Python writes warnings and errors that nobody caught as plain text
        logging.captureWarnings(True)
        sys.excepthook, threading.excepthook = _uncaught, _uncaught_in_thread
    access = logging.getLogger(ACCESS)
    access.disabled = settings.access_log is None
    if settings.access_log not in (None, "-"):
        file = WatchedFileHandler(settings.access_log, encoding="utf-8")  # logrotate may move it away
        file.setFormatter(JsonLines(process))
        access.handlers, access.propagate = [file], False
