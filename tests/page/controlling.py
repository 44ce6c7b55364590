"""A corrector of its own process, and a controller that sends setpoints to it by the client library."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

from kilter_client.stream import CorrectedStream
from kilter_client.streaming.frames import Setpoint
from kilter_service.ground.settings import Settings
from tests.service.conftest import REPOSITORY, wait_for
from tests.service.forked import ForkedPopen

HOME = (0.1, 0.6, 0.4, 0.3, 0.2)  # rad; the Katana's joints can go there


class CorrectorProcess:
    """`kilterd corrector` as a process of its own."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it and wait until it listens."""
        environment = {**os.environ, **self.settings.environment()}
        command = [sys.executable, "-m", "kilter_service", "corrector"]
        self.process = ForkedPopen(command, env=environment, cwd=REPOSITORY)
        wait_for(self._listens)

    def _listens(self) -> bool:
        assert self.process is not None
        assert self.process.poll() is None, "the corrector ended"
        file = self.settings.corrector_file
        return file.exists() and f'"pid": {self.process.pid}' in file.read_text() and '"query"' in file.read_text()

    def stop(self) -> None:
        """Ask it to stop."""
        if self.process is not None:
            self.process.terminate()
            self.process.wait(20)
            self.process = None


class Controller:
    """Swings the joints while it is open, at about ``rate_hz``."""

    def __init__(self, data: Path, robot: str, stream: str = "main", rate_hz: float = 100.0) -> None:
        self._options = {"data": data, "stream": stream, "deadline_s": 0.5, "connect_timeout_s": 30.0}
        self._robot, self._period_s = robot, 1.0 / rate_hz
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.last: Setpoint | None = None
        self.outside = False  # send a setpoint beyond the joint's limits

    def __enter__(self) -> Controller:
        self._thread.start()
        wait_for(lambda: self.last is not None or not self._thread.is_alive())
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(10)

    def _run(self) -> None:
        began = time.monotonic()
        with CorrectedStream(self._robot, **self._options) as stream:  # type: ignore[arg-type]
            while not self._ended.wait(self._period_s):
                swing = 0.2 * math.sin(2.0 * (time.monotonic() - began))
                first = 50.0 if self.outside else HOME[0] + swing
                self.last = stream.correct((first, HOME[1] + 0.5 * swing, *HOME[2:]))
