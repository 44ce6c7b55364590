"""The job engine's database as an attacker may have changed it, and as an older Kilter left it; a real worker reads it."""

from __future__ import annotations

import base64
import json
import os
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import Connection, Engine, create_engine, inspect, make_url, text

from kilter_service.settings import Settings

Until = Callable[..., None]
FINAL = ("succeeded", "failed", "cancelled")
# The columns in which DBOS keeps what programs hand it.
LOADED = {"inputs", "output", "error", "message", "value", "context"}


class Command:
    """Unpickled, it makes a file."""

    def __init__(self, mark: Path) -> None:
        self._mark = mark

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self._mark),)


def bomb(mark: Path) -> str:
    return base64.b64encode(pickle.dumps(Command(mark))).decode()


@contextmanager
def engine_database(settings: Settings) -> Iterator[Connection]:
    url = make_url(settings.jobs_database)
    postgresql = url.get_backend_name() == "postgresql"
    engine: Engine = create_engine(url.set(drivername="postgresql+psycopg") if postgresql else url)
    with engine.begin() as connection:
        if postgresql:
            connection.execute(text("SET search_path TO dbos"))
        yield connection
    engine.dispose()


def queued(client: httpx.Client, katana: Any, worker: Any, until: Until) -> str:
    """Return a job in the queue of an engine without a worker."""
    campaign = katana.campaign(client, 60)
    worker.start()  # makes the engine's tables
    assert worker.stop() == 0
    job = {"kind": "identify", "robot": "katana", "campaigns": [campaign], "options": {"level": 1}}
    return str(client.post("/v1/jobs", json=job).raise_for_status().json()["id"])


def ended(client: httpx.Client, job: str, until: Until) -> dict[str, Any]:
    until(lambda: client.get(f"/v1/jobs/{job}").json()["state"] in FINAL, seconds=60)
    found: dict[str, Any] = client.get(f"/v1/jobs/{job}").json()
    return found


def insert(connection: Connection, table: str, **values: Any) -> None:
    names = ", ".join(f'"{name}"' for name in values)
    places = ", ".join(f":{name}" for name in values)
    connection.execute(text(f"INSERT INTO {table} ({names}) VALUES ({places})"), values)


def fill_all(connection: Connection, job: str, pickled: str, form: str) -> set[tuple[str, str]]:
    """Write the pickle into every column that may be loaded; returns which there are."""
    schema = "dbos" if connection.dialect.name == "postgresql" else None
    tables = {
        table: {column["name"] for column in inspect(connection).get_columns(table, schema=schema)}
        for table in inspect(connection).get_table_names(schema=schema)
    }
    tables = {table: columns for table, columns in tables.items() if columns & LOADED}
    insert(
        connection, "operation_outputs", workflow_uuid=job, function_id=1, function_name="compute", output=pickled,
        started_at_epoch_ms=1, completed_at_epoch_ms=2, serialization=form,
    )  # fmt: skip
    event = {"workflow_uuid": job, "key": "progress", "value": pickled, "serialization": form}
    insert(connection, "workflow_events", **event)
    insert(connection, "workflow_events_history", **event, function_id=1)
    insert(connection, "streams", **event, function_id=1, offset=0)
    insert(connection, "notifications", destination_uuid=job, topic="t", message=pickled, serialization=form)
    insert(
        connection, "workflow_schedules", schedule_id="s1", schedule_name="s1", workflow_name="kilter.job",
        schedule="* * * * * *", context=pickled,
    )  # fmt: skip
    for table, columns in (("workflow_input", ("inputs",)), ("workflow_output", ("output", "error"))):
        connection.execute(text(f"DELETE FROM {table} WHERE workflow_uuid = :job"), {"job": job})
        insert(connection, table, workflow_uuid=job, retention_timestamp=1 << 42, **dict.fromkeys(columns, pickled))
    if "event_dispatch_kv" in tables:  # PostgreSQL only
        named = {"service_name": "s", "workflow_fn_name": "kilter.job", "key": "k"}
        insert(connection, "event_dispatch_kv", **named, value=pickled)
    words = "inputs = :pickled, output = :pickled, error = :pickled, serialization = :form"
    filled = {"pickled": pickled, "form": form, "job": job}
    connection.execute(text(f"UPDATE workflow_status SET {words} WHERE workflow_uuid = :job"), filled)
    return {(table, column) for table, columns in tables.items() for column in columns & LOADED}


@pytest.mark.parametrize("form", ["py_pickle", "custom_serializer"])
def test_a_pickle_in_any_column_runs_nothing_and_fails_its_job_only(
    client: httpx.Client, katana: Any, worker: Any, until: Until, settings: Settings, tmp_path: Path, form: str
) -> None:
    job, mark = queued(client, katana, worker, until), tmp_path / "attacked"
    with engine_database(settings) as connection:
        columns = fill_all(connection, job, bomb(mark), form)
    known = {
        ("workflow_status", "inputs"), ("workflow_status", "output"), ("workflow_status", "error"),
        ("workflow_input", "inputs"), ("workflow_output", "output"), ("workflow_output", "error"),
        ("operation_outputs", "output"), ("operation_outputs", "error"), ("notifications", "message"),
        ("workflow_events", "value"), ("workflow_events_history", "value"), ("streams", "value"),
        ("workflow_schedules", "context"), ("event_dispatch_kv", "value"),
    }  # fmt: skip
    assert columns <= known, "DBOS has a new column: attack it as well"
    worker.start()
    done = ended(client, job, until)
    assert done["state"] == "failed", done
    assert done["error"]["code"] == "internal_error"
    assert "Give the job again" in done["error"]["message"]
    assert not mark.exists()
    again = client.post("/v1/jobs", json={k: done[k] for k in ("kind", "robot", "campaigns", "options")}).json()
    assert ended(client, again["id"], until)["state"] == "succeeded"
    assert not mark.exists()
    assert worker.stop() == 0


def test_a_pickle_among_the_results_of_steps_runs_nothing(
    client: httpx.Client, katana: Any, worker: Any, until: Until, settings: Settings, tmp_path: Path
) -> None:
    """The row of the job is sound; what the first step is said to have returned, is not."""
    for column in ("output", "error"):
        job, mark = queued(client, katana, worker, until), tmp_path / f"attacked-{column}"
        with engine_database(settings) as connection:
            insert(
                connection, "operation_outputs", workflow_uuid=job, function_id=1, function_name="compute",
                started_at_epoch_ms=1, completed_at_epoch_ms=2, serialization="py_pickle", **{column: bomb(mark)},
            )  # fmt: skip
        worker.start()
        done = ended(client, job, until)
        assert done["state"] == "failed", done
        assert "pickle" in done["error"]["message"]
        assert not mark.exists()
        assert worker.stop() == 0


def test_the_api_reads_no_pickle_either(
    client: httpx.Client, katana: Any, worker: Any, until: Until, settings: Settings, tmp_path: Path
) -> None:
    job, mark = queued(client, katana, worker, until), tmp_path / "attacked"
    with engine_database(settings) as connection:
        fill_all(connection, job, bomb(mark), "py_pickle")
    assert client.post(f"/v1/jobs/{job}/cancel").json()["state"] == "cancelled"
    from kilter_service.jobs.queue import JobQueue

    queue = JobQueue(settings)
    found = queue.row(job)
    assert found is not None
    assert not found.readable
    queue.close()
    assert not mark.exists()


def test_what_the_engine_writes_is_json(
    client: httpx.Client, katana: Any, worker: Any, until: Until, settings: Settings
) -> None:
    job = queued(client, katana, worker, until)
    worker.start()
    assert ended(client, job, until)["state"] == "succeeded"
    with engine_database(settings) as connection:
        for table in ("workflow_status", "operation_outputs"):
            for row in connection.execute(text(f"SELECT * FROM {table}")).mappings():
                assert row["serialization"] == "portable_json"
                for column in LOADED & set(row) - {"error"}:
                    if row[column] is not None:
                        json.loads(row[column])


def test_jobs_queued_by_an_older_kilter_are_started_anew(
    client: httpx.Client, katana: Any, worker: Any, until: Until, settings: Settings
) -> None:
    """Kilter wrote pickles until its jobs were of version 1; what a job asks for stands in Kilter's own database."""
    job = queued(client, katana, worker, until)
    old = base64.b64encode(pickle.dumps({"args": (job,), "kwargs": {}})).decode()
    words = "inputs = :old, serialization = 'py_pickle', application_version = 'kilter-jobs-1'"
    with engine_database(settings) as connection:
        connection.execute(
            text(f"UPDATE workflow_status SET {words} WHERE workflow_uuid = :job"), {"old": old, "job": job}
        )
    worker.start()
    done = ended(client, job, until)
    assert done["state"] == "succeeded", done
