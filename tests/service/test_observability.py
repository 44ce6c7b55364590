"""Logs, metrics and traces, from outside: what a request leaves behind in each."""

from __future__ import annotations

import json
import logging
import math
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from prometheus_client.parser import text_string_to_metric_families
from sqlalchemy import text

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector.fast_path import bin_edges_us
from kilter_service.versions import metrics
from kilter_service.versions.metrics import HELD_BACK
from kilter_service.web import logs
from kilter_service.web import store as health
from kilter_service.web.auth.token import admin_token
from kilter_service.web.request_log import UNKNOWN
from tests.service.forked import ForkedPopen

TRACE = "0af7651916cd43dd8448eb211c80319c"
Until = Callable[..., None]


def values(page: str) -> dict[tuple[str, tuple[tuple[str, str], ...]], float]:
    """The samples of a page of metrics, by name and labels."""
    families = text_string_to_metric_families(page)
    return {(s.name, tuple(sorted(s.labels.items()))): s.value for family in families for s in family.samples}


def sample(client: httpx.Client, name: str, **labels: str) -> float:
    answer = client.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain")
    return values(answer.text).get((name, tuple(sorted(labels.items()))), 0.0)


def test_requests_are_counted_by_route_and_refusals_by_code(client: httpx.Client) -> None:
    route = {"method": "GET", "route": "/v1/robots/{robot}", "status": "404"}
    before = sample(client, "kilter_http_requests_total", **route)
    refused = sample(client, "kilter_refusals_total", code="robot_not_found")
    for name in ("a", "b", "c"):
        assert client.get(f"/v1/robots/{name}").status_code == 404
    assert sample(client, "kilter_http_requests_total", **route) == before + 3
    assert sample(client, "kilter_refusals_total", code="robot_not_found") == refused + 3
    timed = {"method": "GET", "route": "/v1/robots/{robot}"}
    assert sample(client, "kilter_http_request_duration_seconds_count", **timed) >= 3


def test_addresses_that_no_route_takes_share_one_name(client: httpx.Client) -> None:
    labels = {"method": "GET", "route": UNKNOWN, "status": "404"}
    before = sample(client, "kilter_http_requests_total", **labels)
    for k in range(20):
        client.get(f"/random/{k}")
    assert sample(client, "kilter_http_requests_total", **labels) == before + 20
    assert "random" not in client.get("/metrics").text


def test_jobs_and_heartbeats_are_read_from_the_database(client: httpx.Client, katana: Any) -> None:
    campaign = katana.campaign(client, 30)
    job = {"kind": "identify", "robot": katana.name, "campaigns": [campaign]}
    client.post("/v1/jobs", json=job).raise_for_status()
    assert sample(client, "kilter_jobs", kind="identify", state="queued") == 1
    assert sample(client, "kilter_job_queue_age_seconds") > 0
    assert sample(client, "kilter_database_up") == 1


def test_metrics_say_that_the_database_does_not_answer(client: httpx.Client, database: Database) -> None:
    assert sample(client, "kilter_database_up") == 1
    with database.transaction() as session:
        session.execute(text("ALTER TABLE heartbeats RENAME TO away"))
    assert sample(client, "kilter_database_up") == 0
    assert sample(client, "process_resident_memory_bytes") > 1e7


def test_metrics_say_how_much_room_is_left_and_when_the_certificate_ends(database: Database, tmp_path: Path) -> None:
    now = datetime.now(UTC).replace(microsecond=0)
    certificate = tmp_path / "cert.pem"
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "cell")])
    made = x509.CertificateBuilder(name, name, key.public_key(), 7, now, now + timedelta(days=9))
    certificate.write_bytes(made.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
    with_it = values(metrics.text(database, Settings(data=tmp_path, tls_certificate=certificate)).decode())
    assert with_it["kilter_certificate_end_timestamp_seconds", ()] == (now + timedelta(days=9)).timestamp()
    assert with_it["kilter_disk_free_bytes", ()] > 0
    for settings in (Settings(data=tmp_path), Settings(data=tmp_path, tls_certificate=tmp_path / "none.pem")):
        without = values(metrics.text(database, settings).decode())
        assert ("kilter_certificate_end_timestamp_seconds", ()) not in without


def test_streams_are_counted_by_robot_and_status(client: httpx.Client, database: Database) -> None:
    took_us = [2.0, 3.9, 5.0, 5.0, 30.0, 900.0, 50_000.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    bins = [*bin_edges_us(), math.inf]
    said = {
        "by_time": np.histogram(took_us, bins)[0].tolist(),
        "robot": "arm", "stream": "main", "received": 12, "counters": {"OK": 10, "STALE": 2}, "version_id": "ver_1",
        "epoch": 3, "processing_us": {"mean": 5.0, "max": 40.0}, "reversing": 1, "damped": 4, "saturated": 0,
        "slowed": 2, "left_mm": {"lately": 0.31, "max": 0.9},
    }  # fmt: skip
    with database.transaction() as session:
        health.beat(session, "corrector", "local", 1, {"streams": [said]})
    place = {"robot": "arm", "stream": "main"}
    assert sample(client, "kilter_stream_answers_total", **place, status="OK") == 10
    assert sample(client, "kilter_stream_answers_total", **place, status="STALE") == 2
    assert sample(client, "kilter_stream_processing_seconds_count", **place) == 12
    assert sample(client, "kilter_stream_processing_seconds_sum", **place) == pytest.approx(60e-6)
    for edge_us in (4, 8, 1024, 32_768):
        told = sample(client, "kilter_stream_processing_seconds_bucket", **place, le=repr(edge_us * 1e-6))
        assert told == sum(one <= edge_us for one in took_us), edge_us
    assert sample(client, "kilter_stream_epoch", **place, version_id="ver_1") == 3
    held_back = [sample(client, "kilter_stream_held_back_total", **place, by=by) for by in HELD_BACK]
    assert held_back == [1, 4, 0, 2]
    assert sample(client, "kilter_stream_left_meters", **place) == pytest.approx(0.31e-3)


def test_a_corrector_of_an_earlier_release_is_counted_too(client: httpx.Client, database: Database) -> None:
    said = {
        "robot": "arm", "stream": "main", "received": 1, "counters": {"OK": 1}, "version_id": "ver_1", "epoch": 3,
        "processing_us": {"mean": 5.0, "max": 40.0}, "reversing": 0, "damped": 7,
    }  # fmt: skip
    with database.transaction() as session:
        health.beat(session, "corrector", "local", 1, {"streams": [said]})
    place = {"robot": "arm", "stream": "main"}
    assert sample(client, "kilter_stream_held_back_total", **place, by="damped") == 7
    told = client.get("/metrics").text
    assert "kilter_stream_left_meters{" not in told
    assert "kilter_stream_processing_seconds_bucket{" not in told


def test_a_request_keeps_the_name_that_its_caller_gave(client: httpx.Client) -> None:
    given = client.get("/v1/robots/none", headers={"X-Request-ID": "lab-7.run_3"})
    assert given.headers["x-request-id"] == given.json()["request_id"] == "lab-7.run_3"
    for bad in ("a b", "x" * 65, "é", "a;drop"):
        answer = client.get("/v1/health/live", headers={"X-Request-ID": bad.encode()})
        assert re.fullmatch(r"[0-9a-f]{16}", answer.headers["x-request-id"])


def test_lines_say_what_they_are_about() -> None:
    record = logging.LogRecord("kilter.x", logging.INFO, "f", 1, "took %d", (3,), None)
    record.status = 200
    with logs.about(request_id="r1", robot=""), logs.about(job_id="j1"):
        line = json.loads(logs.JsonLines("worker").format(record))
        plain = logs.TextLines().format(record)
        assert logs.request_id() == "r1"
    assert {
        "message": "took 3",
        "request_id": "r1",
        "job_id": "j1",
        "status": 200,
        "process": "worker",
    }.items() <= line.items()
    assert "robot" not in line
    assert plain.endswith("took 3 request_id=r1 job_id=j1 status=200")
    assert "request_id" not in json.loads(logs.JsonLines("worker").format(record))


class Collector(BaseHTTPRequestHandler):
    """Takes what an exporter of OpenTelemetry sends."""

    spans: list[Any]

    def do_POST(self) -> None:
        from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import ExportTraceServiceRequest

        body = self.rfile.read(int(self.headers["Content-Length"]))
        found = ExportTraceServiceRequest.FromString(body)
        for resource in found.resource_spans:
            for scope in resource.scope_spans:
                self.spans.extend(scope.spans)
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def collector() -> Iterator[tuple[str, list[Any]]]:
    spans: list[Any] = []
    handler = type("Taking", (Collector,), {"spans": spans})
    with HTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}", spans
        server.shutdown()
        thread.join()


def test_request_and_job_share_their_identifiers_from_client_to_worker(
    settings: Settings, database: Database, katana: Any, collector: Any, until: Until, tmp_path: Path
) -> None:
    """Two real processes: `kilterd api` and `kilterd worker`, with logs as JSON, an access log and traces."""
    endpoint, spans = collector
    environment = {
        **{name: value for name, value in os.environ.items() if not name.startswith("OTEL_")},
        **settings.environment(),
        "KILTER_LOG_FORMAT": "json",
        "KILTER_ACCESS_LOG": str(tmp_path / "access.log"),
        "OTEL_EXPORTER_OTLP_ENDPOINT": endpoint,
        "OTEL_BSP_SCHEDULE_DELAY": "100",
        "NO_PROXY": "*",
    }
    logged = {name: (tmp_path / f"{name}.log").open("w+") for name in ("api", "worker")}
    running = {
        name: ForkedPopen(
            [sys.executable, "-m", "kilter_service", name],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
        for name, log in logged.items()
    }
    try:
        api = running["api"].stdout
        assert api is not None
        url = json.loads(api.readline())["url"]
        headers = {"Authorization": f"Bearer {admin_token(settings)}"}
        with httpx.Client(base_url=url, headers=headers, timeout=60) as client:
            campaign = katana.campaign(client, 40)
            job = client.post(
                "/v1/jobs",
                json={"kind": "identify", "robot": katana.name, "campaigns": [campaign], "options": {"level": 1}},
                headers={"X-Request-ID": "run-42", "traceparent": f"00-{TRACE}-b7ad6b7169203331-01"},
            ).json()["id"]
            until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] == "succeeded")
            assert sample(client, "kilter_jobs", kind="identify", state="succeeded") == 1
            labels = {"kind": "identify", "state": "succeeded"}
            assert sample(client, "kilter_job_duration_seconds_count", **labels) == 1
            until(lambda: len([s for s in spans if s.trace_id.hex() == TRACE]) >= 2)
    finally:
        for process in running.values():
            process.terminate()
        for process in running.values():
            process.wait(20)
            assert process.stdout is not None
            process.stdout.close()
    lines = {}
    for name, log in logged.items():
        log.seek(0)
        lines[name] = [json.loads(line) for line in log]
        log.close()
    of_job = [line for line in lines["worker"] if line.get("job_id") == job]
    assert {line["request_id"] for line in of_job} == {"run-42"}
    said = next(line for line in of_job if line["message"].startswith("identify succeeded"))
    assert said["robot"] == katana.name
    access = [json.loads(line) for line in (tmp_path / "access.log").read_text().splitlines()]
    asked = next(line for line in access if line["request_id"] == "run-42")
    assert asked["message"] == "POST /v1/jobs 202"
    assert asked["client"] == "127.0.0.1"
    assert asked["duration_s"] > 0
    ours = {span.name: span for span in spans if span.trace_id.hex() == TRACE}
    assert set(ours) == {"POST /v1/jobs", "job identify"}
    assert ours["job identify"].parent_span_id == ours["POST /v1/jobs"].span_id


def test_without_a_collector_nothing_is_traced() -> None:
    assert logs.traceparent() == ""
