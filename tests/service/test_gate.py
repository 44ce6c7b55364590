"""What comes from a page of another site, by another name, past the proxy or in the clear; and HTTPS of the server itself."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI
from pydantic import ValidationError

from kilter_client import Kilter, ServerUnreachableError, UsageError
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token, check_binding
from tests.service.forked import ForkedPopen

from .conftest import REPOSITORY, ready

Serve = Callable[[FastAPI], httpx.Client]
PLAIN = {"Authorization": ""}


def code(answer: httpx.Response) -> str:
    return "" if answer.status_code < 400 else str(answer.json()["code"])


@pytest.mark.parametrize(
    "host", ["attacker.example", "localhost.attacker.example", "attacker.example:8730", "127.0.0.1.nip.example", ""]
)
def test_a_name_that_somebodys_dns_points_here_is_not_answered(shared_client: httpx.Client, host: str) -> None:
    """Not even with the token, and not on the pages that need none: a page of that name could read the answer."""
    for path in ("/v1/robots", "/v1/health/live", "/docs", "/openapi.json"):
        answer = shared_client.get(path, headers={"Host": host})
        assert (answer.status_code, code(answer)) == (421, "host_refused"), path
        assert "KILTER_HOSTS" in answer.json()["detail"]


@pytest.mark.parametrize(
    "host", ["localhost", "LOCALHOST:1", "127.0.0.1", "127.3.2.1:80", "[::1]:8730", "localhost.:8730"]
)
def test_names_of_this_machine_read_without_a_token(shared_client: httpx.Client, host: str) -> None:
    assert shared_client.get("/v1/robots", headers={**PLAIN, "Host": host}).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Forwarded": "for=203.0.113.9"}, {"X-Forwarded-For": "127.0.0.1"}, {"X-Forwarded-Proto": "https"},
        {"X-Forwarded-Host": "localhost"}, {"X-Real-IP": "127.0.0.1"}, {"Via": "1.1 proxy"}, {"Host": "192.0.2.7:8730"},
        {"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"},
    ],
)  # fmt: skip
def test_what_was_passed_on_needs_a_token(shared_client: httpx.Client, headers: dict[str, str]) -> None:
    assert code(shared_client.get("/v1/robots", headers=PLAIN | headers)) == "token_missing"
    assert shared_client.get("/v1/robots", headers=headers).status_code == 200


def test_further_names_are_those_of_the_settings(settings: Settings, database: Database, serve: Serve) -> None:
    client = serve(create_app(settings.model_copy(update={"hosts": "cell.example, Kilter.Example"})))
    for host in ("cell.example", "kilter.example:443"):
        assert client.get("/v1/health/live", headers={"Host": host}).status_code == 200
        assert code(client.get("/v1/robots", headers={"Host": host})) == "token_missing"
    assert code(client.get("/v1/robots", headers={"Host": "other.example"})) == "host_refused"


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "https://attacker.example"}, {"Origin": "null"}, {"Origin": "http://localhost:3000"},
        {"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"},
    ],
)  # fmt: skip
def test_a_page_of_another_site_changes_nothing(shared_client: httpx.Client, headers: dict[str, str]) -> None:
    answer = shared_client.post("/v1/frames", content=b"{", headers=headers)
    assert (answer.status_code, code(answer)) == (403, "origin_refused")
    asked = shared_client.options("/v1/robots", headers=headers | {"Access-Control-Request-Method": "POST"})
    for one in (answer, asked, shared_client.get("/v1/robots", headers=headers)):
        assert not [name for name in one.headers if name.startswith("access-control-")]


def test_the_servers_own_page_may(shared_client: httpx.Client) -> None:
    base = shared_client.base_url
    headers = {"Origin": f"http://{base.host}:{base.port}", "Sec-Fetch-Site": "same-origin"}
    assert code(shared_client.post("/v1/frames", json={}, headers=headers)) != "origin_refused"


def test_behind_a_proxy_everybody_needs_a_token_and_is_recorded_by_the_proxys_word(
    settings: Settings, database: Database, serve: Serve
) -> None:
    behind = settings.model_copy(update={"proxy": "127.0.0.1,10.0.0.0/8"})
    client = serve(create_app(behind))
    assert code(client.get("/v1/robots")) == "token_missing"
    client.headers["Authorization"] = f"Bearer {admin_token(behind)}"
    robot = {"name": "arm", "convention": "preset", "preset": "ur10"}
    # The first was written by whoever sent it, the last one by a proxy of ours.
    passed = {"X-Forwarded-For": "1.2.3.4, 203.0.113.9, 10.0.0.7"}
    client.post("/v1/robots", json=robot, headers=passed).raise_for_status()
    (entry,) = client.get("/v1/audit").json()["entries"]
    assert entry["address"] == "203.0.113.9"


def test_past_the_proxy_nobody_is_answered(settings: Settings) -> None:
    import asyncio

    from kilter_service.web.gate import Gate

    reached, sent = [], []

    async def behind(scope: object, receive: object, send: object) -> None:
        reached.append(scope)

    async def send(message: dict[str, object]) -> None:
        sent.append(message)

    gate = Gate(behind, settings.model_copy(update={"proxy": "10.0.0.1", "host": "0.0.0.0"}))  # type: ignore[arg-type]
    for peer, answered in (("192.0.2.9", False), ("10.0.0.2", False), ("10.0.0.1", True), ("127.0.0.1", True)):
        scope = {
            "type": "http",
            "method": "GET",
            "path": "/",
            "headers": [(b"host", b"localhost")],
            "client": (peer, 1),
        }
        asyncio.run(gate(scope, None, send))  # type: ignore[arg-type]
        assert bool(reached) == answered, peer
        reached.clear()
    assert sent[0]["status"] == 403
    assert b"proxy_only" in sent[1]["body"]  # type: ignore[operator]


@pytest.mark.parametrize("proxy", ["nonsense", "10.0.0.1/33", "10.0.0.1;10.0.0.2"])
def test_a_proxy_that_is_no_address_is_refused(monkeypatch: pytest.MonkeyPatch, proxy: str) -> None:
    monkeypatch.setenv("KILTER_PROXY", proxy)
    with pytest.raises(ValidationError, match="proxy"):
        Settings()


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A certificate for localhost, signed by itself, and its key."""
    folder = tmp_path_factory.mktemp("tls")
    cert, key = folder / "cert.pem", folder / "key.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2",
         "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1", "-keyout", key, "-out", cert],
        check=True, capture_output=True, timeout=60,
    )  # fmt: skip
    return cert, key


def test_beyond_this_machine_only_with_tls_or_a_stated_proxy(
    settings: Settings, certificate: tuple[Path, Path]
) -> None:
    admin_token(settings)
    wide = {"host": "0.0.0.0"}
    with pytest.raises(ServiceError, match=r"in the clear: set KILTER_TLS_CERTIFICATE .* KILTER_PROXY"):
        check_binding(settings.model_copy(update=wide))
    check_binding(settings.model_copy(update=wide | {"proxy": "10.0.0.1"}))
    check_binding(
        settings.model_copy(update=wide | dict(zip(("tls_certificate", "tls_key"), certificate, strict=True)))
    )
    with pytest.raises(ServiceError, match="Set both"):
        check_binding(settings.model_copy(update={"tls_certificate": certificate[0]}))
    with pytest.raises(ServiceError, match="PEM files"):
        check_binding(settings.model_copy(update={"tls_certificate": certificate[0], "tls_key": certificate[0]}))


@pytest.fixture(scope="module")
def secure(tmp_path_factory: pytest.TempPathFactory, migrated: Path, certificate: tuple[Path, Path]) -> Iterator[str]:
    """`kilterd api` with its own certificate; gives its address."""
    settings = Settings(
        data=tmp_path_factory.mktemp("secure"), port=0, tls_certificate=certificate[0], tls_key=certificate[1]
    )
    ready(settings, migrated)
    command = [sys.executable, "-m", "kilter_service", "api"]
    environment = {**os.environ, **settings.environment()}
    with ForkedPopen(command, env=environment, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True) as api:
        assert api.stdout is not None
        document = json.loads(api.stdout.readline())
        os.environ["KILTER_DATA"], before = document["data"], os.environ.get("KILTER_DATA")
        try:
            yield document["url"]
        finally:
            os.environ.pop("KILTER_DATA")
            if before is not None:
                os.environ["KILTER_DATA"] = before
            api.terminate()


def test_the_client_speaks_https_with_an_authority_of_its_own(
    secure: str, certificate: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert secure.startswith("https://127.0.0.1:")
    monkeypatch.delenv("KILTER_URL", raising=False)
    monkeypatch.delenv("KILTER_TOKEN", raising=False)
    with Kilter() as kilter, pytest.raises(ServerUnreachableError, match="KILTER_CA"):
        kilter.robots.list()
    monkeypatch.setenv("KILTER_CA", str(certificate[0]))
    with Kilter() as kilter:
        kilter.robots.add({"name": "arm", "convention": "preset", "preset": "ur10"})
        assert [robot["name"] for robot in kilter.robots.list()] == ["arm"]
    monkeypatch.setenv("KILTER_CA", str(tmp_path / "missing.pem"))
    with pytest.raises(UsageError, match="KILTER_CA"):
        Kilter()
    with pytest.raises(httpx.HTTPError):
        httpx.get(secure.replace("https", "http") + "/v1/health/live", timeout=10)
