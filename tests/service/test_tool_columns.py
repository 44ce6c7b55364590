"""Columns and conditions of what holds, loads or touches the tool: what is taken, what is refused, what core gets."""

from __future__ import annotations

from typing import Any

import httpx
import numpy as np
import pyarrow as pa
import pytest

from kilter_service.ground.tables.assemble import observations
from kilter_service.ground.tables.columns import read_columns

ROBOT = {"name": "arm", "convention": "dh", "rows": [{"a_mm": 300, "alpha_deg": 90}, {"a_mm": 200}]}
Q = {"q1_deg": [1.0, 2.0], "q2_deg": [3.0, 4.0]}
MARKERS = {f"m{k}{axis}_mm": [100.0 * k, 90.0 * k] for k in (1, 2, 3) for axis in "xyz"}


def upload(client: httpx.Client, columns: dict[str, Any]) -> httpx.Response:
    client.post("/v1/robots", json=ROBOT).raise_for_status()
    campaign = client.post("/v1/robots/arm/campaigns", json={"name": "c", "numbered": True}).json()["id"]
    return client.post(f"/v1/campaigns/{campaign}/observations", json={**Q, **columns})


@pytest.mark.parametrize(
    "columns",
    [
        {"socket_id": [1, 2]},
        {"socket_id": [1, 0], "plane_id": [0, 3]},
        {"bar_id": [1, 0], "bar_mm": [250.5, 0], "plane_id": [0, 1]},
        {**MARKERS, "tipx_mm": [1.0, None], "tipy_mm": [1.0, None], "tipz_mm": [1.0, None]},
        {"x_mm": [1, 2], "y_mm": [1, 2], "z_mm": [1, 2], "fx_n": [0, 0], "fy_n": [0, 0], "fz_n": [-9, 9]},
    ],
)
def test_taken(shared_client: httpx.Client, columns: dict[str, Any]) -> None:
    answer = upload(shared_client, columns)
    assert answer.status_code in (200, 201), answer.text


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"socket_id": [1, 0]}, "Row 2, column 'socket_id' and its neighbours must name the one thing"),
        ({"socket_id": [1, 1], "plane_id": [0, 1]}, "Row 2, column 'socket_id'"),
        ({"socket_id": [1, 1.5]}, "is not a whole number"),
        ({"socket_id": [1, 1], "sx_mm": [0.1, 0.1], "sy_mm": [0.1, 0.1], "sz_mm": [0.1, 0.1]}, "these rows have none: leave"),
        ({"socket_id": [1, -1]}, "is negative"),
        ({"bar_id": [1, 1]}, "'bar' is missing"),
        ({"bar_id": [1, 1], "bar_mm": [250, 0]}, "Row 2, column 'bar_mm' is not the length"),
        ({"socket_id": [1, 1], "x_mm": [1, 2], "y_mm": [1, 2], "z_mm": [1, 2]}, "cannot go with a measured tool"),
        ({"x_mm": [1, 2], "y_mm": [1, 2], "z_mm": [1, 2], "tipx_mm": [1, 2], "tipy_mm": [1, 2], "tipz_mm": [1, 2]},
         "missing its markers"),
        ({**MARKERS, "tipx_mm": [1.0, None], "tipy_mm": [1.0, 2.0], "tipz_mm": [1.0, None]}, "Row 2, column 'tipx_mm'"),
        ({"x_mm": [1, 2], "y_mm": [1, 2], "z_mm": [1, 2], "fx_n": [0, 0]}, "'fy' is missing"),
        ({"x_mm": [1, 2], "y_mm": [1, 2], "z_mm": [1, 2], "fx": [0, 0]}, "fx_n"),
    ],
)  # fmt: skip
def test_refused_with_row_and_column(shared_client: httpx.Client, columns: dict[str, Any], says: str) -> None:
    answer = upload(shared_client, columns)
    assert answer.status_code == 400
    assert says in answer.json()["detail"]


def test_what_core_gets() -> None:
    table = pa.table({
        "q1_deg": [0.0, 1.0], "x_mm": [1.0, 2.0], "y_mm": [1.0, 2.0], "z_mm": [1.0, 2.0],
        "mx_nm": [0.1, 0.2], "my_nm": [0.3, 0.4], "mz_nm": [0.5, 0.6],
    })  # fmt: skip
    found = observations(table, read_columns(table.column_names, ["revolute"]), {"tool_force_n": [1.0, 2.0, 3.0]})
    np.testing.assert_array_equal(found.wrench, [[1, 2, 3, 0.1, 0.3, 0.5], [1, 2, 3, 0.2, 0.4, 0.6]])
    table = pa.table({"q1_deg": [0.0, 1.0], "bar_id": [1.0, 0.0], "bar_mm": [250.0, 0.0], "plane_id": [0.0, 4.0]})
    found = observations(table, read_columns(table.column_names, ["revolute"]), {})
    assert found.wrench is None
    assert found.position is None
    np.testing.assert_array_equal(found.bar, [1, 0])
    np.testing.assert_array_equal(found.plane, [0, 4])
    np.testing.assert_allclose(found.bar_length, [0.25, 0.0])  # type: ignore[arg-type]
