"""Data of the first revision brought to this one and back, as the page says."""

from __future__ import annotations

import json
import logging
import math
import shutil
import sqlite3
import subprocess
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from alembic import command

from kilter_core.correct.program import CorrectionOptions, CorrectionProgram, Track, compile_program
from kilter_service.ground.db import Database, revision
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import DATABASE_FILE, Settings
from kilter_service.robots.documents import hash_canonical_json
from kilter_service.run.backup import upgrade
from kilter_service.run.backup.service import verify
from kilter_service.stream.corrector.active import DatabaseSource
from tests.corrector.conftest import calibration_of
from tests.corrector.live import ROBOT, Q
from tests.corrector.stored import store_active

PAGE = Path(__file__).resolve().parents[2] / "docs/how-to/run-a-server.md"
FIRST = "0001"
Kilterd = Callable[[list[str]], None]


@pytest.fixture
def old(tmp_path: Path) -> tuple[Settings, bytes]:
    """Settings of a data folder of the first revision, and what its releases answered: the tool point alone, of five joints."""
    settings = Settings(data=tmp_path / "data", database_url=None)
    settings.data.mkdir()
    store_active(settings, calibration_of(ROBOT))
    assert corrections(settings) != point_alone()  # activated today it has today's task
    corrected = point_alone()
    command.downgrade(revision.configuration(settings.database), FIRST)
    assert revision_of(settings) == FIRST
    with closing(sqlite3.connect(settings.data / DATABASE_FILE)) as file:
        calibration, limits = file.execute("SELECT calibration, limits FROM versions").fetchone()
        # The hash of the first releases does not cover the robot.
        first = hash_canonical_json({"calibration": json.loads(calibration), "limits": json.loads(limits)})
        file.execute("UPDATE versions SET sha256 = ?", (first,))
        file.commit()
    return settings, corrected


def corrections(settings: Settings) -> bytes:
    """Bytes of a corrected path."""
    source = DatabaseSource(settings.database)
    try:
        source.stamp()
        active = source.load()[ROBOT]
    finally:
        source.close()
    return followed(active.program)


def followed(program: CorrectionProgram) -> bytes:
    """Bytes of the path as a program corrects it."""
    path = np.array(Q) + 0.1 * np.sin(np.arange(200) * 0.01)[:, None]
    _, out, _, _ = Track(program, settled=True).follow(path, 1, np.full(len(path), 0.01))
    return bytes(out.tobytes())


def point_alone() -> bytes:
    """Bytes of the path where every posture counts as weak, so that the tool point alone is held."""
    options = CorrectionOptions(largest_rad=math.radians(1.0), largest_m=0.005, farthest_m=0.005, least_leverage=1000.0)
    return followed(compile_program(calibration_of(ROBOT), options))


def revision_of(settings: Settings) -> str | None:
    with closing(sqlite3.connect(settings.data / DATABASE_FILE)) as file:
        found: str | None = file.execute("SELECT version_num FROM alembic_version").fetchone()[0]
    return found


def commands(heading: str) -> list[str]:
    section = PAGE.read_text(encoding="utf-8").split(f"### {heading}\n")[1].split("\n##")[0]
    return [line for block in section.split("```\n")[1::2] for line in block.splitlines()]


def test_the_page_upgrades_data_of_the_first_revision_and_goes_back(
    old: tuple[Settings, bytes], kilterd: Kilterd, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    settings, before = old
    backups = tmp_path / "backups"
    backups.mkdir()
    for line in commands("Before") + commands("Upgrade"):
        words = line.replace("/backups", str(backups)).split()[1:]
        kilterd([words[0], "--data", str(settings.data), *words[1:]])
        if words[-1] == "--check":
            assert revision_of(settings) == FIRST
            assert not list(settings.data.glob("kilter-before-*"))
    said = capsys.readouterr().out
    assert f"from revision {FIRST} to {revision.HEAD}" in said
    assert "0003: guarded activations" in said
    assert revision_of(settings) == revision.HEAD
    assert corrections(settings) == before
    (copy,) = settings.data.glob(f"kilter-before-{revision.HEAD}-*.kilter-backup")
    assert str(copy) in said
    for kept in (copy, *backups.glob("*.kilter-backup")):
        assert verify(kept).damaged == []
    shell = "\n".join(commands("Go back")).replace("~/.kilter", str(settings.data))
    subprocess.run(
        ["sh", "-e", "-c", shell.replace("kilter-before-0015-20261123T220000Z.kilter-backup", copy.name)], check=True
    )
    assert revision_of(settings) == FIRST
    kilterd(["upgrade", "--data", str(settings.data)])
    assert corrections(settings) == before


def test_data_of_an_earlier_revision_are_backed_up_verified_and_looked_at(
    old: tuple[Settings, bytes], kilterd: Kilterd, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    settings, before = old
    kilterd(["backup", "--data", str(settings.data), str(tmp_path / "one.backup")])
    kilterd(["verify", "--data", str(settings.data)])
    assert "of a release without seals, so no seal was compared" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        kilterd(["doctor", "--data", str(settings.data)])
    assert "run `kilterd migrate`" in capsys.readouterr().out
    assert revision_of(settings) == FIRST
    kilterd(["restore", "--data", str(tmp_path / "other"), str(tmp_path / "one.backup")])
    assert corrections(Settings(data=tmp_path / "other", database_url=None)) == before


def test_the_log_names_the_copy_and_nothing_is_migrated_without_room_for_it(
    old: tuple[Settings, bytes], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, _ = old
    usage = shutil.disk_usage(settings.data)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1 << 20))
    with pytest.raises(ServiceError, match=r"not migrated: .* has 1 MB free"):
        upgrade.upgrade(settings)
    assert revision_of(settings) == FIRST
    monkeypatch.undo()
    with caplog.at_level(logging.INFO, "kilter.serve"):
        done = upgrade.upgrade(settings)
    assert f"of revision {FIRST} is kept as {done.copy}" in caplog.text
    assert upgrade.upgrade(settings).steps == []


def test_the_plan_of_an_empty_folder_is_every_revision_and_makes_nothing(tmp_path: Path) -> None:
    plan = upgrade.plan_upgrade(Settings(data=tmp_path, database_url=None))
    assert (plan.found, plan.steps[0].revision, plan.steps[-1].revision) == (None, FIRST, revision.HEAD)
    assert len(plan.steps) == len(revision.known_revisions())
    assert list(tmp_path.iterdir()) == []


def test_a_newer_database_is_refused_in_one_sentence(old: tuple[Settings, bytes]) -> None:
    settings, _ = old
    with closing(sqlite3.connect(settings.data / DATABASE_FILE)) as file:
        file.execute("UPDATE alembic_version SET version_num = '9999'")
        file.commit()
    database = Database(settings.database)
    database.close()
    for refused in (upgrade.plan_upgrade, upgrade.upgrade):
        with pytest.raises(ServiceError, match="of a newer Kilter: it has revision 9999"):
            refused(settings)
