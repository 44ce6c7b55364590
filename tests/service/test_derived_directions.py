"""A lab that logs no directions: a backlash is found, used and checked by the order of the rows.

The cell is plain DH in numpy and shares nothing with the core.
"""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter

from kilter_core.arm.presets import preset_document
from kilter_service.contract.jobs.registry import NewJob
from kilter_service.ground.db import Database
from kilter_service.jobs import store as jobs
from kilter_service.jobs.registry import get_job_kind
from kilter_service.jobs.work.runner import with_direction_warning
from kilter_service.robots import store as robots

Floats = NDArray[np.float64]
# A UR10, as built: theta offset, d, a, alpha.
DH = np.array([
    [0.0, 0.1273, 0.0, np.pi / 2], [0.0, 0.0, -0.612, 0.0], [0.0, 0.0, -0.5723, 0.0],
    [0.0, 0.163941, 0.0, np.pi / 2], [0.0, 0.1157, 0.0, -np.pi / 2], [0.0, 0.0922, 0.0, 0.0],
])  # fmt: skip
TOOL = np.array([0.05, 0.03, 0.12, 1.0])
BACKLASH = np.radians([0.0, 0.08, 0.0, 0.05, 0.0, 0.0])
NOISE_MM = 0.03
SAID = "directions were derived from the order of the rows. State dir1 ... where another order was driven."


def tool_points(q: Floats) -> Floats:
    """Tool points (N, 3) m in the frame of the base, of joints (N, 6) rad."""
    built = DH + np.random.default_rng(1).normal(0.0, 3e-4, DH.shape)
    out = []
    for row in q:
        pose = np.eye(4)
        for angle, (offset, d, a, alpha) in zip(row, built, strict=True):
            c, s, ca, sa = np.cos(angle + offset), np.sin(angle + offset), np.cos(alpha), np.sin(alpha)
            pose = pose @ np.array(
                [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
            )
        out.append((pose @ TOOL)[:3])
    return np.array(out)


class Cell:
    """A cell whose joints 2 and 4 have backlash, and which writes poses in the order in which it drives them."""

    def __init__(self, client: httpx.Client, database: Database) -> None:
        self.client, self.database = client, database
        client.post("/v1/robots", json={**preset_document("ur10"), "name": "arm"}).raise_for_status()

    def send(self, q: Floats, name: str, stated: bool = False) -> str:
        """Measure the poses (N, 6) rad one after the other, and upload them."""
        rng = np.random.default_rng(len(q))
        sides = np.where(rng.random(q.shape) < 0.5, -1.0, 1.0)  # whence the arm came to the first pose is not known
        for k in range(1, len(q)):
            step = q[k] - q[k - 1]
            sides[k] = np.where(np.abs(step) > BACKLASH, np.sign(step), sides[k - 1])
        points = tool_points(q + sides * BACKLASH / 2.0) + NOISE_MM * 1e-3 * rng.normal(size=(len(q), 3))
        columns = [f"q{j}_deg" for j in range(1, 7)] + [f"{axis}_mm" for axis in "xyz"]
        values = np.hstack([np.degrees(q), 1e3 * points])
        if stated:
            columns, values = columns + [f"dir{j}" for j in range(1, 7)], np.hstack([values, sides])
        text = "\n".join([",".join(columns), *(",".join(f"{v:.6f}" for v in row) for row in values)]) + "\n"
        made = self.client.post("/v1/robots/arm/campaigns", json={"name": name}).raise_for_status().json()["id"]
        self.client.post(
            f"/v1/campaigns/{made}/observations", content=text.encode(), headers={"Content-Type": "text/csv"}
        ).raise_for_status()
        return str(made)

    def compute(self, kind: str, campaigns: list[str], **asked: Any) -> dict[str, Any]:
        """Compute a job in this process as a worker does."""
        job = TypeAdapter[Any](NewJob).validate_python({"kind": kind, "robot": "arm", "campaigns": campaigns, **asked})
        with self.database.transaction() as session:
            made = jobs.add(session, robots.get(session, "arm").id, job)
            loaded = jobs.load(session, made)
            output = with_direction_warning(kind, get_job_kind(kind).run(loaded, lambda fraction, stage: None), loaded)
            jobs.succeed(session, made, output.result, output.version)
            result = jobs.get(session, made).result
        assert result is not None
        return result


@pytest.fixture
def cell(client: httpx.Client, database: Database) -> Cell:
    return Cell(client, database)


def poses(count: int, seed: int) -> Floats:
    return np.random.default_rng(seed).uniform(-2.2, 2.2, (count, 6))


def warned(result: dict[str, Any], code: str = "directions_derived") -> list[str]:
    return [one["message"] for one in result["warnings"] if one["code"] == code]


def test_a_backlash_is_found_without_columns_of_directions(cell: Cell) -> None:
    fit, held = cell.send(poses(120, 2), "fit"), cell.send(poses(40, 3), "held")
    options = {"effects": ["backlash", "encoder_scale"], "next_poses": 0, "bootstraps": 299, "resamples": 10,
               "permutations": 3}  # fmt: skip
    found = cell.compute("gap", [fit], validation=[held], options=options)
    named = {(one["id"], tuple(one["joints"])) for one in found["effects"]}
    assert {id_ for id_, _ in named} == {"backlash"}
    assert {joint for _, joints in named for joint in joints} == {2, 4}
    assert warned(found) == [f"fit, held: {SAID}"]
    error = cell.compute("evaluate", [held], options={"version": found["version_id"]})
    assert error["metrics"][held]["left_out"] == 1
    assert error["metrics"][held]["identified"]["rms_mm"] < 1.2 * NOISE_MM * 3**0.5  # 0.6 mm without the backlash
    assert warned(error) == [f"held: {SAID}"]


def test_a_version_with_backlash_is_checked_by_poses_without_directions(cell: Cell) -> None:
    fit = cell.send(poses(80, 2), "fit")
    options = {"effects": [{"id": "backlash", "joints": [2, 4]}]}
    made = cell.compute("identify", [fit], options=options)
    assert made["metrics"]["train"]["identified"]["rms_mm"] < 1.8 * NOISE_MM * 3**0.5  # 0.5 mm in the first row
    assert warned(made) == [f"fit: {SAID}"]
    version = {"version": made["version_id"]}
    plan = cell.compute("plan", [], options={"purpose": "check", "count": 6, **version})
    assert not any(name.startswith("dir") for name in plan["csv"].splitlines()[0].split(","))
    planned = np.radians([[row[f"q{j}_deg"] for j in range(1, 7)] for row in plan["poses"]])
    check = cell.send(planned, "check")
    verdict = cell.compute("drift", [check], options=version)
    assert verdict["verdict"] == "ok", verdict["sentence"]
    assert warned(verdict) == [f"check: {SAID}"]
    (left_out,) = warned(verdict, "side_unknown")
    assert left_out.startswith("Not counted: ")
    assert "row 1" in left_out


def test_campaigns_with_and_without_directions_go_together(cell: Cell) -> None:
    both = [cell.send(poses(60, 2), "stated", stated=True), cell.send(poses(61, 3), "derived")]
    made = cell.compute("identify", both, options={"effects": [{"id": "backlash", "joints": [2, 4]}]})
    assert made["metrics"]["train"]["identified"]["rms_mm"] < 1.8 * NOISE_MM * 3**0.5
    assert warned(made) == [f"derived: {SAID}"]
    assert not warned(cell.compute("identify", both))  # geometry alone follows no directions
