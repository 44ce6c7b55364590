"""What the correction costs: corrected round trip against a bare zenoh echo, interleaved in one run.

    python -m benchmarks.stream [--samples 20000] [--rounds 4] [--rate 1000] [--tls] [--save samples.npz]

With ``--tls`` both have TLS with certificates on both sides and access control, and the corrected setpoints are signed.

Echo and corrector have the same session settings, ring, thread and priority, and take turns in blocks of a quarter of a
second, so that whatever else the machine does meets both. Two processes of the same program differ by several per cent,
by where their memory happens to lie; so both are started anew in every round, and the samples of all rounds are put
together. The last line is ``ratio p50=... p99=... lost=...``.
"""

from __future__ import annotations

import argparse
import gc
import math
import multiprocessing
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import zenoh

from benchmarks.stream_arm import ROBOT, calibration, kernel_times, path
from kilter_client.signing import Signer, on_this_machine
from kilter_core.correct.program import CorrectionOptions, compile_program
from kilter_service.ground.settings import Settings
from kilter_service.run.zenoh_folders import load_or_make_authority, write_folders
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active, version_number
from kilter_service.stream.corrector.loop import ask_for_real_time
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import config, open_listening
from kilter_service.stream.corrector.wire import Flag

SITE = "bench"
BARE_SITE = "bare"
STREAMS = f"kilter/@v1/{SITE}/{ROBOT}/stream"
ECHO = (
    f"kilter/@v1/{BARE_SITE}/{ROBOT}/stream/echo"  # as long as a stream's, of a site that the corrector does not serve
)
BLOCK_S = 0.25
REAL_TIME: dict[str, Any] = {
    "priority": zenoh.Priority.REAL_TIME,
    "congestion_control": zenoh.CongestionControl.DROP,
    "express": False,
}


class Fixed:
    """A source of robots whose versions never change."""

    def __init__(self, *actives: Active) -> None:
        self._active = {active.robot: active for active in actives}

    def stamp(self) -> Hashable:
        """Never changes."""
        return 0

    def load(self) -> Mapping[str, Active]:
        """The versions."""
        return self._active

    def close(self) -> None:
        """Nothing is open."""


@dataclass(frozen=True)
class Guarded:
    """Zenoh configurations with TLS and access control, as `kilterd zenoh-config` writes them."""

    folder: Path

    def write(self) -> None:
        """Write them, for the corrector's site and for that of the echo."""
        authority, trusted = load_or_make_authority(self.folder, rotate=False)
        for site in (SITE, BARE_SITE):
            folder = self.folder / site
            write_folders(folder, site, ("127.0.0.1",), 7447, {"main": ("*",)}, 0, authority, trusted)

    def file(self, site: str, role: str) -> Path:
        """Configuration of a role."""
        return self.folder / site / role / "zenoh.json5"


@contextmanager
def running(source: Fixed, guarded: Guarded | None = None) -> Iterator[Corrector]:
    """A corrector in a folder of its own."""
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(data=Path(folder), zenoh_listen="tcp/127.0.0.1:0", site=SITE)
        if guarded:
            secured = {"zenoh_listen": "tls/127.0.0.1:0", "zenoh_config": guarded.file(SITE, "corrector")}
            settings = settings.model_copy(update=secured)
        corrector = Corrector(settings, source)
        corrector.start()
        try:
            yield corrector
        finally:
            corrector.stop()


def echo_main(pipe: Connection, guarded: Guarded | None = None) -> None:
    """A process that sends back what it gets, built like the stream process without the correction."""
    sys.setswitchinterval(0.0005)
    ask_for_real_time()
    listen, file = ("tls/127.0.0.1:0", guarded.file(BARE_SITE, "corrector")) if guarded else ("tcp/127.0.0.1:0", None)
    session, endpoint = open_listening(listen, file)
    with session:
        subscriber = session.declare_subscriber(f"{ECHO}/in", zenoh.handlers.RingChannel(256))
        publisher = session.declare_publisher(f"{ECHO}/out", **REAL_TIME)
        pipe.send(endpoint)
        gc.freeze()
        gc.disable()
        ring = subscriber.handler
        while not pipe.poll():
            sample = ring.try_recv() or ring.recv()
            publisher.put(sample.payload.to_bytes())


class Line:
    """One direction there and back, with the round trips of its frames."""

    def __init__(self, session: zenoh.Session, key: str, signer: Signer | None = None) -> None:
        self.signer = signer
        self.arrived: list[tuple[int, bytes]] = []
        self.sent: dict[int, int] = {}
        self.seq = 0
        self._publisher = session.declare_publisher(f"{key}/in", **REAL_TIME)
        session.declare_subscriber(f"{key}/out", zenoh.handlers.Callback(self._take, indirect=False))
        end = time.monotonic() + 20
        while not self._publisher.matching_status.matching:
            if time.monotonic() > end:
                raise SystemExit(f"nobody listens to {key}")
            time.sleep(0.01)
        if signer is not None:
            self._publisher.put(signer.greeting())
            while not any(signer.accept_challenge(data, b"") for _, data in self.arrived):
                if time.monotonic() > end:
                    raise SystemExit(f"no nonce for {key}")
                time.sleep(0.01)
            self.arrived.clear()

    def answers(self, first: int = 0) -> list[wire.Answer]:
        """What came back, without signatures; those of the wrong key count as lost."""
        found = [data if self.signer is None else self.signer.verify_answer(data) for _, data in self.arrived[first:]]
        return [wire.decode_answer(data) for data in found if data is not None]

    def _take(self, sample: zenoh.Sample) -> None:
        self.arrived.append((time.perf_counter_ns(), sample.payload.to_bytes()))

    def send(self, values: np.ndarray, step_ns: int | None = None) -> None:
        """Send a point, or a chunk when ``step_ns`` is given."""
        self.seq += 1
        flags = Flag.RESET | Flag.SETTLED if self.seq == 1 else 0
        data = wire.encode_setpoints(
            values, joints=6, seq=self.seq, t_send_ns=time.monotonic_ns(), t_apply_ns=0, flags=flags, step_ns=step_ns
        )
        self.sent[self.seq] = time.perf_counter_ns()  # a controller signs, too: it counts
        self._publisher.put(data if self.signer is None else self.signer.sign_frame(data))

    def wait(self, seconds: float = 3.0) -> None:
        """Wait for the answers that are under way."""
        end = time.monotonic() + seconds
        while len(self.arrived) < self.seq and time.monotonic() < end:
            time.sleep(0.001)

    def round_trips_us(self) -> np.ndarray:
        """Round trips of the frames that came back, µs."""
        trips = [at - self.sent[int.from_bytes(data[8:16], "little")] for at, data in self.arrived]
        return np.array(trips[100:]) / 1000.0  # the first ones meet cold caches


def take_turns(lines: list[Line], samples: int, rate: float) -> None:
    """Send ``samples`` to every line in turn, in blocks, at ``rate`` per second."""
    period = 1.0 / rate
    block = max(1, int(BLOCK_S * rate))
    for start in range(0, samples, block):
        for line in lines:
            due = time.perf_counter()
            for k in range(start, min(start + block, samples)):
                due += period
                time.sleep(max(0.0, due - time.perf_counter()))
                line.send(path(k))
            line.wait(0.2)


def throughput(line: Line, points: int = 200, window: int = 8, seconds: float = 3.0) -> float:
    """Setpoints per second in chunks, ``window`` of them under way."""
    chunks = [np.vstack([path(points * c + k) for k in range(points)]) for c in range(64)]
    chunks += chunks[::-1]  # there and back, without a leap
    begin, first = time.perf_counter(), line.seq
    while time.perf_counter() - begin < seconds:
        if line.seq - len(line.arrived) < window:
            line.send(chunks[line.seq % len(chunks)], 1_000_000)
        else:
            time.sleep(0.0001)
    line.wait()
    good = sum(answer.status == 0 for answer in line.answers(first))
    return points * good / (time.perf_counter() - begin)


def report(name: str, trips: np.ndarray, sent: int) -> tuple[float, float]:
    """Print the quantiles of a line; returns p50 and p99."""
    p50, p95, p99, p999 = np.percentile(trips, [50, 95, 99, 99.9])
    print(
        f"{name:10s} n={sent} p50={p50:7.1f} p95={p95:7.1f} p99={p99:7.1f} p99.9={p999:8.1f} max={trips.max():8.1f} µs"
    )
    return float(p50), float(p99)


def quiet() -> None:
    """Say when something else keeps the machine busy: half a second in which this program does nothing."""

    def ticks() -> tuple[int, int]:
        fields = [int(x) for x in Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()[1:]]
        return fields[3] + fields[4], sum(fields[:8])

    idle, total = ticks()
    time.sleep(0.5)
    busy = 1.0 - (ticks()[0] - idle) / max(1, ticks()[1] - total)
    print(f"other programs use {busy:.0%} of the machine" + (": these figures are not worth keeping" * (busy > 0.1)))


def client_config(endpoints: tuple[str, ...], guarded: Guarded | None) -> zenoh.Config:
    """A peer of both, with a controller's certificate where there is TLS."""
    if guarded is None:
        return config("tcp/127.0.0.1:0", endpoints)
    made = config(None, endpoints, guarded.file(SITE, "controller-main"))
    made.insert_json5("mode", '"peer"')
    return made


def signer_of(corrector: Corrector, stream: str, guarded: Guarded | None) -> Signer | None:
    """Keys for a stream, where setpoints are signed."""
    session = on_this_machine(corrector.file.with_name("stream-keys.json"), SITE, ROBOT, stream) if guarded else None
    return Signer(session) if session else None


@contextmanager
def beside_an_echo(
    active: Active,
    entry: Callable[..., None],
    door: str,
    wake: Callable[[zenoh.Session], object],
    guarded: Guarded | None = None,
) -> Iterator[tuple[zenoh.Session, Corrector]]:
    """A session with a corrector (its ``door``, "stream" or "query") and an echo in a process of its own.

    The echo's ``entry`` sends its endpoint and ends when the pipe has something for it, which ``wake`` makes it look at.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    echo = context.Process(target=entry, args=(theirs, guarded) if guarded else (theirs,))
    echo.start()
    endpoint = ours.recv()
    try:
        with (
            running(Fixed(active), guarded) as corrector,
            zenoh.open(client_config((endpoint, corrector.endpoints[door]), guarded)) as session,
        ):
            time.sleep(0.5)
            yield session, corrector
            ours.send("stop")
            wake(session)
            echo.join(5)
    finally:
        if echo.is_alive():
            echo.kill()


@dataclass
class Round:
    """What one pair of processes did."""

    echo_us: np.ndarray
    corrected_us: np.ndarray
    inside_us: np.ndarray
    lost: tuple[int, int]
    verdicts: Counter[str]
    chunks_per_s: float


def run_round(active: Active, samples: int, rate: float, guarded: Guarded | None = None) -> Round:
    """Start both, send ``samples`` setpoints to each, then chunks to the corrector."""

    def wake(session: zenoh.Session) -> None:
        session.put(f"{ECHO}/in", b"")

    with beside_an_echo(active, echo_main, "stream", wake, guarded) as (session, corrector):
        gc.collect()
        gc.freeze()
        gc.disable()
        signers = {name: signer_of(corrector, name, guarded) for name in ("corrected", "chunks")}
        lines = [Line(session, ECHO), Line(session, f"{STREAMS}/corrected", signers["corrected"])]
        take_turns(lines, samples, rate)
        for line in lines:
            line.wait()
        answers = lines[1].answers()
        done = Round(
            lines[0].round_trips_us(),
            lines[1].round_trips_us(),
            np.array([answer.processing_ns for answer in answers]) / 1000.0,
            (lines[0].seq - len(lines[0].arrived), lines[1].seq - len(answers)),
            Counter(answer.status.name for answer in answers),
            throughput(Line(session, f"{STREAMS}/chunks", signers["chunks"])),
        )
        gc.enable()
    p50, p99 = (np.percentile(done.corrected_us, q) / np.percentile(done.echo_us, q) for q in (50, 99))
    print(
        f"round: echo p50={np.median(done.echo_us):.1f} µs, corrected / echo p50={p50:.3f} p99={p99:.3f}, inside the "
        f"corrector p50={np.median(done.inside_us):.1f} µs, {done.chunks_per_s:,.0f} setpoints/s in chunks of 200",
        flush=True,
    )
    return done


def main() -> None:
    """Run everything once."""
    parser = argparse.ArgumentParser(description="Corrected round trip against a bare zenoh echo.")
    parser.add_argument("--samples", type=int, default=20_000, help="setpoints per line")
    parser.add_argument("--rounds", type=int, default=4, help="pairs of processes that share them")
    parser.add_argument("--rate", type=float, default=1000.0, help="setpoints per second")
    parser.add_argument("--tls", action="store_true", help="TLS and access control for both; setpoints are signed")
    parser.add_argument("--save", type=Path, help="file for the samples, as benchmarks.latency_page reads them (.npz)")
    arguments = parser.parse_args()
    quiet()
    program = compile_program(calibration(), CorrectionOptions())
    kernel_times(program)
    active = Active(ROBOT, "ver_bench", version_number(program.digest), 1, program)
    share = math.ceil(arguments.samples / arguments.rounds)
    with tempfile.TemporaryDirectory() as folder:
        guarded = Guarded(Path(folder)) if arguments.tls else None
        if guarded:
            guarded.write()
        rounds = [run_round(active, share, arguments.rate, guarded) for _ in range(arguments.rounds)]
    echo_us, corrected_us, inside_us = (
        np.concatenate([getattr(done, name) for done in rounds]) for name in ("echo_us", "corrected_us", "inside_us")
    )
    lost = np.sum([done.lost for done in rounds], axis=0)
    echo_p50, echo_p99 = report("echo", echo_us, share * len(rounds))
    our_p50, our_p99 = report("corrected", corrected_us, share * len(rounds))
    quantiles = np.percentile(inside_us, [50, 99])
    verdicts = sum((done.verdicts for done in rounds), Counter[str]())
    print(f"inside the corrector p50={quantiles[0]:.1f} p99={quantiles[1]:.1f} µs; {dict(verdicts)}")
    chunks = float(np.median([done.chunks_per_s for done in rounds]))
    print(f"throughput in chunks of 200: {chunks:,.0f} setpoints/s, the median of the rounds")
    load = os.getloadavg()[0]
    if arguments.save:
        medians = [[np.median(done.echo_us), np.median(done.corrected_us)] for done in rounds]
        np.savez_compressed(
            arguments.save, echo_us=echo_us, corrected_us=corrected_us, inside_us=inside_us, lost=lost,
            rate_hz=arguments.rate, chunks_per_s=chunks, load=load, medians_us=medians,
        )  # fmt: skip
    print(f"cores {os.cpu_count()}, load {load:.1f}")
    print(f"ratio p50={our_p50 / echo_p50:.3f} p99={our_p99 / echo_p99:.3f} lost={lost[1]}")


if __name__ == "__main__":
    main()
