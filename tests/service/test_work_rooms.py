"""Each kind of work has a room: dropped files, and whatever else strangers send, hold up no correction."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, get_args

import httpx
import pytest

from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import Scratch
from kilter_service.ground.settings import Settings
from kilter_service.page.drop import routes
from kilter_service.page.drop.drafts import Drafts
from kilter_service.run.app import create_app
from kilter_service.web.auth.policy import PAGE_RULES, RULES, Kind
from kilter_service.web.auth.token import admin_token
from kilter_service.web.bodies import Room, rooms_by_kind
from tests.service.conftest import Katana, Serve
from tests.service.made_versions import store_version

Until = Callable[..., None]
DROP = "/robots/katana/campaigns/new/file"


class Gate:
    """A reading of dropped files that first waits until it is let go."""

    def __init__(self, read: Callable[..., None]) -> None:
        self.go, self.inside, self._read = threading.Event(), 0, read

    def __call__(self, *given: Any) -> None:
        self.inside += 1
        assert self.go.wait(60)
        self._read(*given)


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Iterator[Gate]:
    gate = Gate(routes.read)
    monkeypatch.setattr(routes, "read", gate)
    yield gate
    gate.go.set()


class Arms:
    """A server with an arm that is corrected, and people with tokens of their own."""

    def __init__(self, settings: Settings, database: Database, serve: Serve, katana: Katana) -> None:
        self.app = create_app(settings)
        self.client = serve(self.app)
        self.client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        katana.campaign(self.client, 20, 1)
        self._version = store_version(database, katana.name, 1)
        self._path = {name: values for name, values in katana.columns(5, 3).items() if name.startswith("q")}

    def person(self, name: str) -> dict[str, str]:
        asked = self.client.post("/v1/tokens", json={"name": name, "role": "operator"}).raise_for_status().json()
        return {"Authorization": f"Bearer {asked['token']}"}

    def drop(self, person: dict[str, str]) -> httpx.Response:
        return self.client.post(DROP, params={"name": "a.csv"}, content=b"A1;X\n1;2\n", headers=person)

    def correct(self) -> int:
        address = f"/v1/robots/katana/correct?version={self._version}"
        return self.client.post(address, json=self._path, timeout=30).status_code


@pytest.fixture
def arms(settings: Settings, database: Database, serve: Serve, katana: Katana) -> Arms:
    return Arms(settings, database, serve, katana)


def test_drops_hold_up_neither_corrections_nor_the_drops_of_others(arms: Arms, gate: Gate, until: Until) -> None:
    drops: Room = arms.app.state.rooms["drops"]
    drops.wait_s = None  # whose machine is busy waits longer than most
    first, second, third = (arms.person(name) for name in ("first", "second", "third"))
    with ThreadPoolExecutor(5) as pool:
        waiting = [pool.submit(arms.drop, first) for _ in range(4)]
        until(lambda: drops.open.total() == 4 and gate.inside == 1, seconds=30)
        fifth = arms.drop(first)
        assert (fifth.status_code, "too_many_open" in fifth.text) == (429, True)
        waiting.append(pool.submit(arms.drop, second))  # who has a slot of their own
        until(lambda: gate.inside == 2, seconds=30)
        drops.wait_s = 0.2
        busy = arms.drop(third)
        assert (busy.status_code, "busy" in busy.text) == (503, True)
        for refused in (fifth, busy):
            assert int(refused.headers["retry-after"]) > 0
        assert arms.correct() == 200
        assert arms.client.get("/v1/health/live").status_code == 200
        assert arms.client.post("/v1/robots/katana/rollback", json={}).status_code == 409  # there is none to return to
        gate.go.set()
        assert [answer.result(120).status_code for answer in waiting] == [201] * 5
    assert drops.open == drops.computing == {}


def test_a_file_that_waits_too_long_is_busy_and_leaves_nothing(arms: Arms, gate: Gate, until: Until) -> None:
    arms.app.state.rooms["drops"].wait_s = 0.2
    person = arms.person("one")
    with ThreadPoolExecutor(1) as pool:
        read = pool.submit(arms.drop, person)
        until(lambda: gate.inside == 1, seconds=30)
        assert [arms.drop(person).status_code for _ in range(5)] == [503] * 5
        gate.go.set()
        assert read.result(120).status_code == 201
    assert len([*(arms.app.state.scratch.folder / "drafts").iterdir()]) == 1


def test_a_file_read_anew_takes_a_slot_of_drops_only(arms: Arms, gate: Gate, until: Until) -> None:
    """It comes with a form, whose room others need for jobs."""
    gate.go.set()
    address = arms.drop({}).json()["address"]
    gate.go.clear()
    with ThreadPoolExecutor(1) as pool:
        read = pool.submit(arms.client.post, f"{address}/read", data={"way": "auto"})
        until(lambda: gate.inside == 2, seconds=30)
        computing = {kind: room.computing.total() for kind, room in arms.app.state.rooms.items()}
        assert {kind for kind, count in computing.items() if count} == {"drops"}
        assert arms.client.post(f"{address}/discard").status_code == 303
        gate.go.set()
        assert read.result(60).status_code == 200  # not of a folder that is gone


def test_the_rooms_of_the_routes() -> None:
    rules = {**RULES, **PAGE_RULES}
    rooms = rooms_by_kind(Settings())
    assert set(rooms) == set(get_args(Kind))
    assert [route for route, rule in rules.items() if rule.room == "corrections"] == [
        "POST /v1/robots/{robot}/correct", "POST /v1/robots/{robot}/torques",
    ]  # fmt: skip
    assert {route for route, rule in rules.items() if rule.room == "stops"} == {
        "POST /v1/versions/{version}/activate", "POST /v1/robots/{robot}/rollback", "POST /versions/{version}/activate",
        "POST /robots/{robot}/rollback",
    }  # fmt: skip
    for kind in ("corrections", "stops"):
        assert rooms[kind].slots_each < rooms[kind].slots
        assert rooms[kind].places_each < rooms[kind].places


def test_slots_are_taken_in_turn_and_given_back() -> None:
    async def run() -> None:
        room = Room(slots=2, places=4, slots_each=1, places_each=2)
        await room.take_slot("a", None)
        with pytest.raises(ServiceError, match="other requests of this kind"):
            await room.take_slot("a", 0.01)
        await room.take_slot("b", 0.01)
        assert room.is_full
        waiting = [asyncio.create_task(room.take_slot(person, 5.0)) for person in ("a", "c")]
        await asyncio.sleep(0)
        await room.release_slot("b")
        await waiting[1]
        assert not waiting[0].done()
        await room.release_slot("a")
        await waiting[0]
        assert dict(room.computing) == {"a": 1, "c": 1}

    asyncio.run(run())


def test_a_draft_in_use_keeps_its_folder(tmp_path: Path) -> None:
    scratch = Scratch(tmp_path)
    drafts = Drafts(scratch)
    draft = drafts.new("arm", "me", "a.csv")
    with drafts.in_use(draft):
        others = [drafts.new("arm", "me", f"{k}.csv") for k in range(5)]
        assert draft.folder.exists()
        assert not others[0].folder.exists()
        drafts.discard(draft)
        assert draft.folder.exists()
    assert not draft.folder.exists()
    with pytest.raises(ServiceError, match="no longer here"), drafts.in_use(draft):
        pass
    scratch.close()
