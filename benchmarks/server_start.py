"""From `kilterd serve` on an empty data folder to the line that says all is ready."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time

from benchmarks.table import Line

FIRST_S, AGAIN_S, STOP_S = 2.5, 2.0, 30.0


def lines() -> list[Line]:
    """Seconds until API, worker and corrector are ready; the second start has the database already."""
    with tempfile.TemporaryDirectory() as data:
        first, again = _seconds(data), _seconds(data)
    return [
        Line("server ready, new data folder", f"{first:.1f} s", f"<= {FIRST_S:g} s", first <= FIRST_S),
        Line("server ready, started again", f"{again:.1f} s", f"<= {AGAIN_S:g} s", again <= AGAIN_S),
    ]


def _seconds(data: str) -> float:
    plain = {name: value for name, value in os.environ.items() if not name.startswith("KILTER_")}
    environment = plain | {"KILTER_DATA": data, "KILTER_PORT": "0", "KILTER_ZENOH_LISTEN": "tcp/127.0.0.1:0"}
    began = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-m", "kilter_service", "serve"],
        env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    ) as server:  # fmt: skip
        assert server.stdout is not None
        try:
            if not server.stdout.readline():
                raise RuntimeError(
                    f"kilterd ended with {server.wait()} before it was ready: run `make serve` to see why."
                )
            return time.perf_counter() - began
        finally:
            server.terminate()
            server.wait(STOP_S)
