"""One trajectory by every way it may come: HTTP, query, ROS 2, chunks and setpoints give the same numbers and refusals."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import httpx
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_core.twin import Twin, thesis_katana
from kilter_service.ground.db import Database
from kilter_service.stream import ros2_messages
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.queries import QueryError, correct_trajectory, decode_trajectory, encode_trajectory
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.wire import Answer, Flag, Status, decode_answer, encode_setpoints
from kilter_service.stream.ros2_process import TrajectoryRelay
from tests.service.test_versions import Versions

STEP_NS = 20_000_000
ROWS = 61
SPEEDS = {1: 0, 2: Flag.QD, 3: Flag.QD | Flag.QDD}
NAMES = tuple(f"a{j + 1}" for j in range(5))


@dataclass
class Motion:
    """``t (N,)`` s and ``vectors``: q, then qd and qdd (N, 5) rad, rad/s, rad/s² where given."""

    t: np.ndarray
    vectors: list[np.ndarray]

    @property
    def values(self) -> np.ndarray:
        return np.hstack(self.vectors)


@dataclass
class Refused:
    """Where the first refusal is, and what it is called; None where a transport does not say."""

    index: int | None
    status: str


Found = np.ndarray | Refused
Way = Callable[[httpx.Client, Active, Motion], Found]


def motion(width: int = 1) -> Motion:
    """Every joint turns back at least once, within some thousandths of a radian too."""
    t = np.arange(ROWS) * STEP_NS * 1e-9
    phase, rate = np.arange(5) + 0.3, np.array([2.0, 7.0, 3.0, 5.0, 11.0])
    size = np.array([0.4, 2e-5, 0.3, 0.005, 3e-6])
    q = 0.4 + size * np.sin(rate * t[:, None] + phase)
    qd = size * rate * np.cos(rate * t[:, None] + phase)
    return Motion(t, [q, qd, -(rate**2) * (q - 0.4)][:width])


def columns_of(asked: Motion) -> dict[str, list[float]]:
    units = ("rad", "rad_s", "rad_s2")
    table = {"t_s": asked.t.tolist()}
    for name, unit, vector in zip(("q", "qd", "qdd"), units, asked.vectors, strict=False):
        table |= {f"{name}{j + 1}_{unit}": vector[:, j].tolist() for j in range(5)}
    return table


def read(table: dict[str, list[Any]]) -> Found:
    moved = [word for k, word in enumerate(table["status"]) if table["q1_rad"][k] is not None]
    assert set(moved) <= {"OK", "DAMPED", "LIMITED"}
    bad = [k for k in range(ROWS) if table["q1_rad"][k] is None]
    if bad:
        return Refused(bad[0], table["status"][bad[0]])
    return np.stack([np.array(table[f"q{j + 1}_rad"], dtype=float) for j in range(5)], axis=1)


def by_json(client: httpx.Client, active: Active, asked: Motion) -> Found:
    return read(client.post("/v1/robots/katana/correct", json=columns_of(asked)).raise_for_status().json())


def by_parquet(client: httpx.Client, active: Active, asked: Motion) -> Found:
    buffer = io.BytesIO()
    parquet.write_table(pa.table(columns_of(asked)), buffer)
    headers = {"content-type": "application/vnd.apache.parquet"}
    answer = client.post("/v1/robots/katana/correct", content=buffer.getvalue(), headers=headers).raise_for_status()
    return read(parquet.read_table(io.BytesIO(answer.content)).to_pydict())


def by_query(client: httpx.Client, active: Active, asked: Motion) -> Found:
    data = encode_trajectory(asked.t, asked.values, joints=5, flags=int(SPEEDS[len(asked.vectors)]))
    try:
        answer = correct_trajectory(decode_trajectory(data), active)
    except QueryError as error:
        return Refused(error.document["first_bad_index"], error.document["code"])
    return np.frombuffer(answer[-8 * ROWS * 5 :]).reshape(ROWS, 5)


def by_ros2(client: httpx.Client, active: Active, asked: Motion) -> Found:
    """In another order than the robot's, with a gripper that passes unchanged."""
    order = [4, 0, 1, 3, 2]
    parts = [np.column_stack([np.full(ROWS, 0.02), vector[:, order]]) for vector in asked.vectors]
    parts += [np.empty((ROWS, 0))] * (4 - len(parts))
    nanos = np.round(asked.t * 1e9).astype(np.int64)
    time = np.stack([nanos // 10**9, nanos % 10**9], axis=1).astype(np.int32)
    head = ros2_messages.Head((0, 0), "world", ("grip", *(NAMES[k] for k in order)))
    relay = TrajectoryRelay(NAMES)
    out = relay.answer(
        ros2_messages.encode_joint_trajectory(ros2_messages.JointTrajectory(head, time, *parts)), None, 0, active
    )
    if out is None:
        (name,) = relay.counts
        return Refused(None, name)
    positions = ros2_messages.decode_joint_trajectory(out).positions
    assert set(positions[:, 0]) == {0.02}
    return positions[:, 1:][:, np.argsort(order)]


def streamed(active: Active, asked: Motion, size: int | None) -> Found:
    """As setpoints, or as chunks of ``size`` points, until one is refused."""
    stream, out, at, seq = Stream(), [], 0, 0
    while at < ROWS:
        end = at + 1 if size is None else min(at + size, ROWS)
        sent = 10**12 + at * STEP_NS
        flags = SPEEDS[len(asked.vectors)] | (Flag.RESET | Flag.SETTLED if at == 0 else 0)
        data = encode_setpoints(
            asked.values[at:end], joints=5, seq=seq, t_send_ns=sent, t_apply_ns=sent, flags=int(flags),
            step_ns=None if size is None else STEP_NS,
        )  # fmt: skip
        answer: Answer = decode_answer(stream.answer(data, sent, active) or b"")
        if answer.status != Status.OK:
            return Refused(at if size is None else None, answer.status.name)
        out.append(answer.values)
        at, seq = end, seq + 1
    return np.vstack(out)


def by_setpoints(client: httpx.Client, active: Active, asked: Motion) -> Found:
    return streamed(active, asked, None)


def by_small_chunks(client: httpx.Client, active: Active, asked: Motion) -> Found:
    return streamed(active, asked, 7)


def by_one_chunk(client: httpx.Client, active: Active, asked: Motion) -> Found:
    return streamed(active, asked, ROWS)


WAYS: tuple[Way, ...] = (by_json, by_parquet, by_ros2, by_setpoints, by_small_chunks, by_one_chunk)


@pytest.fixture(scope="module")
def twin() -> Twin:
    return thesis_katana()


@pytest.fixture
def active(client: httpx.Client, database: Database, katana: Any, twin: Twin) -> Active:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    version = Versions(database).add("a", twin.truth)
    client.post(f"/v1/versions/{version}/activate").raise_for_status()
    return Active("katana", version, 1, 1, compile_program(twin.truth, CorrectionOptions()))


@pytest.mark.parametrize("width", [1, 2, 3])
def test_the_same_trajectory_gives_the_same_numbers(client: httpx.Client, active: Active, width: int) -> None:
    asked = motion(width)
    expected = by_query(client, active, asked)
    assert isinstance(expected, np.ndarray)
    assert np.abs(expected - asked.vectors[0]).max() > 1e-5
    for way in WAYS:
        found = way(client, active, asked)
        assert isinstance(found, np.ndarray), way
        assert np.abs(found - expected).max() < 1e-12, way


@pytest.mark.parametrize(("joint", "to", "word"), [(1, 50.0, "JOINT_LIMIT"), (2, 0.4 + 1.0, "RATE_LIMIT")])
def test_the_same_trajectory_is_refused_at_the_same_point(
    client: httpx.Client, active: Active, joint: int, to: float, word: str
) -> None:
    asked = motion()
    asked.vectors[0][33, joint] = to
    for way in (by_query, *WAYS):
        found = way(client, active, asked)
        assert isinstance(found, Refused), way
        assert (found.status, found.index) in ((word, 33), (word, None)), way


def test_rows_without_times_are_refused_where_a_stream_would_refuse_them(client: httpx.Client, active: Active) -> None:
    """The correction of a joint just outside its limit may lie inside: the stream does not look at it."""
    lower = thesis_katana().robot.limits[0, 0]
    table = {f"q{j + 1}_rad": [0.4] * 400 for j in range(5)}
    table["q1_rad"] = (lower + np.linspace(-1e-3, 1e-3, 400)).tolist()
    out = client.post("/v1/robots/katana/correct", json=table).raise_for_status().json()
    outside = np.array(table["q1_rad"]) < lower
    assert {word for word, out_of in zip(out["status"], outside, strict=True) if out_of} == {"JOINT_LIMIT"}
    for k in (0, 199, 200, 399):
        row = np.array([[table[f"q{j + 1}_rad"][k] for j in range(5)]])
        data = encode_setpoints(
            row, joints=5, seq=0, t_send_ns=10**12, t_apply_ns=0, flags=int(Flag.RESET | Flag.SETTLED)
        )
        assert decode_answer(Stream().answer(data, 10**12, active) or b"").status.name == out["status"][k]


def test_times_that_go_back_are_refused_by_every_trajectory(client: httpx.Client, active: Active) -> None:
    asked = motion()
    asked.t[20] = asked.t[18]
    answer = client.post("/v1/robots/katana/correct", json=columns_of(asked))
    assert (answer.status_code, answer.json()["context"]["row"]) == (400, 21)
    assert by_query(client, active, asked) == Refused(20, "SEQ_BACK")
    assert by_ros2(client, active, asked) == Refused(None, "SEQ_BACK")
