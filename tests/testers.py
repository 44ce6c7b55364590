"""Tests shared among forks of the process that collected them: `pytest --testers 6`.

Each process of pytest-xdist (`-n`) imports all tests for itself, 17 s of the processor, and what forks processes for its
tests imports the service once more. A fork has both from the one process that collected. A tester takes the next module
when the last test of its own begins.
"""

from __future__ import annotations

import os
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from itertools import groupby
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest
from _pytest import runner
from _pytest._io import TerminalWriter

from tests.service.forked import end_process

PLACE_BYTES = 4


class Testers:
    """Runs the tests of a session in so many forks, and reports what these report."""

    def __init__(self, count: int) -> None:
        self._count = count

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Run until every test has ended; a tester that dies costs the test that it ran, and others take the rest."""
        if session.config.option.collectonly or session.testsfailed:
            return None
        if (reporter := session.config.pluginmanager.get_plugin("terminalreporter")) is not None:
            reporter.showfspath = False  # modules take turns: a name at each change would be one for each test
        left = list(session.items)
        while left:
            ended = _Round(session, left).run(self._count)
            left = [item for item in left if item.nodeid not in ended]
        return True


class _Round:
    """Testers that share modules, and what came back from them."""

    def __init__(self, session: pytest.Session, items: Sequence[pytest.Item]) -> None:
        self._session, self._hook = session, session.config.hook
        self._modules = [list(group) for _, group in groupby(items, lambda item: item.nodeid.partition("::")[0])]
        self._locations = {item.nodeid: item.location for item in items}
        self._running: dict[Connection, int] = {}  # process ids
        self._begun: dict[int, str] = {}  # the test that a process runs
        self._ended: set[str] = set()

    def run(self, count: int) -> set[str]:
        """Return the names of the tests that have ended."""
        turns, ends = os.pipe()
        os.write(ends, b"".join(k.to_bytes(PLACE_BYTES) for k in range(len(self._modules))))
        os.close(ends)
        _private_folder(self._session.config)
        try:
            for number in range(min(count, len(self._modules))):
                self._start_tester(number, turns)
            while self._running:
                for connection in wait(list(self._running)):
                    assert isinstance(connection, Connection)
                    self._receive(connection)
        finally:
            os.close(turns)
            for connection, pid in self._running.items():
                connection.close()
                os.kill(pid, signal.SIGINT)
                os.waitpid(pid, 0)
        return self._ended

    def _start_tester(self, number: int, turns: int) -> None:
        here, there = Pipe(duplex=False)
        sys.stdout.flush()
        with warnings.catch_warnings(
            action="ignore", category=DeprecationWarning
        ):  # of threads of libraries, idle here
            pid = os.fork()
        if pid == 0:
            for connection in (here, *self._running):
                connection.close()
            _be_tester(self._session, number, there, self._take_items(turns))
        there.close()
        self._running[here] = pid

    def _take_items(self, turns: int) -> Iterator[pytest.Item]:
        while place := os.read(turns, PLACE_BYTES):
            yield from self._modules[int.from_bytes(place)]

    def _receive(self, connection: Connection) -> None:
        pid = self._running[connection]
        try:
            kind, content = connection.recv()
        except EOFError:
            del self._running[connection]
            self._report_end(pid, os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
            return
        if kind == "start":
            self._begun[pid] = content
            self._hook.pytest_runtest_logstart(nodeid=content, location=self._locations[content])
        elif kind == "finish":
            self._ended.add(self._begun.pop(pid))
            self._hook.pytest_runtest_logfinish(nodeid=content, location=self._locations[content])
        else:
            report = self._hook.pytest_report_from_serializable(config=self._session.config, data=content)
            # Printed as one of pytest-xdist: in which process it was, and no name of a module before its letter.
            report.node = SimpleNamespace(
                gateway=SimpleNamespace(id=f"tester {pid}"), _workerinfocache=f"[tester {pid}]"
            )
            self._hook.pytest_runtest_logreport(report=report)
        if self._session.shouldfail:
            raise self._session.Failed(self._session.shouldfail)
        if self._session.shouldstop:
            raise self._session.Interrupted(self._session.shouldstop)

    def _report_end(self, pid: int, code: int) -> None:
        if (test := self._begun.pop(pid, None)) is None:
            assert code == 0, f"a tester ended outside of a test, with exit code {code}"
            return
        self._ended.add(test)
        why = f"the process that ran {test} ended with exit code {code}"
        report = pytest.TestReport(test, self._locations[test], {}, "failed", why, "call")
        self._hook.pytest_runtest_logreport(report=report)


class _Sender:
    """Sends what a tester reports to the process that prints."""

    def __init__(self, config: pytest.Config, connection: Connection) -> None:
        self._config, self._connection = config, connection

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Say which test begins."""
        self._connection.send(("start", nodeid))

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """Say which one has ended."""
        self._connection.send(("finish", nodeid))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Send what came out."""
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        self._connection.send(("report", data))


def _be_tester(session: pytest.Session, number: int, connection: Connection, items: Iterator[pytest.Item]) -> NoReturn:
    """Run tests while there are any, and end as the interpreter ends; folders, output and reports are this fork's own."""
    code, plugins = 1, session.config.pluginmanager
    try:
        plugins.unregister(name="terminalreporter")
        plugins.register(
            SimpleNamespace(_tw=TerminalWriter(sys.stderr)), "terminalreporter"
        )  # pytest-timeout writes there
        plugins.register(_Sender(session.config, connection))
        if (capture := plugins.get_plugin("capturemanager")) is not None:
            capture.stop_global_capturing()
            capture.start_global_capturing()
            capture.suspend_global_capture()
        _private_folder(session.config, f"tester{number}")
        item = next(items, None)
        while item is not None:
            following = next(items, None)
            session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            item = following
        code = 0
    except BaseException as error:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        if not isinstance(error, KeyboardInterrupt | pytest.exit.Exception):
            traceback.print_exc()
        with suppress(BaseException):
            runner.pytest_sessionfinish(session)  # its fixtures end what they started
    connection.close()
    end_process(code)


def _private_folder(config: pytest.Config, name: str = "") -> None:
    """Make the folder of temporary files, and have a tester use one of its own in it."""
    factory: Any = vars(config)["_tmp_path_factory"]
    factory._basetemp = factory.getbasetemp() / name
    factory._basetemp.mkdir(mode=0o700, exist_ok=True)
