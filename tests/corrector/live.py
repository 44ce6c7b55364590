"""A running corrector as the tests of this folder meet it: its robot, its streams, and waiting for it."""

from __future__ import annotations

import time
from collections.abc import Callable

from kilter_client.stream import CorrectedStream

from service.corrector.process import Corrector

ROBOT = "katana450-chapter4"
ROOT = f"kilter/@v1/test/{ROBOT}"
Q = (0.1, 0.6, 0.4, 0.3, 0.2)


def until(condition: Callable[[], bool], seconds: float = 30.0) -> None:
    """Wait until the condition holds; fail when it does not in time."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.01)


def open_stream(corrector: Corrector, name: str, **options: object) -> CorrectedStream:
    # A loaded test machine may take its time: nothing here depends on being fast.
    given = {"deadline_s": 2.0, "data": corrector.file.parent, "stream": name, "settled": True, **options}
    return CorrectedStream(ROBOT, **given)  # type: ignore[arg-type]
