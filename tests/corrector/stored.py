"""A server's data as its routes and jobs write them, and the processes of a server."""

from __future__ import annotations

from pathlib import Path

from kilter_core.model import Calibration
from kilter_service.contract.versions import ActivationWish
from kilter_service.ground.db import Database, revision
from kilter_service.ground.db.tables import JobRow
from kilter_service.ground.settings import Settings
from kilter_service.robots import service as robots
from kilter_service.robots.wire import DOCUMENT
from kilter_service.versions import activation, store
from kilter_service.versions.store import NewVersion
from tests.corrector.live import ROBOT


def descendants(pid: int) -> set[int]:
    """Process ids below a process."""
    try:
        below = {int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()}
    except OSError:
        return set()
    return below.union(*(descendants(child) for child in below))


def store_active(settings: Settings, calibration: Calibration) -> None:
    """A database with one robot and its active version, as job and routes write them."""
    document = {"name": ROBOT, "convention": "preset", "preset": ROBOT}
    report: dict[str, object] = {"parameters": [], "metrics": {}, "noise_mm": 0.01}
    limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
    version = NewVersion(calibration.to_document(), report, {}, [], limits, None, "test")
    database = Database(settings.database)
    try:
        revision.migrate(database)
        robots.add(database, DOCUMENT.validate_python(document))
        with database.transaction() as session:
            session.add(JobRow(id="job_1", kind="identify", robot_id=1, request={}, state="succeeded"))
            session.flush()
            added = store.add(session, 1, "job_1", version)
        activation.activate(database, added, "admin", ActivationWish())
    finally:
        database.close()
