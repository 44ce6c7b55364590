"""Columns of loads on links: what they become, and what is refused of observations and of trajectories."""

from __future__ import annotations

import json
from pathlib import Path

import httpx
import numpy as np
import pyarrow as pa
import pytest

from kilter_core.errors import ObservationError
from kilter_service.campaigns.facts import meaning
from kilter_service.correction.service import read_trajectory
from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.tables.columns import read_columns
from tests.core.arm.test_link_loads import TORSO

KINDS = ["revolute"] * 4
JOINTS = {f"q{j}_deg": [10.0, 20.0] for j in range(1, 5)}
MASS = {"load2_kg": [5.0, 4.0], "load2_x_mm": [100.0, 200.0], "load2_y_mm": [0.0, 0.0], "load2_z_mm": [10.0, 0.0]}
PULL = {"load3_fx_n": [1.0, 2.0], "load3_fy_n": [0.0, 0.0], "load3_fz_n": [-3.0, 0.0]}


def test_they_become_masses_and_wrenches_of_links() -> None:
    table = pa.table(JOINTS | MASS | PULL)
    columns = read_columns(table.column_names, KINDS)
    rows = observations(table, columns, {})
    assert rows.link_mass is not None
    assert rows.link_wrench is not None
    assert rows.link_mass.shape == (2, 4, 4)
    np.testing.assert_allclose(rows.link_mass[:, 1], [[5.0, 0.1, 0.0, 0.01], [4.0, 0.2, 0.0, 0.0]])
    np.testing.assert_allclose(rows.link_wrench[0, 2], [1.0, 0.0, -3.0, 0.0, 0.0, 0.0])
    assert not np.any(rows.link_mass[:, [0, 2, 3]])
    said = {column.name: meaning(column) for column in columns}
    assert said["load2_kg"] == "mass on link 2 beyond its own"
    assert said["load2_z_mm"] == "place of the mass along z, on link 2"
    assert said["load3_fz_n"] == "force along z, on link 3"


@pytest.mark.parametrize(
    ("names", "why"),
    [
        (["load2_kg"], "load2_x"),
        (["load2_x_mm", "load2_y_mm", "load2_z_mm"], "load2_kg"),
        (["load9_kg"], "joint 9"),
        (["load3_fx_n", "load3_fy_n"], "load3_fz"),
        (["load2_kg", "load2_x_deg", "load2_y_mm", "load2_z_mm"], "unit"),
    ],
)
def test_half_a_load_is_refused(names: list[str], why: str) -> None:
    with pytest.raises(ObservationError, match=why):
        read_columns([*JOINTS, *names], KINDS)


def test_a_trajectory_states_masses_and_no_forces(tmp_path: Path) -> None:
    path = tmp_path / "path.json"
    path.write_text(json.dumps(JOINTS | MASS))
    table, columns = read_trajectory(path, "application/json", KINDS)
    assert observations(table, columns, {}).link_mass is not None
    path.write_text(json.dumps(JOINTS | PULL))
    with pytest.raises(ObservationError, match="forces yet to come"):
        read_trajectory(path, "application/json", KINDS)


def test_a_negative_mass_is_refused_with_its_row(client: httpx.Client) -> None:
    client.post("/v1/robots", json=TORSO.document() | {"name": "torso"}).raise_for_status()
    campaign = client.post("/v1/robots/torso/campaigns", json={"name": "two arms"}).raise_for_status().json()["id"]
    table = JOINTS | MASS | {f"{k}_mm": [300.0, 310.0] for k in "xyz"}
    client.post(f"/v1/campaigns/{campaign}/observations", json=table).raise_for_status()
    refused = client.post(f"/v1/campaigns/{campaign}/observations", json=table | {"load2_kg": [1.0, -1.0]})
    assert refused.status_code == 400
    assert "Row 2" in refused.json()["detail"]
    assert "load2_kg" in refused.json()["detail"]
