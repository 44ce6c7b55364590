"""What the corrector tells people while a stream runs: the numbers of its answers, signed, only while somebody listens."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from kilter_core.model import Calibration
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.fast_path import bin_edges_us, latency_bin
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import Rules, config
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.telemetry import TurnedAway, answer_document
from kilter_service.stream.corrector.wire import Flag, Status
from tests.corrector import sealer
from tests.corrector.live import ROOT, Q, open_stream, until

FRESH = Rules(max_age_ns=10**12)


def frame(seq: int, q: tuple[float, ...] = Q, step_ns: int | None = None, flags: int = 0) -> bytes:
    rows = np.array([q, q]) if step_ns else np.array([q])
    sent = 10**9 + seq * 1_000_000
    return wire.encode_setpoints(
        rows, joints=len(q), seq=seq, t_send_ns=sent, t_apply_ns=0, step_ns=step_ns, flags=flags
    )


def ask(stream: Stream, active: Active, data: bytes, seq: int) -> wire.Answer:
    answer = stream.answer(data, 2 * 10**9 + seq * 1_000_000, active)
    assert answer is not None
    return wire.decode_answer(answer)


def test_the_last_answer_is_what_is_shown(katana: Calibration, active_of: Callable[..., Active]) -> None:
    active, stream = active_of(katana), Stream(FRESH)
    assert stream.last_answer is None
    for seq in range(1, 30):
        q = (Q[0] + 1e-4 * seq, *Q[1:])
        step_ns = 1_000_000 if seq in (5, 29) else None  # chunks take the full path
        answer = ask(stream, active, frame(seq, q, step_ns, Flag.RESET | Flag.SETTLED if seq == 1 else 0), seq)
        assert answer.status == Status.OK
        assert stream.last_answer is not None
        last = answer_document(stream.last_answer)
        np.testing.assert_array_equal(last["wanted"], q)
        np.testing.assert_allclose(np.add(last["wanted"], last["correction"]), answer.values[-1], rtol=0, atol=1e-15)
        assert 1e-5 < np.linalg.norm(last["tool"]) < 5e-3
    before = stream.last_answer
    assert ask(stream, active, frame(30, (50.0, *Q[1:])), 30).status == Status.JOINT_LIMIT
    assert stream.last_answer == before  # a refused setpoint has no correction


def test_every_answer_is_counted_in_the_bin_of_its_time(katana: Calibration, active_of: Callable[..., Active]) -> None:
    active, stream = active_of(katana), Stream(FRESH)
    spent = []
    for seq in range(1, 60):
        q = Q if seq % 10 else (50.0, *Q[1:])
        spent.append(ask(stream, active, frame(seq, q, flags=Flag.RESET if seq == 1 else 0), seq).processing_ns)
    counted = stream.counters.by_time
    assert sum(counted) == sum(1 for one in spent if one > 0)
    expected = np.histogram(np.array([one for one in spent if one > 0]) / 1e3, bins=[*bin_edges_us(), np.inf])[0]
    np.testing.assert_array_equal(counted, expected)


def test_bins_begin_where_is_said() -> None:
    edges = bin_edges_us()
    assert edges[0] == 0
    for k, edge in enumerate(edges[1:], 1):
        assert latency_bin(int(edge * 1e3) + 1) == k
        assert latency_bin(int(edge * 1e3) - 1) == k - 1
    assert latency_bin(10**10) == len(edges) - 1


def test_streams_without_a_slot_are_few() -> None:
    away = TurnedAway()
    for k in range(1000):
        away.count(f"{ROOT}/stream/s{k}/out", "NO_VERSION")
    assert len(away.counts) <= TurnedAway.MOST
    place = next(reversed(away.counts))
    away.count(f"{ROOT}/stream/{place[1]}/out", "OVERLOAD")
    document = away.document(place)
    assert (document["received"], document["last_status"]) == (2, "OVERLOAD")


def test_messages_are_signed_and_made_for_listeners_only(corrector: Corrector) -> None:
    document = json.loads(corrector.file.read_text())
    with zenoh.open(config(None, tuple(document["endpoints"].values()))) as session:
        got: list[tuple[str, bytes]] = []

        def take(sample: zenoh.Sample) -> None:
            got.append((str(sample.key_expr), sample.payload.to_bytes()))

        with open_stream(corrector, "looked-at") as stream:
            stream.correct(Q)
            heard = session.declare_subscriber(f"{ROOT}/stream/looked-at/live", zenoh.handlers.Callback(take))

            def moves() -> bool:
                stream.correct(Q)
                return len({json.loads(data)["received"] for _, data in got}) >= 5

            until(moves)
            key, data = got[-1]
            told: dict[str, Any] = json.loads(data)
            np.testing.assert_allclose(told["last"]["wanted"], Q)
            assert told["instance"] == corrector.instance
            assert sum(told["counters"].values()) == told["received"]
            rows = json.loads(Path(document["stream_keys"]).read_text())["keys"]
            (secret,) = (bytes.fromhex(row["secret"]) for row in rows)
            body, _, tag = data.rpartition(b', "signature": "')
            key_of_robot = sealer.derive(secret, "KLT2robt", b"\0".join(part.encode() for part in key.split("/")[2:4]))
            expected = sealer.tag(key_of_robot, "KLT2said", key.encode() + b"\0" + body + b"}")
            assert tag[:-2].decode().endswith(f":{expected.hex()}")
            heard.undeclare()
            got.clear()
            for _ in range(20):
                stream.correct(Q)
            assert got == []
