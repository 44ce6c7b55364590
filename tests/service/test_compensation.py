"""Whether a controller corrects by itself: asked, stored beside the document, and nothing corrected twice."""

from __future__ import annotations

import html
import logging
import re
from collections.abc import Callable
from typing import Any

import httpx
import pytest
from alembic import command
from sqlalchemy import text

from kilter_client import Kilter
from kilter_client.cli import main
from kilter_service.ground.db import Database, revision
from kilter_service.robots.compensation import CORRECTS, VALUES
from kilter_service.stream.corrector.active import DatabaseSource
from tests.service.made_versions import store_version

ARM = {"name": "arm", "convention": "preset", "preset": "katana450-chapter5"}
Answer = Callable[..., dict[str, Any]]


def add(client: httpx.Client, name: str, **stated: str) -> dict[str, Any]:
    found: dict[str, Any] = client.post("/v1/robots", json={**ARM, "name": name, **stated}).raise_for_status().json()
    return found


def say(client: httpx.Client, name: str, value: str) -> dict[str, Any]:
    answer = client.patch(f"/v1/robots/{name}", json={"controller_compensation": value})
    found: dict[str, Any] = answer.raise_for_status().json()
    return found


def hashes(robot: dict[str, Any]) -> tuple[str, str]:
    return robot["sha256"], robot["source_sha256"]


def codes(found: list[dict[str, Any]]) -> set[str]:
    return {one["code"] for one in found}


def test_it_is_a_setting_beside_the_document_that_no_hash_covers(client: httpx.Client, database: Database) -> None:
    plain = add(client, "arm")
    assert plain["controller_compensation"] == "unknown"
    version = store_version(database, "arm", 1)
    before = client.get(f"/v1/versions/{version}").json()
    for value in VALUES:
        stated = add(client, f"arm_{value}", controller_compensation=value)
        assert stated["controller_compensation"] == value
        assert stated["document"]["controller_compensation"] == value
        assert stated["sha256"] == plain["sha256"]
        again = say(client, "arm", value)
        assert (again["controller_compensation"], hashes(again)) == (value, hashes(plain))
        after = client.get(f"/v1/versions/{version}").json()
        assert (after["sha256"], after["robot_sha256"]) == (before["sha256"], before["robot_sha256"])
    listed = {one["name"]: one["controller_compensation"] for one in client.get("/v1/robots").json()["robots"]}
    assert listed["arm_factory"] == "factory"
    # What was said stays where the same document comes again; whoever sends it is told.
    told = add(client, "arm_none", controller_compensation="factory")
    assert told["controller_compensation"] == "none"
    assert any("kilter robot compensation arm_none factory" in note for note in told["notes"])
    assert not any("compensation" in note for note in add(client, "arm_none")["notes"])


@pytest.mark.parametrize("body", [{}, {"controller_compensation": "perhaps"}, {"controller": "none"}])
def test_what_is_no_answer_is_refused(client: httpx.Client, body: dict[str, str]) -> None:
    add(client, "arm", controller_compensation="factory")
    assert client.patch("/v1/robots/arm", json=body).status_code == 422
    assert client.get("/v1/robots/arm").json()["controller_compensation"] == "factory"
    assert client.post("/v1/robots", json={**ARM, "controller_compensation": "yes"}).status_code == 422


def test_stored_robots_read_as_unknown(database: Database) -> None:
    command.downgrade(revision.configuration(database.url), "0016")
    with database.engine.begin() as connection:
        connection.execute(
            text(
                "INSERT INTO robots (name, document, created_at, sha256, source_sha256) "
                "VALUES ('old', '{\"name\": \"old\"}', '2026-01-01', 'c0ffee', 'beef')"
            )
        )
    revision.migrate(database)
    with database.engine.connect() as connection:
        row = connection.execute(text("SELECT controller_compensation, sha256, source_sha256, document FROM robots"))
        assert tuple(row.one()) == ("unknown", "c0ffee", "beef", '{"name": "old"}')


def test_an_activation_warns_of_what_is_not_known_and_refuses_a_second_correction(
    client: httpx.Client, database: Database
) -> None:
    add(client, "arm")
    first, second = (store_version(database, "arm", number) for number in (1, 2))
    done = client.post(f"/v1/versions/{first}/activate").raise_for_status().json()
    assert "compensation_unknown" in codes(done["warnings"])
    (said,) = [one["message"] for one in done["warnings"] if one["code"] == "compensation_unknown"]
    assert "kilter robot compensation arm none" in said

    for value in sorted(CORRECTS):
        say(client, "arm", value)
        refused = client.post(f"/v1/versions/{second}/activate")
        assert (refused.status_code, refused.json()["code"]) == (409, "activation_refused")
        assert codes(refused.json()["context"]["objections"]) == {"corrected_twice"}
        assert "kilter robot compensation arm none" in refused.json()["detail"]
        assert client.get("/v1/robots/arm").json()["active_version"] == first
        # The one that is active already stays, and says it.
        kept = client.post(f"/v1/versions/{first}/activate").raise_for_status().json()
        assert "corrected_twice" in codes(kept["warnings"])

    say(client, "arm", "none")
    done = client.post(f"/v1/versions/{second}/activate").raise_for_status().json()
    assert not codes(done["warnings"]) & {"compensation_unknown", "corrected_twice"}
    say(client, "arm", "kilter")
    back = client.post("/v1/robots/arm/rollback").raise_for_status().json()  # never refused
    assert "corrected_twice" in codes(back["warnings"])
    forced = client.post(
        f"/v1/versions/{second}/activate", json={"force": True, "reason": "its file is in the controller"}
    )
    assert codes(forced.raise_for_status().json()["objections"]) == {"corrected_twice"}
    newest = client.get("/v1/robots/arm/activations").json()["activations"][0]
    assert (newest["forced"], codes(newest["objections"])) == (True, {"corrected_twice"})


def test_a_stream_begins_with_a_warning_or_not_at_all(
    client: httpx.Client, database: Database, caplog: pytest.LogCaptureFixture
) -> None:
    add(client, "arm")
    client.post(f"/v1/versions/{store_version(database, 'arm', 1)}/activate").raise_for_status()
    asked = "/v1/robots/arm/stream/sessions"
    assert codes(client.post(asked, json={}).raise_for_status().json()["warnings"]) == {"compensation_unknown"}
    source = DatabaseSource(database.url)
    try:
        unknown = source.stamp()
        assert set(source.load()) == {"arm"}
        say(client, "arm", "none")
        assert client.post(asked, json={}).raise_for_status().json()["warnings"] == []
        assert source.stamp() == unknown
        for value in sorted(CORRECTS):
            say(client, "arm", value)
            refused = client.post(asked, json={})
            assert (refused.status_code, refused.json()["code"]) == (409, "corrected_twice")
            assert "kilter robot compensation arm none" in refused.json()["detail"]
            # A stream that needs no session of the API gets no correction either: the corrector has no version.
            assert source.stamp() != unknown
            with caplog.at_level(logging.WARNING, "kilter.corrector"):
                assert source.load() == {}
            assert "corrects by itself" in caplog.text
        say(client, "arm", "none")
        assert source.stamp() == unknown
        assert set(source.load()) == {"arm"}
    finally:
        source.close()


def test_a_corrected_path_says_what_activation_and_stream_do(client: httpx.Client, database: Database) -> None:
    add(client, "arm")
    client.post(f"/v1/versions/{store_version(database, 'arm', 1)}/activate").raise_for_status()
    path = {f"q{k}_deg": [10.0, 12.0] for k in range(1, 6)}
    for value in VALUES:
        say(client, "arm", value)
        answer = client.post("/v1/robots/arm/correct", json=path).raise_for_status()
        said = answer.headers.get("Kilter-Notes", "")
        now = client.get("/v1/robots/arm/today").json()["sentences"][-1]
        assert (now in said) == (value != "none")
        assert ("corrected twice" in said) == (value != "none")


def test_a_file_for_a_controller_says_what_to_say_then(client: httpx.Client, database: Database) -> None:
    add(client, "arm")
    version = store_version(database, "arm", 1)

    def notes(form: str) -> str:
        answer = client.get(f"/v1/versions/{version}/export", params={"format": form}).raise_for_status()
        return answer.headers.get("Kilter-Notes", "")

    for form in ("dh-csv", "mdh-csv", "corrector", "c"):
        say(client, "arm", "none")
        assert "kilter robot compensation arm kilter" in notes(form)
        say(client, "arm", "factory")
        assert "corrected twice" in notes(form)
        say(client, "arm", "kilter")
        assert "compensation" not in notes(form)
    say(client, "arm", "none")
    assert all("compensation" not in notes(form) for form in ("json", "urdf", "matlab"))


def test_page_library_and_today_say_it(client: httpx.Client, database: Database) -> None:
    add(client, "arm")
    client.post(f"/v1/versions/{store_version(database, 'arm', 1)}/activate").raise_for_status()

    def shown(address: str) -> str:
        return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]*>", " ", client.get(address).raise_for_status().text)))

    def now() -> dict[str, Any]:
        found: dict[str, Any] = client.get("/v1/robots/arm/today").json()
        return found

    assert "is not known" in shown("/robots/arm")
    assert now()["controller_compensation"] == "unknown"
    assert now()["sentences"][-1].replace("`", "") in shown("/robots/arm/settings").replace(" , factory", ", factory")
    client.post("/robots/arm/compensation", data={"compensation": "factory"}).raise_for_status()
    assert now()["controller_compensation"] == "factory"
    assert "would be corrected twice" in now()["sentences"][-1]
    assert "by the controller" in shown("/robots/arm")
    assert "by the controller" in shown("/robots/arm/stream")
    with Kilter(str(client.base_url), client.headers["authorization"].removeprefix("Bearer ")) as kilter:
        assert kilter.set_controller_compensation("arm", "none").controller_compensation == "none"
        made = kilter.add_robot(preset="ur5e", name="other", controller_compensation="factory")
        assert made.controller_compensation == "factory"
    assert not any("controller" in sentence for sentence in now()["sentences"])


def test_the_command_asks_and_takes_the_answer(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("KILTER_URL", str(client.base_url))
    monkeypatch.setenv("KILTER_TOKEN", client.headers["authorization"].removeprefix("Bearer "))

    def kilter(*words: str) -> str:
        with pytest.raises(SystemExit) as ended:
            main(list(words))
        assert ended.value.code in (0, None)
        return re.sub(r"\s+", " ", capsys.readouterr().out)

    said = kilter("robot", "add", "--preset", "ur5e", "--name", "left")
    assert "Check once whether left's controller corrects by itself" in said
    assert "corrects by its maker's calibration" in kilter("robot", "compensation", "left", "factory")
    said = kilter("robot", "add", "--preset", "ur5e", "--name", "right", "--controller-compensation", "none")
    assert "does not correct by itself" in said
    listed = kilter("robot", "list")
    assert re.search(r"left preset 0 0 none factory", listed), listed
    assert re.search(r"right preset 0 0 none none", listed), listed
