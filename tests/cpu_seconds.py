"""Processor time by module of tests, of this process and of those that it started: `pytest --cpu`, `make test-cpu`.

Seconds by the clock say little while others use the machine. A process counts where it ends: a server of a module at the
module's last test, one of the session at the last test of all. What the process that forks them took for its imports,
5 s, is no module's.
"""

from __future__ import annotations

import resource
import time
from collections import Counter
from collections.abc import Generator

import pytest

from tests.service import forked

SHOWN = 40
KEY = "cpu_s"


def used_s() -> float:
    """What this process and its children that have ended took so far."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime + forked.used_s()


class CpuSeconds:
    """Counts in the process that runs a test, and adds up in the one that prints: a report takes the number there."""

    def __init__(self) -> None:
        self._by_module: Counter[str] = Counter()
        self._began_s = used_s()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self) -> Generator[None, object, object]:
        """Begin before the fixtures."""
        self._began_s = used_s()
        return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self, item: pytest.Item) -> Generator[None, object, object]:
        """End after the fixtures; what a report of this phase has travels with it from another process."""
        try:
            return (yield)
        finally:
            item.user_properties.append((KEY, used_s() - self._began_s))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add a test to its module."""
        if report.when == "teardown":
            module = report.nodeid.partition("::")[0]
            self._by_module[module] += sum(float(value) for key, value in report.user_properties if key == KEY)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the modules that took most, and folder by folder what lanes consist of."""
        folders: Counter[str] = Counter()
        for module, seconds in self._by_module.items():
            folders["/".join(module.split("/")[:2])] += seconds
        terminalreporter.section("processor seconds")
        for name, seconds in [*self._by_module.most_common(SHOWN), *folders.most_common()]:
            terminalreporter.write_line(f"{seconds:8.1f}  {name}")
        terminalreporter.write_line(f"{self._by_module.total():8.1f}  all tests, without their collection")
