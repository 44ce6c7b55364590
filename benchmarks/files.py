"""How fast the client reads recordings, and how much memory it takes for ten minutes at 4600 Hz.

    python benchmarks/files.py [--frames 2760000] [--markers 3]

Each format is read in a process of its own, whose largest resident memory is printed. Targets: 500 000 frames/s from
C3D and n3d, 100 000 from CSV, under 500 MB.
"""

from __future__ import annotations

import argparse
import json
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

READ = """
import json, resource, sys, time
from pathlib import Path
from kilter_client.files.recordings import open_recording
from kilter_client.files.dwells import RestOptions, find_dwells
from kilter_client.files.matching import marker_columns
from kilter_client.files.parts import parts
start = time.perf_counter()
recording = open_recording(Path(sys.argv[1]))
frames = sum(len(block) for block in recording.blocks())
read = time.perf_counter() - start
start = time.perf_counter()
if sys.argv[2] == "parts":
    rows = ({"t_s": b.t_s} | marker_columns(b.points_mm) for b in recording.blocks())
    size = sum(len(part.content) for part in parts(rows))
else:
    size = len(find_dwells(recording, RestOptions()))
second = time.perf_counter() - start
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps([frames, frames / read, frames / second, memory]))
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


def main() -> int:
    """Write each format, read it, and say whether the targets are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=2_760_000)
    parser.add_argument("--markers", type=int, default=3)
    options = parser.parse_args()
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
                frames, rate, other, memory = json.loads(run.stdout)
                met = rate >= TARGETS[kind] and memory < 500
                good &= met
                print(
                    f"{kind}: {frames} frames, read {rate:,.0f}/s, {second} {other:,.0f}/s, {memory:.0f} MB "
                    f"({'met' if met else 'MISSED'})"
                )
            path.unlink()
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
