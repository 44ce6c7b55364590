"""A second zenoh session without credentials against a running client and corrector: what it says moves no arm.

``python -m tools.lab attack-stream`` sends 100 000 forged answers; the usual tests send fewer.
"""

from __future__ import annotations

import json
import math
import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import zenoh

from kilter_client.stream import CorrectedStream
from kilter_client.streaming.frames import Setpoint
from kilter_client.streaming.held_correction import LEAST_PAUSE_S
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import config
from kilter_service.stream.corrector.wire import Flag, Status
from tests.corrector import forger, sealer
from tests.corrector.live import ROBOT, ROOT, Q, open_stream, until


@pytest.fixture
def intruder(corrector: Corrector) -> Iterator[zenoh.Session]:
    made = config(None, (corrector.endpoints["stream"],))
    made.insert_json5("mode", '"client"')  # a peer passes messages on from its clients, not between two peers
    with zenoh.open(made) as session:
        yield session


@pytest.fixture
def active(source: object) -> Active:
    found: Active = source.versions[ROBOT]  # type: ignore[attr-defined]
    return found


def way_out(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """A publisher that has somebody to talk to, and waits for a reader that is slow."""
    made = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    until(lambda: made.matching_status.matching)
    return made


@contextmanager
def beside(work: Callable[[threading.Event], None]) -> Iterator[threading.Event]:
    """Do ``work(stop)`` in a thread of its own meanwhile; the event that is handed out says that it has ended."""
    stop, ended = threading.Event(), threading.Event()

    def run() -> None:
        try:
            work(stop)
        finally:
            ended.set()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield ended
    finally:
        stop.set()
        thread.join()


def truth(stream: CorrectedStream) -> np.ndarray:
    """The correction at rest, which every later answer repeats."""
    for _ in range(5):
        last = stream.correct(Q)
    assert last.source == "corrected"
    return np.array(last.delta)


# rad: an iteration that begins anew, after a frame that was late, ends a little elsewhere than one that goes on: 1.2e-9 seen.
# What is forged here differs by far more.
SAME = 1e-8
# What a cycle is answered whose frame, or the one before, a busy machine kept for too long or lost.
KEPT_BACK = (None, Status.STALE.name, Status.SEQ_GAP.name, Status.OVERLOAD.name)


def is_right(setpoint: Setpoint, right: np.ndarray) -> bool:
    """Whether a setpoint has the correction, or some of it where a busy machine itself kept a frame or its answer back."""
    delta = np.array(setpoint.delta)
    if setpoint.source == "corrected":
        return bool(np.abs(delta - right).max() < SAME)
    share = delta @ right / (right @ right)
    late = setpoint.source == "slowed" or setpoint.status in KEPT_BACK
    return late and -1e-6 <= share <= 1.0 + 1e-6 and bool(np.abs(delta - share * right).max() < SAME)


def stray(stream: CorrectedStream) -> int:
    """How many answers the stream has dropped."""
    s = stream.statistics
    return s.forged + s.foreign + s.late + s.malformed + s.unknown_epoch + s.too_large


@pytest.mark.parametrize("signed", [None, False])
@pytest.mark.parametrize("count", [2000, pytest.param(100_000, marks=pytest.mark.slow)])
@pytest.mark.timeout(1800)
def test_forged_replayed_and_disordered_answers_are_not_taken(
    corrector: Corrector, intruder: zenoh.Session, active: Active, count: int, signed: bool | None
) -> None:
    name = f"victim{signed}"
    rng = random.Random(count)
    recorded: list[bytes] = []
    heard = intruder.declare_subscriber(
        f"{ROOT}/stream/{name}/out", lambda sample: recorded.append(sample.payload.to_bytes())
    )
    with open_stream(corrector, name, signed=signed) as stream:  # an earlier session on the same name
        until(lambda: stream.correct(Q).source == "corrected" and len(recorded) > 100)
    earlier = recorded[:100]
    with open_stream(corrector, name, signed=signed) as stream:
        right = truth(stream)
        until(lambda: stream.correct(Q).source == "corrected" and len(recorded) > 300)
        heard.undeclare()  # type: ignore[no-untyped-call]
        own = recorded[-100:]
        out = way_out(intruder, f"{ROOT}/stream/{name}/out")
        strangers = forger.blind(rng, list(Q), active.number, active.epoch)

        def attack(stop: threading.Event) -> None:
            for k in range(count // 4):
                if stop.is_set():
                    return
                for data in (next(strangers), rng.choice(earlier), rng.choice(own), forger.others(own[-1], rng)):
                    out.put(data)
                if k % 10 == 0:
                    time.sleep(0.001)  # as many at once as the machine bears would be an attack on its time

        cycles = wrong = 0
        with beside(attack) as ended:
            while not ended.is_set() or stray(stream) < count:
                cycles += 1
                wrong += not is_right(stream.correct(Q), right)
        assert stray(stream) == count
    assert wrong == 0
    assert cycles > count / 1000
    print(f"{count} forged answers, {cycles} cycles meanwhile: {wrong} taken")


@pytest.mark.timeout(600)
@pytest.mark.parametrize("offset", [1.0, 1e6, math.nan, 0.9 * math.radians(1.0)])
def test_somebody_who_sees_the_setpoints_moves_the_arm_within_bounds(
    corrector: Corrector, intruder: zenoh.Session, active: Active, offset: float
) -> None:
    """He answers every setpoint, exact echo and all, often before the corrector does."""
    name = f"seen{offset:.0f}"
    most = math.radians(1.0)
    with open_stream(corrector, name, signed=False) as stream:
        right = truth(stream)
        out = way_out(intruder, f"{ROOT}/stream/{name}/out")

        def answer(sample: zenoh.Sample) -> None:
            _, _, _, _, seq, sent, apply = forger.HEADER.unpack_from(sample.payload.to_bytes())
            q = [x + offset for x in Q]
            out.put(forger.answer(seq, sent, apply, q, version=active.number, epoch=active.epoch))

        with intruder.declare_subscriber(f"{ROOT}/stream/{name}/in", answer):
            last, before = time.monotonic(), stream.correct(Q)
            for _ in range(300):
                asked, setpoint = time.monotonic(), stream.correct(Q)
                now = time.monotonic()
                assert setpoint.source in ("corrected", "slowed")  # a busy machine may keep an answer back
                delta = np.array(setpoint.delta)
                assert np.abs(delta).max() <= most + 1e-8
                assert np.abs(delta - before.delta).max() <= most * max(now - last, LEAST_PAUSE_S) / 0.2 + 1e-8
                if not offset < most:
                    assert np.abs(delta - right).max() < SAME
                before, last = setpoint, asked


def lies(active: Active, k: int) -> bytes:
    """An announcement that is not true."""
    document = json.loads(active.announcement())
    made: list[object] = [
        {**document, "epoch": active.epoch + 1000 + k}, {**document, "version": f"{k:016x}"},
        {**document, "epoch": 2**32 - 1, "version": "0" * 16, "joints": 3, "largest_deg": 1e9},
        {"robot": ROBOT, "version_id": None, "version": None, "epoch": None},
        {**document, "epoch": 10**400}, {**document, "largest_deg": 1e-12}, [], "[" * 5000, {"epoch": None},
    ]  # fmt: skip
    return json.dumps(made[k % len(made)]).encode()


def test_forged_announcements_cost_nothing(corrector: Corrector, intruder: zenoh.Session, active: Active) -> None:
    with open_stream(corrector, "announced") as stream:
        right = truth(stream)
        said = way_out(intruder, f"{ROOT}/active")
        for k in range(200):
            said.put(lies(active, k))
            assert is_right(stream.correct(Q), right)
            assert stream.active is not None
        assert stream.active["version_id"] == active.version_id
        assert stream.active["joints"] == 5


def test_a_forged_queryable_does_not_end_the_stream(
    corrector: Corrector, intruder: zenoh.Session, active: Active
) -> None:
    asked = []

    def lie(query: zenoh.Query) -> None:
        asked.append(query)
        query.reply(f"{ROOT}/active", lies(active, len(asked)))

    with (
        open_stream(corrector, "queryable", signed=False) as stream,
        intruder.declare_queryable(f"{ROOT}/active", lie, complete=True),
    ):
        right = truth(stream)
        said = way_out(intruder, f"{ROOT}/active")

        def insist() -> bool:
            said.put(b"{}")
            found = stream.correct(Q)
            assert is_right(found, right), (found.source, found.status, found.delta, stream.statistics)
            time.sleep(0.01)
            return len(asked) > 20

        until(insist)
        assert stream.active is not None


def test_one_bad_frame_on_the_way_in_costs_one_cycle_at_most(corrector: Corrector, intruder: zenoh.Session) -> None:
    """The intruder sees the stream, and puts a frame before the next one."""
    heard: list[bytes] = []
    with (
        open_stream(corrector, "poisoned") as stream,
        intruder.declare_subscriber(
            f"{ROOT}/stream/poisoned/in", lambda sample: heard.append(sample.payload.to_bytes())
        ),
    ):
        right = truth(stream)
        put = way_out(intruder, f"{ROOT}/stream/poisoned/in").put
        until(lambda: stream.correct(Q).source == "corrected" and bool(heard))
        hour, far = 3_600_000_000_000, [x + 0.3 for x in Q]
        for flags in (0, Flag.RESET, Flag.RESET | Flag.SETTLED):
            for seq_by in (-1, 0, 1, 2, None):
                for time_by in (0, hour, -hour):
                    _, _, _, _, seq, sent, _ = forger.HEADER.unpack_from(heard[-1])
                    bad = 2**64 - 1 if seq_by is None else seq + seq_by
                    before = len(heard)
                    put(wire.encode_setpoints(
                        np.array([far]), joints=5, seq=bad, t_send_ns=(sent + time_by) % 2**64, t_apply_ns=0, flags=flags,
                    ))  # fmt: skip
                    until(lambda before=before: len(heard) > before)  # type: ignore[misc]
                    time.sleep(0.005)  # the corrector has had it
                    cycles = [stream.correct(Q) for _ in range(20)]
                    assert sum(setpoint.source != "corrected" for setpoint in cycles) <= 1, (flags, seq_by, time_by)
                    assert np.abs(np.array(cycles[-1].delta) - right).max() < 2e-4


@pytest.mark.parametrize("count", [3000, pytest.param(50_000, marks=pytest.mark.slow)])
@pytest.mark.timeout(1800)
def test_attacked_setpoints_of_a_signed_stream_cost_no_cycle(
    corrector: Corrector, intruder: zenoh.Session, count: int
) -> None:
    """Recorded, repeated, damaged, invented and unsigned setpoints, beside a controller: none is corrected."""
    rng = random.Random(count)
    name = f"signed{count}"
    heard: list[bytes] = []
    answers: list[bytes] = []
    own: set[bytes] = set()  # a session hears what it sends itself

    def hear(sample: zenoh.Sample) -> None:
        data = sample.payload.to_bytes()
        if data not in own:
            heard.append(data)

    with (
        open_stream(corrector, name) as stream,
        intruder.declare_subscriber(f"{ROOT}/stream/{name}/in", hear),
        intruder.declare_subscriber(f"{ROOT}/stream/{name}/out", lambda s: answers.append(s.payload.to_bytes())),
    ):
        right = truth(stream)
        until(lambda: stream.correct(Q).source == "corrected" and len(heard) > 50)
        way = way_out(intruder, f"{ROOT}/stream/{name}/in")
        recorded = heard[-50:]
        until(lambda: sequence(heard[-1]) == stream._acceptance._seq)  # the last one has arrived here, too
        before, known = stream.statistics.sent, sequence(heard[-1])

        def attack(stop: threading.Event) -> None:
            for k in range(count // 4):
                if stop.is_set():
                    return
                last = heard[-1]
                plain = b"KLT1" + last[4:-32]
                for data in (rng.choice(recorded), last, sealer.damaged(last, rng), plain):
                    own.add(data)
                    way.put(data)
                if k % 10 == 0:
                    time.sleep(0.001)

        with beside(attack) as ended:
            while not ended.is_set():
                assert is_right(stream.correct(Q), right)
        until(lambda: stream.correct(Q).source == "corrected")
        sent = stream.statistics.sent - before - stream.statistics.refused[Status.STALE.name]

        def corrected() -> list[int]:
            return [sequence(data) for data in answers if is_corrected(data)]

        until(lambda: len({seq for seq in corrected() if seq > known}) >= sent)
        time.sleep(0.1)
        # Each of the controller's own once, and nothing else: what is repeated would be answered a second time.
        assert len(corrected()) == len(set(corrected()))
        assert len({seq for seq in corrected() if seq > known}) == sent
    print(f"{count} attacked setpoints over zenoh: 0 corrected")


def sequence(data: bytes) -> int:
    return int.from_bytes(data[8:16], "little")


def is_corrected(data: bytes) -> bool:
    return len(data) > 48 and data[44:46] == b"\0\0"
