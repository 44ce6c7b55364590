"""Frames of somebody who is not the corrector, made from the byte tables of docs/reference/stream.md alone."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterator

HEADER, VERDICT = struct.Struct("<4sBBHQQQ"), struct.Struct("<QIHHIi")
BAD = (1.0, -1.0, 1e6, -1e6, math.nan, math.inf, -math.inf, 0.02, 1e300)  # added to a joint, rad


def answer(
    seq: int, sent: int, apply: int, q: list[float], *, version: int, epoch: int, status: int = 0, kind: int = 0,
    joints: int | None = None,
) -> bytes:  # fmt: skip
    """An answer as the corrector would send it."""
    head = HEADER.pack(b"KLT1", kind, len(q) if joints is None else joints, 0, seq, sent, apply)
    return head + VERDICT.pack(version, epoch, status, 0, 1000, 0) + struct.pack(f"<{len(q)}d", *q)


def blind(rng: random.Random, q: list[float], version: int, epoch: int) -> Iterator[bytes]:
    """Answers of somebody who does not see the setpoints, but knows robot, version and epoch; without an end."""
    now = 10**9 * rng.randrange(1, 10**6)
    seq = rng.choice((0, 1, rng.getrandbits(32), rng.getrandbits(62), rng.getrandbits(64)))
    while True:
        seq = (seq + 1) % 2**64
        now += 1_000_000
        bad = list(q)
        bad[rng.randrange(len(q))] += rng.choice((*BAD, 1e-3, -1e-3))
        sent, apply = rng.choice((0, now, rng.getrandbits(62))), rng.choice((0, now, rng.getrandbits(62)))
        yield answer(seq, sent, apply, bad, version=version, epoch=epoch, status=0 if rng.random() < 0.9 else 3)


def spoilt(good: bytes, rng: random.Random) -> bytes:
    """An answer with the right echo that says something it must not: too much, another shape, another version."""
    data = bytearray(good)
    joints = data[5]
    what = rng.randrange(8)
    if what < 3:
        at = 56 + 8 * rng.randrange(joints)
        value = struct.unpack_from("<d", data, at)[0] + rng.choice(BAD) * (1.0 if what else 1e3)
        struct.pack_into("<d", data, at, value)
    elif what == 3:
        data[32 + rng.randrange(8)] ^= 1 << rng.randrange(8)  # version
    elif what == 4:
        data[40 + rng.randrange(4)] ^= 1 << rng.randrange(8)  # epoch
    elif what == 5:
        data[4] = rng.choice((1, 2, 255))  # kind
    elif what == 6:
        data[5] = (joints - 1) or 2
        data = data[: 56 + 8 * data[5]]
        data += bytes(max(0, 56 + 8 * data[5] - len(data)))
    else:
        data = data[: rng.randrange(32, len(data))]
    return bytes(data)


def others(good: bytes, rng: random.Random) -> bytes:
    """An answer of another moment: late, repeated, out of order, or with one bit of the echo turned over."""
    magic, kind, joints, flags, seq, sent, apply = HEADER.unpack_from(good)
    what = rng.randrange(5)
    if what == 0:
        seq = (seq + rng.choice((-1, 1, -2, 2, -1000, 1000, 2**40))) % 2**64
    elif what == 1:
        sent = (sent + rng.choice((-1, 1, -(10**6), 10**6, 3600 * 10**9))) % 2**64
    elif what == 2:
        apply = (apply + rng.choice((-1, 1, 10**6, 3600 * 10**9))) % 2**64
    elif what == 3:
        seq, sent = (seq + 1) % 2**64, (sent + 10**6) % 2**64
    else:
        apply = 0 if apply else 1
    return HEADER.pack(magic, kind, joints, flags, seq, sent, apply) + good[32:]
