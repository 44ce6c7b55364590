"""The simulator of a Franka robot, its judges on, with a witness of its joints; run by the environment of the simulator.

``python franka_server.py FOLDER``: the model is made of the URDF that the package brings. At SIGTERM, ``FOLDER/joints.npy``
has time, joints of the physics and joints wanted (N, 15); the log has what the judges said.
``FOLDER/ready`` says that it listens. With ``LATE=drop`` it drops a command whose cycle is over, as the robot does; by itself
it goes back for it, which it calls the one place where it has to differ from the robot (its ``rewind_extrapolation``).
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np


def model_in(folder: Path, package: Path) -> Path:
    """Make a MuJoCo model of the package's own URDF, without its shapes; rotors have inertia, which a URDF does not say."""
    root = ET.parse(package / "models" / "fr3.urdf").getroot()
    for link in root.iter("link"):
        for name in ("visual", "collision"):
            for shape in link.findall(name):
                link.remove(shape)
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", {"fusestatic": "false"})
    path = folder / "fr3.xml"
    mujoco.mj_saveLastXML(str(path), mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode")))
    made = ET.parse(path)
    for joint in made.iter("joint"):
        joint.set("armature", "0.195" if int(joint.attrib["name"][-1]) < 5 else "0.074")
    made.write(path)
    return path


def main() -> None:
    """Serve until SIGTERM."""
    import franka_sim

    folder = Path(sys.argv[1])
    os.environ["FR3_MJCF"] = str(model_in(folder, Path(franka_sim.__file__).parent))
    server = franka_sim.FrankaSimServer(
        host="127.0.0.1", enable_gripper=False, enforce_comm_constraints=True, enforce_motion_limits=True
    )
    if os.environ.get("LATE") == "drop":
        absorb = franka_sim.FrankaSimServer._absorb_within_motion_limits
        franka_sim.FrankaSimServer._absorb_within_motion_limits = lambda self, command, *, fresh: (
            fresh and absorb(self, command, fresh=True)
        )
    rows: list[list[float]] = []
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(0.005):
            data = getattr(server.physics_sim, "data", None)
            if data is not None:
                rows.append([data.time, *data.qpos[:7].tolist(), *map(float, server.robot_state.state["q_d"])])
                (folder / "ready").touch()

    def end(*_: object) -> None:
        ended.set()
        np.save(folder / "joints.npy", np.array(rows))
        os._exit(0)

    signal.signal(signal.SIGTERM, end)
    threading.Thread(target=watch, daemon=True).start()
    threading.Thread(target=server.start, daemon=True).start()
    while True:
        time.sleep(1.0)


if __name__ == "__main__":
    main()
