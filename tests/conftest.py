"""What tests of every folder share."""

from __future__ import annotations

import gc
import logging
import os
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from kilter_service.ground.memory import ShortPauses
from tests.measured_seconds import measured
from tests.temporary_files import put_in_memory

# Set before numpy is imported: its threads make small fits ten times slower on two busy cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Each client of httpx would read all authorities that this machine trusts, 0.03 s of the processor: tests name whom they trust.
os.environ.pop("SSL_CERT_FILE", None)
os.environ["SSL_CERT_DIR"] = os.path.dirname(__file__)

put_in_memory()

# A first call loads compiled code, and the machine may be busy: no test fails by the clock.
settings.register_profile("kilter", deadline=None)
settings.load_profile("kilter")

REPOSITORY = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--cpu", action="store_true", help="print the processor time that each module of tests took")
    parser.addoption(
        "--write-cpu", action="store_true", help="with --cpu: write that of each test to tests/seconds.txt"
    )
    parser.addoption("--since", metavar="COMMIT", help="only the tests that what changed since this commit can reach")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--cpu"):
        from tests.cpu_seconds import CpuSeconds

        config.pluginmanager.register(CpuSeconds(config.getoption("--write-cpu")), "cpu-seconds")


@pytest.fixture(autouse=True, scope="session")
def wide_screen() -> Iterator[None]:
    """Commands print each sentence on one line; ``tests/clients/test_screens.py`` says what fits on a screen."""
    from kilter_client.cli.terminal import output

    usual, output.WIDE = output.WIDE, 10_000
    yield
    output.WIDE = usual


COLLECTIONS = (50_000, 20, 20)  # Python: 700, 10, 10
LONG_COLLECTION_S = 0.02


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
        # What is imported later: each job that ends looks for garbage.
        ShortPauses(LONG_COLLECTION_S).watch_collections()
        gc.set_threshold(*COLLECTIONS)
        gc.enable()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Generator[None, object, object]:
    """Mark what is long before marks choose, and put the long modules first; what is in a module stays as it was.

    A module is one process's: begun last, the others would wait for it. A test that is asked for by its name is not long.
    """
    found = measured()
    long = set() if any("::" in one for one in config.args) else {row.name for row in found if row.is_long}
    for item in items:
        if long & {item.nodeid, item.nodeid.partition("::")[0]}:
            item.add_marker(pytest.mark.long)
    if since := config.getoption("--since"):
        from tests.reach import Reach, changed_files

        reach, all_items = Reach(changed_files(since)), items[:]
        items[:] = [item for item in all_items if reach.includes(item)]
        reached = set(items)
        config.hook.pytest_deselected(items=[item for item in all_items if item not in reached])
    done = yield
    by_module: dict[str, float] = defaultdict(float)
    for row in found:
        by_module[row.name.partition("::")[0]] += row.took.clock_s
    items.sort(key=lambda item: -by_module[item.nodeid.partition("::")[0]])
    return done


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
