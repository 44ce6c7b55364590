"""Processor time of tests, of their process and of those that it started: `pytest --cpu`, `python -m tools.lab cpu`.

Seconds by the clock say little while others use the machine. A fork (`tests/service/forked.py`) counts while it runs, so a
test has what the server of its session computed for it; any other process counts where it ends, by its parent. What the
process that forks them took for its imports, 5 s, is no module's.
"""

from __future__ import annotations

import resource
import time
from collections import defaultdict
from collections.abc import Generator
from typing import Any

import pytest

from tests.measured_seconds import Took, rows_of, write
from tests.service import forked

SHOWN = 40
KEY, FIXTURES_KEY, SHARED_KEY = "cpu_s", "cpu_fixtures_s", "cpu_shared_fixtures_s"


def used_s() -> float:
    """What this process and its children that have ended took so far."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime + forked.used_s()


def _most(seconds: dict[str, float]) -> list[tuple[str, float]]:
    return sorted(seconds.items(), key=lambda item: -item[1])


class CpuSeconds:
    """Counts in the process that runs a test, and adds up in the one that prints: a report takes the number there."""

    def __init__(self, write: bool = False) -> None:
        self._own_s: dict[str, float] = defaultdict(float)
        self._fixtures_s: dict[str, float] = defaultdict(float)
        self._own_clock_s: dict[str, float] = defaultdict(float)
        self._fixtures_clock_s: dict[str, float] = defaultdict(float)
        self._shared_s: dict[str, float] = defaultdict(float)
        self._shared_now: list[tuple[str, float]] = []
        self._write = write
        self._began_s = self._called_s = self._ended_s = used_s()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self) -> Generator[None, object, object]:
        """Begin before the fixtures."""
        self._began_s = used_s()
        try:
            return (yield)
        finally:
            self._called_s = self._ended_s = used_s()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[object]) -> Generator[None, object, object]:
        """Count what is set up for more than one test by itself: each tester that runs such tests sets it up anew."""
        if fixturedef.scope == "function":
            return (yield)
        began_s = used_s()
        try:
            return (yield)
        finally:
            self._shared_now.append((f"{fixturedef.argname} ({fixturedef.baseid})", used_s() - began_s))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self) -> Generator[None, object, object]:
        """Note when the test itself has ended."""
        try:
            return (yield)
        finally:
            self._ended_s = used_s()

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(
        self, item: pytest.Item, nextitem: pytest.Item | None
    ) -> Generator[None, object, object]:
        """End after the fixtures; what a report of this phase has travels with it from another process."""
        last_s = used_s()
        try:
            return (yield)
        finally:
            own = self._ended_s - self._called_s
            end_s = (
                last_s if nextitem is None else used_s()
            )  # what lasts for the session ends with the last test of all
            item.user_properties.append((KEY, own))
            item.user_properties.append((FIXTURES_KEY, end_s - self._began_s - own))
            item.user_properties.append((SHARED_KEY, self._shared_now))
            self._shared_now = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add a test to its module."""
        module = report.nodeid.partition("::")[0]
        if report.when == "call":
            self._own_clock_s[report.nodeid] += report.duration
        else:
            self._fixtures_clock_s[module] += report.duration
        if report.when == "teardown":
            given: dict[str, Any] = dict(report.user_properties)
            for fixture, seconds in given.get(SHARED_KEY, ()):
                self._shared_s[fixture] += seconds
            self._own_s[report.nodeid] += float(str(given.get(KEY, 0.0)))
            self._fixtures_s[module] += float(str(given.get(FIXTURES_KEY, 0.0)))

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Print the modules that took most, folder by folder what lanes consist of, and the fixtures that took most."""
        by_module, folders = self._fixtures_s.copy(), defaultdict[str, float](float)
        for test, seconds in self._own_s.items():
            by_module[test.partition("::")[0]] += seconds
        for module, seconds in by_module.items():
            folders["/".join(module.split("/")[:2])] += seconds
        terminalreporter.section("processor seconds")
        for name, seconds in [*_most(by_module)[:SHOWN], *_most(folders)]:
            terminalreporter.write_line(f"{seconds:8.1f}  {name}")
        terminalreporter.write_line(f"{sum(by_module.values()):8.1f}  all tests, without their collection")
        terminalreporter.write_line(f"{sum(self._shared_s.values()):8.1f}  of these, fixtures of modules and sessions:")
        for name, seconds in _most(self._shared_s)[:SHOWN]:
            terminalreporter.write_line(f"{seconds:8.1f}  {name}")
        if self._write:
            tests = {test: Took(seconds, self._own_clock_s[test]) for test, seconds in self._own_s.items()}
            fixtures = {
                module: Took(seconds, self._fixtures_clock_s[module]) for module, seconds in self._fixtures_s.items()
            }
            write(rows_of(tests, fixtures), fixtures.keys())
