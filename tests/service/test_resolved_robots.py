"""A robot and its versions stay what they are: through a release that edits a preset, and through the migration."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from alembic import command
from sqlalchemy import text

import kilter_core.arm.presets
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.effects import make_effect
from kilter_core.model import Calibration, RobotModel
from kilter_core.observations import Observations
from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.tables import JobRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.robots.documents import core_document
from kilter_service.run.app import create_app
from kilter_service.stream.corrector.active import DatabaseSource, version_number
from kilter_service.versions import store
from kilter_service.versions.store import NewVersion
from kilter_service.web.auth.token import admin_token

URDF = """<robot name="r"><link name="base"/><link name="upper"><inertial><origin xyz="0.1 0 0.01"/><mass value="2.5"/>
<inertia ixx="0.1" iyy="0.2" izz="0.3" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="tip"/><link name="hand"/>
<joint name="a" type="revolute"><origin xyz="0.1 0.2 0.3" rpy="0.1 -0.2 0.3"/><parent link="base"/><child link="upper"/>
<axis xyz="0 0.6 0.8"/><limit lower="-2" upper="2.5" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><origin xyz="0.333 0 0" rpy="1.1 0 0"/><parent link="upper"/><child link="tip"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="grip" type="revolute"><parent link="tip"/><child link="hand"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
POSTED: list[dict[str, Any]] = [
    {"name": "katana", "convention": "preset", "preset": "katana450-chapter5", "tool": {"x_mm": 0.0, "z_mm": 77.7}},
    {"name": "bent", "convention": "urdf", "urdf": URDF, "base_link": "base", "tip_link": "tip"},
    {**preset_document("ur10"), "name": "table"},
    {"name": "cobot", "convention": "preset", "preset": "ur5e"},
]
WISHES = {"max_joint_deg": 1.0, "max_position_mm": 5.0}


def canonical(document: Any) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


@pytest.fixture
def edited_presets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Let the presets be those of a later release, in which every length is another, once it is called."""
    folder = tmp_path / "presets"
    shutil.copytree(Path(kilter_core.arm.presets.__file__).parent, folder)

    def edit() -> None:
        for file in folder.glob("*.json"):
            document = json.loads(file.read_text())
            for part in (*document.get("rows", ()), *document.get("elements", ())):
                for key in ("a_mm", "d_mm", "value"):
                    if part.get(key):
                        part[key] *= 1.01
            file.write_text(json.dumps(document))
        before = preset_document("katana450-chapter5")
        monkeypatch.setattr("kilter_core.arm.presets.files", lambda _: folder)
        assert preset_document("katana450-chapter5") != before

    return edit


def as_it_was(posted: dict[str, Any], document: dict[str, Any]) -> Calibration:
    """The calibration of a version as every Kilter before the chains built it: from the posted document."""
    return Calibration.from_document(robot_from_document(core_document(posted).document), document)


def calibration_of(posted: dict[str, Any]) -> Calibration:
    robot = robot_from_document(core_document(posted).document)
    model = RobotModel(robot, (make_effect("clearance_tilt"),))
    rng = np.random.default_rng(len(posted["name"]))
    return Calibration(model, model.values0() + rng.normal(0.0, 1e-4, len(model.names)))


def former_database(url: str) -> dict[str, dict[str, Any]]:
    """Fill a database of the former schema with a version on each robot; returns the calibration documents by robot."""
    database = Database(url)
    command.upgrade(revision.configuration(url), "0003")
    made = {}
    with database.engine.begin() as connection:
        for key, posted in enumerate(POSTED, 1):
            made[posted["name"]] = document = calibration_of(posted).to_document()
            values = {
                "key": key, "name": posted["name"], "posted": json.dumps(posted), "calibration": json.dumps(document),
                "sha256": canonical({"calibration": document, "limits": WISHES}), "limits": json.dumps(WISHES),
                "job": f"job_{key}", "version": f"ver_{key}",
            }  # fmt: skip
            for statement in (
                "INSERT INTO robots (id, name, document, created_at) VALUES (:key, :name, :posted, '2026-01-01')",
                "INSERT INTO jobs (id, kind, robot_id, request, state, fraction, stage, attempts, cancel_requested, "
                "created_at) VALUES (:job, 'identify', :key, '{}', 'succeeded', 1, 'done', 1, false, '2026-01-01')",
                "INSERT INTO versions (id, robot_id, job_id, sha256, calibration, report, covariance, campaigns, limits, "
                "code_version, created_at) VALUES (:version, :key, :job, :sha256, :calibration, '{}', '{}', '[]', "
                ":limits, '0', '2026-01-01')",
                "INSERT INTO activations (robot_id, version_id, action, actor, at) "
                "VALUES (:key, :version, 'activate', 'admin', '2026-01-01')",
            ):
                wanted = {name: value for name, value in values.items() if f":{name}" in statement}
                connection.execute(text(statement), wanted)
    database.close()
    return made


def test_a_migrated_database_gives_the_same_arms_to_the_last_bit(settings: Settings, edited_presets: Any) -> None:
    settings.data.mkdir(parents=True, exist_ok=True)
    made = former_database(settings.database)
    expected = {posted["name"]: as_it_was(posted, made[posted["name"]]) for posted in POSTED}
    edited_presets()  # the release that migrates has other presets than the one that stored
    database = Database(settings.database)
    assert revision.migrate(database)
    source = DatabaseSource(settings.database)
    source.stamp()
    streamed = source.load()
    for key, posted in enumerate(POSTED, 1):
        name, before = posted["name"], expected[posted["name"]]
        digest = canonical({"calibration": made[name], "limits": WISHES})
        with database.reading() as session:
            after = store.calibration(session, f"ver_{key}")
            active = store.active_version(session, name)
            shown = store.get(session, f"ver_{key}")
        assert active is not None
        assert (shown.sha256, active.sha256, streamed[name].number) == (digest, digest, version_number(digest))
        assert (shown.hash_scheme, len(shown.robot_sha256)) == (1, 64)
        assert after.model.names == before.model.names
        limits = np.clip(before.robot.limits, -1.0, 1.0)
        rows = Observations(np.random.default_rng(key).uniform(limits[:, 0], limits[:, 1], (30, len(limits))))
        there, here = before.predict(rows), after.predict(rows)
        assert np.array_equal(here.position, there.position)
        assert np.array_equal(here.rotation, there.rotation)
    source.close()
    database.close()


def test_the_chains_of_a_migration_are_those_of_robots_added_now(settings: Settings, client: httpx.Client) -> None:
    """One way leads from a document to a chain: the migrated robot and the one posted today have the same hashes."""
    old = Settings(**{**settings.model_dump(), "data": settings.data / "former"})
    if old.database == settings.database:
        pytest.skip("PostgreSQL has one database for a test; the other test migrates it")
    old.data.mkdir(parents=True)
    former_database(old.database)
    database = Database(old.database)
    revision.migrate(database)
    for posted in POSTED:
        report = client.post("/v1/robots", json=posted).raise_for_status().json()
        with database.reading() as session:
            (found,) = session.execute(
                text("SELECT sha256, source_sha256, left_out FROM robots WHERE name = :name"), {"name": posted["name"]}
            ).all()
        left_out = json.loads(found.left_out) if isinstance(found.left_out, str) else found.left_out
        assert (report["sha256"], report["notes"][: len(left_out)]) == (
            found.sha256,
            left_out,
        )  # then what no hash covers
    assert report["sha256"] != report["source_sha256"]
    database.close()


def test_a_robot_that_no_longer_resolves_stops_nobody_else(settings: Settings) -> None:
    settings.data.mkdir(parents=True, exist_ok=True)
    database = Database(settings.database)
    command.upgrade(revision.configuration(settings.database), "0003")
    with database.engine.begin() as connection:
        for key, document in ((1, {"name": "odd", "convention": "preset", "preset": "gone"}), (2, POSTED[0])):
            connection.execute(
                text("INSERT INTO robots (id, name, document, created_at) VALUES (:k, :n, :d, '2026-01-01')"),
                {"k": key, "n": document["name"], "d": json.dumps(document)},
            )
    revision.migrate(database)
    with database.reading() as session:
        assert store.robots.core_robot(session, 2).n_joints == 5
        with pytest.raises(ServiceError, match="add the robot again under another name") as refused:
            store.robots.core_robot(session, 1)
    assert refused.value.code == "robot_invalid"
    database.close()


def test_a_downgrade_takes_the_chains_away_and_keeps_the_rest(settings: Settings) -> None:
    settings.data.mkdir(parents=True, exist_ok=True)
    former_database(settings.database)
    database = Database(settings.database)
    revision.migrate(database)
    command.downgrade(revision.configuration(settings.database), "0003")
    with database.engine.connect() as connection:
        assert connection.execute(text("SELECT count(*) FROM activations")).scalar_one() == len(POSTED)
    revision.migrate(database)
    with database.reading() as session:
        assert store.active_version(session, "bent") is not None
    database.close()


def add_version(database: Database, name: str, calibration: Calibration, robot_id: int = 1) -> str:
    report = {"parameters": [], "metrics": {"train": {"n": 1}}, "noise_mm": 0.01}
    new = NewVersion(
        calibration.to_document(), report, {"names": [], "matrix": [], "units": "SI"}, [], dict(WISHES), None, "test"
    )
    with database.transaction() as session:
        session.add(JobRow(id=f"job_{name}", kind="identify", robot_id=robot_id, request={}, state="running"))
        session.flush()
        return store.add(session, robot_id, f"job_{name}", new)


def test_an_edited_preset_changes_nothing_that_is_stored(
    client: httpx.Client, settings: Settings, database: Database, edited_presets: Any, serve: Any
) -> None:
    posted = POSTED[0]
    client.post("/v1/robots", json=posted).raise_for_status()
    version = add_version(database, "a", calibration_of(posted))
    client.post(f"/v1/versions/{version}/activate").raise_for_status()
    path = {f"q{j}_deg": [0.0, 1.0, 2.0 * j] for j in range(1, 6)}

    def asked(at: httpx.Client) -> list[Any]:
        return [
            at.get("/v1/robots/katana").raise_for_status().json(),
            at.get(f"/v1/versions/{version}").raise_for_status().json(),
            at.post("/v1/robots/katana/correct", json=path).raise_for_status().json(),
            at.get(f"/v1/versions/{version}/export?format=dh-csv").raise_for_status().text,
        ]

    before = asked(client)
    edited_presets()
    later = serve(create_app(settings))
    later.headers["Authorization"] = f"Bearer {admin_token(settings)}"
    assert asked(later) == before
    again = later.post("/v1/robots", json=posted)
    assert again.status_code == 200
    assert again.json()["sha256"] == before[0]["sha256"]
    assert "Add it under another name" in again.json()["notes"][-1]
    new = later.post("/v1/robots", json={**posted, "name": "newer"}).json()
    assert new["sha256"] != before[0]["sha256"]
    assert new["source_sha256"] != before[0]["source_sha256"]  # the name is part of what was posted


def test_the_hash_of_a_new_version_covers_its_robot(client: httpx.Client, database: Database) -> None:
    """The same numbers on another arm are another version, with another number in the stream."""
    longer = {
        **POSTED[2],
        "name": "longer",
        "rows": [{**row, "d_mm": 10.0 + row.get("d_mm", 0)} for row in POSTED[2]["rows"]],
    }
    found = []
    for key, posted in enumerate((POSTED[2], longer), 1):
        report = client.post("/v1/robots", json=posted).raise_for_status().json()
        calibration = as_it_was(posted, calibration_of(POSTED[2]).to_document())
        version = client.get(f"/v1/versions/{add_version(database, str(key), calibration, key)}").json()
        document = {"calibration": calibration.to_document(), "limits": WISHES, "robot": report["sha256"]}
        assert (version["hash_scheme"], version["sha256"]) == (2, canonical(document))
        assert version["robot_sha256"] == report["sha256"]
        found.append((version["sha256"], canonical(calibration.to_document())))
    assert found[0][0] != found[1][0]
    assert found[0][1] == found[1][1]


def test_the_source_hash_of_a_urdf_is_that_of_its_text(client: httpx.Client) -> None:
    report = client.post("/v1/robots", json=POSTED[1]).raise_for_status().json()
    assert report["source_sha256"] == hashlib.sha256(URDF.encode()).hexdigest()
    assert report["document"]["urdf"] == URDF
    assert report["notes"] == ["joints outside the chain, held at zero: grip"]
