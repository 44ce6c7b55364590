"""`kilter server token`, `whoami` and `audit` against a server, and `kilterd audit` on the file of its database."""

from __future__ import annotations

import copy
import hashlib
import json
import os
import shutil
import sqlite3
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import pytest

from kilter_client import Kilter, NotAuthorisedError
from kilter_client.cli import run
from kilter_client.errors import ConflictError
from kilter_client.requests.calls.references import verify_entries
from kilter_service.ground.settings import DATABASE_FILE, Settings
from tests.service.forked import forked_command

from .conftest import REPOSITORY

Said = Callable[..., tuple[int, str]]


@pytest.fixture
def said(client: httpx.Client, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Said:
    """Run `kilter` with the admin token, or with another; returns its exit code and what it printed on stdout."""
    monkeypatch.setenv("KILTER_URL", str(client.base_url))
    admin = client.headers["Authorization"].split()[1]

    def command(*words: str, token: str = admin) -> tuple[int, str]:
        monkeypatch.setenv("KILTER_TOKEN", token)
        capsys.readouterr()
        return run(words), capsys.readouterr().out

    return command


def test_a_token_is_made_used_listed_and_revoked(said: Said) -> None:
    code, secret = said("token", "add", "anna", "--role", "operator", "--robot", "arm,leg", "--days", "90")
    assert (code, secret.startswith("kilter_"), secret.count("\n")) == (0, True, 1)
    assert said("whoami", token=secret.strip()) == (0, "anna: operator of arm, leg\n")
    code, listed = said("token", "list", "--json")
    (entry,) = json.loads(listed)["tokens"]
    assert (entry["name"], entry["role"], entry["robots"], entry["created_by"]) == (
        "anna",
        "operator",
        ["arm", "leg"],
        "admin",
    )
    assert secret.strip() not in listed
    assert "anna" in said("token")[1]
    assert said("token", "list", token=secret.strip())[0] == 1
    assert said("token", "revoke", "anna")[0] == 0
    code, refused = said("whoami", "--json", token=secret.strip())
    assert (code, json.loads(refused)["code"]) == (1, "token_ended")
    assert json.loads(said("token", "revoke", "nobody", "--json")[1])["code"] == "token_not_found"


def test_the_library_makes_and_ends_tokens(client: httpx.Client) -> None:
    admin = client.headers["Authorization"].split()[1]
    with Kilter(str(client.base_url), admin) as kilter:
        made = kilter.add_token("script", "viewer", days=None)
        assert made["expires_at"] is None
        with Kilter(str(client.base_url), made["token"]) as guest:
            assert guest.whoami()["role"] == "viewer"
            assert guest.robots.list() == []
            with pytest.raises(NotAuthorisedError, match="operator"):
                guest.run(_frame())
        assert kilter.revoke_token("script")["revoked_by"] == "admin"


def _frame() -> Any:
    from kilter_client.requests.steps import post

    return post("/v1/frames", {})


def test_the_audit_is_shown_and_checked(said: Said, client: httpx.Client) -> None:
    robot = {"name": "arm", "convention": "preset", "preset": "ur10"}
    client.post("/v1/robots", json=robot).raise_for_status()
    head = json.loads(said("audit", "--verify", "--json")[1])["head"]
    client.patch("/v1/robots/arm", json={"remarks": "after the crash"}).raise_for_status()
    code, shown = said("audit", "--limit", "1")
    assert (code, "PATCH /v1/robots/{robot}" in shown, "after the crash" in shown) == (0, True, True)
    code, found = said("audit", "--verify", "--head", head, "--json")
    assert (code, json.loads(found)["entries"]) == (0, 2)
    code, found = said("audit", "--verify", "--head", f"1:{'0' * 64}", "--json")
    assert (code, json.loads(found)["code"]) == (1, "audit_broken")


def test_what_a_server_sends_is_not_believed(client: httpx.Client) -> None:
    robot = {"name": "arm", "convention": "preset", "preset": "ur10"}
    client.post("/v1/robots", json=robot).raise_for_status()
    for number in range(3):
        client.patch("/v1/robots/arm", json={"remarks": str(number)}).raise_for_status()
    found = client.get("/v1/audit").json()["entries"]
    assert verify_entries(found)[0] == 4
    for wrong in (found[1:], found[:1] + found[2:], [found[0], *found]):
        with pytest.raises(ConflictError):
            verify_entries(wrong)
    for field, value in (("actor", "otto"), ("content", "{}"), ("sha256", "0" * 64), ("number", 7)):
        wrong = copy.deepcopy(found)
        wrong[2][field] = value
        with pytest.raises(ConflictError):
            verify_entries(wrong)


def test_a_database_is_checked_without_a_server(client: httpx.Client, settings: Settings, tmp_path: Path) -> None:
    if settings.database_url is not None:
        pytest.skip("the database is PostgreSQL")
    robot = {"name": "arm", "convention": "preset", "preset": "ur10"}
    client.post("/v1/robots", json=robot).raise_for_status()
    client.patch("/v1/robots/arm", json={"remarks": "x"}).raise_for_status()
    with sqlite3.connect(settings.data / DATABASE_FILE) as raw:
        raw.execute("VACUUM INTO ?", [str(tmp_path / "copy.sqlite")])

    def offline(name: str, *more: str) -> subprocess.CompletedProcess[str]:
        url = f"sqlite:///{tmp_path / name}"
        return forked_command("audit", "--database-url", url, *more, environment=os.environ, folder=REPOSITORY)

    whole = offline("copy.sqlite")
    assert (whole.returncode, whole.stdout.startswith("The audit is whole: 2 entries")) == (0, True), whole.stderr
    assert offline("copy.sqlite", "--head", whole.stdout.split()[-1].rstrip(".")).returncode == 0
    shutil.copy(tmp_path / "copy.sqlite", tmp_path / "cut.sqlite")
    with sqlite3.connect(tmp_path / "cut.sqlite") as raw:
        raw.execute("DROP TRIGGER audit_delete")
        raw.execute("DELETE FROM audit WHERE number = 1")
    broken = offline("cut.sqlite")
    assert (broken.returncode, broken.stderr.count("\n")) == (1, 1)
    assert "Entry 1 of the audit is not what was written" in broken.stderr


def test_what_was_cut_or_rewritten_is_seen_by_the_journal(
    client: httpx.Client, settings: Settings, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    if settings.database_url is not None:
        pytest.skip("the database is PostgreSQL")
    with caplog.at_level("INFO", "kilter.audit"):
        client.post("/v1/robots", json={"name": "arm", "convention": "preset", "preset": "ur10"}).raise_for_status()
        for remarks in ("x", "y"):
            client.patch("/v1/robots/arm", json={"remarks": remarks}).raise_for_status()
    journal = tmp_path / "journal.log"
    journal.write_text("".join(f"Nov 23 kilterd[7]: INFO {record.getMessage()}\n" for record in caplog.records))

    def checked(name: str, change: Callable[[sqlite3.Connection], object]) -> subprocess.CompletedProcess[str]:
        with sqlite3.connect(settings.data / DATABASE_FILE) as raw:
            raw.execute("VACUUM INTO ?", [str(tmp_path / name)])
        with sqlite3.connect(tmp_path / name) as raw:
            raw.execute("DROP TRIGGER audit_delete")
            change(raw)
        arguments = ["--journal", str(journal), "--database-url", f"sqlite:///{tmp_path / name}"]
        return forked_command("audit", *arguments, environment=os.environ, folder=REPOSITORY)

    def rewritten(raw: sqlite3.Connection) -> None:
        """Forge the last entry, with a hash that fits it."""
        number, previous, content = raw.execute(
            "SELECT number, previous, content FROM audit ORDER BY number"
        ).fetchall()[-1]
        raw.execute("DELETE FROM audit WHERE number = ?", [number])
        forged = content.replace("admin", "nobody")
        sha256 = hashlib.sha256(f"{previous}\n{forged}".encode()).hexdigest()
        raw.execute(
            "INSERT INTO audit (number, previous, sha256, content) VALUES (?, ?, ?, ?)",
            [number, previous, sha256, forged],
        )

    whole = checked("whole.sqlite", lambda raw: None)
    assert (whole.returncode, whole.stdout.splitlines()[0]) == (0, "The journal names 3 entries."), whole.stderr
    journal.rename(tmp_path / "moved.log")
    gone = checked("gone.sqlite", lambda raw: None)
    assert (gone.returncode, "cannot be read" in gone.stderr, "Traceback" in gone.stderr) == (1, True, False), gone
    (tmp_path / "moved.log").rename(journal)
    for name, change in (("cut", lambda raw: raw.execute("DELETE FROM audit WHERE number = 3")), ("forged", rewritten)):
        found = checked(f"{name}.sqlite", change)
        assert (found.returncode, "does not hold entry 3" in found.stderr) == (1, True), (name, found)


def test_a_link_to_log_in_with_is_printed_once(said: Said, client: httpx.Client) -> None:
    code, printed = said("login", "--minutes", "2")
    address, _, secret = printed.strip().partition("#")
    assert (code, address) == (0, f"{str(client.base_url).rstrip('/')}/login")
    used = [httpx.post(f"{address}/link", data={"link": secret}, timeout=60).status_code for _ in range(2)]
    assert used == [303, 401]
