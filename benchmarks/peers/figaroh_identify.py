"""FIGAROH 1.0.2 with its structural method on the same arm as URDF; prints one JSON line. Runs in .venv-peers."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.tools.load_robot import load_robot


def urdf(table: np.ndarray, tool_mm: np.ndarray) -> str:
    """The table as URDF: joint i stands at Tz(d of the row before) Rx(alpha) Tx(a) Rz(theta)."""
    links = ["base_link", *(f"link_{k + 1}" for k in range(6)), "tool"]
    parts = [f'<link name="{name}"/>' for name in links]
    before = 0.0
    for k, (alpha, a, theta, d) in enumerate(table):
        c, s = math.cos(alpha), math.sin(alpha)
        ct, st = math.cos(theta), math.sin(theta)
        R = np.array([[ct, -st, 0.0], [c * st, c * ct, -s], [s * st, s * ct, c]])
        rpy = (math.atan2(R[2, 1], R[2, 2]), math.asin(-R[2, 0]), math.atan2(R[1, 0], R[0, 0]))
        parts.append(
            f'<joint name="j{k + 1}" type="revolute"><parent link="{links[k]}"/><child link="{links[k + 1]}"/>'
            f'<origin xyz="{a / 1e3} 0 {before / 1e3}" rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/><axis xyz="0 0 1"/>'
            '<limit lower="-6.3" upper="6.3" effort="100" velocity="3"/></joint>'
        )
        before = d
    x, y, z = tool_mm / 1e3
    parts.append(
        '<joint name="mount" type="fixed"><parent link="link_6"/><child link="tool"/>'
        f'<origin xyz="{x} {y} {z + before / 1e3}" rpy="0 0 0"/></joint>'
    )
    return '<robot name="ur10">' + "".join(parts) + "</robot>"


CONFIG = """
robot: {{name: ur10}}
tasks:
  calibration:
    enabled: true
    type: kinematic_calibration
    kinematics: {{base_frame: universe, tool_frame: tool}}
    parameters: {{calibration_level: full_params, include_non_geometric: false, outlier_threshold: 1.0}}
    measurements:
      markers: [{{name: m1, ref_joint: j6, measurable_dof: [true, true, true, false, false, false]}}]
      poses: {{base_pose: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], tool_pose: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]}}
    data: {{source_file: "{data}", number_of_samples: {count}}}
"""


class Calibration(BaseCalibration):
    """The cost function its documentation recommends, without weights."""

    def cost_function(self, var):
        """Position residuals in metres."""
        predicted = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        return self.PEE_measured - predicted


def main() -> None:
    """Fit the campaign and print seconds, parameters and held-out error."""
    data = np.load(sys.argv[1])
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "arm.urdf").write_text(urdf(data["table"], data["tool"]))
        with (folder / "rows.csv").open("w", newline="") as stream:
            writer = csv.writer(stream)
            writer.writerow(["x1", "y1", "z1", *(f"j{k + 1}" for k in range(6))])
            writer.writerows(np.hstack([data["position"] / 1e3, data["q"]]).tolist())
        (folder / "config.yaml").write_text(CONFIG.format(data=folder / "rows.csv", count=len(data["q"])))
        seconds = float("inf")
        with contextlib.redirect_stdout(io.StringIO()):
            for _ in range(3):  # the shortest counts, as for Kilter; a fresh model each time, for a fit may change it
                robot = load_robot(str(folder / "arm.urdf"), package_dirs=name)
                began = time.perf_counter()
                fit = Calibration(robot, str(folder / "config.yaml"))
                # Base and tool are known here, as for the others; its parser leaves these two to the caller.
                fit.calib_config["known_baseframe"] = fit.calib_config["known_tipframe"] = True
                fit.initialize()
                result = fit.solve(enable_logging=False)
                seconds = min(seconds, time.perf_counter() - began)
            config = {**fit.calib_config, "NbSample": len(data["q_held"])}
            predicted = calc_updated_fkm(fit.model, fit.data, result.x, data["q_held"], config)
    apart = np.linalg.norm(np.reshape(predicted, (3, -1)).T * 1e3 - data["position_held"], axis=1)
    print(json.dumps({"seconds": seconds, "parameters": len(result.x), "held_out_mm": float(apart.mean())}))


main()
