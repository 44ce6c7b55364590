"""An active version keeps its task, its rules and its answers: an upgrade that changes what arms are sent says so."""

from __future__ import annotations

import json
import math
import re
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from alembic import command
from sqlalchemy import update

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_core.model import Calibration, RobotModel
from kilter_service.contract.versions import ActivationWish
from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.tables import JobRow, ReplayRow
from kilter_service.ground.settings import DATABASE_FILE, Settings
from kilter_service.robots import service as robots
from kilter_service.robots.wire import DOCUMENT
from kilter_service.run.backup import service as backups
from kilter_service.stream.corrector.active import DatabaseSource
from kilter_service.versions import activation, store
from kilter_service.versions.store import BY_UPGRADE, NewVersion
from tests.corrector.conftest import calibration_of

ROBOT = "katana450-chapter4"
# Two parallel axes 0.6 m apart, the tool 0.4 m beyond the second: stretched out, it is 1 m from the first.
PLANAR = {
    "name": "planar", "convention": "dh", "rows": [
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 0, "a_mm": 600, "alpha_deg": 0},
        {"type": "revolute", "theta_offset_deg": 0, "d_mm": 0, "a_mm": 400, "alpha_deg": 0},
    ],
    "joints": [{"name": "j1", "limits_deg": [-170, 170]}, {"name": "j2", "limits_deg": [-170, 170]}],
}  # fmt: skip
Kilterd = Callable[[list[str]], None]


def store_active(settings: Settings, database: Database, document: dict[str, object], calibration: Calibration) -> str:
    """A robot and its active version, as job and routes write them; returns the id of the version."""
    robots.add(database, DOCUMENT.validate_python(document))
    report: dict[str, object] = {"parameters": [], "metrics": {}, "noise_mm": 0.01}
    limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
    new = NewVersion(calibration.to_document(), report, {}, [], limits, None, "test")
    with database.transaction() as session:
        session.add(JobRow(id="job_1", kind="identify", robot_id=1, request={}, state="succeeded"))
        session.flush()
        version = store.add(session, 1, "job_1", new)
    activation.activate(database, version, "admin", ActivationWish())
    return version


def keep_instead(settings: Settings, **values: object) -> None:
    """Let an activation have been kept otherwise, as by another release."""
    database = Database(settings.database)
    with database.engine.begin() as connection:
        connection.execute(update(ReplayRow.__table__).values(**values))
    database.close()
    assert backups.seal(settings, accept=True) == []


def streamed(settings: Settings, name: str, q: np.ndarray) -> np.ndarray:
    source = DatabaseSource(settings.database)
    try:
        source.stamp()
        return np.asarray(source.load()[name].program.correct_rows(q).q)
    finally:
        source.close()


@pytest.mark.both_databases
def test_a_version_keeps_its_task_until_it_is_activated_anew(settings: Settings, database: Database) -> None:
    calibration = calibration_of(ROBOT)
    version = store_active(settings, database, {"name": ROBOT, "convention": "preset", "preset": ROBOT}, calibration)
    with database.reading() as session:
        rules = store.activation_rules(session, version)
    assert rules is not None
    assert (rules["task"], "largest_rad" in rules) == ("position", False)
    keep_instead(settings, rules={**rules, "least_leverage": 50.0, "of_another_release": 1})
    q = np.array([[0.1, 0.6, 0.4, 0.3, 0.2], [0.5, 0.8, -0.4, 0.6, 1.0]])
    options = CorrectionOptions(largest_rad=math.radians(1.0))
    today = compile_program(calibration, options).correct_rows(q).q
    kept = compile_program(calibration, replace(options, least_leverage=50.0)).correct_rows(q).q
    assert np.abs(today - kept).max() > 1e-4
    np.testing.assert_array_equal(streamed(settings, ROBOT, q), kept)
    activation.activate(database, version, "admin", ActivationWish())
    np.testing.assert_array_equal(streamed(settings, ROBOT, q), today)
    with database.reading() as session:
        assert len(store.activations(session, 1)) == 2
    activation.activate(database, version, "admin", ActivationWish())  # again: it has today's rules already
    with database.reading() as session:
        assert len(store.activations(session, 1)) == 2


def test_a_rollback_returns_to_the_rules_of_that_time(settings: Settings, database: Database) -> None:
    calibration = calibration_of(ROBOT)
    document = {"name": ROBOT, "convention": "preset", "preset": ROBOT}
    first = store_active(settings, database, document, calibration)
    with database.reading() as session:
        rules = store.activation_rules(session, first)
    assert rules is not None
    keep_instead(settings, rules={**rules, "rate_rad_s": 0.001})
    with database.transaction() as session:
        session.add(JobRow(id="job_2", kind="identify", robot_id=1, request={}, state="succeeded"))
        session.flush()
        record = store.get(session, first)
        new = NewVersion(record.calibration, record.report, {}, [], record.limits, None, "test", "other")
        second = store.add(session, 1, "job_2", new)
    activation.activate(database, second, "admin", ActivationWish(force=True, reason="test"))
    assert activation.rollback(database, ROBOT, "admin").id == first
    with database.reading() as session:
        found, entry = store.activation_rules(session, first), store.active_entry(session, 1)
        assert entry is not None
        assert session.get(ReplayRow, entry.id) is not None
    assert found is not None
    assert found["rate_rad_s"] == 0.001


def test_a_version_of_the_first_releases_keeps_their_task_until_it_is_activated_anew(
    settings: Settings, database: Database, kilterd: Kilterd, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    document = {"name": ROBOT, "convention": "preset", "preset": ROBOT}
    calibration = calibration_of(ROBOT, effects=())
    version = store_active(settings, database, document, calibration)
    command.downgrade(revision.configuration(settings.database), "0014")
    kilterd(["backup", "--data", str(settings.data), str(tmp_path / "old.backup")])
    capsys.readouterr()
    kilterd(["upgrade", "--check", "--data", str(settings.data)])
    said = capsys.readouterr().out
    found = re.search(
        r"would keep the task.* Activated anew, joints change by at most (\S+) deg, the tool point by (\S+) mm", said
    )
    assert found is not None, said
    # The release of 2026-11-23 10:18 itself answers these setpoints otherwise by 0.4953 deg and 0.0000 mm at most.
    assert float(found[1]) == pytest.approx(0.495, abs=0.01)
    assert float(found[2]) < 0.001
    kilterd(["upgrade", "--data", str(settings.data)])
    assert f"{version}: no earlier answers are stored; it keeps the task of its release." in capsys.readouterr().out
    restored = settings.model_copy(update={"data": tmp_path / "restored"})
    kilterd(["restore", "--data", str(restored.data), str(tmp_path / "old.backup")])
    q = np.array([[0.1, 0.6, 0.4, 0.3, 0.2], [0.5, 0.8, -0.4, 0.6, 1.0]])
    options = CorrectionOptions(largest_rad=math.radians(1.0), largest_m=0.005, farthest_m=0.005)
    kept, today = (
        compile_program(calibration, one).correct_rows(q).q for one in (replace(options, least_leverage=1e3), options)
    )
    assert np.abs(kept - today).max() > 1e-4
    for each in (settings, restored):
        np.testing.assert_array_equal(streamed(each, ROBOT, q), kept)
    command.downgrade(revision.configuration(settings.database), "0014")
    kilterd(["upgrade", "--data", str(settings.data)])
    np.testing.assert_array_equal(streamed(settings, ROBOT, q), kept)
    capsys.readouterr()
    kilterd(["upgrade", "--check", "--data", str(settings.data)])
    assert f"{version}: joints change by at most 0 deg" in capsys.readouterr().out
    activation.activate(database, version, "admin", ActivationWish())
    np.testing.assert_array_equal(streamed(settings, ROBOT, q), today)


def planar() -> Calibration:
    model = RobotModel(robot_from_document(PLANAR), ())
    return Calibration(model, model.values0())


def test_an_upgrade_says_by_how_much_answers_change(
    settings: Settings, database: Database, kilterd: Kilterd, capsys: pytest.CaptureFixture[str]
) -> None:
    version = store_active(settings, database, PLANAR, planar())
    data = ["--data", str(settings.data)]
    kilterd(["upgrade", "--check", *data])
    assert (
        f"planar {version}: joints change by at most 0 deg, the tool point by 0 mm, at 300 setpoints."
        in capsys.readouterr().out
    )
    q = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    before = q + np.array([math.radians(0.5), 0.0])
    keep_instead(settings, setpoints=q.tobytes(), answers=before.tobytes())
    for words in (["upgrade", "--check"], ["upgrade"], ["upgrade", "--check"]):
        kilterd([*words, *data])
        # 1 m out, half a degree is a chord of 2 sin(0.25 deg) = 8.73 mm.
        assert (
            f"planar {version}: joints change by at most 0.5 deg, the tool point by 8.7 mm, at 3 setpoints."
            in capsys.readouterr().out
        )
    before[1] = np.nan
    keep_instead(settings, answers=before.tobytes())
    kilterd(["upgrade", "--check", *data])
    assert "1 are refused that were not, or the other way round" in capsys.readouterr().out


def test_versions_of_releases_that_kept_no_answers_have_todays_and_it_is_said(
    settings: Settings, database: Database, kilterd: Kilterd, capsys: pytest.CaptureFixture[str]
) -> None:
    version = store_active(settings, database, PLANAR, planar())
    command.downgrade(revision.configuration(settings.database), "0021")
    before = (settings.data / DATABASE_FILE).read_bytes()
    kilterd(["upgrade", "--check", "--data", str(settings.data)])
    said = f"planar {version}: no earlier answers are stored; today's "
    assert f"{said}would be kept.\n" in capsys.readouterr().out
    assert (settings.data / DATABASE_FILE).read_bytes() == before
    kilterd(["upgrade", "--data", str(settings.data)])
    assert f"{said}are kept.\n" in capsys.readouterr().out
    with closing(sqlite3.connect(settings.data / DATABASE_FILE)) as file:
        ((rules, made_by),) = file.execute("SELECT rules, made_by FROM replays").fetchall()
    assert (json.loads(rules)["task"], made_by) == ("position", BY_UPGRADE)
    assert backups.verify_stored(settings).sentences == []
    (copy,) = settings.data.glob("kilter-before-*.kilter-backup")
    capsys.readouterr()
    kilterd(["restore", "--data", str(settings.data / "restored"), str(copy)])
    assert f"{said}are kept.\n" in capsys.readouterr().out
    with closing(sqlite3.connect(settings.data / "restored" / DATABASE_FILE)) as file:
        assert file.execute("SELECT count(*) FROM replays").fetchone() == (1,)
    kilterd(["upgrade", "--check", "--data", str(settings.data)])
    assert "at 300 setpoints" in capsys.readouterr().out
