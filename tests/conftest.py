"""What tests of every folder share."""

from __future__ import annotations

import gc
import logging
import os
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Set before numpy is imported: its threads make small fits ten times slower on two busy cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A first call loads compiled code, and the machine may be busy: no test fails by the clock.
settings.register_profile("kilter", deadline=None)
settings.load_profile("kilter")

REPOSITORY = Path(__file__).resolve().parent.parent

# Modules that take long, on a quiet machine 15 s or more. A module is one process's: begun last, the others would wait for it.
LONG = (
    "contract/test_doc_examples.py",
    "corrector/test_c_controller.py",
    "service/test_degraded_starts.py",
    "service/test_activation_guard.py",
    "contract/test_systemd.py",
    "service/test_workers.py",
    "clients/test_lost_connections.py",
    "core/identify/test_plausibility.py",
    "core/gap/test_find_gap.py",
    "clients/files/match/test_silent_rows.py",
    "clients/files/rig/sheet/test_points_order.py",
    "service/test_clock_jumps.py",
    "service/test_kills.py",
    "service/test_gap.py",
    "corrector/test_kill_every.py",
    "core/arm/test_compiled.py",
    "blind/test_gap_blind.py",
    "core/gap/test_drift.py",
    "contract/test_demo.py",
    "mix_ups/test_mix_ups.py",
    "clients/test_filter_many.py",
    "core/gap/test_claims.py",
    "contract/test_contributing.py",
    "service/test_bad_starts.py",
    "service/test_seals.py",
    "contract/test_words.py",
)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--cpu", action="store_true", help="print the processor time that each module of tests took")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--cpu"):
        from tests.cpu_seconds import CpuSeconds

        config.pluginmanager.register(CpuSeconds(), "cpu-seconds")


COLLECTIONS = (50_000, 20, 20)  # Python: 700, 10, 10


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Look for garbage neither while all modules are imported nor, later, among what lives as long as this process.

    It took a quarter of the time of collecting the tests, and a twelfth of that of running them.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(*COLLECTIONS)
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the long modules first, in their order; what is in a module, and all others, stays as it was."""
    first = {REPOSITORY / "tests" / name: place for place, name in enumerate(LONG)}
    items.sort(key=lambda item: first.get(item.path, len(first)))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real measurements, which is not part of this repository."""
    folder = Path(os.environ.get("KILTER_SHARED_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real measurements not found in {folder}: set KILTER_SHARED_DATA to their folder")
    return folder


@pytest.fixture
def kilterd() -> Iterator[Callable[[list[str]], None]]:
    """The command of the server, in this process; what it sets up for its log lines and its files ends with the test."""
    from kilter_service.__main__ import main

    rights = os.umask(0o077)
    os.umask(rights)
    yield main
    os.umask(rights)
    for handler in [one for one in logging.root.handlers if type(one) is logging.StreamHandler]:
        logging.root.removeHandler(handler)
    logging.getLogger("kilter.access").disabled = True
