"""How long the corrector in C takes for a setpoint in process, memory locked, up to the slowest: `tools.lab bench-c`."""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from kilter_core.correct.program import CorrectionProgram
from tests.core.correct.c_corrector import COMPILER, FOLDER, blob_of
from tests.core.correct.test_c_corrector import HANGING, program_of

CASES: dict[str, Callable[[], CorrectionProgram]] = {
    "geometry alone": lambda: program_of("ur10"),
    "one effect that bends the arm": lambda: program_of("ur10", "axial_compliance", hanging=True),
    "three, one of them with sides": lambda: program_of("ur10", *HANGING[0], hanging=True, payload_kg=5.0),
}


def main() -> None:
    """Compile, run each program and print microseconds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=3_000_000)
    parser.add_argument("--priority", type=int, help="real-time priority (SCHED_FIFO), where that is allowed")
    options = parser.parse_args()
    priority = [] if options.priority is None else [str(options.priority)]
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "c_corrector"
        sources = [str(Path(__file__).with_suffix(".c")), str(FOLDER / "kilter_corrector.c")]
        command = [str(COMPILER), "-std=gnu99", "-O2", f"-I{FOLDER}", "-o", str(made), *sources, "-lm"]
        subprocess.run(command, check=True)
        print(f"{options.count} setpoints of a UR10 each, us: median, p99, p99.9, p99.99, p99.999, slowest")
        for name, program in CASES.items():
            blob = Path(folder) / "arm.klt"
            blob.write_bytes(blob_of(program()))
            done = subprocess.run(
                [made, blob, str(options.count), *priority], capture_output=True, text=True, check=True
            )
            locked, real_time, refused, *took = done.stdout.split()
            how = f"memory {'' if locked == '1' else 'not '}locked{', real time' if real_time == '1' else ''}"
            us = [f"{float(ns) / 1e3:7.2f}" for ns in took]
            print(f"{name:30} {'  '.join(us[:6])}   {how}, {refused} refused")
            print(f"{'  an empty loop beside it':30} {'  '.join(us[6:])}")


if __name__ == "__main__":
    main()
