"""What a process counts and times. Names follow Prometheus: base units, ``_total`` for what only grows."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, disable_created_metrics
from prometheus_client.gc_collector import GCCollector
from prometheus_client.process_collector import ProcessCollector

# When a counter was made: twice the lines, and nobody asks for it.
disable_created_metrics()  # type: ignore[no-untyped-call]
REGISTRY = CollectorRegistry()
ProcessCollector(registry=REGISTRY)
GCCollector(registry=REGISTRY)

REQUESTS = Counter("kilter_http_requests", "Requests answered.", ["method", "route", "status"], registry=REGISTRY)
DURATION = Histogram(
    "kilter_http_request_duration_seconds",
    "Time from the first byte of a request to the last of its answer.",
    ["method", "route"],
    buckets=(0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 120.0),
    registry=REGISTRY,
)
OPEN = Gauge("kilter_http_requests_open", "Requests that are being answered.", registry=REGISTRY)
REFUSALS = Counter("kilter_refusals", "Requests refused, by error code.", ["code"], registry=REGISTRY)
