"""The metrics of a server: those its process keeps, and those it reads from the database when it is asked."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.registry import Collector

from kilter_service.contract.drift import CheckOfRobot
from kilter_service.ground.db import Database, Session
from kilter_service.ground.failure_log import Failing
from kilter_service.ground.settings import Settings
from kilter_service.ground.version import code_version
from kilter_service.ground.wire import to_metres
from kilter_service.versions.drift.service import Creeping, last_checks
from kilter_service.web.observability import histograms, machine, store
from kilter_service.web.observability.requests import REGISTRY

reading = Failing(logging.getLogger("kilter.api"), "the metrics of the database cannot be read")

MEDIA_TYPE = CONTENT_TYPE_LATEST
DATABASE_UP = "Whether the database answers."
VERDICTS = ("ok", "moved", "cannot_tell")
CREEPING = Creeping()
HELD_BACK = ("reversing", "damped", "saturated", "slowed")  # counters of a stream's status


def text(database: Database, settings: Settings) -> bytes:
    """Write all metrics in the text format of Prometheus; without a database, those of the process alone."""
    asked = CollectorRegistry()
    asked.register(_Asked(database, settings))
    return generate_latest(REGISTRY) + generate_latest(asked)


def streams(database: Database) -> list[dict[str, Any]]:
    """Return what every stream of every corrector that runs has last said of itself."""
    with database.reading() as session:
        return store.streams(session)


class _Asked(Collector):
    """Metrics that are read when they are asked for."""

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database, self._settings = database, settings

    def describe(self) -> Iterable[Metric]:
        """Name nothing beforehand, so that registering reads nothing."""
        return []

    def collect(self) -> Iterable[Metric]:
        """Read and give the metrics."""
        yield _gauge("kilter_build_info", "1, with the version that runs.", ("version",), [((code_version(),), 1.0)])
        yield from machine.gauges(self._settings)
        try:
            with self._database.reading() as session:
                known = list(_iter_database_metrics(session))
        except Exception as error:  # the metrics are there to say so
            reading.report_failure(error)
            yield _gauge("kilter_database_up", DATABASE_UP, (), [((), 0.0)])
            return
        reading.report_success()
        yield _gauge("kilter_database_up", DATABASE_UP, (), [((), 1.0)])
        yield from known


def _iter_database_metrics(session: Session) -> Iterable[Metric]:
    jobs = [((kind, state), float(number)) for kind, state, number in store.jobs_by_state(session)]
    yield _gauge("kilter_jobs", "Jobs in the database.", ("kind", "state"), jobs)
    age = [((), store.queue_age_s(session))]
    yield _gauge("kilter_job_queue_age_seconds", "How long the oldest queued job has waited.", (), age)
    yield from histograms.of_jobs(store.ended_jobs(session))
    beats = [((process, name), age_s) for process, name, age_s in store.beats(session)]
    text = "Time since a process last said that it is alive."
    yield _gauge("kilter_heartbeat_age_seconds", text, ("process", "name"), beats)
    checks = last_checks(session)
    yield from _of_checks(checks, CREEPING.creeping_by_robot(session, checks))
    yield from _of_webhooks(store.webhooks(session))
    yield from _of_streams(store.streams(session))


def _of_checks(checks: Mapping[str, CheckOfRobot], creeping: Mapping[str, bool]) -> Iterable[Metric]:
    """What the last check of each robot's active version said."""
    verdicts = [
        ((robot, verdict), float(one.verdict == verdict)) for robot, one in checks.items() for verdict in VERDICTS
    ]
    yield _gauge("kilter_drift_verdict", "1 for what the last check of a robot said.", ("robot", "verdict"), verdicts)
    chances = [((robot,), one.p_value) for robot, one in checks.items()]
    text = "Chance of the last check from an arm that has not moved."
    yield _gauge("kilter_drift_p_value", text, ("robot",), chances)
    text = "1 where no check says that a robot has moved and all together do; no value until its sums are known."
    yield _gauge("kilter_drift_creeping", text, ("robot",), [((robot,), float(one)) for robot, one in creeping.items()])
    measured = [((robot,), one.at.timestamp()) for robot, one in checks.items()]
    text = "When the rows of the last check were measured, s since 1970."
    yield _gauge("kilter_drift_last_check_timestamp_seconds", text, ("robot",), measured)


def _of_webhooks(counts: Mapping[str, Mapping[str, int]]) -> Iterable[Metric]:
    """What workers have posted of verdicts; a restarted worker has another name and begins at zero."""
    text = "Verdicts of checks that were posted to the webhook (sent), or given up (failed)."
    posts = CounterMetricFamily("kilter_webhook_posts", text, labels=("worker", "outcome"))
    for worker, found in counts.items():
        for outcome, number in found.items():
            posts.add_metric((worker, outcome), number)
    yield posts


def _of_streams(streams: Sequence[Mapping[str, Any]]) -> Iterable[Metric]:
    """What the corrector's streams have counted; a restarted corrector begins at zero."""
    answers = CounterMetricFamily("kilter_stream_answers", "Setpoints answered.", labels=("robot", "stream", "status"))
    text = "Setpoints corrected whose correction was held back, by what held it."
    held_back = CounterMetricFamily("kilter_stream_held_back", text, labels=("robot", "stream", "by"))
    longest, versions, left = [], [], []
    for one in streams:
        place, times = (one["robot"], one["stream"]), one["processing_us"]
        for status, count in one["counters"].items():
            answers.add_metric((*place, status), count)
        for by in HELD_BACK:
            held_back.add_metric((*place, by), one.get(by, 0))  # a corrector of an earlier release does not count all
        if "left_mm" in one:
            left.append((place, to_metres(one["left_mm"]["lately"])))
        longest.append((place, times["max"] * 1e-6))
        versions.append(((*place, one["version_id"] or ""), float(one["epoch"] or 0)))
    yield answers
    yield held_back
    yield histograms.of_streams(streams)
    yield _gauge(
        "kilter_stream_processing_longest_seconds", "The longest of these times.", ("robot", "stream"), longest
    )
    text = "The most that was left of the error of the tool after correction in the last two seconds, by the version."
    yield _gauge("kilter_stream_left_meters", text, ("robot", "stream"), left)
    text = "Epoch of the version that a stream corrects with."
    yield _gauge("kilter_stream_epoch", text, ("robot", "stream", "version_id"), versions)


def _gauge(name: str, text: str, labels: Sequence[str], values: Iterable[tuple[Sequence[str], float]]) -> Metric:
    family = GaugeMetricFamily(name, text, labels=labels)
    for label, value in values:
        family.add_metric(label, value)
    return family
