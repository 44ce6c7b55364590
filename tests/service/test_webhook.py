"""Verdicts posted to the operator's address, taken by a real HTTP server: signed, bounded, and never in a job's way."""

from __future__ import annotations

import hashlib
import hmac
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from pydantic import ValidationError

from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.ground.webhook import Webhook
from kilter_service.jobs.work.runner import CreepingPosts
from tests.core.watch.drifting import some_arm
from tests.service.conftest import WorkerProcess, wait_for
from tests.service.watched_robot import Until, Watched

SECRET = b"a secret of more than 24 characters"


@dataclass
class Peer:
    """Who takes the posts: answers with these statuses, one after the other and then the last again."""

    statuses: list[int]
    location: str = ""
    hold: threading.Event | None = None
    posts: list[tuple[str, dict[str, str], bytes]] = field(default_factory=list)
    url: str = ""


@contextmanager
def serving(peer: Peer) -> Iterator[Peer]:
    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            status = peer.statuses[min(len(peer.posts), len(peer.statuses) - 1)]
            peer.posts.append((self.path, dict(self.headers), body))
            if peer.hold is not None:
                peer.hold.wait(20)
            self.send_response(status)
            if peer.location:
                self.send_header("Location", peer.location)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    peer.url = f"http://127.0.0.1:{server.server_port}/alarms?line=3"
    try:
        yield peer
    finally:
        if peer.hold is not None:
            peer.hold.set()
        server.shutdown()
        server.server_close()
        thread.join()


def told(webhook: Webhook, *deliveries: str) -> dict[str, int]:
    for delivery in deliveries:
        webhook.enqueue_message(delivery, {"verdict": "moved"})
    wait_for(lambda: sum(webhook.counts.values()) == len(deliveries), 30)
    return webhook.counts


def genuine(headers: dict[str, str], body: bytes) -> bool:
    at, v1 = (part.partition("=")[2] for part in headers["Kilter-Signature"].split(","))
    return hmac.compare_digest(hmac.new(SECRET, at.encode() + b"." + body, hashlib.sha256).hexdigest(), v1)


def test_what_is_refused_is_tried_three_times_and_no_more() -> None:
    with serving(Peer([500, 503, 204])) as peer:
        assert told(Webhook(peer.url, SECRET, 5.0, (0.0, 0.0)), "job_1") == {"sent": 1, "failed": 0}
        assert [(path, headers["Kilter-Delivery"]) for path, headers, _ in peer.posts] == 3 * [
            ("/alarms?line=3", "job_1")
        ]
        assert all(genuine(headers, body) for _, headers, body in peer.posts)
        assert not genuine(peer.posts[0][1], b"{}")
    with serving(Peer([500])) as peer:
        assert told(Webhook(peer.url, SECRET, 5.0, (0.0, 0.0)), "job_1", "job_2") == {"sent": 0, "failed": 2}
        assert len(peer.posts) == 6


def test_a_redirection_is_not_followed() -> None:
    with serving(Peer([200])) as other, serving(Peer([307], location=other.url)) as peer:
        assert told(Webhook(peer.url, SECRET, 5.0, (0.0,)), "job_1") == {"sent": 0, "failed": 1}
        assert (len(peer.posts), len(other.posts)) == (2, 0)


def test_whoever_does_not_answer_holds_nobody_up() -> None:
    with serving(Peer([200], hold=threading.Event())) as peer:
        webhook = Webhook(peer.url, SECRET, 0.2, ())
        webhook.settle(0.0)
        assert told(webhook, "job_1") == {"sent": 0, "failed": 1}
    gone = Webhook(peer.url, SECRET, 0.2, ())  # nobody listens there now
    for number in range(150):  # more than wait at once: told at once, never in the way
        gone.enqueue_message(f"job_{number}", {"verdict": "moved"})
    wait_for(lambda: gone.counts["failed"] == 150, 60)


@pytest.mark.parametrize("drip", [b"HTTP/1.1 200 OK\r\nX-A: ", b"HTTP/1.1 ", b"HTTP/1.1 100 Continue\r\n\r\n"])
def test_whoever_drips_an_answer_is_given_up_at_the_time_out_as_a_whole(drip: bytes) -> None:
    over, pieces = threading.Event(), 0

    def send(listening: socket.socket) -> None:
        nonlocal pieces
        connection, _ = listening.accept()
        with connection, suppress(OSError):
            connection.sendall(drip)
            while not over.wait(0.05):
                connection.sendall(drip if b"100" in drip else b"x")
                pieces += 1

    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=send, args=(listening,), daemon=True)
        thread.start()
        webhook = Webhook(f"http://127.0.0.1:{listening.getsockname()[1]}/", SECRET, 1.0, ())
        try:
            assert told(webhook, "job_1") == {"sent": 0, "failed": 1}  # it would be sent for ever
        finally:
            over.set()
            thread.join(10)
    assert pieces > 0


@pytest.mark.parametrize(
    "url", ["ftp://host/x", "file:///etc/passwd", "https://", "https://name:word@host/", "host/x", "http://host/#part"]
)
def test_other_addresses_are_refused(url: str, tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="KILTER_WEBHOOK_URL needs http"):
        Settings(data=tmp_path, webhook_url=url, webhook_secret=tmp_path / "secret")


def test_nothing_is_posted_without_a_good_secret(tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="nothing is posted unsigned"):
        Settings(data=tmp_path, webhook_url="https://host/x")
    file = tmp_path / "secret"
    settings = Settings(data=tmp_path, webhook_url="https://host/x", webhook_secret=file)
    assert settings.environment()["KILTER_WEBHOOK_SECRET"] == str(file)
    for content, mode, said in (
        (None, 0o600, "cannot be read"),
        (SECRET, 0o644, "by others"),
        (b"short", 0o600, "too short"),
    ):
        if content is not None:
            file.write_bytes(content)
            file.chmod(mode)
        with pytest.raises(ServiceError, match=said) as refused:
            Webhook.from_settings(settings)
        assert refused.value.code == "webhook_secret_unusable"
    assert Webhook.from_settings(Settings(data=tmp_path)) is None


def posts_counted(client: httpx.Client) -> dict[str, float]:
    lines = [
        line for line in client.get("/metrics").text.splitlines() if line.startswith("kilter_webhook_posts_total{")
    ]
    return {line.split('outcome="')[1].split('"')[0]: float(line.rsplit(" ", 1)[1]) for line in lines}


def test_a_worker_posts_what_has_moved_and_a_failure_fails_no_job(
    client: httpx.Client, worker: WorkerProcess, until: Until, database: Database, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    secret = tmp_path / "webhook-secret"
    secret.write_bytes(SECRET + b"\n")
    secret.chmod(0o600)
    arm = some_arm(np.random.default_rng(3))
    with serving(Peer([200])) as peer:
        monkeypatch.setenv("KILTER_WEBHOOK_URL", peer.url)
        monkeypatch.setenv("KILTER_WEBHOOK_SECRET", str(secret))
        worker.start()
        watched = Watched(client, until, arm, "arm")
        version = watched.calibrated(database)
        assert watched.checked(arm, 1, 0)["verdict"] == "ok"
        said = watched.checked(arm.after("zero_3", 4e-3), 2, 1)
        assert said["verdict"] == "moved"
        until(lambda: posts_counted(client) == {"sent": 1.0, "failed": 0.0})
        ((_, headers, body),) = peer.posts
        message = json.loads(body)
        assert genuine(headers, body)
        assert (message["event"], message["robot"], message["verdict"]) == ("check", "arm", "moved")
        assert (message["version_id"], message["sentence"]) == (version, said["sentence"])
        assert message["headline"] == said["headline"]
        assert message["causes"] == [{"name": "zero_3", "words": "zero of joint 3"}]
        assert message["job_id"] == headers["Kilter-Delivery"] == watched.history()["last"]["job_id"]
        assert message["campaigns"] == [watched.history()["last"]["campaign_id"]]
    assert watched.checked(arm.after("zero_3", 4e-3), 3, 2)["verdict"] == "moved"  # nobody takes it now
    until(lambda: posts_counted(client) == {"sent": 1.0, "failed": 1.0})


def test_what_creeps_is_posted_once_when_it_begins_and_once_when_it_ends(
    client: httpx.Client, worker: WorkerProcess, until: Until, database: Database, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Each check agrees and their sums do not; a second worker and a restart tell nothing again."""
    secret = tmp_path / "webhook-secret"
    secret.write_bytes(SECRET)
    secret.chmod(0o600)
    arm = some_arm(np.random.default_rng(3))
    watched = Watched(client, until, arm, "arm")
    version = watched.calibrated(database)
    made = [watched.checked_here(database, arm, 100 + day, day) for day in range(25)]
    size = np.median([one["value"] for said in made for one in said["smallest"] if one["name"] == "zero_2"])
    moved = arm.after("zero_2", 0.5 * float(np.radians(size)))
    for day in range(15):
        watched.checked_here(database, moved, 200 + day, 25 + day)
    assert watched.history()["state"] == "creeping"
    with serving(Peer([200])) as peer:
        monkeypatch.setenv("KILTER_WEBHOOK_URL", peer.url)
        monkeypatch.setenv("KILTER_WEBHOOK_SECRET", str(secret))

        def told() -> list[dict[str, Any]]:
            return [one for one in map(json.loads, (body for _, _, body in peer.posts)) if one["event"] != "check"]

        worker.start()
        assert watched.checked(moved, 300, 40)["verdict"] == "ok"
        began = watched.history()
        assert began["state"] == "creeping"
        until(lambda: len(told()) == 1)
        (said,) = told()
        _, headers, body = next(one for one in peer.posts if json.loads(one[2])["event"] == "creeping_began")
        assert genuine(headers, body)
        assert headers["Kilter-Delivery"] == f"{said['job_id']}-creeping_began"
        assert (said["event"], said["robot"], said["version_id"]) == ("creeping_began", "arm", version)
        assert (said["state"], said["sentence"]) == ("creeping", began["sentence"])
        assert said["job_id"] == began["last"]["job_id"]
        highest = max(
            (one for one in began["charts"] if one["alarms"]), key=lambda one: max(one["up"][-1], one["down"][-1])
        )
        assert said["causes"][0] == {"name": highest["name"], "words": highest["words"]}
        assert datetime.fromisoformat(said["since"]) == datetime.fromisoformat(highest["since"])
        assert "kilter watch drift arm" in said["remedy"]

        worker.stop()
        worker.start()
        mild = arm.after("zero_2", 0.25 * float(np.radians(size)))  # which by itself hardly alarms
        assert watched.checked(mild, 301, 41)["verdict"] == "ok"
        assert watched.history()["state"] == "creeping"  # still: a worker that was restarted knows that it was told
        assert len(told()) == 1
        client.post("/v1/robots/arm/repairs", json={"what": "mastered anew"}).raise_for_status()
        webhook = Webhook(peer.url, SECRET, 5.0, ())
        first, second = (CreepingPosts(database, webhook, clock=lambda: 1e9) for _ in range(2))
        first.post_changes_if_due()
        second.post_changes_if_due()
        until(lambda: len(told()) == 2)
        ended = told()[1]
        assert (ended["event"], ended["job_id"], ended["state"]) == ("creeping_ended", said["job_id"], "never")
        assert ended["sentence"].startswith("Not checked since the repair of ")
        assert (ended["since"], ended["causes"], ended["remedy"]) == (None, [], "")
        first.post_changes_after_check("arm")
        webhook.settle(5.0)
        assert len(told()) == 2
