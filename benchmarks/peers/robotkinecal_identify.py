"""robotkinecal 0.1.0 on the same arm as screws; prints one JSON line. Runs in .venv-peers-poe, for it needs numpy 1."""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time

import numpy as np
import roboticstoolbox as rtb
from robotkinecal import SerialRobotKineCal
from spatialmath import SE3


def arm(table: np.ndarray, tool_mm: np.ndarray) -> rtb.PoERobot:
    """The table Rx(alpha) Tx(a) Rz(theta) Tz(d) as joint lines and the tool's pose at zero, in metres."""
    T, joints = SE3(), []
    for alpha, a, theta, d in table:
        T = T * SE3.Rx(alpha) * SE3.Tx(a / 1e3)
        joints.append(rtb.PoERevolute(T.R[:, 2], T.t))
        T = T * SE3.Rz(theta) * SE3.Tz(d / 1e3)
    return rtb.PoERobot(joints, T * SE3.Trans(*tool_mm / 1e3))


data = np.load(sys.argv[1])
rows = [np.asarray(q) for q in data["q"]], [np.asarray(p) for p in data["position"] / 1e3]
seconds = float("inf")
with contextlib.redirect_stdout(io.StringIO()):
    for _ in range(3):  # the shortest counts, as for Kilter; a new one each time, for it changes its arm in place
        fit = SerialRobotKineCal(arm(data["table"], data["tool"]))
        # The toolbox counts base and tool among the links of such a robot, which robotkinecal takes for joints.
        fit.joints, fit.joint_screw_axis, fit.N_JOINTS = (
            fit.joints[1:-1],
            fit.joint_screw_axis[1:-1],
            len(data["table"]),
        )
        began = time.perf_counter()
        fit.set_observations(*rows)
        fit.solve()
        seconds = min(seconds, time.perf_counter() - began)
predicted = np.array([fit.forward_kinematics(fit.N_JOINTS + 1, q).t for q in data["q_held"]]) * 1e3
apart = np.linalg.norm(predicted - data["position_held"], axis=1)
print(json.dumps({"seconds": seconds, "parameters": fit.N_PARAMS, "held_out_mm": float(apart.mean())}))
