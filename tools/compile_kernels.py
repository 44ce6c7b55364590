"""Compile every kernel into numba's cache, so that the first server, test or demo does not wait for it."""

from __future__ import annotations

import time

from kilter_core.correct.program import warm_up
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.plan.iso9283_poses import iso_poses
from kilter_core.twin import thesis_katana
from kilter_service.corrector import short_way

POSES = 30


def main() -> None:
    """Use each kernel once: the calls decide the types it is compiled for."""
    start = time.monotonic()
    print("Compiling the kernels: a minute or two, once after each change of them.", flush=True)
    warm_up()
    short_way.warm_up()
    twin = thesis_katana()
    seen = twin.observe(iso_poses(twin.robot, POSES), noise_m=1e-5)
    identify(twin.robot, seen, None, IdentifyOptions(level=3, base="fixed", tool="fixed"))
    print(f"Kernels are compiled ({time.monotonic() - start:.0f} s).", flush=True)


if __name__ == "__main__":
    main()
