"""FIGAROH 1.0.2 on a log of joint torques: base parameters, friction, rotors and offsets by least squares; one JSON line.

Runs in .venv-peers. The steps are those of its own identification examples: filter, differentiate, regressor, elimination of
columns, QR; the log is thinned as there.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from figaroh.tools.load_robot import load_robot
from figaroh.tools.qrdecomposition import build_baseRegressor, get_baseIndex
from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced, get_index_eliminate
from scipy.signal import butter, filtfilt

CUT_OFF_HZ = 5.0
THIN = 5
CONFIG = {
    "has_friction": True,
    "has_actuator_inertia": True,
    "has_joint_offset": True,
    "is_joint_torques": True,
    "is_external_wrench": False,
    "force_torque": None,
    "act_idxv": list(range(6)),
}


def prepared(t: np.ndarray, q: np.ndarray, tau: np.ndarray) -> tuple[np.ndarray, ...]:
    """Joints, speeds, accelerations and torques (N, n) of a motion, filtered and thinned."""
    step = float(np.median(np.diff(t)))
    low = butter(4, CUT_OFF_HZ * 2.0 * step)
    q, tau = (filtfilt(*low, one, axis=0) for one in (q, tau))
    v = np.gradient(q, step, axis=0)
    a = np.gradient(v, step, axis=0)
    inside = slice(50, -50, THIN)
    return q[inside], v[inside], a[inside], tau[inside]


def stacked(robot: object, parts: list[tuple[np.ndarray, ...]]) -> tuple[np.ndarray, np.ndarray]:
    """Regressor and torques of motions, joint after joint."""
    q, v, a, tau = (np.concatenate([part[k] for part in parts]) for k in range(4))
    return np.asarray(build_regressor_basic(robot, q, v, a, CONFIG)), tau.T.ravel()


def main() -> None:
    """Fit all motions but the last third, and print what is left of the torques of those."""
    data = np.load(sys.argv[1], allow_pickle=False)
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        path = Path(folder) / "arm.urdf"
        path.write_text(str(data["urdf"]), encoding="utf-8")
        robot = load_robot(str(path))
        motions = np.unique(data["motion"])
        cut = [[prepared(*(data[k][data["motion"] == m] for k in ("t", "q", "tau"))) for m in some] for some in
               (motions[: -len(motions) // 3], motions[-(len(motions) // 3) :])]  # fmt: skip
        began = time.perf_counter()
        W, tau = stacked(robot, cut[0])
        names = {str(k): 1.0 for k in range(W.shape[1])}
        gone, kept = get_index_eliminate(W, names)
        reduced = build_regressor_reduced(W, gone)
        base = get_baseIndex(reduced, kept)
        phi = np.linalg.lstsq(build_baseRegressor(reduced, base), tau, rcond=None)[0]
        seconds = time.perf_counter() - began
        W, tau = stacked(robot, cut[1])
        left = (tau - build_baseRegressor(build_regressor_reduced(W, gone), base) @ phi).reshape(data["q"].shape[1], -1)
    print(
        json.dumps(
            {"seconds": seconds, "held_out_nm": np.sqrt(np.mean(left**2, axis=1)).tolist(), "parameters": len(phi)}
        )
    )


if __name__ == "__main__":
    main()
