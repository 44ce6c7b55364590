"""Two files of one day are on one clock: what happened once in the first had happened before the second.

The cell is plain DH in numpy and shares nothing with the core.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import TypeAdapter

from kilter_core.arm.presets import preset_document
from kilter_files import prepare
from kilter_service.contract.jobs.registry import NewJob
from kilter_service.ground.db import Database
from kilter_service.jobs import store as jobs
from kilter_service.jobs.registry import get_job_kind
from kilter_service.jobs.work.runner import with_clock_warnings
from kilter_service.robots import store as robots
from tests.service.test_derived_directions import tool_points

Floats = NDArray[np.float64]
NOISE_MM = 0.03
STAMPS = "%Y-%m-%d %H:%M:%S.%f"
MAP = """
[columns]
"q*" = {{ from = "A*", unit = "deg" }}
x_mm = {{ from = "X", unit = "mm" }}
y_mm = {{ from = "Y", unit = "mm" }}
z_mm = {{ from = "Z", unit = "mm" }}
t_s = {{ from = "Time", unit = "timestamp"{more} }}
"""


class Cell:
    """A cell whose base is knocked once, and whose tracker writes dates and clocks."""

    def __init__(
        self,
        client: httpx.Client,
        database: Database,
        folder: Path,
        knock: datetime,
        name: str,
        drift_mm_h: float = 0.0,
    ) -> None:
        self.client, self.database, self.folder, self.knock, self.name = client, database, folder, knock, name
        self.drift_m_s = drift_mm_h * 1e-3 / 3600.0
        client.post("/v1/robots", json={**preset_document("ur10"), "name": name}).raise_for_status()

    def send(self, begin: datetime, end: datetime, rows: int, seed: int, stamps: str = STAMPS, more: str = "") -> str:
        """Measure random poses, write them as a lab does, and upload the file through a column map."""
        rng = np.random.default_rng(seed)
        q = rng.uniform(-2.2, 2.2, (rows, 6))
        times = [begin + (end - begin) * k / (rows - 1) for k in range(rows)]
        moved = np.array([time >= self.knock for time in times])[:, None]
        points = tool_points(q)
        points = points + moved * (np.array([3e-4, -2e-4, 1e-4]) + np.cross([0.0, 1e-4, 2e-4], points))
        since = np.array([(time - begin).total_seconds() for time in times])[:, None]
        points = points + since * self.drift_m_s * np.array([0.0, 1.0, 0.0])
        points = points + NOISE_MM * 1e-3 * rng.normal(size=points.shape)
        file, column_map = self.folder / f"{seed}.csv", self.folder / f"{seed}.toml"
        lines = [f"Time,{','.join(f'A{k}' for k in range(1, 7))},X,Y,Z"]
        lines += [",".join([time.strftime(stamps), *(f"{v:.6f}" for v in (*np.degrees(a), *(1e3 * p)))])
                  for time, a, p in zip(times, q, points, strict=True)]  # fmt: skip
        file.write_text("\n".join(lines) + "\n")
        column_map.write_text(MAP.format(more=more))
        prepared = prepare(file, column_map=column_map)
        made = self.client.post(f"/v1/robots/{self.name}/campaigns", json={"name": file.name}).raise_for_status()
        campaign = str(made.json()["id"])
        self.client.post(
            f"/v1/campaigns/{campaign}/observations", content=prepared.content,
            headers={"Content-Type": prepared.content_type},
        ).raise_for_status()  # fmt: skip
        return campaign

    def compute(self, kind: str, campaigns: list[str], **asked: Any) -> dict[str, Any]:
        """Compute a job in this process as a worker does."""
        body = {"kind": kind, "robot": self.name, "campaigns": campaigns, **asked}
        job = TypeAdapter[Any](NewJob).validate_python(body)
        with self.database.transaction() as session:
            made = jobs.add(session, robots.get(session, self.name).id, job)
            loaded = jobs.load(session, made)
            output = with_clock_warnings(get_job_kind(kind).run(loaded, lambda fraction, stage: None), loaded)
            jobs.succeed(session, made, output.result, output.version)
            result = jobs.get(session, made).result
        assert result is not None
        return result


DAY = datetime(2026, 10, 27)
OPTIONS = {
    "effects": ["base_step", "drift", "backlash"], "next_poses": 0, "bootstraps": 299, "resamples": 10, "permutations": 3,
}  # fmt: skip


def at(hour: int, minute: int, day: int = 0) -> datetime:
    """A time of the day of the knock, or of one some days later."""
    return DAY + timedelta(days=day, hours=hour, minutes=minute)


def test_held_out_rows_of_the_same_day_come_after_the_knock(
    client: httpx.Client, database: Database, tmp_path: Path
) -> None:
    cell = Cell(client, database, tmp_path, at(11, 0), "arm")
    fit, held = cell.send(at(9, 1), at(12, 32), 90, 2), cell.send(at(12, 34), at(13, 25), 29, 3)
    found = cell.compute("gap", [fit], validation=[held], options=OPTIONS)
    codes = {one["code"] for one in found["warnings"]}
    assert "moved_once" in codes
    assert not codes & {"set_up_elsewhere", "worse_than_geometry", "clock_unknown"}
    error = cell.compute("evaluate", [held], options={"version": found["version_id"]})["metrics"][held]
    assert error["identified"]["rms_mm"] < 1.2 * NOISE_MM * 3**0.5  # 0.48 mm by a version that takes them as before it
    assert error["within_u95"] > 0.9
    dated = client.get(f"/v1/campaigns/{held}").json()["measured_at"]
    assert datetime.fromisoformat(dated).replace(tzinfo=None) == at(13, 25)


def test_clocks_without_a_date_do_not_place_a_knock_in_other_rows(
    client: httpx.Client, database: Database, tmp_path: Path
) -> None:
    cell = Cell(client, database, tmp_path, at(11, 0), "undated")
    fit = cell.send(at(9, 1), at(12, 32), 90, 2, stamps="%H:%M:%S.%f")
    held = cell.send(at(12, 34), at(13, 25), 29, 3, stamps="%H:%M:%S.%f")
    found = cell.compute("gap", [fit], validation=[held], options=OPTIONS)
    (said,) = (one["message"] for one in found["warnings"] if one["code"] == "clock_unknown")
    assert said == (
        "3.csv: Nothing says when these rows were measured, as against those of the fit. Counted as having happened before "
        "them: base step. Give both files time stamps with a date."
    )
    assert found["gap"]["validation_after_mm"] < 1.2 * NOISE_MM * 3**0.5
    answer = cell.compute("evaluate", [held], options={"version": found["version_id"]})
    assert [one["code"] for one in answer["warnings"]] == ["clock_unknown"]
    assert answer["metrics"][held]["identified"]["rms_mm"] < 1.2 * NOISE_MM * 3**0.5


def test_a_drift_is_not_carried_to_another_day(client: httpx.Client, database: Database, tmp_path: Path) -> None:
    cell = Cell(client, database, tmp_path, at(0, 0), "drifting", drift_mm_h=0.2)
    fit, later = cell.send(at(9, 1), at(12, 32), 60, 2), cell.send(at(9, 0, day=6), at(9, 10, day=6), 20, 3)
    made = cell.compute("identify", [fit], validation=[later], options={"effects": [{"id": "drift"}]})
    (said,) = (one["message"] for one in made["warnings"] if one["code"] == "law_of_another_day")
    assert said == "3.csv: These rows were measured on another day than those of the fit. Not applied to them: drift."
    assert made["metrics"]["train"]["identified"]["rms_mm"] < 1.2 * NOISE_MM * 3**0.5
    assert made["metrics"]["validation"]["identified"]["rms_mm"] < 0.3  # 29 mm where the drift goes on for six days


@pytest.mark.parametrize("method", ["least_squares", "kalman"])
def test_a_start_brings_no_drift_of_an_unknown_clock(
    client: httpx.Client, database: Database, tmp_path: Path, method: str
) -> None:
    cell = Cell(client, database, tmp_path, at(0, 0), "continued", drift_mm_h=0.2)
    fit = cell.send(at(9, 1), at(12, 32), 60, 2, stamps="%H:%M:%S.%f")
    later = cell.send(at(9, 0), at(9, 5), 30, 3, stamps="%H:%M:%S.%f")
    start = cell.compute("identify", [fit], options={"effects": [{"id": "drift"}]})["version_id"]
    made = cell.compute("identify", [later], options={"start": start, "method": method})
    assert [one["code"] for one in made["warnings"] if one["code"] == "clock_unknown"] == ["clock_unknown"]
    assert made["metrics"]["train"]["identified"]["rms_mm"] < 2.0 * NOISE_MM * 3**0.5
    assert not [one for one in made["parameters"] if one["name"].startswith("drift")]
