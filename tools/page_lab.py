"""A server with a robot, its campaigns, a version in use and a moving stream: for pictures and measurements of the page."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from kilter_client import Kilter
from kilter_client.cli.demo import PRESET, ROBOT, STAGES, identify, measure
from kilter_client.requests.local_server import LocalServer, local_server
from kilter_client.stream import CorrectedStream
from kilter_core.twin import thesis_katana

HOME = (0.1, 0.6, 0.4, 0.3, 0.2)  # rad


@dataclass(frozen=True)
class Lab:
    """What there is to look at."""

    server: LocalServer
    robot: str
    train: str
    held_out: str
    version: str

    @property
    def token(self) -> str:
        """The admin token."""
        return (self.server.data / "token").read_text(encoding="ascii").strip()


@contextmanager
def lab(folder: Path) -> Iterator[Lab]:
    """Measure, identify and activate as the demo does, on a server of its own."""
    twin = thesis_katana(PRESET)
    with local_server(folder / "data") as server:
        os.environ["KILTER_DATA"] = str(server.data)
        with Kilter(server.url) as kilter:
            train, held_out = measure(kilter, twin, folder)
            found = [identify(kilter, name, train, held_out) for name in STAGES]
            version = min(found, key=lambda one: one.held_out_mm).version
            kilter.versions.activate(version)
        yield Lab(server, ROBOT, train, held_out, version)


@contextmanager
def moving(data: Path, robot: str, rate_hz: float = 250.0) -> Iterator[None]:
    """Swing the joints of a robot by a stream."""
    ended = threading.Event()

    def run() -> None:
        began = time.monotonic()
        with CorrectedStream(robot, data=data, deadline_s=0.2, connect_timeout_s=30.0) as stream:
            while not ended.wait(1.0 / rate_hz):
                swing = 0.2 * math.sin(0.7 * (time.monotonic() - began))
                stream.correct((HOME[0] + swing, HOME[1] + 0.5 * swing, HOME[2] - 0.3 * swing, *HOME[3:]))

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
