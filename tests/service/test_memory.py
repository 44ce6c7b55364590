"""What a job used is given back when it is over."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRATCH = """
import numpy as np
from kilter_service.ground.memory import return_freed_memory

def resident():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmRSS"))

before = resident()
pieces = [np.ones(2000) for _ in range(20_000)]
last = np.ones(2000)
used = resident() - before
del pieces
kept = resident() - before
return_freed_memory()
print(used, kept, resident() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_of_a_job_goes_back_to_the_system() -> None:
    out = subprocess.run([sys.executable, "-c", SCRATCH], check=True, capture_output=True, text=True, timeout=120)
    used, kept, left = map(float, out.stdout.split())
    assert used > 250
    assert kept > 250  # the C library keeps freed pieces: without this the test would show nothing
    assert left < 30


def test_the_api_process_shares_the_memory_of_its_threads() -> None:
    program = (
        "from kilter_service.ground.memory import keep_small; keep_small(); import pyarrow as pa; "
        "print(pa.default_memory_pool().backend_name)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "system"


def test_the_api_starts_without_scipy() -> None:
    program = "import sys, kilter_service.run.app; print([name for name in sys.modules if name.startswith('scipy.')])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


LIGHT = """
import sys
import numpy as np
import kilter_core.evaluate.prediction, kilter_core.identify.comparison, kilter_core.measurement
import kilter_core.motion.model
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.observations.repeats import numbered_poses
from kilter_core.twin import Twin
from kilter_service.ground.core import core_observations
from kilter_service.ground.correction_outcome import about
from kilter_service.versions.predictions.differences import chance
print(round(float(about(np.array([0.0]), np.array([2.0]))[0]), 9), round(chance(2, 6), 9))
rows = Twin(robot_from_document(preset_document("ur10")), {}, ()).observe(np.zeros((2, 6)))
print(rows.position.shape, numbered_poses(rows.q), core_observations.is_log(rows))
heavy = ("scipy.stats", "scipy.signal", "scipy.optimize", "scipy.interpolate", "numba.np.linalg")
print([name for name in heavy if name in sys.modules])
"""


def test_what_the_api_computes_needs_neither_statistics_nor_optimisers() -> None:
    done = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["2.0 0.2890625", "(2, 3) [0 0] False", "[]"]


LIBRARIES = """
import llvmlite.binding as llvm
import numba
import pyarrow
from kilter_service.ground.memory import return_pages_of_libraries

def resident():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmRSS"))

loaded = resident()
return_pages_of_libraries()
print(loaded - resident())
return_pages_of_libraries()
print(numba.njit(lambda x: 2.0 * x)(21.0), pyarrow.array([40, 2]).sum().as_py())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_libraries_work_after_the_pages_that_only_loading_read_are_given_back() -> None:
    done = subprocess.run([sys.executable, "-c", LIBRARIES], capture_output=True, text=True, check=True)
    given_back, answers = done.stdout.splitlines()
    assert float(given_back) > 20
    assert answers == "42.0 42"


EXPORT = """
import sys
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document
from kilter_core.twin import Twin
from kilter_service.robots.exporters.registry import export
from tests.service.exporters.test_exporters import exportable
document = preset_document("ur10")
made = export("usd", exportable(document, Twin(robot_from_document(document), {}, ()).truth))
print(made.text.startswith("#usda"), any(name.partition(".")[0] == "pxr" for name in sys.modules))
"""


def test_a_process_that_exports_usd_does_not_load_its_package() -> None:
    done = subprocess.run([sys.executable, "-c", EXPORT], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"]
