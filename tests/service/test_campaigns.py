from __future__ import annotations

import hashlib
import io
import json
import socket
import time
from dataclasses import replace
from typing import Any

import httpx
import numpy as np
import pyarrow as pa
import pytest
from numpy.typing import NDArray
from pyarrow import parquet
from scipy.spatial.transform import Rotation

from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_files.ground.errors import number_of_session
from kilter_service.campaigns import store
from kilter_service.ground.db import Database
from kilter_service.jobs.setups import Setups
from kilter_service.robots import store as robots

pytestmark = pytest.mark.both_databases
Columns = dict[str, list[Any]]
CSV = {"content-type": "text/csv"}
ROBOT = {
    "name": "arm", "convention": "dh", "rows": [{"a_mm": 300, "d_mm": 100}, {"a_mm": 200}],
    "joints": [{"name": "j1", "limits_deg": [-170, 170]}, {"name": "j2", "limits_deg": [-120, 120]}],
}  # fmt: skip


def columns(rows: int = 5) -> Columns:
    rng = np.random.default_rng(rows)
    q1, q2 = rng.uniform(-100, 100, rows).round(3), rng.uniform(-100, 100, rows).round(3)
    a, b = np.radians(q1), np.radians(q1 + q2)
    x, y = 300 * np.cos(a) + 200 * np.cos(b), 300 * np.sin(a) + 200 * np.sin(b)
    z = 100 + rng.normal(0, 0.1, rows)
    made = {"q1_deg": q1, "q2_deg": q2, "x_mm": x, "y_mm": y, "z_mm": z}
    return {name: values.tolist() for name, values in made.items()}


def csv_of(columns: Columns) -> str:
    rows = zip(*columns.values(), strict=True)
    return "\n".join([",".join(columns), *(",".join("" if c is None else repr(c) for c in row) for row in rows)]) + "\n"


def parquet_of(columns: Columns) -> bytes:
    buffer = io.BytesIO()
    parquet.write_table(pa.table(columns), buffer)
    return buffer.getvalue()


@pytest.fixture
def campaign(client: httpx.Client) -> str:
    client.post("/v1/robots", json=ROBOT).raise_for_status()
    answer = client.post("/v1/robots/arm/campaigns", json={"name": "first", "device": "tracker"})
    assert answer.status_code == 201
    return str(answer.json()["id"])


@pytest.fixture
def shared_campaign(shared_client: httpx.Client) -> str:
    """A new campaign on the module's server."""
    shared_client.post("/v1/robots", json=ROBOT).raise_for_status()
    return str(shared_client.post("/v1/robots/arm/campaigns", json={"name": "shared", "numbered": True}).json()["id"])


def send(client: httpx.Client, campaign: str, body: str | bytes, media: str = "text/csv") -> httpx.Response:
    return client.post(f"/v1/campaigns/{campaign}/observations", content=body, headers={"content-type": media})


def stored(database: Database, campaign: str) -> Observations:
    with database.transaction() as session:
        return store.observations(session, campaign, robots.core_robot(session, 1))


def test_csv_parquet_and_json_become_the_same_observations(client: httpx.Client, database: Database) -> None:
    client.post("/v1/robots", json=ROBOT)
    rows = columns()
    bodies: list[tuple[str | bytes, str]] = [
        (csv_of(rows), "text/csv; charset=utf-8"),
        (parquet_of(rows), "application/vnd.apache.parquet"),
        (json.dumps(rows), "application/json"),
    ]
    for body, media in bodies:
        campaign = client.post("/v1/robots/arm/campaigns", json={"name": media}).json()["id"]
        answer = send(client, campaign, body, media)
        assert answer.status_code == 201, answer.text
        raw = body.encode() if isinstance(body, str) else body
        assert answer.json()["sha256"] == hashlib.sha256(raw).hexdigest()
        assert answer.json()["rows"] == 5
        found = stored(database, campaign)
        assert np.array_equal(found.q[:, 0], np.radians(rows["q1_deg"]))
        assert found.position is not None
        assert np.array_equal(found.position[:, 1], np.array(rows["y_mm"]) * 1e-3)


def test_the_same_bytes_twice_change_nothing(shared_client: httpx.Client, shared_campaign: str) -> None:
    body = csv_of(columns())
    assert send(shared_client, shared_campaign, body).status_code == 201
    again = send(shared_client, shared_campaign, body)
    assert (again.status_code, again.json()["new"], again.json()["total_rows"]) == (200, False, 5)
    more = send(shared_client, shared_campaign, csv_of(columns(7)))
    assert (more.status_code, more.json()["total_rows"]) == (201, 12)
    report = shared_client.get(f"/v1/campaigns/{shared_campaign}").json()
    assert (report["rows"], len(report["uploads"]), report["role"]) == (12, 2, "train")
    assert shared_client.get("/v1/robots/arm/campaigns").json()["campaigns"][-1] == report


def change(name: str, row: int, value: Any) -> str:
    rows = columns()
    rows.setdefault(name, [0] * 5)[row - 1] = value
    return csv_of(rows)


def renamed(old: str, new: str) -> str:
    return csv_of({new if name == old else name: values for name, values in columns().items()})


def without(name: str) -> str:
    return csv_of({key: values for key, values in columns().items() if key != name})


def quaternions(**cells: Any) -> str:
    return csv_of(columns() | {name: [value] * 5 for name, value in cells.items()})


def markers(**cells: Any) -> str:
    rows = {name: values for name, values in columns().items() if name[0] == "q"}
    base = {f"m{k}{axis}_mm": [50.0 * k + 100.0 * n for n in range(5)] for k in (1, 2, 3) for axis in "xyz"}
    for name, value in cells.items():
        base[name][3] = value
    return csv_of(rows | base)


def scaled(factor: float, unit: str) -> str:
    return csv_of({
        name if name[0] == "q" else f"{name[0]}_{unit}": values if name[0] == "q" else [v * factor for v in values]
        for name, values in columns(40).items()
    })  # fmt: skip


def moved(**cells: dict[int, float]) -> str:
    rows = columns(40)
    for name, changes in cells.items():
        for row, value in changes.items():
            rows[name][row - 1] = value
    return csv_of(rows)


LINES = csv_of(columns()).splitlines()

BAD: list[tuple[str, str, int | None, str | None]] = [
    (renamed("x_mm", "x"), "Column 'x' has no unit: name it 'x_mm' or 'x_m'", None, "x"),
    (renamed("x_mm", "x_inch"), "'x_mm' or 'x_m'", None, "x_inch"),
    (renamed("q2_deg", "q2_mm"), "'q2_deg' or 'q2_rad'", None, "q2_mm"),
    (renamed("q2_deg", "q3_deg"), "the robot has 2 joints", None, "q3_deg"),
    (renamed("z_mm", "zz_mm"), "is unknown. Near it: z_mm", None, "zz_mm"),
    (without("q2_deg"), "'q2_deg' is missing", None, "q2_deg"),
    (without("y_mm"), "x, y, z belong together", None, "y"),
    (csv_of({"q1_deg": [1.0], "q2_deg": [2.0]}), "Nothing was measured", None, None),
    ("\n".join([LINES[0] + ",x_m", *(line + ",1" for line in LINES[1:])]), "says the same as 'x_mm'", None, "x_m"),
    ("\n".join([LINES[0] + ",x_mm", *(line + ",1" for line in LINES[1:])]), "appears twice", None, "x_mm"),
    (change("y_mm", 3, float("nan")), "Row 3, column 'y_mm' is nan", 3, "y_mm"),
    (change("y_mm", 2, "inf"), "Row 2, column 'y_mm'", 2, "y_mm"),
    (change("y_mm", 2, None), "Row 2, column 'y_mm' is empty: only markers", 2, "y_mm"),
    (change("q2_deg", 4, 131.0), "Row 4, column 'q2_deg' is outside the limits -120 to 120 of joint 'j2'", 4, "q2_deg"),
    (change("dir1", 2, 2), "Column 'dir2' is missing", None, "dir2"),
    (change("session", 2, 0.5), "Row 2, column 'session' is not a whole number", 2, "session"),
    (change("payload_kg", 5, -1), "Row 5, column 'payload_kg' is negative", 5, "payload_kg"),
    (change("temperature_c", 1, -300), "below absolute zero", 1, "temperature_c"),
    (quaternions(qw=1, qx=1, qy=0, qz=0), "do not form a unit quaternion", 1, "qw"),
    (quaternions(qw=1, qx=0, qy=0), "qw, qx, qy, qz belong together", None, "qz"),
    (quaternions(sx_mm=0, sy_mm=1, sz_mm=1), "must be above 0", 1, "sx_mm"),
    (markers(m2y_mm=None), "Row 4, column 'm2y_mm' is empty where", 4, "m2y_mm"),
    (markers(m2x_mm=0.0, m2y_mm=0.0, m2z_mm=0.0), "leave the cells of a missing marker empty", 4, "m2x_mm"),
    ("\n".join([*LINES[:3], LINES[3] + ",9", *LINES[4:]]), "Row 3 has 6 cells where the header has 5", 3, None),
    ("\n".join([*LINES[:2], "", *LINES[2:]]), "Row 2, column 'q1_deg' is empty", 2, "q1_deg"),
    ("\n".join([*LINES[:3], LINES[3].replace(".", "o")]), "Row 3, column 'q1_deg' is", 3, "q1_deg"),
    (LINES[0], "no rows", None, None),
    ("", "empty", None, None),
    (csv_of(columns()).replace(",", ";"), "export it with commas", None, None),
    (scaled(1.0, "m"), "multiplied by 0.001: they look like mm declared as m", None, "x_m"),
    (scaled(1e-3, "mm"), "multiplied by 1000: they look like m declared as mm", None, "x_mm"),
    (scaled(1e3, "mm"), "multiplied by 0.001", None, "x_mm"),
    (scaled(1e-6, "m"), "multiplied by 1000", None, "x_m"),
]  # fmt: skip


@pytest.mark.parametrize(("body", "message", "row", "column"), BAD)
def test_a_broken_rule_names_its_place_and_nothing_is_stored(
    shared_client: httpx.Client, shared_campaign: str, body: str, message: str, row: int | None, column: str | None
) -> None:
    answer = send(shared_client, shared_campaign, body)
    assert answer.status_code == 400, answer.text
    problem = answer.json()
    assert problem["code"] == "observations_invalid"
    assert message in problem["detail"]
    assert problem["context"].get("row") == row
    assert problem["context"].get("column") == column
    assert shared_client.get(f"/v1/campaigns/{shared_campaign}").json()["rows"] == 0


@pytest.mark.parametrize(
    ("body", "message"),
    [
        (
            '{"q1_deg": [1], "q2_deg": [1, 2], "x_mm": [1, 2], "y_mm": [1, 2], "z_mm": [1, 2]}',
            "Row 2, column 'q1_deg' is missing",
        ),
        ('{"q1_deg": ["1"], "q2_deg": [1], "x_mm": [1], "y_mm": [1], "z_mm": [1]}', "Row 1, column 'q1_deg'"),
        ('{"q1_deg": [NaN]}', "holds NaN"),
        ('{"q1_deg": [1], "q1_deg": [2]}', "appears twice"),
        ("[1, 2]", "must be columns"),
        ("{", "not JSON"),
    ],
)
def test_json_is_as_strict(shared_client: httpx.Client, shared_campaign: str, body: str, message: str) -> None:
    answer = send(shared_client, shared_campaign, body, "application/json")
    assert answer.status_code == 400
    assert message in answer.json()["detail"]


def test_parquet_is_as_strict(shared_client: httpx.Client, shared_campaign: str) -> None:
    media = "application/vnd.apache.parquet"
    assert "not a Parquet file" in send(shared_client, shared_campaign, b"PAR1 no", media).json()["detail"]
    text = send(shared_client, shared_campaign, parquet_of(columns() | {"x_mm": ["a"] * 5}), media).json()
    assert text["context"]["column"] == "x_mm"
    rows = columns()
    rows["y_mm"][1] = float("nan")
    assert "Row 2, column 'y_mm'" in send(shared_client, shared_campaign, parquet_of(rows), media).json()["detail"]


def test_unknown_media_types_and_campaigns_are_refused(shared_client: httpx.Client, shared_campaign: str) -> None:
    assert send(shared_client, shared_campaign, "x", "application/pdf").status_code == 415
    assert send(shared_client, "cmp_none", "x").json()["code"] == "campaign_not_found"
    assert shared_client.post("/v1/robots/nobody/campaigns", json={"name": "a"}).json()["code"] == "robot_not_found"
    unknown = shared_client.post("/v1/robots/arm/campaigns", json={"name": "a", "colour": "red"})
    assert unknown.status_code == 422


def test_columns_of_later_uploads_must_be_the_same(shared_client: httpx.Client, shared_campaign: str) -> None:
    send(shared_client, shared_campaign, csv_of(columns()))
    other = send(shared_client, shared_campaign, csv_of(columns() | {"t_s": [1, 2, 3, 4, 5]}))
    assert (other.status_code, other.json()["context"]["columns"]) == (400, ["t_s"])


def test_conditions_fill_what_the_rows_do_not_say(client: httpx.Client, database: Database) -> None:
    client.post("/v1/robots", json=ROBOT)
    conditions = {"payload_kg": 2.5, "payload_com_mm": [0, 0, 40], "temperature_c": 21}
    campaign = client.post("/v1/robots/arm/campaigns", json={"name": "a", "conditions": conditions}).json()["id"]
    send(client, campaign, csv_of(columns() | {"temperature_c": [20.0] * 5})).raise_for_status()
    found = stored(database, campaign)
    assert found.payload_kg is not None
    assert found.payload_kg.tolist() == [2.5] * 5
    assert found.payload_com is not None
    assert found.payload_com[4].tolist() == [0, 0, 0.04]
    assert found.temperature_c is not None
    assert found.temperature_c.tolist() == [20.0] * 5


def test_orientations_and_markers_become_core_arrays(client: httpx.Client, database: Database) -> None:
    client.post("/v1/robots", json=ROBOT)
    angles: NDArray[np.float64] = np.random.default_rng(0).uniform(-1, 1, (5, 3))
    euler = {name: np.degrees(angles[:, k]).tolist() for k, name in enumerate(("phi_deg", "theta_deg", "psi_deg"))}
    rotations = Rotation.from_euler("ZXZ", angles)
    xyzw = rotations.as_quat()
    quaternion = {name: xyzw[:, k].tolist() for name, k in (("qw", 3), ("qx", 0), ("qy", 1), ("qz", 2))}
    for extra in (euler, quaternion):
        campaign = client.post("/v1/robots/arm/campaigns", json={"name": "a", "numbered": True}).json()["id"]
        send(client, campaign, csv_of(columns() | extra)).raise_for_status()
        found = stored(database, campaign)
        assert found.rotation is not None
        assert np.allclose(found.rotation, rotations.as_matrix(), atol=1e-12)
    campaign = client.post("/v1/robots/arm/campaigns", json={"name": "b", "numbered": True}).json()["id"]
    send(client, campaign, markers(m2x_mm=None, m2y_mm=None, m2z_mm=None)).raise_for_status()
    found = stored(database, campaign)
    assert found.markers is not None
    assert found.markers.shape == (5, 3, 3)
    assert np.isnan(found.markers).sum() == 3
    assert np.isnan(found.markers[3, 1]).all()


def test_poses_of_two_campaigns_keep_apart() -> None:
    part = Observations(q=np.zeros((3, 2)), pose_id=np.array([5, 5, 9]), session=np.array([1, 1, 1]))
    joined = Observations.concatenate(store.renumber_poses_and_sessions([part, part]))
    assert joined.pose_id is not None
    assert joined.pose_id.tolist() == [0, 0, 1, 2, 2, 3]
    assert joined.session is not None
    assert joined.session.tolist() == [0, 0, 0, 1, 1, 1]


def test_sessions_of_one_name_are_one_in_all_campaigns() -> None:
    morning, afternoon = number_of_session("morning"), number_of_session("afternoon")
    parts = [
        Observations(q=np.zeros((2, 2)), session=np.array(codes))
        for codes in ([afternoon, morning], [morning, morning], [1, 2], [2, 1])
    ]
    joined = [part.session.tolist() for part in store.renumber_poses_and_sessions(parts) if part.session is not None]
    assert joined == [[0, 1], [1, 1], [2, 3], [5, 4]]
    assert morning != afternoon
    marked = Setups(("base",), {}).number_setups(
        [(str(k), replace(p, position=np.zeros((2, 3)))) for k, p in enumerate(parts)]
    )
    assert [set(part.setup.tolist()) for part in marked if part.setup is not None] == [{1, 2}, {2}, {3, 4}, {5, 6}]


def test_many_rows_are_stored_in_chunks_and_come_back_exactly(
    client: httpx.Client, campaign: str, database: Database
) -> None:
    rows = columns(150_000)
    send(client, campaign, csv_of(rows)).raise_for_status()
    found = stored(database, campaign)
    assert len(found) == 150_000
    assert found.position is not None
    assert np.array_equal(found.position[:, 0], np.array(rows["x_mm"]) * 1e-3)
    assert Calibration.nominal(robots_of(database)).predict(found.select(slice(0, 2))).position.shape == (2, 3)


def robots_of(database: Database) -> Any:
    with database.transaction() as session:
        return robots.core_robot(session, 1)


def test_an_upload_that_breaks_off_leaves_nothing(client: httpx.Client, campaign: str) -> None:
    body = csv_of(columns(1000)).encode()
    url = client.base_url
    with socket.create_connection((url.host, url.port or 80)) as connection:
        head = (
            f"POST /v1/campaigns/{campaign}/observations HTTP/1.1\r\nHost: localhost\r\nContent-Type: text/csv\r\n"
            f"Authorization: {client.headers['authorization']}\r\nContent-Length: {len(body)}\r\n\r\n"
        )
        connection.sendall(head.encode() + body[: len(body) // 2])
    deadline = time.monotonic() + 5
    while client.get(f"/v1/campaigns/{campaign}").json()["rows"] == 0 and time.monotonic() < deadline - 4.7:
        time.sleep(0.05)
    assert client.get(f"/v1/campaigns/{campaign}").json()["uploads"] == []
    assert send(client, campaign, body).status_code == 201


def test_a_staged_campaign_is_seen_by_nobody_before_its_commit(client: httpx.Client) -> None:
    client.post("/v1/robots", json=ROBOT).raise_for_status()
    staged = client.post("/v1/robots/arm/campaigns", json={"name": "long", "staged": True}).json()["id"]
    hashes = []
    for rows in (5, 7):
        answer = client.post(f"/v1/campaigns/{staged}/observations", content=csv_of(columns(rows)), headers=CSV)
        hashes.append(answer.json()["sha256"])
    assert client.get("/v1/robots/arm/campaigns").json()["campaigns"] == []
    assert client.get("/v1/robots").json()["robots"][0]["campaigns"] == 0
    job = {"kind": "identify", "robot": "arm", "campaigns": [staged]}
    assert client.post("/v1/jobs", json=job).json()["code"] == "campaign_incomplete"
    short = client.post(f"/v1/campaigns/{staged}/commit", json={"sha256": hashes[:1]})
    assert (short.status_code, short.json()["context"]["others"]) == (409, hashes[1:])
    for _ in range(2):  # again changes nothing
        done = client.post(f"/v1/campaigns/{staged}/commit", json={"sha256": hashes})
        assert (done.status_code, done.json()["rows"], done.json()["staged"]) == (200, 12, False)
    assert client.delete(f"/v1/campaigns/{staged}").json()["code"] == "campaign_committed"


def test_a_staged_campaign_is_dropped_with_its_rows(client: httpx.Client) -> None:
    client.post("/v1/robots", json=ROBOT).raise_for_status()
    staged = client.post("/v1/robots/arm/campaigns", json={"name": "long", "staged": True}).json()["id"]
    client.post(f"/v1/campaigns/{staged}/observations", content=csv_of(columns()), headers=CSV).raise_for_status()
    assert client.delete(f"/v1/campaigns/{staged}").status_code == 204
    assert client.get(f"/v1/campaigns/{staged}").json()["code"] == "campaign_not_found"
    client.post("/v1/robots/arm/campaigns", json={"name": "other", "staged": True}).raise_for_status()
    assert client.delete("/v1/robots/arm").status_code == 204  # a staged campaign does not hold a robot


def test_readings_a_hair_beyond_a_limit_are_taken(shared_client: httpx.Client, shared_campaign: str) -> None:
    """Limits of a URDF are rounded: 0.3 deg beyond counts as inside."""
    taken = moved(q2_deg={2: 120.29, 9: -120.29})
    assert send(shared_client, shared_campaign, taken).status_code == 201


def test_readings_some_degrees_beyond_a_limit_are_taken_and_named(
    shared_client: httpx.Client, shared_campaign: str
) -> None:
    answer = send(shared_client, shared_campaign, moved(q2_deg={2: 120.31, 9: -129.9}))
    assert answer.status_code == 201
    (said,) = [one for one in answer.json()["warnings"] if one["code"] == "beyond_limits"]
    assert said["rows"] == [2, 9]
    assert "column 'q2_deg' (limits -120 to 120 of joint 'j2') row 2, 9, by up to 9.9 deg" in said["message"]
    rows = shared_client.get(f"/v1/campaigns/{shared_campaign}/suspicious").json()
    named = {one["row"]: one["why"] for one in rows["found"]}
    assert "joint j2 is 9.9 deg outside its limits" in named[9]
    refused = send(shared_client, shared_campaign, moved(q2_deg={2: 120.31, 9: -131.0}))
    assert (refused.status_code, refused.json()["context"]["rows"]) == (400, [2, 9])


def test_all_readings_beyond_their_limits_are_listed_at_once(shared_client: httpx.Client, shared_campaign: str) -> None:
    many = {row: 131.0 + 0.1 * row for row in range(20, 31)}
    answer = send(shared_client, shared_campaign, moved(q2_deg=many, q1_deg={7: 200.0}))
    assert answer.status_code == 400
    problem = answer.json()
    assert problem["code"] == "observations_invalid"
    assert problem["context"]["rows"] == [7, *range(20, 31)]
    assert (problem["context"]["row"], problem["context"]["column"]) == (7, "q1_deg")
    said = problem["detail"]
    assert said.startswith("12 readings are outside the limits of their joints: column 'q1_deg' (limits ")
    assert "row 7, by up to " in said
    assert "column 'q2_deg' (limits -120 to 120 of joint 'j2') row 20, 21, 22, 23, 24, 25, 26, 27 and 3 more" in said
    assert "by up to 14 deg. Correct the rows or the robot." in said


def test_rows_in_later_pieces_have_their_numbers(shared_client: httpx.Client, shared_campaign: str) -> None:
    rows = 9000
    table = {name: np.tile(values, rows // 5) for name, values in columns().items()}
    table["q2_deg"][[3, 8500]] = 135.0
    stream = io.BytesIO()
    parquet.write_table(pa.table(table), stream, row_group_size=1000)
    answer = send(shared_client, shared_campaign, stream.getvalue(), "application/vnd.apache.parquet")
    assert answer.json()["context"]["rows"] == [4, 8501]


def test_a_clock_that_goes_back_is_named_at_upload(client: httpx.Client, campaign: str) -> None:
    rows = columns(20)
    rows["t_s"] = [float(k if k < 12 else k - 5) for k in range(20)]
    warnings = send(client, campaign, csv_of(rows)).raise_for_status().json()["warnings"]
    (said,) = [one["message"] for one in warnings if one["code"] == "clock_backwards"]
    assert said.startswith("The clock runs backwards at row 13: the order of the rows replaces the time.")


def test_stamps_with_a_date_date_a_campaign_unless_somebody_did(client: httpx.Client) -> None:
    client.post("/v1/robots", json=ROBOT)
    rows = {**columns(5), "t_s": [1.79e9 + k for k in range(5)]}
    later = {**columns(6), "t_s": [1.79e9 + 100.0 + k for k in range(6)]}
    stated = {"measured_at": "2026-09-22T12:00:00Z"}
    for name, said, dates in (
        ("stamped", {}, ["2026-09-21T14:13:24Z", "2026-09-21T14:15:05Z"]),
        ("stated", stated, [stated["measured_at"]] * 2),
    ):
        made = client.post("/v1/robots/arm/campaigns", json={"name": name, **said}).raise_for_status().json()["id"]
        for part, date in zip((rows, later), dates, strict=True):
            send(client, made, csv_of(part)).raise_for_status()
            assert client.get(f"/v1/campaigns/{made}").json()["measured_at"] == date
