"""``kilter demo``: the whole job on a simulated arm, measured poses in, corrected setpoints out.

A Katana 450 with the errors of the thesis's tables is measured, identified and corrected through the public client and
the public stream of a server that runs for the time of the demo. The true arm is known to this module alone.
"""

from __future__ import annotations

import csv
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as File
from typing import Any

import numpy as np

from kilter_client import Kilter
from kilter_client.requests.connection import LocalServer, local_server
from kilter_client.stream import Setpoint, Statistics, corrected
from kilter_core.arm import Robot
from kilter_core.model import RobotModel
from kilter_core.observations import Observations
from kilter_core.plan import iso_poses
from kilter_core.twin import Twin, thesis_katana
from kilter_core.types import Floats

ROBOT, PRESET = "katana450", "katana450-chapter5"
NOISE_MM = 0.01
TRAIN_POSES, HELD_OUT_POSES = 118, 40
RATE_HZ = 500.0
# No arm hangs on this stream, so it waits longer than a controller would: a busy machine must not spoil the picture.
DEADLINE_S, HOLD_CYCLES = 0.02, 100
JOB_TIMEOUT_S = 120.0
# The tracker's frame and the tool are known here, as in the thesis: errors are absolute, nothing is fitted away.
FRAMES = {"base": "fixed", "tool": "fixed"}
STAGES: Mapping[str, tuple[str, ...]] = {
    "conventional": (),
    "stiffness only": ("axial_compliance",),
    "full tilting": ("clearance_tilt", "backlash_load", "axial_compliance"),
}
FIGURES = ("mean_mm", "p95_mm", "max_mm")
# Two of its quarter points and its centre, in the nominal base frame.
CENTRE_MM = (0.0, -300.0, 139.2893)
FIRST_MM = (0.0, -370.7107, 210.0)
SECOND_MM = (-100.0, -300.0, 139.2893)
# The posture the free motion of five joints around a three-dimensional path is drawn to.
POSTURE_DEG = (-90.0, 70.0, -110.0, 20.0, 0.0)

TOLERANCE_M = 1e-10
TOLERANCE_RAD = 1e-6
LARGEST_ITERATION = 200


@dataclass(frozen=True)
class Identified:
    """A finished identification: its name in the table, its metrics, and the version it made."""

    name: str
    metrics: dict[str, Any]
    version: str

    @property
    def held_out_mm(self) -> float:
        """Mean error on the poses the fit has not seen."""
        return float(self.metrics["validation"]["identified"]["mean_mm"])


@dataclass(frozen=True)
class Path:
    """A wanted path: times ``t (N,)`` s, nominal joints ``q (N, n)`` rad, tool points ``wanted (N, 3)`` m."""

    t: Floats
    q: Floats
    wanted: Floats


def run_demo(circle_s: float) -> dict[str, list[float]]:
    """Run the demo from start to end; returns the error along the circle."""
    start = time.monotonic()
    twin = thesis_katana(PRESET)
    with tempfile.TemporaryDirectory(prefix="kilter-demo-") as folder, local_server(File(folder) / "data") as server:
        say(f"A server for this demo runs at {server.url}; its stream is at {server.zenoh}.")
        os.environ["KILTER_DATA"] = str(server.data)
        with Kilter(server.url) as kilter:
            train, held_out = measure(kilter, twin, File(folder))
            found = [identify(kilter, name, train, held_out) for name in STAGES]
            show_table(found)
            best = min(found, key=lambda one: one.held_out_mm)
            kilter.versions.activate(best.version)
            number = kilter.versions.get(best.version)["number"]
            say(f"\nThe best on poses it has not seen is '{best.name}': {ROBOT} v{number} is active now.")
        record = stream_circle(twin, server, circle_s)
    say_farewell(time.monotonic() - start)
    return record


def measure(kilter: Kilter, twin: Twin, folder: File) -> tuple[str, str]:
    """Register the robot and upload both campaigns; returns their ids."""
    kilter.robots.add({"name": ROBOT, "convention": "preset", "preset": PRESET})
    say(f"The robot '{ROBOT}' is registered. Measuring it: {TRAIN_POSES} ISO 9283 poses, {NOISE_MM} mm noise.")
    ids = []
    for role, count, seed in (("train", TRAIN_POSES, 1), ("validation", HELD_OUT_POSES, 2)):
        seen = twin.observe(iso_poses(twin.robot, count, seed), noise_m=NOISE_MM / 1000.0, seed=seed)
        file = folder / f"{role}.csv"
        write_campaign(file, seen)
        campaign = kilter.campaigns.add(ROBOT, role, device="simulated", role=role, numbered=True)
        kilter.campaigns.upload(campaign["id"], file)
        ids.append(str(campaign["id"]))
    return ids[0], ids[1]


def write_campaign(file: File, seen: Observations) -> None:
    """Write observations as a table of the contract."""
    assert seen.position is not None
    joints = [f"q{joint + 1}_deg" for joint in range(seen.q.shape[1])]
    with file.open("w", newline="", encoding="utf-8") as out:
        rows = csv.writer(out)
        rows.writerow([*joints, "x_mm", "y_mm", "z_mm"])
        for q, position in zip(np.degrees(seen.q), seen.position * 1000.0, strict=True):
            rows.writerow([*(f"{value:.8f}" for value in q), *(f"{value:.4f}" for value in position)])


def identify(kilter: Kilter, name: str, train: str, held_out: str) -> Identified:
    """Run one identification as a job and wait for it."""
    options = {"effects": list(STAGES[name]), **FRAMES}
    job = kilter.jobs.run("identify", ROBOT, [train], [held_out], options, timeout_s=JOB_TIMEOUT_S)
    result = job["result"]
    return Identified(name, result["metrics"], str(result["version_id"]))


def show_table(found: Sequence[Identified]) -> None:
    """Print the errors before and after each kind of calibration."""
    say(f"\n{'error in mm':18}{f'{TRAIN_POSES} poses of the fit':^27}{f'{HELD_OUT_POSES} held-out poses':^27}")
    say(f"{'':18}" + f"{'mean':>9}{'p95':>9}{'max':>9}" * 2)
    rows = [("before", "nominal", found[0]), *((one.name, "identified", one) for one in found)]
    for name, stage, one in rows:
        figures = [one.metrics[part][stage][figure] for part in ("train", "validation") for figure in FIGURES]
        say(f"{name:18}" + "".join(f"{value:9.3f}" for value in figures))
    say(f"(Noise of {NOISE_MM} mm an axis alone gives a mean of {NOISE_MM * np.sqrt(8.0 / np.pi):.3f} mm.)")


def stream_circle(twin: Twin, server: LocalServer, seconds: float) -> dict[str, list[float]]:
    """Stream the thesis's circle through the corrector and compare what the true arm does with and without it."""
    path = circle(twin.robot, seconds=seconds, rate_hz=RATE_HZ)
    say(f"\nStreaming the thesis's circle through zenoh: {len(path.q)} setpoints at {RATE_HZ:.0f} Hz.")
    statistics = Statistics()
    answers: list[Setpoint] = list(
        corrected(
            path.q.tolist(),
            ROBOT,
            period_s=1.0 / RATE_HZ,
            data=server.data,
            settled=True,
            deadline_s=DEADLINE_S,
            hold_cycles=HOLD_CYCLES,
            statistics=statistics,
        )
    )
    trips = np.array(statistics.round_trips_s) * 1e6
    say(
        f"{statistics.corrected} corrected, {statistics.held} held, {statistics.bypassed} bypassed; "
        f"round trip {np.percentile(trips, 50):.0f} us at the median, {np.percentile(trips, 99):.0f} us at p99."
    )
    before = path_error(twin, path.q, path.wanted)
    after = path_error(twin, np.array(answers), path.wanted)
    say(f"\n{'path error in mm':18}{'mean':>9}{'p95':>9}{'max':>9}")
    for name, error in (("before", before), ("after", after)):
        say(f"{name:18}{error.mean():9.3f}{np.percentile(error, 95):9.3f}{error.max():9.3f}")
    say("(The peaks are where a joint crosses its backlash: the corrector limits how fast.)")
    return {"t_s": path.t.tolist(), "before_mm": before.tolist(), "after_mm": after.tolist()}


def path_error(twin: Twin, q: Floats, wanted: Floats) -> Floats:
    """Distance (N,) mm of the true tool from the wanted path when the arm is sent ``q (N, n)``."""
    position = twin.observe(q).position
    assert position is not None
    return np.asarray(np.linalg.norm(position - wanted, axis=1) * 1000.0)


def say_farewell(seconds: float) -> None:
    """Name what to try next."""
    say(f"\nDone in {seconds:.0f} s. The demo's server and its data are gone. What to try next:")
    say("  kilter try FILE --robot PRESET_OR_FILE      your own measurements, without a server")
    say("  kilterd serve                               a server that stays")
    say("  docs/tutorial/first-calibration.md          the same by hand, in five minutes")
    say("  docs/how-to/from-your-files.md              your own robot and files")


def say(text: str) -> None:
    """Print a line at once, whoever reads."""
    print(text, flush=True)


def circle(robot: Robot, *, seconds: float, rate_hz: float) -> Path:
    """Once round the circle at constant speed, starting and ending at its first point."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    angle = 2.0 * np.pi * t / seconds
    centre, first, second = (np.array(point) / 1000.0 for point in (CENTRE_MM, FIRST_MM, SECOND_MM))
    points = centre + np.outer(np.cos(angle), first - centre) + np.outer(np.sin(angle), second - centre)
    wanted = points @ robot.T_base[:3, :3].T + robot.T_base[:3, 3]
    return Path(t, _follow(robot, wanted), wanted)


def _follow(robot: Robot, wanted: Floats) -> Floats:
    """Joints (N, n) that bring the nominal tool to each point, each solved from the one before."""
    model = RobotModel(robot)
    values = model.values0()
    posture = np.radians(POSTURE_DEG)
    q = posture.copy()
    out = np.empty((len(wanted), robot.n_joints))
    for row, point in enumerate(wanted):
        for _ in range(LARGEST_ITERATION):
            prediction, jacobian = model.joint_jacobian(Observations(q=q[None]), values)
            across = np.linalg.pinv(jacobian[0, :3])
            miss = point - prediction.position[0]
            drift = (np.eye(len(q)) - across @ jacobian[0, :3]) @ (posture - q)
            if np.linalg.norm(miss) < TOLERANCE_M and np.linalg.norm(drift) < TOLERANCE_RAD:
                break
            q = q + across @ miss + drift
        out[row] = q
    return out
