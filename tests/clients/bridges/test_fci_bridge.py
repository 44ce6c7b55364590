"""`kilter bridge fci` on a simulator of the robot that enforces limits of motion and of communication: `tools.lab franka`."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from tests.clients.bridges.franka_arm import Floats, from_path_mm, table, tool_mm
from tests.clients.bridges.running_bridge import REAL_TIME, Bridge, bridging

ENVIRONMENT = Path(os.environ.get("KILTER_FRANKA", "/nowhere"))
SECONDS, REST_S, RAMP_S = float(os.environ.get("SECONDS", "16")), 2.0, 1.0
OBJECTION = r"violat|discontinuity|reflex|abort|Traceback"  # of the simulator's judges
pytestmark = [
    pytest.mark.franka,
    pytest.mark.skipif(
        not (ENVIRONMENT / "bin" / "python").exists(),
        reason="no simulator of a Franka robot: `python -m tools.lab franka` installs it beside",
    ),
]


@contextmanager
def simulator(folder: Path) -> Iterator[Path]:
    """The robot, until the block ends; its log."""
    script, log = Path(__file__).with_name("franka_server.py"), folder / "simulator.log"
    with log.open("wb") as file:
        process = subprocess.Popen(
            [*REAL_TIME, str(ENVIRONMENT / "bin" / "python"), str(script), str(folder)], stdout=file, stderr=file
        )
    try:
        end = time.monotonic() + 60
        while not (folder / "ready").exists():
            assert process.poll() is None, log.read_text()
            assert time.monotonic() < end, log.read_text()
            time.sleep(0.2)
        yield log
    finally:
        process.terminate()
        process.wait(20)


def calibrated(kilter: Kilter, name: str, folder: Path) -> None:
    """Add the arm and activate what measurements of the real one identify."""
    kilter.robots.add({"name": name, "convention": "preset", "preset": "panda", "controller_compensation": "none"})
    rng = np.random.default_rng(5)
    low, high = np.radians([-100, -60, -100, -150, -100, 40, -100]), np.radians([100, 60, 100, -30, 100, 180, 100])
    q = rng.uniform(low, high, (150, 7))
    rows = np.hstack([np.degrees(q), tool_mm(q, real=True) + rng.normal(0, 1e-4, (len(q), 3))])
    head = ",".join([f"q{k}_deg" for k in range(1, 8)] + ["x_mm", "y_mm", "z_mm"])
    path = folder / "measured.csv"
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.10g")
    assert run(["upload", name, str(path), "--name", "monday"]) == 0
    assert run(["identify", name, "-c", "monday", "--level", "2", "--tool", "fixed", "--base", "fixed"]) == 0
    assert run(["activate", "latest", "--robot", name, "--force"]) == 0


class Seen(NamedTuple):
    """Joints (N, 7) rad while the arm was corrected and on its path: as it was told, and as its motors brought it; its rest."""

    told: Floats
    moved: Floats
    rest: Floats


def seen(folder: Path) -> Seen:
    rows: Floats = np.load(folder / "joints.npy")
    rows = rows[np.unique(rows[:, 0], return_index=True)[1]]
    changes = np.abs(np.diff(rows[:, 8:], axis=0)).max(axis=1)
    began = rows[np.flatnonzero((changes > 0) & (rows[1:, 0] > 1.0))[0], 0]
    time_s = rows[:, 0] - began
    on_path = (time_s > RAMP_S + 0.5) & (time_s < REST_S + SECONDS)
    resting = on_path & (time_s < REST_S)
    return Seen(rows[on_path, 8:], rows[on_path, 1:8], rows[resting, 1:8])


@contextmanager
def moving(name: str, rows: Floats, folder: Path) -> Iterator[Bridge]:
    """A bridge that lets the arm play a table."""
    path = folder / "table.csv"
    head = "t_s," + ",".join(f"q{k}_deg" for k in range(1, 8))
    np.savetxt(path, np.column_stack([rows[:, :1], np.degrees(rows[:, 1:])]), "%.12g", ",", header=head, comments="")
    options = ["--path", str(path), "--ramp-s", str(RAMP_S)]
    with bridging("fci", name, "127.0.0.1", *options, PYTHONPATH=str(ENVIRONMENT / "bridge")) as bridge:
        yield bridge


def test_the_arm_is_on_its_path_and_the_simulator_has_nothing_against_it(kilter: Kilter, tmp_path: Path) -> None:
    calibrated(kilter, "fr3", tmp_path)
    rows = table(SECONDS, REST_S)
    with simulator(tmp_path) as log:
        with moving("fr3", rows, tmp_path) as bridge:
            assert bridge.process.stdout is not None
            out = bridge.process.stdout.read()
            assert bridge.process.wait(30) == 0, "\n".join(bridge.said)
        said = log.read_text()
    assert re.search(r"fci bridge of fr3: \d+ answers", out)
    assert not re.search(OBJECTION, said, re.IGNORECASE), said[-3000:]
    path = tool_mm(rows[::5, 1:])
    found = seen(tmp_path)
    assert len(found.told) > 100
    assert len(found.rest) > 5
    error, moved, rest = (from_path_mm(tool_mm(joints, real=True), path) for joints in found)
    without = from_path_mm(tool_mm(rows[::200, 1:], real=True), path)
    print(f"\nas told {error.max():.4f} mm, as moved {moved.max():.3f} mm, at rest {rest.max():.4f} mm", end=", ")
    print(f"without {without.max():.3f} mm; {out}")
    assert without.max() > 1.0
    assert error.max() < 0.05
    assert rest.max() < 0.05  # the simulator's motors lag behind in motion, corrected or not


def test_ended_in_motion_it_comes_to_rest_and_where_it_hangs_the_robot_stops_by_itself(
    kilter: Kilter, tmp_path: Path
) -> None:
    calibrated(kilter, "fr3-2", tmp_path)
    rows = table(16.0, REST_S)
    with simulator(tmp_path) as log:
        with moving("fr3-2", rows, tmp_path) as bridge:
            bridge.heard("correcting")
            time.sleep(REST_S + 3.0)
            assert "fci bridge of fr3-2" in bridge.ended()
        said = log.read_text()
        assert not re.search(OBJECTION, said, re.IGNORECASE), said[-3000:]
        with moving("fr3-2", rows, tmp_path) as bridge:  # its table begins elsewhere: the arm stays where it is
            bridge.heard("correcting")
            bridge.process.send_signal(signal.SIGSTOP)
            end = time.monotonic() + 30.0
            while "communication_constraints_violation" not in log.read_text() and time.monotonic() < end:
                time.sleep(0.1)
        assert "communication_constraints_violation" in log.read_text()
    rows_seen: Floats = np.load(tmp_path / "joints.npy")
    found = rows_seen[np.unique(rows_seen[:, 0], return_index=True)[1]]
    found = found[found[:, 0] > 1.0]
    assert np.ptp(found[-100:, 1:8], axis=0).max() < 5e-3  # it stands; its motors settle
    assert np.abs(found[-1, 1:8] - rows[0, 1:]).max() > 0.02  # in the midst of its path
    speed = np.abs(np.diff(found[:, 1:8], axis=0)).max(axis=1) / np.diff(found[:, 0])
    assert speed.max() < 1.5  # rad/s, planned is 0.9
