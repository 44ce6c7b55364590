"""Speed of the gap finder: ``python -m benchmarks.gap``, seconds and memory with full library, all gates and controls.

Targets on a quiet machine: 118 poses in 20 s, 10 000 poses in 20 s and 600 MB, 60 s of a motion at 4600 Hz in 120 s and
2 GB. Memory is the high-water mark of the whole run, some 220 MB of it before the first hunt.
``--quick`` runs the 118 poses only.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads only wait for each other

import resource
import sys
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.arm.robot import Robot
from kilter_core.effects import make_effect
from kilter_core.gap import GapReport, find_gap
from kilter_core.model import RobotModel
from kilter_core.observations import Observations

NOISE_M = 2e-5


def poses(robot: Robot, count: int) -> Observations:
    """Random poses under two loads, a fifth of them three times."""
    rng = np.random.default_rng(0)
    pose = np.concatenate([np.arange(count), np.tile(np.arange(count // 5), 2)])
    low, high = np.clip(robot.limits, -2.9, 2.9).T
    q = rng.uniform(low, high, (count, robot.n_joints))[pose]
    rows = Observations(
        q=q, direction=rng.choice([-1.0, 1.0], (count, robot.n_joints))[pose], pose_id=pose,
        payload_kg=rng.choice([0.0, 5.0], count)[pose], temperature_c=rng.uniform(20, 25, count)[pose],
        t=30.0 * np.arange(len(q)), position=np.zeros((len(q), 3)),
    )  # fmt: skip
    return measured(robot, rows, rng)


def motion(robot: Robot, seconds: float, rate: float) -> Observations:
    """Sines in all joints, with noise that is correlated over 5 ms."""
    rng = np.random.default_rng(1)
    t = np.arange(int(seconds * rate)) / rate
    f, phase = rng.uniform(0.1, 0.6, robot.n_joints), rng.uniform(0, 6.3, robot.n_joints)
    q = 0.7 * np.sin(2 * np.pi * f * t[:, None] + phase) + 0.4 * np.sin(np.pi * f[::-1] * t[:, None])
    qd = np.gradient(q, t, axis=0)
    rows = Observations(
        q=q, qd=qd, direction=np.sign(qd), t=t, payload_kg=np.full(len(t), 5.0), position=np.zeros((len(t), 3))
    )
    return measured(robot, rows, rng, correlation=5e-3 * rate)


def measured(robot: Robot, rows: Observations, rng: np.random.Generator, correlation: float = 0.0) -> Observations:
    """Rows of an arm with two hidden effects."""
    effects = (make_effect("axial_compliance", [1, 2]), make_effect("backlash", [0]))
    model = RobotModel(robot, tuple(e.configure_for_robot(robot, rows) for e in effects))
    values = model.values0()
    values[model.n_geometric :] = [4e-6, 4e-6, 2e-4]
    noise: NDArray[np.float64] = rng.standard_normal((len(rows), 3))
    if correlation > 0.0:
        a = np.exp(-1.0 / correlation)
        from scipy.signal import lfilter

        noise = np.asarray(lfilter([np.sqrt(1 - a**2)], [1.0, -a], noise, axis=0))
    parts = [model.predict(rows.select(slice(k, k + 20_000)), values).position for k in range(0, len(rows), 20_000)]
    return Observations(**{**rows._present(), "position": np.concatenate(parts) + NOISE_M * noise})


def timed(label: str, run: Callable[[], GapReport], limit: float) -> None:
    """Run once and print seconds, the limit, what was named, the longest silence, and the memory high-water mark."""
    began = time.perf_counter()
    report = run()
    took = time.perf_counter() - began
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    names = ", ".join(j.evidence.candidate.label for j in report.effects)
    print(f"{label:34s} {took:7.1f} s (limit {limit:.0f})  {memory:6.0f} MB  {report.verdict}: {names}", flush=True)


def main() -> None:
    """Run all cases, the small one first to compile the kernels."""
    robot = robot_from_document(preset_document("ur10"))
    find_gap(robot, poses(robot, 60))
    timed("118 poses", lambda: find_gap(robot, poses(robot, 118)), 20)
    if "--quick" in sys.argv[1:]:
        return
    timed("118 poses, 30 % held out", lambda: find_gap(robot, poses(robot, 118), validation=0.3), 20)
    timed("10 000 poses", lambda: find_gap(robot, poses(robot, 10_000)), 20)
    timed("60 s of motion at 4600 Hz", lambda: find_gap(robot, motion(robot, 60.0, 4600.0)), 120)


if __name__ == "__main__":
    main()
