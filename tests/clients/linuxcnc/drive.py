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
    command, stat, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()
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
    seen = [
        {"pose": stat.position[:6], "joints_deg": [stat.joint[k]["output"] for k in range(6)], "told": errors.poll()}
    ]
    for pose in json.loads(POSES.read_text()):
        words = " ".join(f"{axis}{value:.9f}" for axis, value in zip("XYZABC", pose, strict=True))
        command.mdi(f"G21 G90 G1 {words} F6000")
        # What the planner says of itself is no help: it is done before a move begins too, and on a busy machine its answer to a
        # command can be missed. Where the arm is and that it rests decide. The joints never rest quite, as each cycle finds
        # them by iteration anew.
        for _ in range(3000):
            time.sleep(0.02)
            stat.poll()
            there = all(abs(now - wanted) < 1e-6 for now, wanted in zip(stat.position[:6], pose, strict=True))
            if there and all(abs(stat.joint[k]["velocity"]) < 1e-4 for k in range(6)):
                break
        seen.append({"pose": pose, "joints_deg": [stat.joint[k]["output"] for k in range(6)], "told": errors.poll()})
    OUT.write_text(json.dumps(seen))


try:
    main()
except Exception:
    traceback.print_exc()
    sys.exit(1)
