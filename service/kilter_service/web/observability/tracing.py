"""Spans of OpenTelemetry, when the environment names where they go and the packages are there.

``OTEL_EXPORTER_OTLP_ENDPOINT`` and its siblings are read by OpenTelemetry itself. Without them this costs nothing.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from kilter_files.ground.later import Later

if TYPE_CHECKING:
    from opentelemetry.trace import Span, Tracer

log = logging.getLogger("kilter.tracing")

PACKAGES = "opentelemetry-sdk opentelemetry-exporter-otlp-proto-http"
WANTED = ("OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT")

_tracer: Tracer | None = None
propagation, trace = map(Later, ("opentelemetry.trace.propagation.tracecontext", "opentelemetry.trace"))


def configure(process: str) -> None:
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
        log.warning("%s is set, but packages are missing: pip install %s", WANTED[0], PACKAGES)
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
