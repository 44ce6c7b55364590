"""Backups by a timer: how many are kept, and who says how old the newest is."""

from __future__ import annotations

import math
import os
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from kilter_service.ground import backup_folder
from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.run.doctor import commands
from kilter_service.versions import metrics
from tests.service.conftest import ready
from tests.service.forked import forked_command

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def prepared(tmp_path: Path, migrated: Path) -> Settings:
    (tmp_path / "backups").mkdir()
    data = tmp_path / "data"
    found = Settings(data=data, database_url=None, port=0, backups=tmp_path / "backups", token=None)
    ready(found, migrated)
    return found


def kilterd(settings: Settings, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **settings.environment()}
    if settings.backups is None:
        environment.pop("KILTER_BACKUPS", None)
    return forked_command("backup", *arguments, environment=environment, folder=REPOSITORY)


def backup_of(settings: Settings, age: timedelta) -> Path:
    """A real backup that was made some time ago: its name says when, and the file beside it keeps its hash."""
    assert settings.backups is not None
    before = set(settings.backups.iterdir())
    done = kilterd(settings)
    assert done.returncode == 0, done.stderr
    (made,) = [path for path in set(settings.backups.iterdir()) - before if path.suffix == ".kilter-backup"]
    named = made.with_name(f"kilter-{datetime.now(UTC) - age:%Y%m%dT%H%M%SZ}.kilter-backup")
    made.rename(named)
    made.with_name(f"{made.name}.sha256").rename(f"{named}.sha256")
    return named


def age_s(settings: Settings) -> float | None:
    """The age that `/metrics` gives."""
    database = Database(settings.database)
    try:
        page = metrics.text(database, settings).decode()
    finally:
        database.close()
    families = {family.name: family for family in text_string_to_metric_families(page)}
    return next((sample.value for sample in families["kilter_backup_age_seconds"].samples), None)


def test_the_newest_are_kept_and_nothing_else_is_touched(prepared: Settings) -> None:
    assert prepared.backups is not None
    old = [backup_of(prepared, timedelta(days=days)) for days in (3, 2, 1)]
    others = ["notes.txt", "kilter-before-0016-20200101T000000Z.kilter-backup", "kilter-20200101T000000Z.kilter-backup"]
    for name in others:  # the last was cut off before it had its hash
        (prepared.backups / name).write_bytes(b"mine")
    done = kilterd(prepared, "--keep", "2")
    assert done.returncode == 0, done.stderr
    assert f"2 backups are kept in {prepared.backups}, 2 older ones were removed." in done.stdout
    assert [path.exists() for path in old] == [False, False, True]
    assert all((prepared.backups / name).read_bytes() == b"mine" for name in others)
    left = [backup.path for backup in backup_folder.backups(prepared.backups)]
    assert (len(left), left[1]) == (2, old[2])
    assert sum(path.suffix == ".sha256" for path in prepared.backups.iterdir()) == 2


def test_what_was_altered_counts_for_none_and_stays(prepared: Settings) -> None:
    assert prepared.backups is not None
    whole, altered = backup_of(prepared, timedelta(days=2)), backup_of(prepared, timedelta(days=1))
    content = bytearray(altered.read_bytes())
    content[len(content) // 2] ^= 1
    altered.write_bytes(content)
    done = kilterd(prepared, "--keep", "2")
    assert done.returncode == 0, done.stderr
    assert f"{altered} does not have its hash: it was altered, move it away." in done.stderr
    assert whole.exists()
    assert altered.exists()


def test_metrics_and_doctor_say_how_old_the_newest_is(prepared: Settings, tmp_path: Path) -> None:
    assert prepared.backups is not None
    assert age_s(prepared) == math.inf
    ok, said = commands.backup(prepared)
    assert (ok, "none in" in said, "run `kilterd backup`" in said) == (False, True, True)
    backup_of(prepared, timedelta(hours=70))
    assert age_s(prepared) == pytest.approx(70 * 3600, abs=120)
    ok, said = commands.backup(prepared)
    assert (ok, "is 70 h old: run `kilterd backup`" in said, "journalctl -u kilter-backup" in said) == (
        False,
        True,
        True,
    )
    newest = backup_of(prepared, timedelta(hours=5))
    ok, said = commands.backup(prepared)
    assert (ok, said) == (True, f"the newest of 2, {newest.name}, is 5 h old")
    assert age_s(prepared) == pytest.approx(5 * 3600, abs=120)
    newest.write_bytes(newest.read_bytes()[:-1])
    assert "does not have its hash: move it away" in commands.backup(prepared)[1]
    gone = prepared.model_copy(update={"backups": tmp_path / "gone"})
    assert age_s(gone) == math.inf
    said = next(check.detail for check in commands.run(gone) if check.name == "backup")
    assert said.startswith(f"There is no folder {tmp_path / 'gone'}: make it")


def test_a_backup_of_tomorrow_is_a_clock_that_is_wrong(prepared: Settings) -> None:
    backup_of(prepared, -timedelta(days=1))
    assert commands.backup(prepared) == (False, commands.backup(prepared)[1])
    assert "is of a later time than now: set the clock" in commands.backup(prepared)[1]


def test_without_a_folder_nothing_is_watched_and_the_command_asks_for_a_path(prepared: Settings) -> None:
    none = prepared.model_copy(update={"backups": None})
    assert age_s(none) is None
    assert commands.backup(none)[0]
    done = kilterd(none)
    assert (done.returncode, "set KILTER_BACKUPS" in done.stderr) == (2, True)


def test_a_folder_that_is_not_there_and_a_number_that_keeps_none(prepared: Settings, tmp_path: Path) -> None:
    gone = prepared.model_copy(update={"backups": tmp_path / "gone"})
    for settings, arguments in ((gone, ()), (prepared, (str(tmp_path / "gone"), "--keep", "3"))):
        done = kilterd(settings, *arguments)
        assert (done.returncode, f"There is no folder {tmp_path / 'gone'}: make it" in done.stderr) == (1, True), (
            done.stderr
        )
    assert not (tmp_path / "gone").exists()
    for number in ("0", "-3", "many"):
        done = kilterd(prepared, "--keep", number)
        assert (done.returncode, "--keep" in done.stderr) == (2, True)
