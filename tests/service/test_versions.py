"""Versions and correction, on versions stored as a job would store them."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np
import pyarrow as pa
import pytest
import yaml
from pyarrow import parquet

from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_core.effects import make_effect
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.groups import last_motion
from kilter_core.twin import Twin, thesis_katana
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow, VersionRow
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.queries import correct_trajectory, decode_trajectory, encode_trajectory
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.wire import Answer, Flag, decode_answer, encode_setpoints
from kilter_service.versions import store
from kilter_service.versions.store import NewVersion
from tests.core.correct.reference import CorrectOptions, correct

pytestmark = pytest.mark.both_databases


@dataclass
class Versions:
    """Makes versions of the Katana."""

    database: Database

    def add(
        self,
        name: str,
        calibration: Calibration,
        covariance: dict[str, Any] | None = None,
        said: Any = None,
        **limits: float,
    ) -> str:
        document = calibration.to_document()
        report = said or {"parameters": [], "metrics": {"train": {"n": 1}}, "noise_mm": 0.01}
        limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0} | limits
        new = NewVersion(
            document, report, covariance or {"names": [], "matrix": [], "units": "SI"}, [], limits, None, "test"
        )
        with self.database.transaction() as session:
            session.add(JobRow(id=f"job_{name}", kind="identify", robot_id=1, request={}, state="running"))
            session.flush()
            first = store.add(session, 1, f"job_{name}", new)
            assert store.add(session, 1, f"job_{name}", new) == first
        return first


@pytest.fixture
def versions(client: httpx.Client, database: Database, katana: Any) -> Versions:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    return Versions(database)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return thesis_katana()


def test_activation_rollback_and_their_log(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    a, b, c = (versions.add(name, twin.truth) for name in "abc")

    def active() -> str | None:
        found: str | None = client.get("/v1/robots/katana").json()["active_version"]
        return found

    def stamp() -> int:
        with versions.database.transaction() as session:
            return session.execute(store.query_for_active_stamp()).scalar_one()

    stamps = [stamp()]
    assert active() is None
    assert client.post("/v1/robots/katana/rollback").json()["code"] == "nothing_to_roll_back"
    for version in (a, b, c):
        assert client.post(f"/v1/versions/{version}/activate").json()["active"] is True
        stamps.append(stamp())
    assert len(set(stamps)) == 4
    client.post(f"/v1/versions/{c}/activate")
    assert stamp() == stamps[-1]
    assert client.post("/v1/robots/katana/rollback").json()["id"] == b
    assert client.post("/v1/robots/katana/rollback").json()["id"] == a
    assert active() == a
    assert client.post("/v1/robots/katana/rollback").status_code == 409
    client.post(f"/v1/versions/{c}/activate")
    assert client.post("/v1/robots/katana/rollback").json()["id"] == a
    log = client.get("/v1/robots/katana/activations").json()["activations"]
    assert [(e["version_id"], e["action"]) for e in reversed(log)] == [
        (a, "activate"), (b, "activate"), (c, "activate"), (b, "rollback"), (a, "rollback"), (c, "activate"),
        (a, "rollback"),
    ]  # fmt: skip
    assert {e["actor"] for e in log} == {"admin"}
    flags = {v["id"]: v["active"] for v in client.get("/v1/robots/katana/versions").json()["versions"]}
    assert flags == {a: True, b: False, c: False}


def test_activation_names_what_is_not_corrected_at_run_time(
    client: httpx.Client, versions: Versions, twin: Twin
) -> None:
    model = twin.truth.with_effects([*twin.truth.model.effects, make_effect("thermal_growth")])
    warm, plain = versions.add("warm", model), versions.add("plain", twin.truth)
    assert client.post(f"/v1/versions/{plain}/activate").json()["unsupported_effects"] == []
    assert client.post(f"/v1/versions/{warm}/activate").json()["unsupported_effects"] == ["thermal_growth"]
    assert client.post("/v1/robots/katana/rollback").json()["unsupported_effects"] == []


def test_the_active_version_comes_back_as_core_knows_it(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    with versions.database.transaction() as session:
        assert store.robots_with_active(session) == []
        assert store.active_version(session, "katana") is None
    version = versions.add("a", twin.truth, max_joint_deg=2.0)
    client.post(f"/v1/versions/{version}/activate")
    with versions.database.transaction() as session:
        assert store.robots_with_active(session) == ["katana"]
        found = store.active_version(session, "katana")
    assert found is not None
    assert (found.id, found.limits.max_position_mm, found.limits.max_joint_deg) == (version, 5.0, 2.0)
    rows = twin.observe(np.full((1, 5), 0.3))
    assert np.allclose(found.calibration.predict(rows).position, twin.truth.predict(rows).position, atol=1e-12)
    assert found.calibration.model.load_chain is not None  # the loads of the version come back with it


def test_a_version_cannot_be_changed(versions: Versions, twin: Twin) -> None:
    version = versions.add("a", twin.truth)
    with pytest.raises(RuntimeError, match="immutable"), versions.database.transaction() as session:
        session.get_one(VersionRow, version).code_version = "other"


def test_diff_names_effects_and_changes(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    a, b = versions.add("a", Calibration.nominal(twin.robot)), versions.add("b", twin.truth)
    diff = client.get(f"/v1/versions/{a}/diff/{b}").json()
    assert diff["effects_added"] == ["clearance_tilt", "backlash_load", "axial_compliance"]
    changes = {row["name"]: row for row in diff["parameters"]}
    assert changes["a_2"]["unit"] == "mm"
    assert changes["a_2"]["change"] == pytest.approx(0.003)
    assert changes["theta_offset_1"]["change"] == pytest.approx(-0.061)
    assert changes["clearance_1"]["a"] is None
    assert changes["base_x"]["a"] == pytest.approx(twin.robot.T_base[0, 3] * 1e3)
    assert client.get(f"/v1/versions/{a}/diff/ver_none").json()["code"] == "version_not_found"


def test_export_json_and_the_list_of_formats(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    version = versions.add("a", twin.truth)
    answer = client.get(f"/v1/versions/{version}/export", params={"format": "json"})
    assert version in answer.headers["content-disposition"]
    document = answer.json()
    assert document["format"] == "kilter-version/1"
    assert document["calibration_si"] == twin.truth.to_document()
    urdf = client.get(f"/v1/versions/{version}/export", params={"format": "urdf"})
    assert urdf.headers["content-type"].startswith("application/xml")
    assert "Left out: clearance_tilt" in urdf.headers["kilter-notes"]
    refused = client.get(f"/v1/versions/{version}/export", params={"format": "stone"})
    assert refused.status_code == 400
    formats = [
        "json", "urdf", "mjcf", "usd", "dh-csv", "mdh-csv", "ur-yaml", "matlab", "ranges", "corrector", "c", "torque-c",
    ]  # fmt: skip
    assert refused.json()["context"]["formats"] == formats


def trajectory(rows: int = 50) -> dict[str, list[float]]:
    t = np.linspace(0, 1, rows)
    q = np.stack([20 * np.sin(2 * t + j) for j in range(5)], axis=1)
    q[:, 1] += 30
    return {"t_s": t.tolist()} | {f"q{j + 1}_deg": q[:, j].tolist() for j in range(5)}


def joints(columns: dict[str, list[float]]) -> np.ndarray:
    return np.radians(np.stack([np.array(columns[f"q{j + 1}_deg"], dtype=float) for j in range(5)], axis=1))


def streamed(active: Active, q: np.ndarray, step_s: float) -> list[Answer]:
    """What the stream answers to the rows one by one, the arm resting at the first."""
    stream, answers, step = Stream(), [], round(step_s * 1e9)
    for k, row in enumerate(q):
        flags = Flag.RESET | Flag.SETTLED if k == 0 else 0
        at = 10**12 + k * step
        data = encode_setpoints(row[None], joints=5, seq=k, t_send_ns=at, t_apply_ns=at, flags=flags)
        answers.append(decode_answer(stream.answer(data, at, active) or b""))
    return answers


def test_correction_over_http_is_that_of_stream_and_query(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    columns = trajectory(51)  # 0.02 s, a whole number of the stream's nanoseconds
    none = client.post("/v1/robots/katana/correct", json=columns)
    assert (none.status_code, none.json()["code"]) == (409, "no_active_version")
    version = versions.add("a", twin.truth)
    client.post(f"/v1/versions/{version}/activate")
    program = compile_program(twin.truth, CorrectionOptions())
    active = Active("katana", version, 1, 1, program)
    q, t = joints(columns), np.array(columns["t_s"])

    out = client.post("/v1/robots/katana/correct", json=columns).json()
    told = ["left_mm", "left_x_mm", "left_y_mm", "left_z_mm", "u95_x_mm", "u95_y_mm", "u95_z_mm", "flags", "status"]
    assert list(out) == [*columns, "dx_mm", "dy_mm", "dz_mm", *told]
    assert {cell for axis in "xyz" for cell in out[f"u95_{axis}_mm"]} == {None}  # nothing is known of this version
    assert out["t_s"] == columns["t_s"]
    assert np.abs(np.array(out["q2_deg"]) - columns["q2_deg"]).max() > 1e-3
    # What is left is by the version itself, whose backlash jumps: a row that is on its way from one side to the other says so.
    real, wanted = (
        one.predict(Observations(at)).position
        for one, at in ((twin.truth, joints(out)), (twin.truth.nominal_in_wanted_frames(), q))
    )
    off_mm = np.linalg.norm(real - wanted, axis=1) * 1e3
    np.testing.assert_allclose(out["left_mm"], off_mm, rtol=1e-6, atol=3e-4)
    late = off_mm > 0.01  # of this version nothing more is stated
    assert 0 < late.sum() < 25
    assert out["status"] == ["LIMITED" if one else "OK" for one in late]
    assert all("REVERSING" in (out["flags"][k] or "").split("|") for k in np.flatnonzero(late))
    by_stream = np.array([answer.values[0] for answer in streamed(active, q, t[1] - t[0])])
    assert np.max(np.abs(joints(out) - by_stream)) < 1e-12
    query = correct_trajectory(decode_trajectory(encode_trajectory(t, q, joints=5)), active)
    by_query = np.frombuffer(query[-8 * q.size :]).reshape(q.shape)
    assert np.max(np.abs(joints(out) - by_query)) < 1e-12
    off = np.stack([out[f"d{axis}_mm"] for axis in "xyz"], axis=1) * 1e-3
    ideal = correct(twin.truth, q, direction=last_motion(q), options=CorrectOptions())
    # The stream crosses play no faster than its rate limit; the ideal jumps.
    apart = np.linalg.norm(off - ideal.error_removed, axis=1)
    assert np.median(apart) < 0.1 * np.median(np.linalg.norm(off, axis=1))

    buffer = io.BytesIO()
    parquet.write_table(pa.table(columns), buffer)
    headers = {"content-type": "application/vnd.apache.parquet"}
    as_parquet = client.post("/v1/robots/katana/correct", content=buffer.getvalue(), headers=headers)
    assert as_parquet.headers["content-type"] == "application/vnd.apache.parquet"
    assert parquet.read_table(io.BytesIO(as_parquet.content)).to_pydict() == out

    text = ",".join(columns) + "\n" + "\n".join(",".join(map(repr, row)) for row in zip(*columns.values(), strict=True))
    as_csv = client.post("/v1/robots/katana/correct", content=text, headers={"content-type": "text/csv"})
    rows = list(csv.DictReader(io.StringIO(as_csv.text)))
    assert [float(row["q3_deg"]) for row in rows] == out["q3_deg"]
    assert rows[0]["status"] == "OK"


def test_rows_without_times_are_corrected_each_by_itself(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    client.post(f"/v1/versions/{versions.add('a', twin.truth)}/activate")
    columns = {name: cells for name, cells in trajectory().items() if name != "t_s"}
    answer = client.post("/v1/robots/katana/correct", json=columns).json()
    out, q = joints(answer), joints(columns)
    ideal = correct(twin.truth, q, direction=last_motion(q), options=CorrectOptions())
    assert np.median(np.abs(answer["dz_mm"] - ideal.error_removed[:, 2] * 1e3)) < 1e-3
    program = compile_program(twin.truth, CorrectionOptions())
    assert np.max(np.abs(out - program.correct_rows(q, direction=last_motion(q)).q)) < 1e-12
    alone = {name: cells[17:18] for name, cells in columns.items()} | {f"dir{j + 1}": [1] for j in range(5)}
    one = joints(client.post("/v1/robots/katana/correct", json=alone).json())
    assert np.max(np.abs(one - program.correct_rows(q[17:18], direction=np.ones((1, 5))).q)) < 1e-12


def test_a_refused_row_leaves_no_trace(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    version = versions.add("a", twin.truth)
    columns = trajectory(201)
    for k in (*range(60, 70), 130, 200):
        columns["q2_deg"][k] = 500.0
    out = client.post("/v1/robots/katana/correct", params={"version": version}, json=columns).json()
    assert {out["status"][k] for k in (60, 69, 130, 200)} == {"JOINT_LIMIT"}
    assert out["q3_deg"][130] is None
    active = Active("katana", version, 1, 1, compile_program(twin.truth, CorrectionOptions()))
    answers = streamed(active, joints(columns), columns["t_s"][1] - columns["t_s"][0])
    assert [answer.status.name for answer in answers] == [w.replace("LIMITED", "OK") for w in out["status"]]
    good = [k for k, name in enumerate(out["status"]) if name in ("OK", "LIMITED")]
    got = joints({name: [cells[k] for k in good] for name, cells in out.items() if name.startswith("q")})
    assert np.max(np.abs(got - [answers[k].values[0] for k in good])) < 1e-12


def test_a_load_picked_up_on_the_way_changes_the_correction(
    client: httpx.Client, versions: Versions, twin: Twin
) -> None:
    client.post(f"/v1/versions/{versions.add('a', twin.truth)}/activate")
    columns = trajectory(100)
    loads = [0.0] * 40 + [0.4] * 60
    out = joints(client.post("/v1/robots/katana/correct", json=columns | {"payload_kg": loads}).json())
    q, t = joints(columns), np.array(columns["t_s"])
    empty, loaded = (compile_program(twin.truth, CorrectionOptions(payload_kg=kg)) for kg in (0.0, 0.4))
    track = Track(empty, settled=True)
    _, first, _, _ = track.follow(q[:40], 1, np.diff(t[:40], prepend=t[0]))
    track.change(loaded)
    _, second, _, _ = track.follow(q[40:], 1, np.diff(t[40:], prepend=t[39]))
    assert np.max(np.abs(out - np.vstack([first, second]))) < 1e-12
    many = columns | {"payload_kg": [0.001 * k for k in range(100)]}
    assert client.post("/v1/robots/katana/correct", json=many).status_code == 200
    back = columns | {"t_s": [*columns["t_s"][:-1], 0.0]}
    answer = client.post("/v1/robots/katana/correct", json=back)
    assert (answer.status_code, answer.json()["context"]["row"]) == (400, 100)


def test_rows_that_cannot_be_corrected_carry_no_numbers(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    version = versions.add("small", twin.truth, max_joint_deg=0.0001)
    asked = {"version": version, "at_limit": "refuse"}
    out = client.post("/v1/robots/katana/correct", params=asked, json=trajectory(3)).json()
    assert out["status"] == ["CORRECTION_TOO_LARGE"] * 3
    numbers = {name: column for name, column in out.items() if name not in ("t_s", "status", "flags")}
    assert {"q1_deg", "dx_mm", "left_mm", "left_x_mm"} <= set(numbers)
    assert all(column == [None] * 3 for column in numbers.values())


def test_rows_held_at_a_limit_keep_their_numbers_and_say_what_is_left(
    client: httpx.Client, versions: Versions, twin: Twin
) -> None:
    version = versions.add("small", twin.truth, max_joint_deg=0.0001)
    for k in range(3):  # each by itself: the arm rests, so no joint has a side that its motion chose
        columns = {name: [column[k]] for name, column in trajectory(3).items()}
        out = client.post("/v1/robots/katana/correct", params={"version": version}, json=columns).json()
        assert out["status"] == ["LIMITED"]
        assert "SATURATED" in out["flags"][0].split("|")
        change = np.degrees(np.abs(joints(out) - joints(columns)))
        assert change.max() == pytest.approx(0.0001, rel=1e-6)
        along = [out[f"left_{axis}_mm"][0] for axis in "xyz"]
        assert out["left_mm"][0] == pytest.approx(np.linalg.norm(along), rel=1e-9)
        assert out["left_mm"][0] > 0.5
        real = twin.truth.predict(Observations(joints(out))).position
        off = np.linalg.norm(
            real - twin.truth.nominal_in_wanted_frames().predict(Observations(joints(columns))).position
        )
        assert out["left_mm"][0] == pytest.approx(1e3 * off, rel=1e-6)


def test_every_corrected_row_says_how_far_the_tool_may_be_off(
    client: httpx.Client, versions: Versions, twin: Twin
) -> None:
    """A base known to 0.1 mm along x, a first joint known to 1 mrad about z: seen at the wanted point by hand."""
    known = {
        "names": ["base_x", "theta_offset_1"], "matrix": [[1e-8, 0.0], [0.0, 1e-6]], "units": "SI",
        "inadequacy_m": 3e-5, "noise_m": 1.0,
    }  # fmt: skip
    version = versions.add("known", twin.truth, known)
    columns = trajectory(30)
    columns["q2_deg"][7] = 500.0
    out = client.post("/v1/robots/katana/correct", params={"version": version}, json=columns).json()
    assert out["status"][7] == "JOINT_LIMIT"
    assert [out[f"u95_{axis}_mm"][7] for axis in "xyz"] == [None] * 3
    good = [
        k for k in range(30) if out["left_mm"][k] is not None and out["left_mm"][k] < 1e-3
    ]  # backlash is on its way else
    assert len(good) > 15
    p = twin.truth.nominal_in_wanted_frames().predict(Observations(joints(columns)[good])).position * 1e3 - [
        55.0,
        55.0,
        201.5,
    ]
    expected = 1.96 * np.sqrt(
        np.stack([0.1**2 + (1e-3 * p[:, 1]) ** 2, (1e-3 * p[:, 0]) ** 2, np.zeros(len(p))], axis=1) + 0.03**2
    )
    got = np.stack([[out[f"u95_{axis}_mm"][k] for k in good] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(got, expected, rtol=0.02)


def test_a_version_from_before_says_it_by_what_its_fit_left(
    client: httpx.Client, versions: Versions, twin: Twin
) -> None:
    said = {
        "parameters": [], "noise_mm": 0.03, "noise_source": "repeats",
        "metrics": {"train": {"identified": {"rms_mm": 0.05 * 3**0.5}}},
    }  # fmt: skip
    version = versions.add("old", twin.truth, {"names": ["base_x"], "matrix": [[0.0]], "units": "SI"}, said)
    out = client.post("/v1/robots/katana/correct", params={"version": version}, json=trajectory(5)).json()
    assert out["status"][:4] == ["OK"] * 4
    np.testing.assert_allclose(out["u95_z_mm"][:4], 1.96 * 0.04, rtol=1e-3)


def test_a_trajectory_for_ros_2(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    client.post(f"/v1/versions/{versions.add('a', twin.truth)}/activate")
    columns = trajectory(20)
    columns["t_s"] = [5.0 + t for t in columns["t_s"]]
    expected = client.post("/v1/robots/katana/correct", json=columns).json()
    answer = client.post("/v1/robots/katana/correct", params={"format": "ros2-yaml"}, json=columns)
    assert answer.headers["content-type"].startswith("application/yaml")
    message = yaml.safe_load(answer.text)
    assert message["joint_names"] == ["j1", "j2", "j3", "j4", "j5"]
    assert len(message["points"]) == 20
    for k, point in enumerate(message["points"]):
        assert np.degrees(point["positions"]) == pytest.approx(
            [expected[f"q{j + 1}_deg"][k] for j in range(5)], abs=1e-12
        )
        time = point["time_from_start"]
        assert time["sec"] + time["nanosec"] * 1e-9 == pytest.approx(columns["t_s"][k] - 5.0, abs=1e-9)

    def refusal(body: dict[str, list[float]], **parameters: str) -> str:
        refused = client.post("/v1/robots/katana/correct", params={"format": "ros2-yaml"} | parameters, json=body)
        assert refused.status_code == 400
        return str(refused.json()["detail"])

    assert "add the column 't_s'" in refusal({name: v for name, v in columns.items() if name != "t_s"})
    assert "Row 2, column 't_s': the time must rise" in refusal(columns | {"t_s": [1.0] * 20})
    small = versions.add("small", twin.truth, max_joint_deg=0.0001)
    assert "Row 1 is not corrected (CORRECTION_TOO_LARGE), 20 rows" in refusal(
        columns, version=small, at_limit="refuse"
    )
    # Held at its limits the motion can be sent: the remark beside it says what is left.
    held = client.post("/v1/robots/katana/correct", params={"format": "ros2-yaml", "version": small}, json=columns)
    assert len(yaml.safe_load(held.raise_for_status().text)["points"]) == 20
    assert "20 of 20 rows" in held.headers["kilter-notes"]


def test_what_is_no_trajectory_is_refused(client: httpx.Client, versions: Versions, twin: Twin) -> None:
    client.post(f"/v1/versions/{versions.add('a', twin.truth)}/activate")
    columns: dict[str, list[Any]] = dict(trajectory(3))
    refusals = [
        (columns | {"x_mm": [1, 2, 3], "y_mm": [1, 2, 3], "z_mm": [1, 2, 3]}, "is a measurement"),
        (columns | {f"f{axis}_n": [1, 2, 3] for axis in "xyz"}, "does not know forces"),
        (columns | {"q1_deg": [1, None, 3]}, "Row 2, column 'q1_deg' is empty"),
        ({key: value for key, value in columns.items() if key != "q5_deg"}, "'q5_deg' is missing"),
    ]
    for body, message in refusals:
        answer = client.post("/v1/robots/katana/correct", json=body)
        assert answer.status_code == 400
        assert message in answer.json()["detail"]
    assert client.post("/v1/robots/nobody/correct", json=columns).status_code == 404
