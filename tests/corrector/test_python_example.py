"""The reference controller against the real processes, and what it does when the corrector is away."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest

from kilter_client.stream import CorrectedStream, Setpoint
from kilter_service.stream.corrector.process import Corrector

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "python" / "controller.py"
ROBOT = "katana450-chapter4"
START, END = (5.0, 30.0, 20.0, 10.0, 10.0), (15.0, 40.0, 25.0, 20.0, 10.0)


@pytest.fixture(scope="module")
def controller() -> ModuleType:
    spec = importlib.util.spec_from_file_location("controller", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_motion_at_1_khz_is_corrected(corrector: Corrector) -> None:
    data = corrector.file.parent
    postures = [*("--from", *map(str, START)), *("--to", *map(str, END))]
    done = subprocess.run(
        [sys.executable, str(EXAMPLE), ROBOT, *postures, "--seconds", "1"],
        env={**os.environ, "KILTER_DATA": str(data)}, capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    said = json.loads(done.stdout)
    assert said["commands"] == said["sent"] >= 1000
    assert said["commands"] == said["corrected"] + said["slowed"] + said["held"] + said["bypassed"]
    # A loaded machine misses deadlines; the arm must not notice. 10 degrees in a second peak at 0.019 degrees a cycle,
    # the correction adds what ramps and fades may.
    assert said["corrected"] > 0
    assert said["largest_step_deg"] < 0.1


def test_the_motion_slows_down_to_a_stop_in_bypass_and_goes_on(controller: ModuleType) -> None:
    motion = controller.Motion([0.0], [1.0], 1.0)
    path, steps = iter(motion), []
    last = 0.0
    for k in range(2500):
        source = "bypass" if 300 <= k < 1000 else "corrected"
        try:
            (q,) = next(path)
        except StopIteration:
            break
        motion.heed(Setpoint((q,), source=source, wanted=(q,)))  # type: ignore[arg-type]
        steps.append(q - last)
        last = q
    assert math.isclose(last, 1.0)
    assert steps[999] == 0.0
    assert max(abs(b - a) for a, b in pairwise(steps)) < 1e-4
    assert len(steps) == pytest.approx(1700, abs=2)  # 1 s of motion and 0.7 s of waiting


def test_without_a_corrector_a_cycle_does_not_wait(corrector: Corrector) -> None:
    with CorrectedStream(ROBOT, data=corrector.file.parent, stream="alone", deadline_s=3600.0, settled=True) as stream:
        q = [math.radians(x) for x in START]
        assert stream.correct(q).source == "corrected"
        stream._alive.clear()  # as when its token is gone
        assert [stream.correct(q).source for _ in range(6)] == ["held"] * 5 + ["bypass"]
        assert stream.statistics.missed == 6
