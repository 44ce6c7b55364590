"""Slots of streams: junk names lock nobody out, a stream in use is never put out, unknown robots take none."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator

import pytest

from kilter_service.ground.settings import Settings
from kilter_service.stream.corrector.process import Corrector
from kilter_service.stream.corrector.session import Rules
from kilter_service.stream.corrector.wire import Flag, Status
from tests.corrector.forger import HEADER
from tests.corrector.live import ROOT, Line, open_stream, point, until

START = Flag.RESET | Flag.SETTLED
IDLE_S = 1.0


@pytest.fixture(scope="module")
def small(source: object, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Corrector]:
    """A corrector with four slots, of which a stream may hold one for a second without a setpoint."""
    settings = Settings(data=tmp_path_factory.mktemp("data"), zenoh_listen="tcp/127.0.0.1:0", site="test")
    running = Corrector(settings, source, Rules(max_age_ns=round(5e9), slots=4, idle_ns=round(IDLE_S * 1e9)))  # type: ignore[arg-type]
    running.start()
    with open_stream(running, "first", connect_timeout_s=60.0):
        pass  # opened once the version is known: frames that come before are answered NO_VERSION
    yield running
    running.stop()


def endpoints(corrector: Corrector) -> tuple[str, ...]:
    return tuple(corrector.endpoints.values())


def good(line: Line, seq: int) -> bool:
    """Whether a setpoint is answered with numbers."""
    return line.ask(point(seq, START)).status == Status.OK


def test_256_junk_names_lock_nobody_out(corrector: Corrector) -> None:
    with Line(endpoints(corrector), "honest") as line, open_stream(corrector, "also") as stream:
        assert line.ask(point(1, START)).status == Status.OK
        q = (0.1, 0.6, 0.4, 0.3, 0.2)
        assert [stream.correct(q).source for _ in range(3)] == ["corrected"] * 3
        assert line.ask(point(2)).status == Status.OK
        for k in range(600):
            for data in (b"KLT1", point(k), point(k + 2)):
                line.session.put(f"{ROOT}/stream/junk{k}/in", data)
            if k % 20 == 0:  # not faster than the ring is emptied: what overflows there is lost, whosever it is
                assert stream.correct(q).source == "corrected"
        assert line.ask(point(3)).status == Status.OK  # its place in the sequence was kept
        with Line(endpoints(corrector), "newcomer") as other:
            assert other.ask(point(1, START)).status == Status.OK


def test_a_robot_without_a_version_is_answered_and_takes_no_slot(small: Corrector) -> None:
    root = ROOT.replace("katana450-chapter4", "nobody")
    with Line(endpoints(small), "in-use") as line:
        assert good(line, 1)
        for k in range(8):
            with Line(endpoints(small), f"s{k}", root) as other:
                assert other.ask(point(1, START)).status == Status.NO_VERSION
        assert line.ask(point(2)).status == Status.OK


def test_streams_in_use_keep_their_slots_and_idle_ones_give_them_back(small: Corrector) -> None:
    time.sleep(1.5 * IDLE_S)  # those of other tests are idle
    lines = [Line(endpoints(small), f"user{k}") for k in range(4)]
    with Line(endpoints(small), "fifth") as fifth:

        def all_in_use() -> bool:
            for line in lines:
                line.ask(point(1, START))
                line.ask(point(2))
            return fifth.ask(point(1, START)).status == Status.OVERLOAD

        until(all_in_use)
        time.sleep(1.5 * IDLE_S)
        assert fifth.ask(point(1, START)).status == Status.OK
    for line in lines:
        line.__exit__()


@pytest.mark.parametrize("joints", [0, 1, 4, 6, 16, 17, 255])
def test_another_number_of_joints_is_answered(corrector: Corrector, joints: int) -> None:
    """At once on a new stream, and in the middle of one that goes on undisturbed."""
    with Line(endpoints(corrector), f"joints{joints}") as line:
        for seq in (1, 3):
            numbers = struct.pack(f"<{joints}d", *[0.1] * joints)
            refused = line.ask(HEADER.pack(b"KLT1", 0, joints, START, seq, time.monotonic_ns(), 0) + numbers)
            assert refused.status in (Status.BAD_FRAME, Status.VERSION_MISMATCH)
            assert refused.values.size == 0
            until(lambda seq=seq: good(line, seq + 1))  # type: ignore[misc]
