"""The C corrector on a processor for controllers, a Cortex-M7 in QEMU without an operating system: the same numbers."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kilter_core.correct.program import CorrectionProgram, Track
from tests.core.correct.c_corrector import FOLDER, blob_of
from tests.core.correct.test_c_corrector import HANGING, path_of, program_of

HERE = Path(__file__).parent
COMPILER, MACHINE = shutil.which("arm-none-eabi-gcc"), shutil.which("qemu-system-arm")
pytestmark = pytest.mark.skipif(
    COMPILER is None or MACHINE is None,
    reason="no arm-none-eabi-gcc or qemu-system-arm (Debian: gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm)",
)
CYCLE_S, COUNT = 0.01, 120
MOST_STACK_BYTES = 16 << 10
SAME_RAD = 1e-13  # the sines and cosines of its library differ in the last digit


def answers(program: CorrectionProgram, q: np.ndarray, folder: Path) -> tuple[np.ndarray, np.ndarray, int]:
    """Status and flags (n, 2), joints (n, n joints) and the bytes of stack, as the Cortex-M7 has them."""
    blob = ",".join(map(str, blob_of(program)))
    rows = ",".join("{" + ",".join(float(v).hex() for v in row) + "}" for row in q)
    (folder / "data.h").write_text(
        f"enum {{ JOINTS = {q.shape[1]}, COUNT = {len(q)} }};\n#define CYCLE_S {CYCLE_S}\n"
        f"static const unsigned char program[] = {{{blob}}};\nstatic const double wanted[COUNT][JOINTS] = {{{rows}}};\n"
    )
    processor = ["-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard"]
    built = folder / "arm.elf"
    sources = [str(HERE / "on_arm.c"), str(FOLDER / "kilter_corrector.c")]
    command = [
        str(COMPILER),
        *processor,
        "-std=gnu99",
        "-O2",
        "-Wall",
        "-Wextra",
        "-Werror",
        f"-I{FOLDER}",
        f"-I{folder}",
    ]
    link = ["-nostartfiles", "--specs=nosys.specs", "-T", str(HERE / "on_arm.ld"), "-lm"]
    subprocess.run([*command, "-o", str(built), *sources, *link], check=True)
    machine = [str(MACHINE), "-M", "mps2-an500", "-nographic", "-monitor", "none", "-serial", "none"]
    told = ["-semihosting-config", "enable=on,target=native", "-kernel", str(built)]
    done = subprocess.run([*machine, *told], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-500:]
    lines = (done.stdout or done.stderr).split("\n")  # QEMU's semihosting writes to either
    bits = np.array([[int(word, 16) for word in line.split()] for line in lines[: len(q)]], dtype=np.uint64)
    told_by = np.column_stack([bits[:, 0] >> np.uint64(32), bits[:, 0] & np.uint64(0xFFFFFFFF)]).astype(np.int64)
    return told_by, np.ascontiguousarray(bits[:, 1:]).view(np.float64), int(lines[len(q)], 16)


@pytest.mark.parametrize("case", [pytest.param("geometry", marks=pytest.mark.slow), "hanging", "effects"])
def test_a_cortex_m7_answers_as_the_kernels_do(case: str, tmp_path: Path) -> None:
    program = {
        "geometry": lambda: program_of("ur10"),
        "hanging": lambda: program_of("ur10", *HANGING[0], hanging=True, payload_kg=5.0),
        "effects": lambda: program_of("ur10", "clearance_tilt", "backlash_load"),
    }[case]()
    q = path_of(program, COUNT, 3)
    told_by, joints, stack = answers(program, q, tmp_path)
    track = Track(program)
    worst = 0.0
    for k, row in enumerate(q):
        assert (track.step(row, 1, CYCLE_S), int(track.info[0])) == tuple(told_by[k])
        worst = max(worst, float(np.abs(joints[k] - track.out).max()))
    assert worst < SAME_RAD
    assert 1000 < stack < MOST_STACK_BYTES
