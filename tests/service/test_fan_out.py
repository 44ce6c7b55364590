"""Parts of a job in several processes: the same numbers whatever ends, cancelled at once, and no process left."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kilter_core.errors import CancelledError, CoreError, OptionError
from kilter_core.identify import Folds, IdentifyOptions, identify
from kilter_core.twin import thesis_katana
from kilter_service.jobs.fan_out import FanOut, fan_out, spread
from kilter_service.jobs.fan_out.spread import LocalProcesses
from tests.service.parts import doubled, killing, where


def alive(pid: int) -> bool:
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and " Z " not in stat.read_text(encoding="ascii")


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spread, "START_S", -1e9)


def test_folds_in_processes_give_the_same_numbers(at_once: None) -> None:
    twin = thesis_katana()
    limits = twin.robot.limits
    q = np.random.default_rng(3).uniform(limits[:, 0], limits[:, 1], (60, twin.robot.n_joints))
    rows, options = twin.observe(q, noise_m=1e-5, seed=3), IdentifyOptions(level=2)
    heard: list[tuple[float, str]] = []
    alone = identify(twin.robot, rows, Folds(4), options)
    found = identify(twin.robot, rows, Folds(4), options, progress=lambda *told: heard.append(told), each=fan_out(2))
    assert found.metrics == alone.metrics
    assert alone.held_rows is not None
    assert found.held_rows is not None
    for name, left in alone.held_rows.left.items():
        np.testing.assert_array_equal(found.held_rows.left[name], left)
    folds = [stage for _, stage in heard if stage.startswith("fold ")]
    assert {stage.partition(",")[0] for stage in folds} >= {"fold 1 of 4", "fold 2 of 4"}
    begun = [fraction for fraction, stage in heard if stage.startswith("fold ") and "," not in stage]
    assert begun == sorted(begun)


def test_profiles_in_processes_give_the_same_numbers(at_once: None) -> None:
    twin = thesis_katana()
    limits = twin.robot.limits
    q = np.random.default_rng(5).uniform(limits[:, 0], limits[:, 1], (40, twin.robot.n_joints))
    rows, options = twin.observe(q, noise_m=1e-5, seed=5), IdentifyOptions(level=1, intervals="profile")
    heard: list[str] = []
    alone = identify(twin.robot, rows, None, options, progress=lambda _, stage: heard.append(stage)).intervals
    watched = Watched(LocalProcesses(2))
    found = identify(twin.robot, rows, None, options, each=watched).intervals
    assert alone is not None
    assert found is not None
    for name in ("lower", "upper", "stands_in"):
        np.testing.assert_array_equal(getattr(found, name), getattr(alone, name))
    assert watched.parts == len(alone.lower)
    assert any(stage.startswith(f"profile 1 of {watched.parts}, ") for stage in heard)


class Watched(FanOut):
    """Counts the parts."""

    parts = 0

    def __call__(self, work: Any, tasks: Any, progress: Any) -> Any:
        self.parts += len(tasks)
        return super().__call__(work, tasks, progress)


def test_parts_run_beside_each_other_and_their_processes_end(at_once: None) -> None:
    found = fan_out(2)(where, [(0.0, "")] + [(0.5, "")] * 4, lambda *_: None)
    assert found[0] == os.getpid()
    assert len(set(found[1:])) == 2
    assert os.getpid() not in found[1:]
    assert not any(alive(pid) for pid in set(found[1:]))


def test_short_parts_stay_in_the_worker() -> None:
    assert set(fan_out(2)(where, [(0.0, "")] * 5, lambda *_: None)) == {os.getpid()}
    assert fan_out(2)(where, [], lambda *_: None) == []


def test_a_cancel_does_not_wait_for_a_part(at_once: None) -> None:
    begun = time.monotonic()

    def told(fraction: float, stage: str) -> None:
        if fraction > 0 and time.monotonic() - begun > 1.0:
            raise CancelledError("enough")

    with pytest.raises(CancelledError):
        fan_out(2)(where, [(0.0, ""), (600.0, ""), (600.0, "")], told)


def test_what_a_part_raises_is_raised_here(at_once: None) -> None:
    with pytest.raises(OptionError, match="there is none") as raised:
        fan_out(2)(where, [(0.0, ""), (0.0, "wrong"), (0.0, "")], lambda *_: None)
    assert raised.value.context == {"option": "x"}


def test_a_part_that_is_killed_is_computed_again(at_once: None, tmp_path: Path) -> None:
    """Of parts and answers far larger than a pipe holds, too."""
    rows = [np.random.default_rng(k).normal(size=100_000) for k in range(6)]
    found = killing(fan_out(2), tmp_path)(doubled, rows, lambda *_: None)
    for one, answer in zip(rows, found, strict=True):
        np.testing.assert_array_equal(answer, 2.0 * one)
    assert (tmp_path / "killed").exists()


def test_a_part_that_kills_every_process_fails_the_job(at_once: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spread, "MOST_BREAKS", 2)
    with pytest.raises(CoreError, match="memory may be full") as raised:
        fan_out(2)(where, [(0.0, ""), (0.0, "killed"), (0.0, "")], lambda *_: None)
    assert raised.value.code == "part_ended"


PROGRAM = """
from kilter_service.jobs.fan_out import FanOut
from kilter_service.jobs.fan_out.spread import LocalProcesses
from tests.service.parts import noted
if __name__ == "__main__":
    list(FanOut(LocalProcesses(2)).as_completed(noted, [({folder!r}, k, 600.0) for k in range(2)]))
"""


def test_processes_end_when_their_worker_is_killed(tmp_path: Path) -> None:
    worker = subprocess.Popen([sys.executable, "-c", PROGRAM.format(folder=str(tmp_path))])
    until(lambda: len(list(tmp_path.iterdir())) == 2)
    worker.kill()
    worker.wait()
    until(lambda: not any(alive(int(path.name.partition("-")[2])) for path in tmp_path.iterdir()))


def until(true: Callable[[], bool], wait_s: float = 60.0) -> None:
    ends = time.monotonic() + wait_s
    while not true():
        assert time.monotonic() < ends
        time.sleep(0.05)
