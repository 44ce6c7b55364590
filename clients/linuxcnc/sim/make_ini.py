"""Writes arm.ini: the simulation of a six-joint arm that is corrected by a version.

    python3 make_ini.py arm.klt 10,-80,75,20,40,30 > arm.ini

The first argument is what `kilter version export VERSION --format corrector` writes, the second where the joints begin, deg.
"""

from __future__ import annotations

import sys
from pathlib import Path

HEAD = """[EMC]
VERSION = 1.1
MACHINE = calibrated arm
DEBUG = 0
[DISPLAY]
DISPLAY = {display}
CYCLE_TIME = 0.1
[KINS]
JOINTS = 6
KINEMATICS = kilter_kins
PROGRAM = {program}
[HAL]
HALFILE = {hal}
[RS274NGC]
PARAMETER_FILE = arm.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.01
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = arm.tbl
[TRAJ]
COORDINATES = X Y Z A B C
LINEAR_UNITS = mm
ANGULAR_UNITS = deg
DEFAULT_LINEAR_VELOCITY = 50
MAX_LINEAR_VELOCITY = 200
DEFAULT_LINEAR_ACCELERATION = 500
MAX_LINEAR_ACCELERATION = 1000
MAX_ANGULAR_VELOCITY = 90
"""
AXIS = "[AXIS_{name}]\nMAX_VELOCITY = {speed}\nMAX_ACCELERATION = 1000\nMIN_LIMIT = -3000\nMAX_LIMIT = 3000\n"
JOINT = """[JOINT_{number}]
TYPE = ANGULAR
MAX_VELOCITY = 200
MAX_ACCELERATION = 4000
MIN_LIMIT = -360
MAX_LIMIT = 360
FERROR = 1
MIN_FERROR = 1
HOME = {home}
HOME_OFFSET = {home}
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
"""


def ini(program: Path, home_deg: list[float], display: str = "axis") -> str:
    """Return the text of the file."""
    hal = Path(__file__).with_name("arm.hal").resolve()
    parts = [HEAD.format(display=display, program=program.resolve(), hal=hal)]
    parts += [AXIS.format(name=name, speed=200 if name in "XYZ" else 90) for name in "XYZABC"]
    parts += [JOINT.format(number=k, home=value) for k, value in enumerate(home_deg)]
    return "".join(parts)


if __name__ == "__main__":
    print(ini(Path(sys.argv[1]), [float(part) for part in sys.argv[2].split(",")]))
