"""The arm that the benchmarks of the stream correct, its motion, and the processor time of one correction."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.correct.program import CorrectionProgram, Track
from kilter_core.effects import make_effect
from kilter_core.model import Calibration, RobotModel

ROBOT = "ur10"
POSTURE = np.array([0.3, -1.2, 1.4, -0.5, 0.9, 0.2])


def calibration() -> Calibration:
    """A UR10 with errors in every parameter and all four effects of the thesis."""
    robot = robot_from_document({"convention": "preset", "preset": ROBOT, "name": ROBOT})
    effects = tuple(make_effect(e) for e in ("clearance_tilt", "backlash_load", "backlash", "axial_compliance"))
    model = RobotModel(robot, effects)
    values = model.values0()
    rng = np.random.default_rng(0)
    sizes = {"clearance": math.radians(0.02), "backlash": math.radians(0.03), "compliance": 2e-5}
    for k, name in enumerate(model.names):
        stem = name.partition("_")[0]
        if stem in sizes:
            values[k] = sizes[stem]
        elif stem not in ("base", "tool"):
            values[k] += rng.normal() * (1e-4 if model.parameter(name).unit == "m" else math.radians(0.01))
    return Calibration(model, values)


def path(k: int) -> np.ndarray:
    """Setpoint k of a slow motion of all joints."""
    return (POSTURE + 0.2 * math.sin(k * 0.0005))[None]


def each_us(call: Callable[[], object], repeat: int = 7, number: int = 3000) -> float:
    """Processor time of one call, µs: the best of several runs, as timeit advises."""
    best = math.inf
    for _ in range(repeat):
        begin = time.process_time()  # not what other programs take from the machine meanwhile
        for _ in range(number):
            call()
        best = min(best, time.process_time() - begin)
    return best / number * 1e6


def kernel_times(program: CorrectionProgram) -> None:
    """Print the correction's own time beside Pinocchio's inverse dynamics."""
    track = Track(program, settled=True)
    still, moving = path(0)[0], np.concatenate([path(0)[0], np.full(6, 0.1), np.full(6, 0.1)])
    many = np.vstack([path(k) for k in range(2000)])
    wide = np.hstack([many, np.full((2000, 12), 0.1)])
    steps = np.full(2000, 0.001)
    assert track.step(still, 1, 0.001) == 0  # once, outside the timing: a refusal would be quick
    print(f"single call, static  {each_us(lambda: track.step(still, 1, 0.001)):6.2f} µs")
    single = each_us(lambda: track.step(moving, 3, 0.001))
    print(f"single call, dynamic {single:6.2f} µs")

    def follow(points: np.ndarray, width: int) -> None:
        track.restart(settled=True)
        assert track.follow(points, width, steps)[0] == len(points)

    print(f"batch, static        {each_us(lambda: follow(many, 1), 9, 3) / 2000:6.2f} µs per setpoint")
    print(f"batch, dynamic       {each_us(lambda: follow(wide, 3), 9, 3) / 2000:6.2f} µs per setpoint")
    try:
        import pinocchio as pin
    except ImportError:
        print("pinocchio is not installed: no comparison")
        return
    model = pin.Model()
    joint = 0
    for j in range(6):
        joint = model.addJoint(joint, pin.JointModelRZ(), pin.SE3.Random(), f"j{j}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    data, q, v = model.createData(), path(0)[0].copy(), np.full(6, 0.1)
    rnea = each_us(lambda: pin.rnea(model, data, q, v, v))
    print(f"pinocchio rnea       {rnea:6.2f} µs, single dynamic call / rnea = {single / rnea:.2f}")
