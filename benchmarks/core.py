"""All core figures in one table: ``python -m benchmarks.core``. Exit 1 when a target is missed."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import fits, identify
from benchmarks.table import Line, best_of, show
from kilter_client.requests.connection import local_server
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.effects import make_effect
from kilter_core.model import RobotModel
from kilter_core.observations import Observations


def main() -> int:
    """Measure, print, and say whether every target was met."""
    lines = [
        line
        for part in (
            measure_model,
            measure_client_import,
            measure_commands,
            measure_server_start,
            identify.lines,
            fits.lines,
        )
        for line in part()
    ]
    print(show(lines))
    return int(any(line.met is False for line in lines))


ROWS, PARAMETERS, TARGET_MS = 118, 40, 1.0


def measure_model() -> list[Line]:
    """Time of one Jacobian of the geometric model and of full tilting on the Katana."""
    ur10 = robot_from_document(preset_document("ur10"))
    katana = robot_from_document(preset_document("katana450-chapter5"))
    tilting = tuple(make_effect(e) for e in ("clearance_tilt", "backlash_load", "axial_compliance"))
    plain = _milliseconds(RobotModel(ur10))
    tilted = _milliseconds(RobotModel(katana, tilting))
    what = f"model and Jacobian, {ROWS} poses x {PARAMETERS} parameters"
    return [
        Line(f"{what}: geometry", f"{plain:.3f} ms", f"<= {TARGET_MS:g} ms", plain <= TARGET_MS),
        Line(f"{what}: full tilting", f"{tilted:.3f} ms"),
    ]


def _milliseconds(model: RobotModel) -> float:
    rng = np.random.default_rng(0)
    batch = model.batch(Observations(rng.uniform(-1.5, 1.5, (ROWS, model.robot.n_joints))))
    values = model.values0() + rng.normal(0.0, 1e-4, len(model.names))
    count = len(model.names)
    free = np.arange(count)[max(0, count - PARAMETERS) :]
    return best_of(lambda: model.jacobian(batch, values, free), 200) * 1e3


TARGET_S, ROUNDS = 0.3, 5
MEASURED = Path(__file__).resolve().parents[1] / "docs" / "tutorial" / "measured.csv"
PROGRAM = str(Path(sys.executable).with_name("kilter"))


def measure_commands() -> list[Line]:
    """The shortest of some runs; wall time on a quiet machine is this and what the server takes."""
    with tempfile.TemporaryDirectory() as folder, local_server(Path(folder)) as server:
        environment = server.environment()
        _command_seconds(environment, "robot", "add", "--preset", "katana450-chapter5", "--name", "arm")
        commands = (("--help",), ("versions", "arm"), ("jobs",), ("upload", "arm", str(MEASURED), "--name", "monday"))
        return list(_timed(environment, commands))


def _timed(environment: dict[str, str], commands: tuple[tuple[str, ...], ...]) -> Iterator[Line]:
    for command in commands:
        took = min(_command_seconds(environment, *command) for _ in range(ROUNDS))
        shown = " ".join(Path(word).name for word in command[:3])
        yield Line(f"kilter {shown}", f"{took:.2f} s", f"<= {TARGET_S:g} s", took <= TARGET_S)


def _command_seconds(environment: dict[str, str], *arguments: str) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([PROGRAM, *arguments], env=environment, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


FIRST_S, AGAIN_S, STOP_S = 2.5, 2.0, 30.0


def measure_server_start() -> list[Line]:
    """Seconds until API, worker and corrector are ready; the second start has the database already."""
    with tempfile.TemporaryDirectory() as data:
        first, again = _start_seconds(data), _start_seconds(data)
    return [
        Line("server ready, new data folder", f"{first:.1f} s", f"<= {FIRST_S:g} s", first <= FIRST_S),
        Line("server ready, started again", f"{again:.1f} s", f"<= {AGAIN_S:g} s", again <= AGAIN_S),
    ]


def _start_seconds(data: str) -> float:
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


IMPORT_TARGET_MS, IMPORT_ROUNDS = 150.0, 7


def measure_client_import() -> list[Line]:
    """Shortest time of ``import kilter_client`` over a bare interpreter's start."""
    bare = min(_import_seconds("pass") for _ in range(IMPORT_ROUNDS))
    with_client = min(_import_seconds("import kilter_client") for _ in range(IMPORT_ROUNDS))
    took = (with_client - bare) * 1e3
    return [Line("import kilter_client", f"{took:.0f} ms", f"<= {IMPORT_TARGET_MS:.0f} ms", took <= IMPORT_TARGET_MS)]


def _import_seconds(statement: str) -> float:
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", statement], check=True)
    return time.perf_counter() - began


if __name__ == "__main__":
    sys.exit(main())
