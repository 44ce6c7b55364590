"""Bytes of the stream: golden frames, both codecs alike, and nothing malformed that gets through."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kilter_client.streaming import frames as client
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.wire import Flag, Kind, Status

POINT = bytes.fromhex(
    "4b4c5431"  # KLT1
    "00" "02" "0000"  # point, 2 joints, no flags
    "0700000000000000" "6400000000000000" "c800000000000000"  # seq 7, sent 100, apply 200
    "000000000000f03f" "000000000000e0bf"  # 1.0, -0.5
)  # fmt: skip
ANSWER = bytes.fromhex(
    "4b4c5431" "00" "02" "0001" "0700000000000000" "6400000000000000" "c800000000000000"
    "efcdab8967452301" "05000000" "0000" "0000" "39300000" "40e20100"  # 123456 nm are left
    "000000000000f03f" "000000000000e0bf"
)  # fmt: skip
REFUSAL = bytes.fromhex(
    "4b4c5431" "00" "00" "0000" "0700000000000000" "6400000000000000" "c800000000000000"
    "efcdab8967452301" "05000000" "0600" "0300" "39300000" "00000000"
)  # fmt: skip

finite = st.floats(allow_nan=False, allow_infinity=False)
u64 = st.integers(0, 2**64 - 1)


def test_a_point_has_these_bytes() -> None:
    values = np.array([[1.0, -0.5]])
    assert wire.encode_setpoints(values, joints=2, seq=7, t_send_ns=100, t_apply_ns=200) == POINT
    decoded = wire.decode_setpoints(POINT)
    assert decoded.header == (Kind.POINT, 2, 0, 7, 100, 200)
    assert decoded.values.tolist() == [[1.0, -0.5]]
    assert decoded.version is None


def test_an_answer_has_these_bytes() -> None:
    header = wire.decode_header(POINT)
    made = wire.encode_answer(
        header, POINT[32:], version=0x0123456789ABCDEF, epoch=5, flags=Flag.DYNAMIC, processing_ns=12345, left_nm=123456
    )
    assert made == ANSWER
    answer = wire.decode_answer(ANSWER)
    assert (answer.version, answer.epoch, answer.status) == (0x0123456789ABCDEF, 5, Status.OK)
    assert answer.values.tolist() == [[1.0, -0.5]]
    theirs = client.decode(ANSWER)
    assert theirs is not None
    assert answer.left_nm == theirs.left_nm == 123456


def test_less_than_nothing_cannot_be_left() -> None:
    for left_nm, good in ((-1, False), (-(2**31), False), (0, True), (2**31 - 1, True)):
        data = ANSWER[:52] + struct.pack("<i", left_nm) + ANSWER[56:]
        decoded = client.decode(data)
        assert (decoded is not None and decoded.left_nm == left_nm) == good
        if good:
            assert wire.decode_answer(data).left_nm == left_nm
        else:
            with pytest.raises(wire.FrameError):
                wire.decode_answer(data)


def test_what_is_left_is_the_longest_in_nanometres_and_never_overflows() -> None:
    assert wire.nanometres(np.array([3e-6, -4e-6, 0.0])) == 5000
    assert wire.nanometres(np.array([[1e-9, 0.0, 0.0], [0.0, 0.0, -7e-4], [0.0, 2e-5, 0.0]])) == 700_000
    assert wire.nanometres(np.array([1e3, 0.0, 0.0])) == 2**31 - 1


def test_a_refusal_has_these_bytes_and_no_numbers() -> None:
    made = wire.encode_refusal(
        wire.decode_header(POINT), Status.JOINT_LIMIT, version=0x0123456789ABCDEF, epoch=5, limit_mask=3,
        processing_ns=12345,
    )  # fmt: skip
    assert made == REFUSAL
    assert wire.decode_answer(made).values.size == 0
    answer = client.decode(made)
    assert answer is not None
    assert (answer.status, answer.q, answer.limit_mask) == ("JOINT_LIMIT", (), 3)


def test_both_codecs_know_the_same_statuses_and_flags() -> None:
    assert tuple(status.name for status in Status) == client.STATUSES
    assert (client.QD, client.QDD, client.VERSION) == (Flag.QD, Flag.QDD, Flag.VERSION)
    assert (client.RESET, client.SETTLED) == (Flag.RESET, Flag.SETTLED)
    for flag in Flag:
        assert getattr(client, flag.name) == flag


@given(
    q=st.lists(finite, min_size=1, max_size=16), width=st.sampled_from([1, 2, 3]), seq=u64, sent=u64, apply=u64,
    version=st.none() | u64, points=st.none() | st.integers(1, 5), step=st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_both_codecs_make_the_same_bytes(
    q: list[float], width: int, seq: int, sent: int, apply: int, version: int | None, points: int | None, step: int
) -> None:
    flags = (0, Flag.QD, Flag.QD | Flag.QDD)[width - 1]
    values = np.tile(q, (points or 1, width))
    ours = wire.encode_setpoints(
        values, joints=len(q), seq=seq, t_send_ns=sent, t_apply_ns=apply, flags=flags, version=version,
        step_ns=None if points is None else step,
    )  # fmt: skip
    theirs = client.encode(
        values.ravel().tolist(), joints=len(q), seq=seq, t_send_ns=sent, t_apply_ns=apply, flags=flags,
        version=version, points=points, step_ns=step if points else 0,
    )  # fmt: skip
    assert ours == theirs
    back = wire.decode_setpoints(ours)
    assert np.array_equal(back.values, values)
    assert back.version == version


@given(
    q=st.lists(finite, min_size=1, max_size=16), points=st.none() | st.integers(1, 5), epoch=st.integers(0, 2**32 - 1)
)
def test_the_client_reads_what_the_corrector_writes(q: list[float], points: int | None, epoch: int) -> None:
    kind = Kind.POINT if points is None else Kind.CHUNK
    header = wire.Header(kind, len(q), 0, 1, 2, 3)
    numbers = np.tile(q, (points or 1, 1)).tobytes()
    data = wire.encode_answer(header, numbers, version=9, epoch=epoch, points=points or 1, step_ns=4)
    answer = client.decode(data)
    assert answer is not None
    assert answer.q == tuple(q) * (points or 1)
    assert np.array_equal(wire.decode_answer(data).values.ravel(), answer.q)


@pytest.mark.parametrize(
    "data",
    [
        b"", b"KLT1", POINT[:-1], POINT + b"\0", b"KLT2" + POINT[4:],
        POINT[:5] + b"\0" + POINT[6:],  # no joints
        POINT[:5] + b"\x11" + POINT[6:],  # 17 joints
        POINT[:4] + b"\x07" + POINT[5:],  # unknown kind
        POINT[:6] + b"\x02\0" + POINT[8:],  # accelerations without velocities
        POINT[:6] + b"\0\x80" + POINT[8:],  # a flag of answers
        struct.pack("<4sBBHQQQII", b"KLT1", 1, 2, 0, 1, 0, 0, 0, 1),  # a chunk of no points
        struct.pack("<4sBBHQQQII", b"KLT1", 1, 2, 0, 1, 0, 0, 2**31, 1),  # a chunk that says it is huge
    ],
)  # fmt: skip
def test_malformed_frames_are_refused(data: bytes) -> None:
    with pytest.raises(wire.FrameError):
        wire.decode_setpoints(data)


@settings(max_examples=500)
@given(data=st.binary(max_size=300) | st.binary(max_size=300).map(lambda tail: b"KLT1" + tail))
def test_random_bytes_never_crash_a_codec(data: bytes) -> None:
    for decode in (wire.decode_setpoints, wire.decode_answer):
        try:
            decode(data)
        except wire.FrameError:
            continue
    client.decode(data)


@given(status=st.integers(1, 20), joints=st.integers(0, 3))
def test_a_refusal_with_numbers_is_not_an_answer(status: int, joints: int) -> None:
    head = wire.HEADER.pack(b"KLT1", 0, joints, 0, 1, 2, 3) + wire.VERDICT.pack(1, 1, status, 0, 0, 0)
    data = head + struct.pack(f"<{joints}d", *[math.pi] * joints)
    answer = client.decode(data)
    assert answer is None or answer.q == ()
    if joints:
        with pytest.raises(wire.FrameError):
            wire.decode_answer(data)
