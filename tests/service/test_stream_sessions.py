"""Sessions of signed streams: over HTTP, on this machine, and after a rotation of the master secret."""

from __future__ import annotations

import json
import shutil
import stat
import subprocess
import time
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import httpx
import pytest

from kilter_client.signing import from_document, on_this_machine
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.stream.signing.masters import load_masters, update_masters_file
from tests.corrector import sealer

PRESET = {"name": "arm", "convention": "preset", "preset": "katana450-chapter4"}


def secrets_of(file: Path) -> list[bytes]:
    return [bytes.fromhex(row["secret"]) for row in json.loads(file.read_text())["keys"]]


def test_a_session_of_the_api_has_the_keys_of_the_tables(client: httpx.Client, settings: Settings) -> None:
    client.post("/v1/robots", json=PRESET)
    answer = client.post("/v1/robots/arm/stream/sessions", json={"stream": "left", "lifetime_h": 2.0})
    assert answer.status_code == 201
    assert answer.headers["Cache-Control"] == "no-store"
    session = from_document(answer.json())
    (secret,) = secrets_of(settings.stream_keys_file)
    assert session.key == sealer.session_key(secret, session.id, "local", "arm", "left")
    assert session.robot_key == sealer.derive(secret, "KLT2robt", b"local\0arm")
    assert abs(session.expires_s - time.time() - 7200) < 60
    assert stat.S_IMODE(settings.stream_keys_file.stat().st_mode) == 0o600
    other = client.post("/v1/robots/arm/stream/sessions", json={"stream": "left"}).json()
    assert from_document(other).key != session.key


def test_a_session_needs_the_token_and_a_robot(client: httpx.Client) -> None:
    assert client.post("/v1/robots/nobody/stream/sessions", json={}).status_code == 404
    bare = client.post("/v1/robots/arm/stream/sessions", json={}, headers={"Authorization": ""})
    assert bare.status_code == 401
    assert client.post("/v1/robots/arm/stream/sessions", json={"stream": "a/b"}).status_code == 422


def test_a_rotation_keeps_the_secret_before_it_for_the_overlap(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kilterd: Callable[[list[str]], None]
) -> None:
    file = tmp_path / "stream-keys.json"
    before = load_masters(file)
    old = on_this_machine(file, "local", "arm", "main")
    kilterd(["stream-keys", "--data", str(tmp_path), "--rotate", "--overlap-h", "1"])
    assert "valid for 1.0 h" in capsys.readouterr().out
    after = load_masters(file)
    assert after.all[0].secret == before.all[0].secret
    new = on_this_machine(file, "local", "arm", "main")
    assert old is not None
    assert new is not None
    for session in (old, new):
        assert after.session_key(session.id, "local", "arm", "main") == session.key
    kilterd(["stream-keys", "--data", str(tmp_path), "--rotate", "--overlap-h", "0"])
    ended = load_masters(file)
    assert ended.session_key(new.id, "local", "arm", "main") is None


def test_a_secret_that_others_can_read_or_that_is_damaged_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "stream-keys.json"
    load_masters(file)
    file.chmod(0o644)
    with pytest.raises(ServiceError, match="chmod 600"):
        load_masters(file)
    file.chmod(0o600)
    file.write_text('{"keys": []}')
    with pytest.raises(ServiceError, match="damaged"):
        load_masters(file)


def test_the_secrets_that_the_how_to_saves_come_back(tmp_path: Path) -> None:
    """Its own commands, in folders of the test."""
    page = (Path(__file__).resolve().parents[2] / "docs/how-to/run-a-server.md").read_text(encoding="utf-8")
    lines = [line for line in page.splitlines() if line.startswith(("umask ", "tar "))]
    assert [line.split()[1] for line in lines] == ["077", "--create", "--append", "--extract", "--extract"]
    places = {"~/.kilter": "data", "/backups": "backups", "/etc/kilter": "etc", "~/restored": "restored"}
    for name in ("data", "backups", "etc/zenoh/authority", "restored"):
        (tmp_path / name).mkdir(parents=True)
    masters = load_masters(tmp_path / "data" / "stream-keys.json")
    (tmp_path / "data" / "token").write_text("secret")
    (tmp_path / "etc" / "zenoh" / "authority" / "key.pem").write_text("key")

    def run(part: list[str]) -> None:
        text = "\n".join(part)
        for place, name in places.items():
            text = text.replace(place, str(tmp_path / name))
        subprocess.run(["sh", "-e", "-c", text], check=True, timeout=30)

    run(lines[:3])
    shutil.rmtree(tmp_path / "data")
    shutil.rmtree(tmp_path / "etc" / "zenoh")
    run(lines[3:])
    saved = tmp_path / "backups" / "secrets.tar"
    assert stat.S_IMODE(saved.stat().st_mode) == 0o600
    assert load_masters(tmp_path / "restored" / "stream-keys.json", make=False) == masters
    assert (tmp_path / "restored" / "token").read_text() == "secret"
    assert (tmp_path / "etc" / "zenoh" / "authority" / "key.pem").read_text() == "key"


def opened(
    client: httpx.Client, token: str, lifetime_h: float = 24.0, stream: str = "main", **more: bool
) -> httpx.Response:
    body, headers = {"stream": stream, "lifetime_h": lifetime_h, **more}, {"Authorization": f"Bearer {token}"}
    return client.post("/v1/robots/arm/stream/sessions", json=body, headers=headers)


def made(client: httpx.Client, name: str, days: int = 1) -> tuple[str, str]:
    found = client.post("/v1/tokens", json={"name": name, "role": "operator", "days": days}).raise_for_status().json()
    return found["id"], found["token"]


def test_who_asked_for_a_session_is_in_the_audit_and_its_key_is_not(client: httpx.Client) -> None:
    client.post("/v1/robots", json=PRESET)
    token_id, token = made(client, "line-1")
    session = opened(client, token).raise_for_status().json()
    entry = client.get("/v1/audit").json()["entries"][-1]
    assert (entry["actor"], entry["token_id"]) == ("line-1", token_id)
    assert session["session"] in json.dumps(entry)
    assert session["key"] not in client.get("/v1/audit").text


def test_a_session_ends_with_its_token(client: httpx.Client, settings: Settings) -> None:
    client.post("/v1/robots", json=PRESET)
    (ends_id, ends), (_, stays) = made(client, "ends"), made(client, "stays")
    longest = opened(client, ends, lifetime_h=168.0).json()
    expires = next(one["expires_at"] for one in client.get("/v1/tokens").json()["tokens"] if one["id"] == ends_id)
    assert from_document(longest).expires_s <= datetime.fromisoformat(expires).timestamp()
    more, other = opened(client, ends).json(), opened(client, stays, stream="other").json()
    client.delete(f"/v1/tokens/{ends_id}").raise_for_status()
    known = load_masters(settings.stream_keys_file)
    for document, held in ((longest, False), (more, False), (other, True)):
        session = from_document(document)
        assert (known.session_key(session.id, "local", "arm", document["stream"]) is not None) == held
    assert opened(client, ends).json()["code"] == "token_ended"
    # The secret is rotated: what was revoked stays so.
    update_masters_file(settings.stream_keys_file, lambda now: now.with_rotated_secret(3600.0))
    assert load_masters(settings.stream_keys_file).revoked == known.revoked


def test_secrets_that_cannot_be_written_are_said_with_the_remedy(client: httpx.Client, settings: Settings) -> None:
    client.post("/v1/robots", json=PRESET)
    token_id, token = made(client, "ends")
    session = opened(client, token).json()["session"]
    file = settings.stream_keys_file
    lock = file.with_name(f"{file.name}.lock")
    lock.unlink(missing_ok=True)
    lock.mkdir()  # whoever runs the tests may write everywhere, but into no folder as if it were a file
    refused = client.delete(f"/v1/tokens/{token_id}")
    assert (refused.status_code, refused.json()["code"]) == (500, "sessions_not_ended")
    assert f"kilterd stream-keys --revoke {session}" in refused.json()["detail"]
    assert opened(client, token).json()["code"] == "token_ended"
    lock.rmdir()
    client.delete(f"/v1/tokens/{token_id}").raise_for_status()  # sent again, it is done
    assert bytes.fromhex(session) in load_masters(file).revoked


def test_a_stream_of_somebody_else_is_taken_over_only_when_that_is_asked_for(
    client: httpx.Client, settings: Settings
) -> None:
    client.post("/v1/robots", json=PRESET)
    (_, left), (_, right) = made(client, "left-cell"), made(client, "right-cell")
    first = opened(client, left).raise_for_status().json()
    assert opened(client, left).status_code == 201  # its own are renewed
    refused = opened(client, right)
    assert (refused.status_code, refused.json()["code"]) == (409, "stream_held")
    said = refused.json()["detail"]
    for part in ("'main'", "'arm'", "'left-cell'", first["expires_at"][:16].replace("T", " "), "take_over=true"):
        assert part in said
    assert opened(client, right, stream="second").status_code == 201  # as the sentence says
    before = len(client.get("/v1/audit").json()["entries"])
    taken = opened(client, right, take_over=True).raise_for_status().json()
    known = load_masters(settings.stream_keys_file)
    assert known.session_key(bytes.fromhex(first["session"]), "local", "arm", "main") is None
    assert known.session_key(bytes.fromhex(taken["session"]), "local", "arm", "main") is not None
    entries = client.get("/v1/audit").json()["entries"]
    assert len(entries) == before + 1
    assert (entries[-1]["actor"], "left-cell" in json.dumps(entries[-1]["changes"])) == ("right-cell", True)
    assert opened(client, left).json()["code"] == "stream_held"  # and now it is the other's
    assert opened(client, left, take_over=True).status_code == 201
