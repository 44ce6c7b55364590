from __future__ import annotations

import stat
from collections.abc import Callable

import httpx
import pytest
from fastapi import APIRouter, Depends, FastAPI

from kilter_service import problems
from kilter_service.auth.access import Admin, reader
from kilter_service.auth.token import admin_token, check_binding
from kilter_service.errors import ServiceError
from kilter_service.settings import Settings

Serve = Callable[[FastAPI], httpx.Client]


def guarded(settings: Settings) -> FastAPI:
    app = FastAPI()
    problems.install(app)
    app.state.settings, app.state.token = settings, admin_token(settings)
    router = APIRouter()

    @router.post("/change")
    def change(actor: Admin) -> str:
        return actor

    @router.get("/read")
    def read() -> str:
        return "read"

    app.include_router(router, dependencies=[Depends(reader)])
    return app


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


def test_changes_need_the_token(settings: Settings, serve: Serve) -> None:
    client = serve(guarded(settings))
    assert client.get("/read").status_code == 200
    assert client.post("/change").json()["code"] == "token_missing"
    wrong = client.post("/change", headers={"Authorization": "Bearer wrong"})
    assert (wrong.status_code, wrong.json()["code"]) == (401, "token_wrong")
    right = client.post("/change", headers={"Authorization": f"Bearer {admin_token(settings)}"})
    assert right.json() == "admin"


def test_reads_are_open_on_loopback_only(settings: Settings, serve: Serve) -> None:
    client = serve(guarded(settings.model_copy(update={"host": "0.0.0.0"})))
    assert client.get("/read").json()["code"] == "token_missing"


def test_listening_beyond_this_machine_needs_a_token(settings: Settings) -> None:
    wide = settings.model_copy(update={"host": "0.0.0.0"})
    with pytest.raises(ServiceError, match="KILTER_TOKEN"):
        check_binding(wide)
    admin_token(wide)
    check_binding(wide)


def test_settings_reach_a_child_process_unchanged(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    given = Settings(**{**settings.model_dump(), "token": "t0ken", "worker_name": "w1", "site": "lab"})
    for name, value in given.environment().items():
        monkeypatch.setenv(name, value)
    assert Settings() == given
