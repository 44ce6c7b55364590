"""Fit, activate, correct, export with a tracker that stands somewhere: the same path for what identifies and what hunts.

The arm, its errors, its compliance, the tracker's place and the judgement of every path are Pinocchio's and scipy's: not
one line of the core makes or judges them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from kilter_client.stream import CorrectedStream
from kilter_core.arm.documents import robot_from_document
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_files.robots import Described, read_robot
from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.robots.documents import core_document
from kilter_service.robots.importers.urdf import chain_document
from kilter_service.stream.corrector.active import DatabaseSource
from kilter_service.stream.corrector.process import Corrector
from tests.core.soft_arm import NOISE_M, TOOL, Scene, scene
from tests.core.truth import Arm

Floats = NDArray[np.float64]
Until = Callable[..., None]

ROBOT = "far"
FINAL = ("succeeded", "failed", "cancelled")
PERIOD_S = 0.004
SAME_RAD = 1.1e-6  # between a file and a stream that holds nothing back
ENOUGH_M = 5e-5  # what may be left of the tool's error on a corrected path
LIBRARY = ["axial_compliance", "eccentricity", "encoder_scale", "backlash"]
JOBS: dict[str, dict[str, Any]] = {
    "identify": {"effects": ["axial_compliance"]},
    "gap": {"effects": LIBRARY, "bootstraps": 499, "resamples": 20, "permutations": 10, "next_poses": 2},
}


@dataclass(frozen=True)
class Placed:
    """The arm as drawn, put where it fits the measured points best: what "wanted" means for a far tracker."""

    drawn: Arm
    turn: Floats
    shift: Floats
    tool: Floats

    @staticmethod
    def of(drawn: Arm, q: Floats, points: Floats) -> Placed:
        """By scipy, from a closed form (Kabsch on the nominal tool)."""
        p, R = replace(drawn, tool=pin.SE3.Identity()).poses(q)

        def at(x: Floats) -> Floats:
            return np.asarray((p + R @ x[6:]) @ Rotation.from_rotvec(x[:3]).as_matrix().T + x[3:6])

        here = p + R @ TOOL.translation
        first, _ = Rotation.align_vectors(points - points.mean(axis=0), here - here.mean(axis=0))
        start = np.concatenate(
            [first.as_rotvec(), points.mean(axis=0) - first.apply(here.mean(axis=0)), TOOL.translation]
        )
        x = least_squares(lambda x: (at(x) - points).reshape(-1), start, xtol=1e-15, ftol=1e-15, x_scale="jac").x
        return Placed(drawn, Rotation.from_rotvec(x[:3]).as_matrix(), x[3:6], x[6:])

    def points(self, q: Floats) -> Floats:
        """Where the tool should be, in the tracker's frame."""
        p, R = replace(self.drawn, tool=pin.SE3.Identity()).poses(q)
        return np.asarray((p + R @ self.tool) @ self.turn.T + self.shift)

    def inside(self, points: Floats) -> Floats:
        """Points of the tracker's frame in the frame of the wanted robot's base."""
        return np.asarray((points - self.shift) @ self.turn)


def path() -> Floats:
    """Four hundred and one setpoints of a smooth motion."""
    s = np.linspace(0.0, 2.0 * np.pi, 401)[:, None]
    start = np.array([0.3, -1.1, 1.2, -0.6, 1.0, 0.2])
    return np.asarray(start + np.array([0.5, 0.3, -0.4, 0.3, 0.2, 0.6]) * np.sin(s * np.array([1, 1, 2, 1, 2, 1])))


@pytest.fixture(scope="module")
def far() -> Scene:
    return scene()


@pytest.fixture(scope="module")
def wanted(far: Scene) -> Placed:
    return Placed.of(far.drawn, far.q, far.measured)


@pytest.fixture
def corrector(settings: Settings, database: Database) -> Iterator[Corrector]:
    running = Corrector(settings, DatabaseSource(settings.database))
    running.start()
    yield running
    running.stop()


def fitted(client: httpx.Client, worker: Any, until: Until, far: Scene, kind: str) -> dict[str, Any]:
    """Upload the rows and run the job; returns the version."""
    client.post("/v1/robots", json={**far.drawn.document(), "name": ROBOT}).raise_for_status()
    campaign = (
        client.post(f"/v1/robots/{ROBOT}/campaigns", json={"name": "rows", "numbered": True})
        .raise_for_status()
        .json()["id"]
    )
    client.post(f"/v1/campaigns/{campaign}/observations", json=far.columns()).raise_for_status()
    worker.start()
    # Fitted to all rows: the frames are those in which the nominal robot fits the rows best, and the goal is in them.
    job = {"kind": kind, "robot": ROBOT, "campaigns": [campaign], "options": JOBS[kind]}
    job |= {"validation": 0} if kind == "gap" else {}
    address = client.post("/v1/jobs", json=job).raise_for_status().headers["location"]
    until(lambda: client.get(address).json()["state"] in FINAL)
    done = client.get(address).json()
    assert done["state"] == "succeeded", done["error"]
    return dict(client.get(f"/v1/versions/{done['result']['version_id']}").raise_for_status().json())


@pytest.mark.parametrize("kind", ["identify", "gap"])
def test_a_path_is_corrected_wherever_the_tracker_stood(
    client: httpx.Client, worker: Any, until: Until, settings: Settings, corrector: Corrector, far: Scene,
    wanted: Placed, kind: str, tmp_path: Path,
) -> None:  # fmt: skip
    version = fitted(client, worker, until, far, kind)
    assert [e for e in version["effects"] if e != "load_error"] == ["axial_compliance"]
    assert {"base_x", "d_1", "a_2", "compliance_2", "compliance_3"} <= set(version["covariance"]["names"])
    assert np.shape(version["covariance"]["matrix"]) == (len(version["covariance"]["names"]),) * 2
    assert 0.5 < version["noise_mm"] / (1e3 * NOISE_M) < 1.5
    assert version["details"]["reference"] == {"base": "registration", "tool": "registration"}
    client.post(f"/v1/versions/{version['id']}/activate").raise_for_status()

    q = path()
    rows = {f"q{j + 1}_deg": np.degrees(q[:, j]).tolist() for j in range(6)}
    sent = {"t_s": (PERIOD_S * np.arange(len(q))).tolist(), **rows}
    answer = client.post(f"/v1/robots/{ROBOT}/correct", json=sent).raise_for_status().json()
    assert set(answer["status"]) == {"OK"}
    by_http = np.radians(np.column_stack([answer[f"q{j + 1}_deg"] for j in range(6)]))
    goal = wanted.points(q)
    before, after = (np.linalg.norm(far.points(x) - goal, axis=1) for x in (q, by_http))
    print(kind, f"path: {1e3 * before.max():.3f} mm before, {1e3 * after.max():.4f} mm after")
    assert before.max() > 10 * ENOUGH_M
    assert after.max() < ENOUGH_M

    corrector.poll()  # as the corrector's process does all the time: follow what is active
    options: dict[str, Any] = {"data": settings.data, "deadline_s": 2.0, "connect_timeout_s": 30.0, "settled": True}
    with CorrectedStream(ROBOT, stream="single", **options) as stream:
        found = [stream.correct(row) for row in q.tolist()]
    assert {setpoint.source for setpoint in found} == {"corrected"}
    # Its times are those of this machine's clock, so the path is faster here: where the correction changes faster than it
    # may, it comes late and says so. All other joints are those of the file, and the tool is where both say it is.
    by_stream = np.array([list(s) for s in found])
    held = np.array([s.slowed or s.damped or s.saturated for s in found])
    assert np.abs(by_stream - by_http)[~held].max() < SAME_RAD
    off = np.linalg.norm(far.points(by_stream) - goal, axis=1)
    assert np.abs(off - after)[~held].max() < 1e-6
    assert (off <= after + 1e-3 * np.array([s.left_mm for s in found]) + 1e-6).all()
    with CorrectedStream(ROBOT, stream="chunk", **options) as stream:
        chunk = stream.correct_chunk(q.tolist(), PERIOD_S)
    assert chunk is not None
    assert np.abs(np.array(chunk.q).reshape(q.shape) - by_http).max() < 1e-12

    files = {form: exported(client, version["id"], form, tmp_path) for form in ("urdf", "dh-csv", "ur-yaml")}
    elsewhere = np.random.default_rng(8).uniform(-1.8, 1.8, (50, 6))
    stiff, bent = (wanted.inside(x) for x in (far.built.poses(elsewhere)[0], far.points(elsewhere)))
    for form, (document, truth, allowed) in {
        "urdf": (files["urdf"][0], stiff, ENOUGH_M),
        "ur-yaml": (files["ur-yaml"][0], stiff, ENOUGH_M),
        "dh-csv": (files["dh-csv"][0], bent, ENOUGH_M + lost_m(files["dh-csv"][1])),
    }.items():
        again = Calibration.nominal(robot_from_document(document))
        miss = np.linalg.norm(again.predict(Observations(elsewhere)).position - truth, axis=1)
        print(kind, form, f"{1e3 * miss.max():.4f} mm, allowed {1e3 * allowed:.4f} mm")
        assert miss.max() < allowed
    table = Calibration.nominal(robot_from_document(files["dh-csv"][0])).model
    assert abs(table.parameter("d_1").value - 0.1273) < 0.005  # the arm's, and not the tracker's place
    assert np.abs(table.T_base[:3, 3]).max() < 0.005
    whole = client.get(f"/v1/versions/{version['id']}/export").raise_for_status().json()
    assert np.linalg.norm(np.array(whole["calibration_si"]["wanted_base"])[:3, 3] - wanted.shift) < 1e-4
    assert whole["version"]["covariance"]["names"] == [row["name"] for row in version["parameters"]]
    program = client.get(f"/v1/versions/{version['id']}/export", params={"format": "matlab"}).raise_for_status().text
    origin = re.search(r"setFixedTransform\(joint, \[(.+?)\]\)", program)
    assert origin is not None
    shoulder = np.array([[float(x) for x in line.split()] for line in origin.group(1).split(";")])
    assert np.linalg.norm(shoulder[:3, 3]) < 0.15  # on the first axis, not two metres away


def exported(client: httpx.Client, version: str, form: str, folder: Path) -> tuple[dict[str, Any], str]:
    """Export a version and read the file back as the command line does: the robot document it makes, and its remarks."""
    answer = client.get(f"/v1/versions/{version}/export", params={"format": form}).raise_for_status()
    notes = answer.headers["Kilter-Notes"]
    if form == "urdf":
        return dict(chain_document(answer.text, "base_link", "tool", "again").document), notes
    path = folder / {"dh-csv": "arm.csv", "ur-yaml": "arm.yaml"}[form]
    path.write_text(answer.text)
    described = Described("again", convention="dh") if form == "dh-csv" else Described("again", model="ur10")
    return dict(core_document({**read_robot(path, described), **said_tool(notes)}).document), notes


def said_tool(notes: str) -> dict[str, Any]:
    """The tool frame that a file has no place for and asks to set."""
    found = re.search(r"x, y, z = (.+?) mm and roll, pitch, yaw = (.+?) deg", notes)
    if found is None:
        return {}
    numbers = [float(x) for part in found.groups() for x in part.split(", ")]
    names = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    return {"tool": dict(zip(names, numbers, strict=True))}


def lost_m(notes: str) -> float:
    """What a file says that it loses at most."""
    found = re.search(r"rms, ([0-9.]+) mm at most, its", notes)
    return 1e-3 * float(found.group(1)) if found else 0.0
