"""Compiles every kernel and keeps it, so that the first server, test, job or demo does not wait for it."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from kilter_core import gap as core_gap
from kilter_core.correct import warm_up
from kilter_core.identify import IdentifyOptions, identify
from kilter_core.observations import numbered_poses
from kilter_core.plan import iso_poses
from kilter_core.twin import thesis_katana
from kilter_service.stream.corrector import fast_path

POSES = 30
# Between them they read the loads of joints, links and base, and follow errors of the masses.
EFFECTS = (
    "clearance_tilt",
    "backlash_load",
    "eccentricity",
    "axial_compliance",
    "link_bending",
    "base_compliance",
    "load_error",
)


def compile_kernels() -> None:
    """Use each kernel once: the calls decide the types it is compiled for."""
    start = time.monotonic()
    print("Compiling the kernels: a minute or two, once after each change of them.", flush=True)
    warm_up()
    fast_path.warm_up()
    core_gap.warm_up()
    twin = thesis_katana()
    seen = twin.observe(iso_poses(twin.robot, POSES), noise_m=1e-5)
    identify(twin.robot, seen, None, IdentifyOptions(level=3, base="fixed", tool="fixed"))
    numbered_poses(seen.q)
    loaded = replace(seen, payload_kg=np.linspace(0.0, 0.5, len(seen)))
    identify(twin.robot, loaded, None, IdentifyOptions(level=3, base="fixed", tool="fixed", effects=EFFECTS))
    print(f"Kernels are compiled ({time.monotonic() - start:.0f} s).", flush=True)
