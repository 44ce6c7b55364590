"""`/docs` without internet: what the page loads, and what Chromium shows of it where that is installed."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import urljoin, urlsplit

import httpx
import pytest

from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app

from .conftest import ready, served

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")


class Page(HTMLParser):
    """Collects what a page loads, and what it holds that a strict policy refuses."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.inline: list[str] = []
        self._holds_code = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self._holds_code = tag in ("script", "style")
        self.loaded += [value for name in ("src", "href") if tag != "a" and (value := named.get(name))]
        self.inline += [f"{tag} {name}" for name in named if name.startswith("on") or name == "style"]

    def handle_data(self, data: str) -> None:
        if self._holds_code and data.strip():
            self.inline.append(data)

    def handle_endtag(self, tag: str) -> None:
        self._holds_code = False


def test_the_page_and_all_it_loads_come_from_this_server(shared_client: httpx.Client) -> None:
    answer = shared_client.get("/docs").raise_for_status()
    page = Page(answer.text)
    assert page.inline == []
    assert len(page.loaded) == 3
    kinds = {".js": "text/javascript", ".css": "text/css"}
    for address in page.loaded:
        assert not urlsplit(address).netloc
        found = shared_client.get(urljoin("/docs", address)).raise_for_status()
        assert found.headers["content-type"].startswith(kinds[address[address.rindex(".") :]])
        # A style sheet may name further files: none of another host.
        if address.endswith(".css"):
            assert not re.findall(r"url\((?!['\"]?(?:data:|#))[^)]*|@import", found.text)
    policy = answer.headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "unsafe" not in policy


def test_it_needs_no_token_and_is_not_described(shared_client: httpx.Client) -> None:
    for path in ("/docs", "/docs/start.js", "/docs/swagger-ui.css"):
        assert httpx.get(shared_client.base_url.join(path), timeout=60).status_code == 200
    assert not [path for path in shared_client.get("/openapi.json").json()["paths"] if path.startswith("/docs")]


@pytest.mark.parametrize("name", ["favicon.png", "..%2f__init__.py", "start.css"])
def test_it_gives_no_other_file(shared_client: httpx.Client, name: str) -> None:
    refused = shared_client.get(f"/docs/{name}")
    assert refused.status_code == 404
    assert refused.json()["code"] == "not_found"


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: the page is parsed only")
def test_chromium_shows_every_route_and_complains_of_nothing(shared_client: httpx.Client, tmp_path: Path) -> None:
    command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--v=0"]
    command += [f"--user-data-dir={tmp_path}", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
    command += ["--virtual-time-budget=60000", "--dump-dom", str(shared_client.base_url.join("/docs"))]
    shown = subprocess.run(command, capture_output=True, text=True, check=False, timeout=200)
    operations = [
        found["operationId"]
        for methods in shared_client.get("/openapi.json").json()["paths"].values()
        for found in methods.values()
    ]
    assert shown.stdout.count('<div class="opblock ') == len(operations) > 30, shown.stderr[-2000:]
    complaints = [line for line in shown.stderr.splitlines() if "CONSOLE" in line and "favicon" not in line]
    assert not complaints


def test_the_description_is_kept_as_text_alone(tmp_path: Path, migrated: Path) -> None:
    settings = Settings(data=tmp_path, host="127.0.0.1", token=None)
    ready(settings, migrated)
    app = create_app(settings)
    app.root_path = "/kilter"
    with served(app) as client:
        answers = [client.get("/openapi.json").raise_for_status().json() for _ in range(2)]
    assert app.openapi_schema is None
    assert answers[0] == answers[1] == {**app.openapi(), "servers": [{"url": "/kilter"}]}
