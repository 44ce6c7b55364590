"""What a whole trajectory costs by query: 10 000 points of 6 joints beside a bare query of 480 kB, taken in turns.

    python -m benchmarks.trajectory [--rounds 60]

Allowed are 1.5 bare round trips and 3 µs for every point. The last line is
``query p50=... ms bare=... ms allowed=... ms ratio=...``.
"""

from __future__ import annotations

import argparse
import time
from multiprocessing.connection import Connection

import numpy as np
import zenoh

from benchmarks.stream import SITE, beside_an_echo
from benchmarks.stream_arm import POSTURE, ROBOT, calibration
from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active, version_number
from kilter_service.stream.corrector.keys import RobotKeys
from kilter_service.stream.corrector.queries import encode_trajectory
from kilter_service.stream.corrector.session import open_listening

POINTS, JOINTS = 10_000, 6
ECHO = "bench/echo"


def echo_main(pipe: Connection) -> None:
    """A process that answers every query with what it was sent."""
    session, endpoint = open_listening("tcp/127.0.0.1:0", None)
    with session:
        queryable = session.declare_queryable(ECHO, zenoh.handlers.FifoChannel(32), complete=True)
        pipe.send(endpoint)
        while not pipe.poll():
            with queryable.handler.recv() as query:
                query.reply(ECHO, query.payload.to_bytes() if query.payload else b"")


def ask(session: zenoh.Session, key: str, payload: bytes) -> tuple[float, bytes]:
    """Seconds of a query until its answer is in one piece of bytes, and the answer."""
    begin = time.perf_counter()
    for reply in session.get(key, payload=payload, timeout=5.0):
        if reply.ok is None:
            raise SystemExit(f"{key}: {reply.err.payload.to_string() if reply.err else 'no answer'}")
        data = reply.ok.payload.to_bytes()
        return time.perf_counter() - begin, data
    raise SystemExit(f"nobody answers {key}")


def trajectory() -> tuple[np.ndarray, np.ndarray]:
    """Times and joints of a motion of all joints at 500 points a second."""
    t = np.arange(POINTS) * 0.002
    return t, POSTURE + 0.3 * np.sin(0.2 * t[:, None] + np.arange(JOINTS))


def measure(session: zenoh.Session, active: Active, rounds: int) -> None:
    """Ask both in turn and print what they took."""
    t, q = trajectory()
    request, key = encode_trajectory(t, q, joints=JOINTS), RobotKeys(SITE, ROBOT).correct
    bare_payload = q.tobytes()
    bare, ours, data = [], [], b""
    for k in range(rounds + 5):
        seconds, _ = ask(session, ECHO, bare_payload)
        corrected, data = ask(session, key, request)
        if k >= 5:  # the first ones meet cold caches
            bare.append(seconds)
            ours.append(corrected)
    out = np.frombuffer(data, offset=len(data) - 8 * q.size).reshape(q.shape)
    _, expected, _, _ = Track(active.program, settled=True).follow(q, 1, np.diff(t, prepend=t[:1]))
    print(f"largest difference from the kernel {np.max(np.abs(out - expected)):.1e} rad")
    inside = wire.VERDICT.unpack_from(data, wire.HEADER.size)[4] / 1e6
    p50, base = np.median(ours) * 1e3, np.median(bare) * 1e3
    allowed = 1.5 * base + POINTS * 3e-3
    print(f"{POINTS} points, {len(request)} bytes; kernel {inside:.1f} ms, {1e3 * inside / POINTS:.2f} µs a point")
    print(f"query p50={p50:.1f} ms bare={base:.2f} ms allowed={allowed:.1f} ms ratio={p50 / allowed:.2f}")


def main() -> None:
    """Run everything once."""
    parser = argparse.ArgumentParser(description="A trajectory of 10 000 points by query against a bare query.")
    parser.add_argument("--rounds", type=int, default=60, help="queries of each kind")
    rounds = parser.parse_args().rounds
    program = compile_program(calibration(), CorrectionOptions())
    active = Active(ROBOT, "ver_bench", version_number(program.digest), 1, program)
    with beside_an_echo(active, echo_main, "query", lambda session: ask(session, ECHO, b"")) as (session, _):
        measure(session, active, rounds)


if __name__ == "__main__":
    main()
