"""Histograms of what others have counted in bins: the jobs in the database, and the answers of a stream."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import timedelta
from typing import Any

from prometheus_client.core import CounterMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.utils import floatToGoString

from kilter_service.ground.ended_jobs.store import AT_MOST_MS
from kilter_service.web.observability.store import Ended

JOB_EDGES_S = {edge: timedelta(milliseconds=edge).total_seconds() for edge in AT_MOST_MS}
# Bin k of a corrector ends at 2^((k+1)/2) µs (docs/reference/stream.md): every second edge, from 4 µs to 33 ms.
STREAM_EDGES_S = {k: 2.0 ** (0.5 * k) * 1e-6 for k in range(4, 31, 2)}


def of_jobs(ended: Mapping[tuple[str, str], Ended]) -> Iterable[Metric]:
    """Jobs that have ended since the database was made, and how long those took that ran."""
    number = CounterMetricFamily(
        "kilter_jobs_ended", "Jobs that have ended, also since purged.", labels=("kind", "state")
    )
    text = "Time jobs took from their first start to their end, of all that have ended."
    took = HistogramMetricFamily("kilter_job_duration_seconds", text, labels=("kind", "state"))
    for labels, one in ended.items():
        number.add_metric(labels, one.jobs)
        took.add_metric(labels, _buckets(one.at_most_ms, JOB_EDGES_S), one.seconds)
    return number, took


def of_streams(streams: Iterable[Mapping[str, Any]]) -> Metric:
    """Time of each stream's answers inside the corrector; one of an earlier release does not tell it in bins."""
    text = "Time in the corrector from the arrival of a setpoint to its answer."
    spent = HistogramMetricFamily("kilter_stream_processing_seconds", text, labels=("robot", "stream"))
    for one in streams:
        bins: Sequence[int] = one.get("by_time", ())
        if bins:
            ends = {k + 1: count for k, count in enumerate(bins)}
            seconds = one["received"] * (one["processing_us"]["mean"] or 0.0) * 1e-6
            spent.add_metric((one["robot"], one["stream"]), _buckets(ends, STREAM_EDGES_S), seconds)
    return spent


def _buckets(counted: Mapping[int, int], edges_s: Mapping[int, float]) -> list[tuple[str, int]]:
    """How many were counted up to each edge; a bin that ends between two edges counts for the upper one."""
    up_to = [sum(count for end, count in counted.items() if end <= edge) for edge in edges_s]
    named = zip(map(floatToGoString, edges_s.values()), up_to, strict=True)
    return [*named, ("+Inf", sum(counted.values()))]
