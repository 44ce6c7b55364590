"""Sequence and time of a stream: clocks that jump, one bad frame among good ones, bursts after a hang."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from kilter_core.model import Calibration
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.wire import Answer, Flag, Status

Q = (0.1, 0.6, 0.4, 0.3, 0.2)
MS = 1_000_000
HOUR = 3_600_000 * MS
START = Flag.RESET | Flag.SETTLED
OK, STALE = Status.OK, Status.STALE


@pytest.fixture(scope="module")
def active(katana: Calibration, active_of: Callable[..., Active]) -> Active:
    return active_of(katana)


class Moving:
    """A controller in motion: one setpoint each period, on a clock of its own."""

    def __init__(self, active: Active, period_ns: int = MS) -> None:
        self.active, self.stream, self.period_ns = active, Stream(), period_ns
        self.seq, self.arrival, self.clock = 10**6, 10**12, 5 * HOUR
        assert self.cycle(START).status == OK
        assert self.cycles(20) == [OK] * 20

    def frame(self, flags: int = 0, **other: int) -> bytes:
        given = {"seq": self.seq, "t_send_ns": self.arrival + self.clock, "t_apply_ns": 0, "flags": flags, **other}
        return wire.encode_setpoints(self.wanted(given["t_send_ns"] - self.clock), joints=5, **given)

    def wanted(self, at_ns: int | None = None) -> np.ndarray:
        """Where it is then, or now; it moves at half a rad per second at most."""
        return np.array([Q]) + 0.1 * np.sin(5e-9 * (self.arrival if at_ns is None else at_ns))

    def send(self, data: bytes) -> Answer:
        answer = self.stream.answer(data, self.arrival, self.active)
        assert answer is not None
        return wire.decode_answer(answer)

    def cycle(self, flags: int = 0) -> Answer:
        self.seq += 1
        self.arrival += self.period_ns
        return self.send(self.frame(flags))

    def cycles(self, count: int) -> list[Status]:
        return [self.cycle().status for _ in range(count)]


@pytest.mark.parametrize("period_ns", [MS // 4, MS, 20 * MS, 200 * MS])
@pytest.mark.parametrize("jump_ms", [-3_600_000, -1000, -60, 60, 1000, 3_600_000])
def test_a_clock_that_jumps_costs_nothing(active: Active, jump_ms: int, period_ns: int) -> None:
    controller = Moving(active, period_ns)
    if jump_ms == -60 and period_ns > 60 * MS:
        pytest.skip("looks like a frame that is 60 ms late")
    for _ in range(5):
        controller.clock += jump_ms * MS
        assert controller.cycles(50) == [OK] * 50


def test_a_way_that_becomes_longer_is_believed_after_a_tenth_of_a_second(active: Active) -> None:
    for period_ns in (MS, 80 * MS):
        controller = Moving(active, period_ns)
        controller.clock -= 60 * MS - period_ns  # sent after the one before, and 60 ms late for good
        statuses = controller.cycles(300)
        refused = statuses.index(OK)
        assert statuses == [STALE] * refused + [OK] * (300 - refused)
        assert refused <= 1 + 100 * MS // period_ns


@pytest.mark.parametrize("hang_ms", [80, 500, 8000])
@pytest.mark.parametrize("jump_ms", [0, -60, -1000, 1000])
@pytest.mark.parametrize("gap_ms", [0.02, 0.5])
def test_a_burst_after_a_hang_stays_stale_whatever_the_clock_did_before(
    active: Active, hang_ms: int, jump_ms: int, gap_ms: float
) -> None:
    """The corrector hangs; what was sent meanwhile, one each millisecond, is read as fast as it can."""
    controller = Moving(active)
    controller.clock += jump_ms * MS
    controller.cycles(10)
    begin, resumed = controller.arrival, controller.arrival + hang_ms * MS
    for k in itertools.count(1):
        controller.seq += 1
        sent = begin + k * MS
        controller.arrival = max(resumed + round(k * gap_ms * MS), sent)
        status = controller.send(controller.frame(t_send_ns=sent + controller.clock)).status
        age = controller.arrival - sent
        assert status == STALE or age < 55 * MS
        assert status == OK or age > 45 * MS
        if controller.arrival == sent:
            break
    assert controller.cycles(10) == [OK] * 10


def bad_frames(controller: Moving) -> list[bytes]:
    """One frame of somebody else each, as he sees the stream just before the controller's next frame."""
    now = controller.arrival + controller.clock
    following = controller.seq + 1
    far = np.array([[-0.4, 1.0, 0.0, -0.5, 0.5]])
    made = [
        controller.frame(flags, seq=seq, t_send_ns=sent)
        for flags in (0, START, int(Flag.RESET))
        for seq in (0, controller.seq, following, following + 1, 2**63 - 1, 2**63, 2**64 - 1)
        for sent in (0, now - HOUR, now, now + HOUR, 2**63, 2**64 - 1)
    ]
    made += [
        wire.encode_setpoints(far, joints=5, seq=following, t_send_ns=now, t_apply_ns=apply, flags=START)
        for apply in (0, 1, now + HOUR, 2**64 - 1)
    ]
    made += [made[2][:40], made[2] + b"\0", wire.MAGIC + b"\xff" * 80, b"", b"KLT1"]
    made.append(wire.encode_setpoints(np.full((1, 5), np.nan), joints=5, seq=following, t_send_ns=now, t_apply_ns=0))
    made.append(wire.encode_setpoints(np.zeros((1, 6)), joints=6, seq=following, t_send_ns=now, t_apply_ns=0))
    return made


@pytest.mark.parametrize("resets", [True, False])
def test_one_bad_frame_costs_one_cycle_at_most(active: Active, resets: bool) -> None:
    """A controller that answers a refusal with RESET, and one that just goes on.

    The latter may have to wait when the frame was the next one and asked for a place far away: it leaps back from there.
    """
    lost = []
    for k in range(len(bad_frames(Moving(active)))):
        controller = Moving(active)
        answer = controller.stream.answer(bad_frames(controller)[k], controller.arrival, active)
        values = wire.decode_answer(answer).values if answer else np.empty((0, 5))
        if not resets and values.size and np.abs(values - controller.wanted()).max() > 0.03:
            continue
        statuses, flags = [], 0
        for _ in range(30):
            statuses.append(controller.cycle(flags).status)
            flags = START if resets and statuses[-1] != OK else 0
        lost.append(sum(status != OK for status in statuses))
    assert max(lost) <= 1
    assert sum(lost) < len(lost) / 3


def test_a_reset_of_somebody_else_does_not_ramp_the_correction_anew(active: Active) -> None:
    controller, undisturbed = Moving(active), Moving(active)
    controller.send(controller.frame(Flag.RESET, seq=7))
    controller.send(controller.frame(Flag.RESET, seq=9))
    one, other = controller.cycle(), undisturbed.cycle()
    assert np.array_equal(one.values, other.values)
    assert not one.header.flags & Flag.RAMPING


def test_a_reset_that_goes_on_is_a_new_start(active: Active) -> None:
    controller = Moving(active)
    old = controller.seq
    controller.seq = 100
    first = controller.cycle(Flag.RESET)
    assert first.header.flags & Flag.RAMPING
    assert controller.cycles(5) == [OK] * 5
    assert controller.send(controller.frame(seq=old + 1)).status == Status.SEQ_GAP
    assert controller.cycles(5) == [OK] * 5


def test_lost_frames_cost_one_more(active: Active) -> None:
    controller = Moving(active)
    for lost in (1, 5, 1000):
        controller.seq += lost
        assert controller.cycles(4) == [Status.SEQ_GAP, OK, OK, OK]
