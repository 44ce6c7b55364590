"""Processor time of the compiled kernels through what calls them: ``python -m benchmarks.kernels``, µs as one JSON line.

Only names that outlast a rearrangement of the kernels are used, so that ``tools/bench_beside.sh`` can run this file with
the core of another commit.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np

from benchmarks.stream_arm import POSTURE, calibration
from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import CorrectionOptions, Track, compile_program
from kilter_core.effects import make_effect
from kilter_core.model import RobotModel
from kilter_core.observations import Observations

ROWS, REPEATS = 2000, 15
BENDING = ("clearance_tilt", "link_bending", "base_compliance", "eccentricity")


def microseconds(run: Callable[[], object], count: int) -> float:
    """Processor time of one of ``count`` things that a run does, of the quickest run: what disturbs only adds."""
    run()
    spent = []
    for _ in range(REPEATS):
        begin = time.process_time()
        run()
        spent.append(time.process_time() - begin)
    return 1e6 * min(spent) / count


def arm() -> dict[str, float]:
    """Poses, Jacobians, loads and their slopes of a UR10, for each row."""
    robot = robot_from_document({"convention": "preset", "preset": "ur10", "name": "ur10"})
    rng = np.random.default_rng(0)
    q = rng.uniform(*robot.limits.T, (ROWS, 6))
    rows = Observations(q, qd=0.1 * q, qdd=0.1 * q, payload_kg=np.full(ROWS, 2.0))
    bare = RobotModel(robot)
    loaded = RobotModel(robot, tuple(make_effect(name) for name in BENDING))
    heavy = RobotModel(robot, (make_effect("axial_compliance"), make_effect("load_error")))
    still, batch = Observations(q, payload_kg=np.full(ROWS, 2.0)), loaded.batch(rows)
    values = loaded.values0() + 1e-5
    return {
        "poses": microseconds(lambda: bare.predict(rows, bare.values0()), ROWS),
        "jacobian": microseconds(lambda: bare.jacobian(rows, bare.values0()), ROWS),
        "jacobian with twists": microseconds(lambda: loaded.jacobian(batch, values), ROWS),
        "loads": microseconds(lambda: loaded.batch(rows), ROWS),
        "load errors": microseconds(lambda: heavy.jacobian(heavy.batch(still), heavy.values0() + 1e-5), ROWS),
    }


def stream() -> dict[str, float]:
    """Setpoints of a UR10 with the effects of the thesis: rows apart, a trajectory, and one by one."""
    program = compile_program(calibration(), CorrectionOptions())
    t = np.arange(ROWS) * 0.002
    q = np.ascontiguousarray(POSTURE + 0.3 * np.sin(0.7 * t[:, None] + np.arange(6)))
    dynamic = np.ascontiguousarray(np.hstack([q, 0.1 * q, 0.1 * q]))
    dt = np.full(ROWS, 0.002)
    one, long, moving = (Track(program, settled=True) for _ in range(3))

    def steps() -> None:
        one.restart(settled=True)
        for row in q:
            one.step(row, 1, 0.002)

    return {
        "rows": microseconds(lambda: program.correct_rows(q), ROWS),
        "dynamic rows": microseconds(lambda: program.correct_rows(q, qd=0.1 * q, qdd=0.1 * q), ROWS),
        "trajectory": microseconds(lambda: (long.restart(settled=True), long.follow(q, 1, dt)), ROWS),
        "dynamic trajectory": microseconds(lambda: (moving.restart(settled=True), moving.follow(dynamic, 3, dt)), ROWS),
        "single setpoints": microseconds(steps, ROWS),
    }


def main() -> None:
    """Measure and print."""
    print(json.dumps(arm() | stream()))


if __name__ == "__main__":
    main()
