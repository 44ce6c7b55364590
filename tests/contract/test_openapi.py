"""The HTTP interface is a promise: a change of it must be seen, in the snapshot beside this file."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app

SNAPSHOT = Path(__file__).with_name("openapi.json")
PROMISED = {
    "POST /v1/robots",
    "POST /v1/robots/{robot}/campaigns",
    "POST /v1/campaigns/{campaign}/observations",
    "POST /v1/jobs",
    "GET /v1/jobs/{job}",
    "GET /v1/jobs/{job}/events",
    "POST /v1/jobs/{job}/cancel",
    "GET /v1/robots/{robot}/versions",
    "GET /v1/versions/{version}",
    "POST /v1/versions/{version}/activate",
    "POST /v1/robots/{robot}/rollback",
    "GET /v1/versions/{version}/export",
    "GET /v1/versions/{a}/diff/{b}",
    "POST /v1/robots/{robot}/correct",
}


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    found = create_app(Settings(data=tmp_path_factory.mktemp("nothing"))).openapi()
    # The version is that of the installed distribution, which is no part of the promise.
    found["info"]["version"] = "0"
    return found


def test_the_interface_is_the_snapshot(document: dict[str, Any]) -> None:
    """Run with KILTER_WRITE_SNAPSHOTS=1 to accept a change, and say it in the changelog."""
    text = json.dumps(document, indent=1, sort_keys=True) + "\n"
    if os.environ.get("KILTER_WRITE_SNAPSHOTS"):
        SNAPSHOT.write_text(text, encoding="utf-8")
    assert text == SNAPSHOT.read_text(encoding="utf-8")


def test_what_the_contract_promises_is_there(document: dict[str, Any]) -> None:
    paths = document["paths"]
    there = {f"{method.upper()} {path}" for path, methods in paths.items() for method in methods}
    assert there >= PROMISED


def test_every_route_says_whether_it_needs_a_token_and_of_which_role(document: dict[str, Any]) -> None:
    (scheme,) = document["components"]["securitySchemes"].values()
    assert (scheme["type"], scheme["scheme"]) == ("http", "bearer")
    operations = {
        f"{m.upper()} {path}": one for path, methods in document["paths"].items() for m, one in methods.items()
    }
    assert all("security" in one for one in operations.values())
    assert not operations["GET /v1/health"]["security"]
    read, change = operations["GET /v1/robots"], operations["POST /v1/versions/{version}/activate"]
    assert (read["x-kilter-role"], read["security"]) == ("viewer", [{"token": []}, {}])
    assert (change["x-kilter-role"], change["security"]) == ("operator", [{"token": []}])
    assert operations["GET /v1/audit"]["security"] == [{"token": []}]


def test_every_route_says_that_errors_are_problem_documents(document: dict[str, Any]) -> None:
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            for status in ("4XX", "422", "5XX"):
                (media,) = operation["responses"][status]["content"]
                assert media == "application/problem+json", (method, path, status)
                schema = operation["responses"][status]["content"][media]["schema"]
                assert schema["$ref"].endswith("/Problem"), (method, path)
            assert operation["summary"]
