"""Search a log of joint torques: Kilter beside FIGAROH on a twin of a UR10, friction that grows with load hidden.

``python -m benchmarks.motion``. FIGAROH runs in the environment that ``python -m tools.lab peers`` makes; without it Kilter is
alone. What is left of torques is that of the last third of the motions, which neither has seen.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from kilter_core.arm.documents import robot_from_document
from kilter_core.motion import MotionOptions, find_missing_torque
from kilter_core.observations import Observations
from tests.core.motion.moving_arm import Logger, reversed_softly, ur_like
from tests.core.truth import UR10_ROWS

HERE = Path(__file__).resolve().parent
SHARE = 0.06  # of the load


def urdf() -> str:
    """The arm as URDF, a link of one kilogram behind each joint."""
    links = ["base", *(f"l{k}" for k in range(1, 7))]
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    body = f'<inertial><mass value="1"/><origin xyz="0 0 0"/>{inertia}</inertial>'
    parts = [f'<link name="{name}">{body}</link>' for name in links]
    a, alpha = 0.0, 0.0
    for k, (d, next_a, next_alpha) in enumerate(UR10_ROWS):
        place = f"{a} {-np.sin(alpha) * d} {np.cos(alpha) * d}"
        parts.append(
            f'<joint name="j{k + 1}" type="revolute"><parent link="{links[k]}"/><child link="{links[k + 1]}"/>'
            f'<origin xyz="{place}" rpy="{alpha} 0 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-6.3" upper="6.3" effort="500" velocity="5"/></joint>'
        )
        a, alpha = next_a, next_alpha
    return f'<robot name="arm">{"".join(parts)}</robot>'


def main() -> None:
    """Print seconds, and what is left of the torques of unseen motions, of both."""
    logger = Logger(ur_like(np.random.default_rng(3)), seed=3)
    logger.extra = [lambda s: SHARE * reversed_softly(s.qd, 0.004) * np.abs(s.rigid)]
    log = logger.log()
    motions = np.unique(log["motion"])
    held = np.isin(log["motion"], motions[-(len(motions) // 3) :])
    session = held.astype(np.int64)
    rows = Observations(q=log["q"], t=log["t"], tau=log["tau"], session=session)
    robot = robot_from_document(logger.arm.document())
    find_missing_torque(robot, rows, MotionOptions(), None, [1])
    began = time.perf_counter()
    report = find_missing_torque(robot, rows, MotionOptions(), None, [1])
    print(
        f"kilter   {time.perf_counter() - began:6.2f} s  left of torques, N m: {np.round(report.held.found, 3).tolist()}"
    )
    print(f"         bodies and friction alone: {np.round(report.held.common, 3).tolist()}")
    python = HERE.parent / ".venv-peers" / "bin" / "python"
    if not python.exists():
        print("figaroh  no environment: python -m tools.lab peers makes it")
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.npz"
        np.savez(path, urdf=urdf(), **log)
        run = subprocess.run(
            [python, "-W", "ignore", HERE / "peers" / "figaroh_torques.py", path],
            capture_output=True,
            text=True,
            check=True,
        )
    peer = json.loads(run.stdout.splitlines()[-1])
    print(f"figaroh  {peer['seconds']:6.2f} s  left of torques, N m: {np.round(peer['held_out_nm'], 3).tolist()}")


if __name__ == "__main__":
    main()
