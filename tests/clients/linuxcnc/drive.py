"""Drives LinuxCNC as its display does: moves to the poses that stand in poses.json, and notes what it commands there."""

import json
import sys
import time
import traceback
from pathlib import Path

import linuxcnc

POSES, OUT = Path("poses.json"), Path("seen.json")


def main() -> None:
    """Home, and move along a line to each pose."""
    command, stat = linuxcnc.command(), linuxcnc.stat()
    for state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON):
        command.state(state)
        command.wait_complete(20)
    command.home(-1)
    while not all(stat.homed[:6]):
        time.sleep(0.02)
        stat.poll()
    command.teleop_enable(1)
    command.wait_complete(20)
    command.mode(linuxcnc.MODE_MDI)
    command.wait_complete(20)
    stat.poll()
    seen = [{"pose": stat.position[:6], "joints_deg": [stat.joint[k]["output"] for k in range(6)], "done": 1}]
    for pose in json.loads(POSES.read_text()):
        words = " ".join(f"{axis}{value:.9f}" for axis, value in zip("XYZABC", pose, strict=True))
        command.mdi(f"G21 G90 G1 {words} F6000")
        done = command.wait_complete(60)
        for _ in range(200):
            time.sleep(0.02)
            stat.poll()
            if stat.inpos and not any(stat.joint[k]["velocity"] for k in range(6)):
                break
        seen.append({"pose": pose, "joints_deg": [stat.joint[k]["output"] for k in range(6)], "done": done})
    OUT.write_text(json.dumps(seen))


try:
    main()
except Exception:
    traceback.print_exc()
    sys.exit(1)
