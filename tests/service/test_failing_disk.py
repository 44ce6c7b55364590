"""A disk that is full, read-only or broken: a sentence with the remedy, nothing half stored, and all goes on afterwards."""

from __future__ import annotations

import json
import os
import resource
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest
from sqlalchemy import event

from kilter_service.ground.db import Database
from kilter_service.ground.db.failures import in_words
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, Serve, ready

REPOSITORY = Path(__file__).resolve().parents[2]
ROWS = 10_000


def noise(rows: int = ROWS, seed: int = 0) -> bytes:
    """Rows of a Katana that do not compress."""
    columns = Katana().columns(rows, seed)
    cells = zip(*columns.values(), strict=True)
    return "\n".join([",".join(columns), *(",".join(f"{v:.14f}" for v in row) for row in cells)]).encode()


def send(client: httpx.Client, campaign: str, body: bytes) -> httpx.Response:
    url = f"/v1/campaigns/{campaign}/observations"
    return client.post(url, content=body, headers={"Content-Type": "text/csv"}, timeout=60)


def new_campaign(client: httpx.Client) -> str:
    client.post("/v1/robots", json=Katana.document).raise_for_status()
    return str(client.post("/v1/robots/katana/campaigns", json={"name": "one"}).raise_for_status().json()["id"])


def test_a_full_database_refuses_and_goes_on(settings: Settings, database: Database, serve: Serve) -> None:
    if settings.database_url is not None:
        pytest.skip("the database is PostgreSQL")
    most = [1 << 30]
    app = create_app(settings)
    client = serve(app)
    client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
    campaign = new_campaign(client)

    @event.listens_for(app.state.database.engine, "begin")
    def limit(connection: object) -> None:
        connection.exec_driver_sql(f"PRAGMA max_page_count={most[0]}")  # type: ignore[attr-defined]

    most[0] = 1  # SQLite takes the pages that there are, and no more
    refused = send(client, campaign, noise())
    assert (refused.status_code, refused.json()["code"]) == (507, "disk_full")
    assert "Make room there" in refused.json()["detail"]
    assert client.get(f"/v1/campaigns/{campaign}").json()["uploads"] == []
    most[0] = 1 << 30
    assert send(client, campaign, noise()).status_code == 201
    assert client.get(f"/v1/campaigns/{campaign}").json()["rows"] == ROWS


@contextmanager
def api(settings: Settings, *before: str, most_bytes: int | None = None) -> Iterator[httpx.Client]:
    """`kilterd api` as a process, whose files may have ``most_bytes`` each."""
    limit = None if most_bytes is None else lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))
    command = [*before, sys.executable, "-m", "kilter_service", "api"]
    environment = {**os.environ, **settings.environment()}
    process = subprocess.Popen(
        command,
        env=environment,
        cwd=REPOSITORY,
        stdout=subprocess.PIPE,
        preexec_fn=limit,
    )
    try:
        assert process.stdout is not None
        said = json.loads(process.stdout.readline() or b"{}")
        token = admin_token(settings)
        with httpx.Client(base_url=said["url"], headers={"Authorization": f"Bearer {token}"}, timeout=60) as client:
            yield client
    finally:
        process.terminate()
        process.wait(20)
        process.stdout.close()


def test_a_body_that_does_not_fit_on_the_disk(settings: Settings, migrated: Path) -> None:
    if settings.database_url is not None:
        pytest.skip("one kind of database is enough")
    ready(settings, migrated)
    most = settings.data.joinpath("kilter.sqlite").stat().st_size + (1 << 20)
    with api(settings, most_bytes=most) as client:
        campaign = new_campaign(client)
        refused = send(client, campaign, noise())  # 1.4 MB
        assert (refused.status_code, refused.json()["code"]) == (507, "disk_full"), refused.text
        assert [
            path for path in settings.data.joinpath("tmp").rglob("*") if path.is_file() and path.stat().st_size
        ] == []
        assert send(client, campaign, noise(100)).status_code == 201


def test_a_small_file_system_that_fills_up(settings: Settings, migrated: Path, tmp_path: Path) -> None:
    """The real thing: the kernel says that no space is left, to the spool and to SQLite's log."""
    namespace = ["unshare", "--user", "--map-root-user", "--mount"]
    mounted = f"mount -t tmpfs -o size=6m none {settings.data}"
    settings.data.mkdir(parents=True)
    if not shutil.which("unshare") or subprocess.run([*namespace, "sh", "-c", mounted], capture_output=True).returncode:
        pytest.skip("this account may not mount a file system of its own")
    if settings.database_url is not None:
        pytest.skip("the database is PostgreSQL")
    admin_token(settings)
    copied = f"cp {settings.token_file} {tmp_path} && {mounted} && cp {tmp_path}/token {migrated} {settings.data}/"
    script = f'{copied} && exec "$@"'
    with api(settings, *namespace, "sh", "-c", script, "sh") as client:
        campaign = new_campaign(client)
        sizes = []
        for seed in range(40):
            answer = send(client, campaign, noise(4000, seed))
            sizes.append(answer.status_code)
            if answer.status_code != 201:
                break
        assert sizes[-1] == 507, sizes
        assert answer.json()["code"] == "disk_full"
        stored = client.get(f"/v1/campaigns/{campaign}").json()
        assert stored["rows"] == 4000 * (len(sizes) - 1)
        assert client.get("/v1/robots").status_code == 200


def test_other_failures_have_their_sentence(tmp_path: Path) -> None:
    path = tmp_path / "some.sqlite"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE t (a)")
    connection.close()
    said = {}
    with (
        sqlite3.connect(f"file:{path}?mode=ro", uri=True) as connection,
        pytest.raises(sqlite3.OperationalError) as read,
    ):
        connection.execute("INSERT INTO t VALUES (1)")
    connection.close()
    said["disk_read_only"] = read.value
    writer, other = sqlite3.connect(path), sqlite3.connect(path, timeout=0)
    writer.execute("BEGIN IMMEDIATE")
    with pytest.raises(sqlite3.OperationalError) as locked:
        other.execute("BEGIN IMMEDIATE")
    said["database_busy"] = locked.value
    writer.close()
    other.close()
    for code, error in said.items():
        known = in_words(error)
        assert known is not None
        assert known.code == code
        assert known.message.endswith(("send it again.", "in a few seconds."))
    assert in_words(ValueError("nothing of a disk")) is None
    assert in_words(sqlite3.OperationalError("no such table: t")) is None
