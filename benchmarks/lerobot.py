"""How fast a data set of LeRobot is read as a joint log, and whether memory grows with its rows.

    python -m benchmarks.lerobot [--rows 1000000]

A data set in the layout of v3.0 is written by pyarrow: six servos that move within their ranges, 20 000 frames to an
episode, one episode to a file. Targets: 200 000 rows/s; memory grows by less than 50 MB between the first tenth of the
rows and the last.
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from benchmarks.table import Line, show
from kilter_files.formats.joints.lerobot.log import blocks, open_recorded_joints
from kilter_files.formats.reader import LogHints

SERVOS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
FPS, EPISODE, LOW, HIGH = 30, 20_000, 800, 3300
LEAST_ROWS_S, MOST_GROWN_MB = 200_000.0, 50.0


def calibration(folder: Path) -> Path:
    """The JSON of six servos."""
    path = folder / "arm.json"
    own = {"drive_mode": 0, "homing_offset": 0, "range_min": LOW, "range_max": HIGH}
    path.write_text(json.dumps({name: {"id": k + 1, **own} for k, name in enumerate(SERVOS)}))
    return path


def data_set(folder: Path, rows: int) -> Path:
    """Files of rows and of episodes, and what info.json says of them."""
    state = {"dtype": "float32", "shape": [len(SERVOS)], "names": [f"{name}.pos" for name in SERVOS]}
    lengths = [min(EPISODE, rows - first) for first in range(0, rows, EPISODE)]
    info = {
        "codebase_version": "v3.0", "robot_type": "so101_follower", "total_episodes": len(lengths), "total_frames": rows,
        "fps": FPS, "chunks_size": 1000, "features": {"action": state, "observation.state": state},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    }  # fmt: skip
    for part in ("data/chunk-000", "meta/episodes/chunk-000"):
        (folder / part).mkdir(parents=True)
    (folder / "meta/info.json").write_text(json.dumps(info))
    for k, length in enumerate(lengths):
        parquet.write_table(_rows(k, length), folder / f"data/chunk-000/file-{k:03d}.parquet")
    count = np.arange(len(lengths))
    chunks = np.zeros_like(count)
    episodes = {"episode_index": count, "length": lengths, "data/chunk_index": chunks, "data/file_index": count}
    parquet.write_table(pa.table(episodes), folder / "meta/episodes/chunk-000/file-000.parquet")
    return folder


def _rows(episode: int, length: int) -> pa.Table:
    time_s = np.arange(length) / FPS
    ticks = (LOW + HIGH) / 2 + 0.4 * (HIGH - LOW) * np.sin(0.3 * time_s[:, None] + np.arange(len(SERVOS)) + episode)
    degrees = (np.round(ticks) - (LOW + HIGH) / 2) * 360.0 / 4095.0
    state = pa.FixedSizeListArray.from_arrays(pa.array(degrees.astype(np.float32).ravel()), len(SERVOS))
    return pa.table({
        "action": state, "observation.state": state, "timestamp": time_s.astype(np.float32),
        "frame_index": np.arange(length), "episode_index": np.full(length, episode),
        "index": episode * EPISODE + np.arange(length), "task_index": np.zeros(length, dtype=np.int64),
    })  # fmt: skip


def measured(rows: int) -> list[Line]:
    """Read all rows, a block at a time, as `kilter measure inspect`, `kilter robot episodes` and a log do."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        hints = LogHints(calibration=calibration(folder), norm_mode="DEGREES")
        path, read, early = data_set(folder / "set", rows), 0, 0
        began = time.perf_counter()
        for block in blocks(open_recorded_joints(path, hints)):
            read += len(block.angles)
            early = early or (_most_kb() if read >= rows / 10 else 0)
        rate = read / (time.perf_counter() - began)
        grown = (_most_kb() - early) / 1024
    return [
        Line("rows of a LeRobot data set per second", f"{rate:.0f}", f"{LEAST_ROWS_S:.0f}", rate >= LEAST_ROWS_S),
        Line(f"memory grown over {rows} rows, MB", f"{grown:.0f}", f"{MOST_GROWN_MB:g}", grown < MOST_GROWN_MB),
        Line("rows read", str(read), str(rows), read == rows),
    ]


def _most_kb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def main() -> None:
    """Print the table, and as JSON on the last line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    lines = measured(parser.parse_args().rows)
    print(show(lines))
    print(json.dumps({line.what: line.value for line in lines}))


if __name__ == "__main__":
    main()
