from __future__ import annotations

import stat
from collections.abc import Callable

import httpx
import pytest
from fastapi import FastAPI

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.web.auth.token import admin_token, check_binding

Serve = Callable[[FastAPI], httpx.Client]


def test_the_token_is_made_once_and_only_its_owner_reads_it(settings: Settings) -> None:
    token = admin_token(settings)
    assert len(token) > 40
    assert stat.S_IMODE(settings.token_file.stat().st_mode) == 0o600
    assert admin_token(settings) == token
    assert [path.name for path in settings.data.iterdir()] == ["token"]


def test_a_token_file_others_can_read_is_refused(settings: Settings) -> None:
    admin_token(settings)
    settings.token_file.chmod(0o644)
    with pytest.raises(ServiceError, match="chmod 600"):
        admin_token(settings)


@pytest.mark.parametrize("token", ["", "x", "short-but-not-so-short", "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa", "ü" * 40])
def test_a_token_that_can_be_guessed_is_refused_with_a_remedy(
    settings: Settings, monkeypatch: pytest.MonkeyPatch, token: str
) -> None:
    monkeypatch.setenv("KILTER_TOKEN", token)
    with pytest.raises(ValueError, match=r"secrets\.token_urlsafe") as caught:
        Settings()
    assert token == "" or token not in caught.value.errors()[0]["msg"]
    monkeypatch.delenv("KILTER_TOKEN")
    settings.data.mkdir()
    settings.token_file.touch(mode=0o600)
    settings.token_file.write_text(token)
    with pytest.raises(ServiceError, match="delete the file"):
        admin_token(settings)
    settings.token_file.unlink()
    assert admin_token(settings)


def test_listening_beyond_this_machine_needs_a_token(settings: Settings) -> None:
    wide = settings.model_copy(update={"host": "0.0.0.0"})
    with pytest.raises(ServiceError, match="KILTER_TOKEN"):
        check_binding(wide)
    admin_token(wide)
    check_binding(wide.model_copy(update={"proxy": "10.0.0.1"}))


def test_settings_reach_a_child_process_unchanged(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    given = Settings(
        **{**settings.model_dump(), "token": "a-token-with-24-characters", "worker_name": "w1", "site": "lab"}
    )
    for name, value in given.environment().items():
        monkeypatch.setenv(name, value)
    assert Settings() == given
