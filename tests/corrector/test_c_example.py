"""The example codec in C, compiled, against golden frames and damaged ones."""

from __future__ import annotations

import random
import re
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.wire import Status
from tests.corrector import forger, sealer

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "c" / "controller.c"
HEADER = EXAMPLE.with_name("kilter_frames.h")
COMPILER = shutil.which("cc") or shutil.which("gcc")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="no C compiler on this machine")


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("c") / "controller"
    warnings = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O1"]
    subprocess.run([str(COMPILER), *warnings, "-o", str(made), str(EXAMPLE)], check=True)
    return made


def talk(controller: Path, lines: list[str]) -> list[str]:
    done = subprocess.run([str(controller)], input="\n".join(lines) + "\n", capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def test_the_byte_tables_of_the_header_file_are_those_of_the_frames() -> None:
    rows = re.findall(r"^ \* +(\d+) +(\d+) +(char\[4\]|u?int\d+) ", HEADER.read_text(), re.MULTILINE)
    codes = {"char[4]": "4s", "uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q", "int32": "i"}
    assert "<" + "".join(codes[kind] for _, _, kind in rows[:7]) == wire.HEADER.format
    assert "<" + "".join(codes[kind] for _, _, kind in rows[7:]) == wire.VERDICT.format
    at = 0
    for offset, size, kind in rows:
        assert (int(offset), int(size)) == (at, struct.calcsize(f"<{codes[kind]}"))
        at += int(size)
    assert at == wire.HEADER.size + wire.VERDICT.size


def test_c_writes_the_bytes_of_a_setpoint(controller: Path) -> None:
    q = [1.0, -0.5, 0.1, 1e-300]
    expected = wire.encode_setpoints(np.array([q]), joints=4, seq=7, t_send_ns=100, t_apply_ns=200)
    assert talk(controller, ["q " + " ".join(map(repr, q))]) == [expected.hex()]


def test_c_reads_an_answer_and_a_refusal(controller: Path) -> None:
    header = wire.Header(0, 2, 0, 9, 100, 200)
    good = wire.encode_answer(header, np.array([0.1, -2.5]).tobytes(), version=0xABC, epoch=5, left_nm=123456)
    bad = wire.encode_refusal(header, Status.JOINT_LIMIT, version=0xABC, epoch=5, limit_mask=3)
    said = talk(controller, [f"a {good.hex()}", f"a {bad.hex()}"])
    assert said[0].split()[:10] == ["seq", "9", "status", "0", "epoch", "5", "version", "0000000000000abc", "mask", "0"]
    assert said[0].split()[10:12] == ["left", "123456"]
    assert [float(x) for x in said[0].split()[12:]] == [0.1, -2.5]
    assert said[1] == "seq 9 status 6 epoch 5 version 0000000000000abc mask 3 left 0"


def test_the_flags_of_the_header_file_are_those_of_the_frames() -> None:
    named = dict(re.findall(r"KILTER_(\w+) = 0x([0-9A-Fa-f]{4})\b", HEADER.read_text()))
    assert {name: int(value, 16) for name, value in named.items()} == {flag.name: int(flag) for flag in wire.Flag}


def test_c_and_python_refuse_the_same_frames(controller: Path) -> None:
    rng = random.Random(2)
    header = wire.Header(0, 3, 0, 9, 100, 200)
    good = wire.encode_answer(header, np.zeros(3).tobytes(), version=1, epoch=5)
    lines, expected = [], []
    for _ in range(2000):
        data = bytearray(good)
        data[rng.randrange(60)] = rng.randrange(256)
        if rng.random() < 0.2:
            data = data[: rng.randrange(len(data))]
        try:
            taken = wire.decode_answer(bytes(data)).header.kind == 0
        except wire.FrameError:
            taken = False
        lines.append(f"a {data.hex()}")
        expected.append(taken)
    assert [line != "not an answer" for line in talk(controller, lines)] == expected


def test_c_acts_on_the_right_answer_only(controller: Path) -> None:
    rng = random.Random(4)
    q = [0.1, -0.5, 0.7]
    good = forger.answer(7, 100, 200, [x + 0.001 for x in q], version=0xABC, epoch=5)
    refusal = forger.answer(7, 100, 200, [], version=0xABC, epoch=5, status=3)
    strangers = forger.blind(rng, q, 0xABC, 5)
    forged = [next(strangers) for _ in range(1000)]
    forged += [forger.others(good, rng) for _ in range(1000)] + [forger.spoilt(good, rng) for _ in range(1000)]
    said = talk(controller, ["q " + " ".join(map(repr, q)), *(f"c 5 abc {d.hex()}" for d in (good, refusal, *forged))])
    assert said[1:3] == ["accepted", "accepted"]
    assert set(said[3:]) == {"dropped"}
    assert len(said) == 3003


def test_blake2s_in_c_is_that_of_the_rfc(controller: Path) -> None:
    assert talk(controller, ["t"]) == ["good"]


def test_c_signs_and_checks_as_the_tables_say(controller: Path) -> None:
    session, key, nonce = bytes(range(16)), bytes(range(32, 64)), bytes(range(100, 116))
    q = [0.1, -0.5, 0.7]
    greeting = sealer.seal(sealer.HEADER.pack(b"KLT2", 3, 0, 0, 5, 6, 0), session, key, "KLT2helo")
    head = sealer.HEADER.pack(b"KLT2", 3, 0, 0, 5, 6, 0) + wire.VERDICT.pack(0, 0, Status.NO_SESSION, 0, 0, 0)
    challenge = sealer.seal(head + nonce, session, key, "KLT2chal")
    in_use = sealer.derive(key, "KLT2work", nonce)
    plain = wire.encode_setpoints(np.array([q]), joints=3, seq=7, t_send_ns=100, t_apply_ns=200)
    rng = random.Random(6)
    good = sealer.seal(
        forger.answer(7, 100, 200, [x + 0.001 for x in q], version=0xABC, epoch=5), session, in_use, "KLT2out"
    )
    forged = [sealer.damaged(good, rng) for _ in range(2000)]
    forged += [sealer.seal(b"KLT1" + good[4:-32], session, rng.randbytes(32), "KLT2out") for _ in range(500)]
    bad_nonces = [sealer.damaged(challenge, rng) for _ in range(200)]
    lines = [
        f"k {session.hex()} {key.hex()}", *(f"n {data.hex()}" for data in (*bad_nonces, challenge)),
        "q " + " ".join(map(repr, q)), *(f"c 5 abc {data.hex()}" for data in (good, *forged)),
    ]  # fmt: skip
    said = talk(controller, lines)
    assert said[0] == greeting.hex()
    assert set(said[1:201]) == {"not a nonce"}
    assert said[201] == "signs"
    assert said[202] == sealer.seal(plain, session, in_use, "KLT2in").hex()
    assert said[203] == "accepted"
    assert set(said[204:]) == {"dropped"}
    assert len(said) == 204 + 2500
