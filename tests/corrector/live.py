"""A running corrector as the tests of this folder meet it: its robot, its streams, and waiting for it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import numpy as np
import zenoh

from kilter_client.stream import CorrectedStream
from kilter_client.streaming.frames import Setpoint
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import config
from kilter_service.stream.corrector.wire import Status

ROBOT = "katana450-chapter4"
ROOT = f"kilter/@v1/test/{ROBOT}"
MOST_LATE = 3  # of the setpoints of one test
Q = (0.1, 0.6, 0.4, 0.3, 0.2)


def until(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait until the condition holds; fail when it does not in time."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.01)


def on_time(setpoints: Iterable[Setpoint]) -> list[tuple[str, str | None]]:
    """Source and status of all but the few frames that a busy machine itself kept for longer than they may be old."""
    found = [(one.source, one.status) for one in setpoints]
    late = [one for one in found if one[1] == Status.STALE.name]
    assert len(late) <= MOST_LATE, late
    return [one for one in found if one not in late]


def open_stream(corrector: Corrector, name: str, **options: object) -> CorrectedStream:
    # A loaded test machine may take its time: nothing here depends on being fast.
    given = {"deadline_s": 2.0, "data": corrector.file.parent, "stream": name, "settled": True, **options}
    return CorrectedStream(ROBOT, **given)  # type: ignore[arg-type]


def point(seq: int, flags: int = 0, q: tuple[float, ...] = Q) -> bytes:
    """A setpoint sent now."""
    return wire.encode_setpoints(
        np.array([q]), joints=len(q), seq=seq, t_send_ns=time.monotonic_ns(), t_apply_ns=0, flags=flags
    )


class Line:
    """A controller that speaks raw frames on a stream."""

    def __init__(self, endpoints: tuple[str, ...], name: str, root: str = ROOT) -> None:
        self.session = zenoh.open(config("tcp/127.0.0.1:0", endpoints))
        self.answers = self.session.declare_subscriber(f"{root}/stream/{name}/out", zenoh.handlers.FifoChannel(10_000))
        self._way = self.session.declare_publisher(f"{root}/stream/{name}/in", priority=zenoh.Priority.REAL_TIME)
        until(lambda: self._way.matching_status.matching)

    def send(self, data: bytes) -> None:
        self._way.put(data)

    def ask(self, data: bytes) -> wire.Answer:
        """The answer to a frame, which is sent once."""
        self.send(data)
        return self.take(1)[0]

    def take(self, count: int) -> list[wire.Answer]:
        """The next answers."""
        taken: list[wire.Answer] = []

        def enough() -> bool:
            while len(taken) < count and (sample := self.answers.handler.try_recv()) is not None:
                taken.append(wire.decode_answer(sample.payload.to_bytes()))
            return len(taken) == count

        until(enough)
        return taken

    def __enter__(self) -> Line:
        return self

    def __exit__(self, *_: object) -> None:
        self.session.close()  # type: ignore[no-untyped-call]
