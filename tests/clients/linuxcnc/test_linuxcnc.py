"""A calibrated arm under LinuxCNC: its planner moves along lines, and its joints are those that Python corrects."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kilter_core.correct.kernels import layout
from tests.clients.six_joint_arms import Arm, Floats, about, shift
from tests.core.correct.c_corrector import blob_of
from tests.core.correct.test_c_corrector import program_of

REPOSITORY = Path(__file__).parents[3]
MODULES = Path("/usr/lib/linuxcnc/modules")
PRESET, HOME = "kr6-r900", np.array([10.0, -80, 75, 20, 40, 30])
NOBODY = 65534
LOCK = Path("/tmp/linuxcnc.lock")  # noqa: S108 - where LinuxCNC itself has it
ENDS_S = 10.0
PYTHON = Path("/usr/bin/python3")  # that of the distribution has LinuxCNC's module

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not (shutil.which("linuxcnc") and shutil.which("halcompile")) or not os.access(MODULES, os.W_OK),
        reason="LinuxCNC is not installed, or its modules cannot be added to (Debian: linuxcnc-uspace-dev)",
    ),
]


@pytest.fixture(scope="module")
def module() -> Path:
    """The kinematics, compiled and put where LinuxCNC looks for them."""
    command = ["halcompile", "--install", "../linuxcnc/kilter_kins.c"]
    built = subprocess.run(command, cwd=REPOSITORY / "clients" / "c", capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    assert "warning" not in built.stdout + built.stderr
    return MODULES / "kilter_kins.so"


def as_user(command: list[str]) -> list[str]:
    """LinuxCNC refuses to run as root."""
    drop = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    return [*drop, *command] if os.geteuid() == 0 else command


def machine(folder: Path, blob: bytes) -> Path:
    """The simulation of clients/linuxcnc/sim in a folder that anybody may read."""
    sim = REPOSITORY / "clients" / "linuxcnc" / "sim"
    for source in (sim / "arm.hal", sim / "make_ini.py", Path(__file__).with_name("drive.py")):
        shutil.copy(source, folder)
    (folder / "arm.klt").write_bytes(blob)
    (folder / "arm.tbl").touch()
    home = ",".join(map(str, HOME))
    text = subprocess.run(
        [sys.executable, "make_ini.py", "arm.klt", home], cwd=folder, check=True, capture_output=True, text=True
    ).stdout
    drive = folder / "drive.sh"
    drive.write_text(f"#!/bin/sh\nexec {PYTHON} drive.py\n")
    drive.chmod(0o755)
    (folder / "arm.ini").write_text(text.replace("DISPLAY = axis", f"DISPLAY = {drive}"))
    if os.geteuid() == 0:
        for path in (folder, *folder.iterdir()):
            os.chown(path, NOBODY, NOBODY)
    return folder / "arm.ini"


def belonging(folder: Path) -> list[int]:
    """Processes that were started for a run in this folder, whoever is their parent now: their environment names it."""
    found, mark = [], f"HOME={folder}".encode()
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if mark in environment.read_bytes().split(b"\0"):
                found.append(int(environment.parent.name))
    return found


def until_gone(folder: Path, seconds: float) -> bool:
    """Whether all of them have ended within this time."""
    end = time.monotonic() + seconds
    while belonging(folder) and time.monotonic() < end:
        time.sleep(0.1)
    return not belonging(folder)


def signalled(folder: Path, number: int) -> None:
    for one in belonging(folder):
        with suppress(OSError):  # it has ended, or belongs to root and is ended by the script
            os.kill(one, number)


def driven(ini: Path, seconds: float) -> str:
    """Run LinuxCNC in a folder; what it printed. Whatever comes of it, nothing that it started stays.

    What plays its real-time kernel (``rtapi_app``) leaves its session and its parent, so that ending these is not enough.
    """
    folder, before = ini.parent, LOCK.exists()
    process = subprocess.Popen(
        as_user(["linuxcnc", "-r", str(ini)]), cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env=os.environ | {"HOME": str(folder)},
    )  # fmt: skip
    try:
        return process.communicate(timeout=seconds)[0]
    finally:
        if not until_gone(folder, ENDS_S):
            signalled(folder, signal.SIGTERM)  # the script then unloads what it loaded
            if not until_gone(folder, ENDS_S):
                signalled(folder, signal.SIGKILL)
                until_gone(folder, ENDS_S)
        process.kill()
        process.communicate()
        if not before:
            LOCK.unlink(missing_ok=True)


def pose_of(T: Floats) -> list[float]:
    z, y, x = Rotation.from_matrix(T[:3, :3]).as_euler("ZYX", degrees=True)
    return [*T[:3, 3].tolist(), float(x), float(y), float(z)]


def test_the_planner_moves_a_calibrated_arm(module: Path) -> None:
    assert module.exists()
    program, arm = program_of(PRESET, "gear_error", "link_bending"), Arm(PRESET)
    folder = Path(subprocess.run(["mktemp", "-d"], check=True, capture_output=True, text=True).stdout.strip())
    try:
        ini = machine(folder, blob_of(program))
        start = arm.flange(HOME)
        steps = [(40, 0, 0), (40, -30, 20), (0, 25, -40), (-30, 10, 15), (0, 0, 0)]
        poses = [pose_of(shift(*step) @ start @ about("y", 0.02 * k)) for k, step in enumerate(steps)]
        (folder / "poses.json").write_text(json.dumps(poses))
        told = driven(ini, 240)
        assert (folder / "seen.json").exists(), told
        seen = json.loads((folder / "seen.json").read_text())
    finally:
        shutil.rmtree(folder)
    assert len(seen) == len(poses) + 1
    assert [one["told"] for one in seen] == [None] * len(seen)
    commanded = np.array([one["joints_deg"] for one in seen])
    assert np.abs(commanded[0] - HOME).max() < 1e-5  # it begins where the arm is, not where the nominal arm would be
    wanted, q = [], HOME
    for pose in poses:
        T = shift(*pose[:3]) @ about("ZYX", np.radians(pose[:2:-1]))
        q = arm.joints(T, q)
        wanted.append(q)
    done = program.correct_rows(np.radians(wanted))
    assert (done.status == layout.OK).all()
    assert np.abs(commanded[1:] - np.degrees(done.q)).max() < 1e-6
    assert np.abs(commanded[1:] - wanted).max() > 1e-3


def test_a_run_that_takes_too_long_leaves_no_process(module: Path) -> None:
    assert module.exists()
    folder = Path(subprocess.run(["mktemp", "-d"], check=True, capture_output=True, text=True).stdout.strip())
    try:
        ini = machine(folder, blob_of(program_of(PRESET, "gear_error")))
        (folder / "drive.sh").write_text(f"#!/bin/sh\ntouch {folder}/begun\nexec sleep 600\n")
        with pytest.raises(subprocess.TimeoutExpired):
            driven(ini, 20)
        assert (folder / "begun").exists()
        assert belonging(folder) == []
        assert not LOCK.exists()
    finally:
        shutil.rmtree(folder)


def altered(content: bytes) -> bytes:
    return content[:400] + bytes([content[400] ^ 1]) + content[401:]


@pytest.mark.parametrize(
    ("of", "said"),
    [
        (altered, "its checksum is wrong: export it again"),
        (lambda content: content[:-8], "The program is cut off: export it again"),
        (lambda content: b"", "The program is cut off: export it again"),
        (lambda content: b"theta,d,a,alpha\n" * 50, "This is not a program"),
        (lambda content: content[:4] + b"\x09\0\0\0" + content[8:], "is newer than this code"),
        (lambda content: blob_of(program_of("katana450-chapter5")), "six joints"),
    ],
    ids=["altered", "cut", "empty", "foreign", "newer", "of five joints"],
)
def test_a_program_that_cannot_be_used_stops_the_start_and_says_why(
    module: Path, of: Callable[[bytes], bytes], said: str
) -> None:
    assert module.exists()
    folder = Path(subprocess.run(["mktemp", "-d"], check=True, capture_output=True, text=True).stdout.strip())
    try:
        ini = machine(folder, of(blob_of(program_of(PRESET, "gear_error"))))
        (folder / "poses.json").write_text("[]")
        told = driven(ini, 120) + "".join(path.read_text() for path in folder.glob("linuxcnc_*.txt"))
        assert not (folder / "seen.json").exists()
        assert said in told
    finally:
        shutil.rmtree(folder)
