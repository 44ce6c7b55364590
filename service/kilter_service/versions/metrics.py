"""The metrics of a server: those its process keeps, and those it reads from the database when it is asked."""

from __future__ import annotations

import contextlib
import logging
import math
import shutil
from collections.abc import Iterable, Mapping, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.exposition import CONTENT_TYPE_LATEST
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString

from kilter_service.contract.today import CheckOfRobot
from kilter_service.ground import backup_folder
from kilter_service.ground.db import Database, Session
from kilter_service.ground.db.failures import Failing
from kilter_service.ground.settings import Settings, code_version
from kilter_service.ground.store import AT_MOST_MS
from kilter_service.ground.wire import to_metres
from kilter_service.versions.drift.service import Creeping, last_checks
from kilter_service.web import store
from kilter_service.web.request_log import REGISTRY
from kilter_service.web.store import Ended


def gauges(settings: Settings) -> Iterable[Metric]:
    """Give what can be read; what cannot is left out, so that an alert on its absence may say so."""
    free = GaugeMetricFamily("kilter_disk_free_bytes", "Bytes free on the disk of the data folder.")
    end = GaugeMetricFamily(
        "kilter_certificate_end_timestamp_seconds", "When the server's certificate ends, s since 1970."
    )
    age = GaugeMetricFamily("kilter_backup_age_seconds", "Since the newest backup in KILTER_BACKUPS; +Inf without any.")
    with contextlib.suppress(OSError):
        free.add_metric((), float(shutil.disk_usage(settings.data).free))
    moment = _certificate_end_s(settings)
    if moment is not None:
        end.add_metric((), moment)
    if settings.backups is not None:
        age.add_metric((), _backup_age_s(settings.backups))
    return free, end, age


def _backup_age_s(folder: Path) -> float:
    """Age of the newest backup; infinite where there is none, or none that can be seen."""
    try:
        found = backup_folder.backups(folder)
    except OSError:
        return math.inf
    return found[0].age_s() if found else math.inf


def _certificate_end_s(settings: Settings) -> float | None:
    """End of the first certificate of the file, which is the server's own; None without one that can be read."""
    if settings.tls_certificate is None:
        return None
    from cryptography import x509

    try:
        certificate = x509.load_pem_x509_certificate(settings.tls_certificate.read_bytes())
    except (OSError, ValueError):
        return None
    return certificate.not_valid_after_utc.timestamp()


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
        yield from gauges(self._settings)
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
    yield from of_jobs(store.ended_jobs(session))
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
    yield of_streams(streams)
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
