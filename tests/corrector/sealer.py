"""Signed frames made from the tables of docs/reference/stream.md alone, for tests: no code of Kilter."""

from __future__ import annotations

import random
import struct
from hashlib import blake2s

HEADER = struct.Struct("<4sBBHQQQ")


def tag(key: bytes, use: str, message: bytes) -> bytes:
    return blake2s(message, key=key, digest_size=16, person=use.encode()).digest()


def derive(key: bytes, use: str, message: bytes) -> bytes:
    return blake2s(message, key=key, digest_size=32, person=use.encode()).digest()


def session_id(secret: bytes, expires_s: int, number: int) -> bytes:
    return blake2s(b"", key=secret, digest_size=4, person=b"KLT2mid").digest() + struct.pack("<IQ", expires_s, number)


def session_key(secret: bytes, session: bytes, site: str, robot: str, stream: str) -> bytes:
    return derive(secret, "KLT2key", session + f"{site}\0{robot}\0{stream}".encode())


def seal(plain: bytes, session: bytes, key: bytes, use: str) -> bytes:
    data = b"KLT2" + plain[4:] + session
    return data + tag(key, use, data)


def greeting(session: bytes, key: bytes, seq: int) -> bytes:
    return seal(HEADER.pack(b"KLT2", 3, 0, 0, seq, seq, 0), session, key, "KLT2helo")


def nonce_of(challenge: bytes) -> bytes:
    """What the corrector gave; its tag is not checked."""
    assert len(challenge) == 104
    assert struct.unpack_from("<H", challenge, 44) == (12,)
    return challenge[56:72]


def damaged(data: bytes, rng: random.Random) -> bytes:
    """The frame with bits turned over, cut off, made longer, or with parts of another one."""
    what = rng.randrange(6)
    out = bytearray(data)
    if what == 0:
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    elif what == 1:
        del out[rng.randrange(len(out)) :]
    elif what == 2:
        at = rng.randrange(len(out))
        del out[at : at + rng.randrange(1, 9)]
    elif what == 3:
        out += rng.randbytes(rng.randrange(1, 33))
    elif what == 4:
        out[-16:] = rng.randbytes(16)  # a tag that is guessed
    else:
        struct.pack_into("<QQ", out, 8, rng.getrandbits(62), rng.getrandbits(62))  # another sequence and time
    return bytes(out)
