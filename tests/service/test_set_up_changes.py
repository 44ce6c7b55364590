"""A tool that was changed by 14 mm between two campaigns of a job is named, and the remedy leaves the noise."""

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
from kilter_service.jobs.work.runner import with_set_up_warning
from kilter_service.robots import store as robots
from tests.core.truth import ur10, with_hidden_errors

Floats = NDArray[np.float64]
ARM = with_hidden_errors(ur10(), np.random.default_rng(0))
TOOL, CHANGE = np.array([0.05, 0.03, 0.12]), np.array([0.009, -0.009, 0.006])  # 14 mm
NOISE_MM = 0.03


def send(client: httpx.Client, name: str, tools: list[Floats], session: bool = False) -> str:
    """Measure 40 poses with each tool, in a session each or in none, and upload them as one campaign."""
    rng, parts = np.random.default_rng(len(name)), []
    for number, tool in enumerate(tools, 1):
        q = rng.uniform(-2.2, 2.2, (40, 6))
        place, turn = ARM.poses(q)
        points = 1e3 * (place + turn @ tool) + NOISE_MM * rng.normal(size=(40, 3))
        parts.append(np.hstack([np.degrees(q), points, np.full((40, 1), number)]))
    rows = np.vstack(parts)
    names = [f"q{j}_deg" for j in range(1, 7)] + ["x_mm", "y_mm", "z_mm"] + (["session"] if session else [])
    lines = [",".join(names), *(",".join(f"{v:.6f}" for v in row[: len(names)]) for row in rows)]
    made = client.post("/v1/robots/arm/campaigns", json={"name": name}).raise_for_status().json()["id"]
    headers = {"Content-Type": "text/csv"}
    client.post(
        f"/v1/campaigns/{made}/observations", content="\n".join(lines) + "\n", headers=headers
    ).raise_for_status()
    return str(made)


def identify(database: Database, campaigns: list[str], **options: Any) -> dict[str, Any]:
    """Compute an identification in this process as a worker does."""
    body = {"kind": "identify", "robot": "arm", "campaigns": campaigns, "options": options}
    with database.transaction() as session:
        made = jobs.add(session, robots.get(session, "arm").id, TypeAdapter[Any](NewJob).validate_python(body))
        loaded = jobs.load(session, made)
        output = with_set_up_warning(
            "identify", get_job_kind("identify").run(loaded, lambda fraction, stage: None), loaded
        )
    return output.result


def left(result: dict[str, Any]) -> float:
    return float(result["metrics"]["train"]["identified"]["rms_mm"])


def changes(result: dict[str, Any]) -> list[dict[str, Any]]:
    return [one for one in result["warnings"] if one["code"] == "set_up_changed"]


@pytest.fixture(autouse=True)
def _robot(client: httpx.Client) -> None:
    client.post("/v1/robots", json={**preset_document("ur10"), "name": "arm"}).raise_for_status()


def test_another_tool_in_each_campaign(client: httpx.Client, database: Database) -> None:
    both = [send(client, "one", [TOOL]), send(client, "other", [TOOL + CHANGE])]
    whole = identify(database, both)
    assert left(whole) > 3.0
    (said,) = changes(whole)
    assert said["message"].startswith("one, other: the tool lies 14 mm apart between campaigns. With a tool for each")
    assert said["message"].endswith("Identify with --refit tool.")
    assert (said["refit"], said["campaigns"]) == (["tool"], both)
    mended = identify(database, both, refit=["tool"])
    assert left(mended) < 1.2 * NOISE_MM * 3**0.5
    assert changes(mended) == []


def test_another_tool_in_each_session(client: httpx.Client, database: Database) -> None:
    campaign = send(client, "days", [TOOL, TOOL + CHANGE], session=True)
    (said,) = changes(identify(database, [campaign]))
    assert "between sessions" in said["message"]
    assert left(identify(database, [campaign], refit=["tool"])) < 1.2 * NOISE_MM * 3**0.5


def test_one_tool_in_two_campaigns_is_no_change(client: httpx.Client, database: Database) -> None:
    assert changes(identify(database, [send(client, "one", [TOOL]), send(client, "other", [TOOL])])) == []
