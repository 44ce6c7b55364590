"""What the stream's client believes: the echo of its own setpoint, small, and of a version it knows. No network here."""

from __future__ import annotations

import json
import math
import random
import struct
from typing import Any

import pytest

from kilter_client.stream import CorrectedStream, StreamError
from tests.corrector import forger

Q = (0.1, 0.6, 0.4, 0.3, 0.2)
NUMBER, EPOCH = 0x0123456789ABCDEF, 7
DOCUMENT = {
    "robot": "arm", "version_id": "ver_1", "version": f"{NUMBER:016x}", "epoch": EPOCH, "joints": 5,
    "joint_kinds": ["revolute"] * 4 + ["prismatic"], "largest_deg": 1.0, "largest_mm": 5.0,
}  # fmt: skip


def announced(**other: object) -> bytes:
    return json.dumps({**DOCUMENT, **other}).encode()


def stream_of(document: bytes = announced(), **options: Any) -> CorrectedStream:
    """A stream that has found its version, without a network."""
    made = CorrectedStream("arm", endpoints=["tcp/127.0.0.1:1"], site="test", **options)
    assert made._in_use.confirm([document])
    made.joints = 5
    return made


def asked(stream: CorrectedStream, q: tuple[float, ...] = Q) -> bytes:
    """The next setpoint as it goes out."""
    return stream._acceptance.frame(q, q, 5, 0, 0)[0]


def answered(frame: bytes, shift: float = 1e-3) -> bytes:
    """The corrector's answer to it."""
    _, _, _, _, seq, sent, apply = forger.HEADER.unpack_from(frame)
    return forger.answer(seq, sent, apply, [x + shift for x in Q], version=NUMBER, epoch=EPOCH)


def test_of_100_000_forged_answers_none_is_taken() -> None:
    rng = random.Random(3)
    stream = stream_of()
    others = stream_of()
    recorded = [answered(asked(others)) for _ in range(200)]
    recorded += [answered(asked(stream)) for _ in range(200)]
    strangers = forger.blind(rng, list(Q), NUMBER, EPOCH)
    taken = sent = 0
    while sent < 100_000:
        good = answered(asked(stream))
        forged = [next(strangers) for _ in range(40)] + rng.sample(recorded, 20)
        forged += [forger.others(good, rng) for _ in range(20)] + [forger.spoilt(good, rng) for _ in range(20)]
        sent += len(forged)
        taken += sum(stream._accept(data) is not None for data in forged)
        assert stream._accept(good) is not None
    assert taken == 0


@pytest.mark.parametrize("joint", range(5))
def test_the_largest_correction_is_that_of_the_version_and_never_above_the_callers(joint: int) -> None:
    for own, versions in ((1.0, 1.0), (0.5, 2.0), (3.0, 0.5)):
        stream = stream_of(
            announced(largest_deg=versions, largest_mm=5 * versions), largest_deg=own, largest_mm=5 * own
        )
        most = min(own, versions) * (5e-3 if joint == 4 else math.radians(1.0))
        for size, taken in ((0.999, True), (-0.999, True), (1.001, False), (-1.001, False)):
            data = bytearray(answered(asked(stream), 0.0))
            struct.pack_into("<d", data, 56 + 8 * joint, Q[joint] + size * most)
            assert (stream._accept(bytes(data)) is not None) == taken
        assert stream.statistics.too_large == 2


def test_sequence_and_time_begin_anywhere() -> None:
    frames = [forger.HEADER.unpack_from(asked(stream_of()))[4:] for _ in range(50)]
    for values in zip(*frames, strict=True):
        assert len(set(values)) == 50
        assert max(values) - min(values) > 2**58
    stream = stream_of()
    steps = [forger.HEADER.unpack_from(asked(stream))[5] % 2**20 for _ in range(50)]
    assert len(set(steps)) > 40


def test_a_refusal_with_the_right_echo_is_heard() -> None:
    stream = stream_of()
    _, _, _, _, seq, sent, apply = forger.HEADER.unpack_from(asked(stream))
    data = forger.answer(seq, sent, apply, [], version=0, epoch=0, status=3)
    answer = stream._accept(data)
    assert answer is not None
    assert answer.status == "SEQ_BACK"


@pytest.mark.parametrize("payload", [
    b"", b"null", b"[]", b"{}", b"7", b"\xff" * 50, b"[" * 10_000, b'{"epoch":' * 2000, b'{"epoch": ' + b"9" * 9000 + b"}",
    announced(epoch=2**32), announced(epoch=-1), announced(epoch=True), announced(epoch="7"), announced(epoch=1e30),
    announced(version="zz"), announced(version=None), announced(version="f" * 17), announced(joints=0),
    announced(joints=6.0), announced(joints=10**6), announced(largest_deg="1"), announced(largest_deg=-1),
    announced(largest_deg=math.inf), announced(largest_mm=math.nan), announced(version_id=3), b" " * 20_000,
])  # fmt: skip
def test_an_announcement_that_is_none_changes_nothing(payload: bytes) -> None:
    stream = stream_of()
    known, active = stream._in_use.known, stream.active
    stream._in_use.announce(payload)
    stream._in_use.confirm([payload])
    assert (stream._in_use.known, stream.active) == (known, active)


def test_an_announcement_adds_a_version_and_takes_none_away() -> None:
    stream = stream_of()
    for k in range(1000):
        stream._in_use.announce(announced(epoch=k, version=f"{k:016x}", largest_deg=1000.0))
    stream._in_use.announce(json.dumps({"robot": "arm", "version_id": None, "version": None, "epoch": None}).encode())
    assert stream.active == DOCUMENT
    assert stream._accept(answered(asked(stream))) is not None
    assert len(stream._in_use.known) < 20
    data = bytearray(answered(asked(stream), 0.0))
    struct.pack_into("<d", data, 56, Q[0] + 0.1)
    assert stream._accept(bytes(data)) is None


def test_a_forged_answer_to_the_question_beside_the_true_one_changes_nothing() -> None:
    stream = stream_of()
    nothing = json.dumps({"robot": "arm", "version_id": None, "version": None, "epoch": None}).encode()
    for lie in (nothing, announced(epoch=2**32 - 1), announced(joints=3), announced(largest_deg=1e-9), b"rubbish"):
        for replies in ([lie, announced()], [announced(), lie]):
            stream._in_use.confirm(replies)
            assert stream._accept(answered(asked(stream))) is not None
            assert stream.active is not None
    stream._in_use.confirm([])
    assert stream.active is not None
    stream._in_use.confirm([nothing])
    assert stream.active is None
    assert stream._accept(answered(asked(stream))) is None


def test_a_new_version_is_followed_and_the_one_before_still_heard() -> None:
    stream = stream_of()
    new = announced(epoch=8, version=f"{5:016x}")
    stream._in_use.confirm([new])
    assert stream.active is not None
    assert stream.active["epoch"] == 8
    assert stream._accept(answered(asked(stream))) is not None
    stream._in_use.confirm([new])
    stream._in_use.confirm([announced(epoch=9, version=f"{6:016x}")])
    assert stream._accept(answered(asked(stream))) is None


def test_another_number_of_joints_is_said_before_anything_is_sent() -> None:
    stream = stream_of()
    for call in (
        lambda: stream.correct((0.0,) * 6),
        lambda: stream.correct(()),
        lambda: stream.correct(Q, Q, Q[:4]),
        lambda: stream.correct_chunk([Q, Q[:4]], 0.001),
    ):
        with pytest.raises(StreamError, match="has 5 joints"):
            call()
    with pytest.raises(StreamError, match="no points"):
        stream.correct_chunk([], 0.001)
    assert stream.statistics.sent == 0


@pytest.mark.parametrize(
    "names", [("a b", "t", "m"), ("arm", "", "m"), ("arm", "t", "1e+6"), ("arm", "t", "x" * 65), ("*", "t", "m")]
)
def test_a_name_that_nobody_would_answer_is_refused(names: tuple[str, str, str]) -> None:
    robot, site, stream = names
    with pytest.raises(StreamError, match="cannot be part of a stream key"):
        CorrectedStream(robot, endpoints=["tcp/127.0.0.1:1"], site=site or "*", stream=stream)


def test_the_correction_changes_no_faster_than_it_may() -> None:
    """Answers of somebody who sees the setpoints leap from end to end of what is allowed, at rest and in motion."""
    stream = stream_of(settled=True, quickest_s=0.2)
    limits = (math.radians(1.0),) * 4 + (5e-3,)
    last: tuple[float, ...] | None = None
    for k in range(2000):
        frame = asked(stream)
        answer = stream._accept(answered(frame, 0.0))
        assert answer is not None
        sign = 1.0 if k % 37 < 18 else -1.0
        wanted = tuple(q + (0.002 * k if k > 1000 else 0.0) for q in Q)
        answer = answer._replace(q=tuple(w + sign * most for w, most in zip(wanted, limits, strict=True)))
        delta = stream._carried.follow(wanted, answer, 0.001, 0.001, 0.002 if k > 1000 else 0.0).delta
        for d, before, most in zip(delta, last or delta, limits, strict=True):
            assert abs(d) <= most * 1.000001
            assert abs(d - before) <= most * 0.001 / 0.2 + (0.0002 if k > 1000 else 0.0) + 1e-8
        last = delta
    assert stream.statistics.slowed > 100


@pytest.mark.parametrize(("statuses", "resets"), [
    (["STALE"], True), (["SEQ_BACK"], True), (["RATE_LIMIT"], True), (["SEQ_GAP"], False), (["OVERLOAD"], False),
    (["SEQ_GAP", "SEQ_GAP"], True), (["OVERLOAD", "SEQ_GAP"], True), (["JOINT_LIMIT"] * 3, False),
    (["NO_VERSION"] * 3, False), ([], False),
])  # fmt: skip
def test_after_refusals_it_starts_anew(statuses: list[str], resets: bool) -> None:
    stream = stream_of()
    answer = stream._accept(answered(asked(stream)))
    assert answer is not None
    assert stream._flags == 0
    for status in statuses:
        stream._react_to_refusal(answer._replace(status=status, q=()))
    assert stream._flags == (8 if resets else 0)
