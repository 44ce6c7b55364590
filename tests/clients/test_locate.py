"""Where the server is found, and where its token must not go."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kilter_client import ServerUnreachableError
from kilter_client.requests.connection import Place, locate


@pytest.fixture
def data(no_settings: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "token").write_text("of the file\n")
    monkeypatch.setenv("KILTER_DATA", str(folder))
    return folder


def test_the_running_server(data: Path) -> None:
    (data / "server.json").write_text(json.dumps({"url": "http://127.0.0.1:1234", "pid": 1}))
    assert locate() == Place("http://127.0.0.1:1234", "of the file")


def test_the_default_data_folder(no_settings: None, tmp_path: Path) -> None:
    from kilter_service.ground.settings import default_data

    folder = default_data()
    assert folder.is_relative_to(tmp_path)
    folder.mkdir(parents=True)
    (folder / "server.json").write_text('{"url": "http://127.0.0.1:1"}')
    assert locate() == Place("http://127.0.0.1:1", None)


def test_the_environment_goes_before_the_files(data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KILTER_URL", "http://localhost:99/")
    assert locate() == Place("http://localhost:99", "of the file")
    monkeypatch.setenv("KILTER_TOKEN", "of the environment")
    assert locate() == Place("http://localhost:99", "of the environment")
    assert locate("http://[::1]:5", "given") == Place("http://[::1]:5", "given")


@pytest.mark.parametrize("url", ["http://lab.example:8730", "http://10.0.0.1", "http://127.0.0.1.example.org"])
def test_the_token_file_stays_on_this_machine(data: Path, url: str) -> None:
    assert locate(url) == Place(url, None)


def test_no_server(data: Path) -> None:
    with pytest.raises(ServerUnreachableError, match="kilterd serve"):
        locate()


@pytest.mark.parametrize("content", ["", "[]", "{}", "null"])
def test_a_damaged_server_file(data: Path, content: str) -> None:
    (data / "server.json").write_text(content)
    with pytest.raises(ServerUnreachableError, match="cannot be read as a server's address"):
        locate()
