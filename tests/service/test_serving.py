"""What a process makes at its start lasts as long as itself, and is not looked through for garbage."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import gc
from kilter_service.run.serving import lasting
collected = []
gc.callbacks.append(lambda phase, info: collected.append(phase))
try:
    with lasting():
        assert not gc.isenabled()
        import kilter_service.run.app
        raise OSError("as a taken port would")
except OSError:
    pass
assert gc.isenabled(), "the collector stays off"
assert gc.get_freeze_count() > 100_000, gc.get_freeze_count()
assert not collected, len(collected)
"""

WORKER = """
import gc, sys
from argparse import Namespace
from pathlib import Path
from kilter_service.run.program import worker
from kilter_service.ground.settings import Settings
settings = Settings(data=Path(sys.argv[1]), database_url=None)
import kilter_service.run.serving
collected = []
gc.collect()
gc.callbacks.append(lambda phase, info: collected.append(info["generation"]))
try:
    worker(settings, Namespace(supervised=True))
except Exception as error:
    assert "worker.lock" in str(error), error
assert "kilter_service.jobs.work.runner" in sys.modules
assert gc.isenabled(), "the collector stays off"
assert gc.get_freeze_count() > 50_000, gc.get_freeze_count()
assert len(collected) < 20, len(collected)  # of what comes after the import
"""

SHORT = """
import gc, weakref
from kilter_service.ground.memory import ShortPauses
class Thing: pass
def cycle():
    one, other = Thing(), Thing()
    one.other, other.other = other, one
    return weakref.ref(one)
kept = [[] for _ in range(1000)]
ShortPauses(long_s=0.0).watch_collections()
gc.collect(1)
assert gc.get_freeze_count() == 0
gc.collect()
frozen = gc.get_freeze_count()
assert frozen >= len(kept), frozen
gone = cycle()
assert gone() is not None
gc.collect()
assert gone() is None, "garbage that came later stays"
"""


def test_nothing_is_collected_while_the_application_is_imported() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_nothing_is_collected_while_the_worker_is_imported(tmp_path: Path) -> None:
    (tmp_path / "kilter.sqlite.worker.lock").mkdir()  # so it ends as soon as it has imported what it needs
    done = subprocess.run(
        [sys.executable, "-c", WORKER, str(tmp_path)], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr


def test_what_a_long_collection_left_is_not_looked_through_again() -> None:
    done = subprocess.run([sys.executable, "-c", SHORT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
