"""How fast the client reads recordings, and how much memory it takes for ten minutes at 4600 Hz.

    python -m benchmarks.files [--frames 2760000] [--markers 3] [--send]

Each format is read in a process of its own, whose largest resident memory is printed. Targets: 500 000 frames/s from
C3D and n3d, 100 000 from CSV, under 500 MB. Frames are counted by the clock on the wall and by the processor's, which
other work on the machine does not slow. With --send the whole way is gone: `kilter measure match --by frames --robot` to a
server started here, and the largest resident memory of the client and of each process of the server.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

READ = """
import json, sys, time
from pathlib import Path
from kilter_files.formats.registry import open_recording
from kilter_files.match.dwells import RestOptions, find_dwells
from kilter_files.match.matching import marker_columns
from kilter_client.cli.files.parts import cut_parquet_parts
start, busy = time.perf_counter(), time.process_time()
recording = open_recording(Path(sys.argv[1]))
frames = sum(len(block) for block in recording.blocks())
read, busy = time.perf_counter() - start, time.process_time() - busy
start = time.perf_counter()
if sys.argv[2] == "parts":
    rows = ({"t_s": b.t_s} | marker_columns(b.points_mm) for b in recording.blocks())
    size = sum(len(part.content) for part in cut_parquet_parts(rows))
else:
    size = len(find_dwells(recording, RestOptions()))
second = time.perf_counter() - start
memory = int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) / 1024
print(json.dumps([frames, frames / read, frames / busy, frames / second, memory]))
"""
TARGETS = {"c3d": 500_000, "n3d": 500_000, "csv": 100_000}
BLOCK = 20_000


def write_n3d(path: Path, points: np.ndarray, repeats: int) -> None:
    """Write a floating-point file of ``repeats`` copies of a block."""
    with path.open("wb") as stream:
        stream.write(struct.pack("<Bhhif", 32, points.shape[1], 3, len(points) * repeats, 4600.0).ljust(256, b"\0"))
        for _ in range(repeats):
            stream.write(points.astype("<f4").tobytes())


def write_c3d(path: Path, points: np.ndarray, repeats: int) -> None:
    """Write a C3D file whose counters of frames are full, as long recordings have them."""
    count = points.shape[1]
    entry = struct.pack("bb5sHb", 5, -1, b"POINT", 3, 0) + struct.pack("bb4sHbBf", 4, 1, b"RATE", 8, 4, 0, 4600.0)
    head = bytes([2, 0x50]) + struct.pack("<5HfHHf", count, 0, 1, 65535, 10, -1.0, 3, 0, 4600.0)
    four = np.concatenate([points, np.zeros((*points.shape[:2], 1))], axis=2).astype("<f4").tobytes()
    with path.open("wb") as stream:
        stream.write(head.ljust(512, b"\0") + (b"\0\0\1\x54" + entry + b"\0\0").ljust(512, b"\0"))
        for _ in range(repeats):
            stream.write(four)


def write_csv(path: Path, points: np.ndarray, repeats: int) -> None:
    """Write a First-Principles-style CSV."""
    rows = [",".join(f"{value:.4f}" for value in frame) for frame in points.reshape(len(points), -1)]
    names = ",".join(f"Marker_{k + 1} {axis}" for k in range(points.shape[1]) for axis in "xyz")
    with path.open("w") as stream:
        stream.write(f"Number of frames,{len(points) * repeats}\nFrequency,4600\nUnits,mm\n\nFrame,{names}\n")
        for repeat in range(repeats):
            first = repeat * len(points) + 1
            stream.writelines(f"{first + i},{row}\n" for i, row in enumerate(rows))


def send(frames: int) -> int:
    """Send a recording whole through the command, and say how much memory client and server took."""
    from kilter_client import Kilter
    from tests.clients.files.simulated import arm, wander, write_log, write_n3d
    from tests.clients.files.test_sending import start_server, three_joints

    with tempfile.TemporaryDirectory() as folder:
        data, t = Path(folder), np.arange(frames) / 4600
        points = np.concatenate([arm(wander(part)) for part in np.array_split(t, max(1, frames // BLOCK))])
        recording = write_n3d(data / "long.n3d", points, 4600.0)
        log_t = np.arange(-1, t[-1] + 2, 0.004)
        log = write_log(data / "log.csv", wander(log_t), log_t)
        del points
        server = start_server(data)
        os.environ["KILTER_DATA"] = str(data)
        with Kilter() as kilter:
            three_joints(kilter, "arm")
        start = time.perf_counter()
        # not ru_maxrss, which a process takes over from the one that started it
        command = "import sys; from kilter_client.cli import run; code = run(sys.argv[1:]); " + (
            "print(open('/proc/self/status').read().partition('VmHWM:')[2].split()[0], file=sys.stderr); sys.exit(code)"
        )
        arguments = ["match", str(recording), str(log), "--by", "frames", "--robot", "arm", "--json"]
        run = subprocess.run([sys.executable, "-c", command, *arguments], capture_output=True, text=True, check=True)
        took, rows = time.perf_counter() - start, json.loads(run.stdout)["rows"]
        client, served = int(run.stderr.split()[-1]) // 1024, peaks(server.pid)
        server.terminate()
        server.wait(30)
    print(f"send: {rows} rows in {took:.0f} s, client {client} MB, server's processes {served} MB")
    return 0 if client < 500 and max(served) < 500 and rows else 1


def peaks(pid: int) -> list[int]:
    """Return the largest resident memory (MB) of a process and of its children."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    family = {pid}
    while more := {child for child, parent in parents.items() if parent in family} - family:
        family |= more
    found = []
    for member in sorted(family):
        with contextlib.suppress(OSError):
            text = Path(f"/proc/{member}/status").read_text()
            found.append(int(text.partition("VmHWM:")[2].split()[0]) // 1024)
    return found


def main() -> int:
    """Write each format, read it, and say whether the targets are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=2_760_000)
    parser.add_argument("--markers", type=int, default=3)
    parser.add_argument("--send", action="store_true")
    options = parser.parse_args()
    if options.send:
        return send(options.frames)
    t = np.arange(BLOCK) / 4600
    motion = 300 * np.sin(2 * np.pi * t / t[-1])[:, None, None] * np.array([1.0, 0.5, 0.2])
    points = np.random.default_rng(0).normal(0, 0.05, (BLOCK, options.markers, 3)) + motion + 500
    good = True
    with tempfile.TemporaryDirectory() as folder:
        for kind, write in (("n3d", write_n3d), ("c3d", write_c3d), ("csv", write_csv)):
            path = Path(folder) / f"long.{kind}"
            write(path, points, max(1, options.frames // BLOCK))
            for second in ("parts", "dwells"):
                run = subprocess.run([sys.executable, "-c", READ, str(path), second], capture_output=True, check=True)
                frames, rate, busy, other, memory = json.loads(run.stdout)
                met = max(rate, busy) >= TARGETS[kind] and memory < 500
                good &= met
                print(
                    f"{kind}: {frames} frames, read {rate:,.0f}/s ({busy:,.0f}/s of processor time), "
                    f"{second} {other:,.0f}/s, {memory:.0f} MB "
                    f"({'met' if met else 'MISSED'})"
                )
            path.unlink()
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
