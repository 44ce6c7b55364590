"""Log lines, each with its request, job and robot; and spans of OpenTelemetry where the environment names where they go.

``OTEL_EXPORTER_OTLP_ENDPOINT`` and its siblings are read by OpenTelemetry itself. Without them this costs nothing.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from datetime import UTC, datetime
from logging.handlers import WatchedFileHandler
from types import TracebackType
from typing import TYPE_CHECKING, Any

from kilter_files.ground.later import Later
from kilter_service.ground.settings import Settings

if TYPE_CHECKING:
    from opentelemetry.trace import Span, Tracer


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


tracing_log = logging.getLogger("kilter.tracing")

PACKAGES = "opentelemetry-sdk opentelemetry-exporter-otlp-proto-http"
WANTED = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")

_tracer: Tracer | None = None
propagation, trace = map(Later, ("opentelemetry.trace.propagation.tracecontext", "opentelemetry.trace"))


def configure_tracing(process: str) -> None:
    """Send spans where the environment says."""
    global _tracer
    if not any(os.environ.get(name) for name in WANTED):
        return
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor
    except ImportError:
        tracing_log.warning("%s is set, but packages are missing: pip install %s", WANTED[0], PACKAGES)
        return
    resource = Resource.create({"service.name": os.environ.get("OTEL_SERVICE_NAME", f"kilter-{process}")})
    provider = TracerProvider(resource=resource)
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    _tracer = provider.get_tracer("kilter")


def _start_span(name: str, kind: str, carrier: Mapping[str, str], attributes: Mapping[str, Any]) -> Any:
    assert _tracer is not None
    parent = propagation.TraceContextTextMapPropagator().extract(carrier)
    return _tracer.start_as_current_span(name, context=parent, kind=trace.SpanKind[kind], attributes=dict(attributes))


@contextmanager
def request(scope: Any) -> Iterator[None]:
    """Span of a request, below the caller's where it sent a ``traceparent``."""
    if _tracer is None:
        yield
        return
    headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
    given = {"http.request.method": scope["method"], "url.path": scope["path"]}
    span: Span
    with _start_span(scope["method"], "SERVER", headers, given) as span:
        yield
        route = getattr(scope.get("route"), "path", None)
        if route is not None:
            span.update_name(f"{scope['method']} {route}")
            span.set_attribute("http.route", route)


@contextmanager
def job(kind: str, job_id: str, robot: str, traceparent: str) -> Iterator[None]:
    """Span of a job, below that of the request that asked for it."""
    if _tracer is None:
        yield
        return
    given = {"kilter.job.id": job_id, "kilter.robot": robot}
    with _start_span(f"job {kind}", "CONSUMER", {"traceparent": traceparent} if traceparent else {}, given):
        yield


def traceparent() -> str:
    """Return where this is in a trace, for the job that goes on with it; empty outside of one."""
    if _tracer is None:
        return ""
    carrier: dict[str, str] = {}
    propagation.TraceContextTextMapPropagator().inject(carrier)
    return carrier.get("traceparent", "")
