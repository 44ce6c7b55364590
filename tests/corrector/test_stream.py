"""The rules of one stream, without zenoh: every verdict, and nothing but OK with numbers."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from kilter_core.correct.kernels import layout
from kilter_core.correct.program import Track, compile_program
from kilter_core.model import Calibration
from kilter_service.stream.corrector import wire
from kilter_service.stream.corrector.active import Active
from kilter_service.stream.corrector.fast_path import PERIOD_BITS
from kilter_service.stream.corrector.session import Rules
from kilter_service.stream.corrector.stream import Stream
from kilter_service.stream.corrector.wire import Answer, Flag, Kind, Status

Q = [0.1, 0.6, 0.4, 0.3, 0.2]
MS = 1_000_000
RESET = Flag.RESET | Flag.SETTLED
MakeCalibration = Callable[..., Calibration]


class Controller:
    """Sends setpoints to a stream on a clock of its own, a constant way behind the corrector's."""

    def __init__(self, active: Active | None, rules: Rules | None = None) -> None:
        self.stream = Stream(rules)
        self.active = active
        self.seq = 0
        self.now = 10**12
        self.clock = 10**16  # how far its clock is from the corrector's

    def send(
        self, q: list[float] = Q, *, flags: int = 0, seq: int | None = None, late_ns: int = 0,
        version: int | None = None, overloaded: bool = False,
    ) -> Answer:  # fmt: skip
        self.seq = self.seq + 1 if seq is None else seq
        self.now += 2 * MS
        sent = self.now + self.clock
        width = wire.width(flags)
        data = wire.encode_setpoints(
            np.array([q]), joints=len(q) // width, seq=self.seq, t_send_ns=sent, t_apply_ns=0, flags=flags,
            version=version,
        )  # fmt: skip
        return self.raw(data, late_ns, overloaded)

    def raw(self, data: bytes, late_ns: int = 0, overloaded: bool = False) -> Answer:
        answer = self.stream.answer(data, self.now + late_ns, self.active, overloaded)
        assert answer is not None
        decoded = wire.decode_answer(answer)
        assert (decoded.values.size > 0) == (decoded.status == Status.OK)
        return decoded


@pytest.fixture
def active(katana: Calibration, active_of: Callable[..., Active]) -> Active:
    return active_of(katana)


def test_a_setpoint_is_corrected(active: Active, katana: Calibration) -> None:
    controller = Controller(active)
    answer = controller.send(flags=RESET)
    track = Track(compile_program(katana), settled=True)
    track.step(np.array(Q), 1, 0.0)
    assert answer.status == Status.OK
    assert (answer.version, answer.epoch, answer.header.seq) == (active.number, active.epoch, 1)
    assert np.array_equal(answer.values[0], track.out)
    assert not answer.header.flags & Flag.DYNAMIC


def test_speeds_and_accelerations_make_the_moments_dynamic(active: Active) -> None:
    answer = Controller(active).send(Q + [0.5] * 5 + [2.0] * 5, flags=RESET | Flag.QD | Flag.QDD)
    assert answer.header.flags & Flag.DYNAMIC


def through_the_wrist(count: int = 800) -> np.ndarray:
    """A path of a UR10 that crosses the singularity of its wrist (joint 5 at zero) slowly."""
    q = np.tile([0.3, -1.2, 1.4, -0.7, 0.0, 0.4], (count, 1))
    q[:, 4] = np.linspace(-0.02, 0.02, count)
    q[:, 0] += 0.1 * np.linspace(0.0, 1.0, count) ** 2
    return q


def test_both_paths_say_what_is_left_in_the_same_bytes_through_a_singularity(
    ur10: Calibration, active_of: Callable[..., Active], monkeypatch: pytest.MonkeyPatch
) -> None:
    active = active_of(ur10, largest_rad=1.5e-3)  # with larger limits nothing is left of the point
    fast, full = Stream(), Stream()
    monkeypatch.setattr(full._fast, "adopt_clock", lambda clock: False)
    slow, calls = fast._full_path, [0]

    def counting(*frame: Any) -> bytes | None:
        calls[0] += 1
        return slow(*frame)

    monkeypatch.setattr(fast, "_full_path", counting)
    left, damped = [], 0
    for k, q in enumerate(through_the_wrist()):
        now = 10**12 + 2 * MS * k
        data = wire.encode_setpoints(
            q[None], joints=6, seq=k, t_send_ns=now, t_apply_ns=0, flags=RESET if k == 0 else 0
        )
        one, other = (stream.answer(data, now, active) for stream in (fast, full))
        assert one is not None
        assert other is not None
        assert (one[:48], one[52:]) == (other[:48], other[52:]), k
        answer = wire.decode_answer(one)
        left.append(answer.left_nm)
        damped += bool(answer.header.flags & Flag.DAMPED)
    assert calls[0] <= 3  # the first frames; all others took the fast path
    assert damped > 0
    assert fast.counters.held_back_counts == full.counters.held_back_counts
    assert fast.counters.held_back_counts["damped"] == damped
    assert fast.counters.most_left_nm[1] == full.counters.most_left_nm[1] == max(left) > 0


def test_what_was_left_is_forgotten_after_two_periods(monkeypatch: pytest.MonkeyPatch) -> None:
    counters, period = Stream().counters, 1 << PERIOD_BITS
    now = [100 * period]
    monkeypatch.setattr("kilter_service.stream.corrector.fast_path.time.monotonic_ns", lambda: now[0])
    counters.count_made(0, 500, now[0])
    assert counters.most_left_nm == (500, 500)
    now[0] += period
    counters.count_made(0, 300, now[0])
    assert counters.most_left_nm == (500, 500)
    now[0] += period
    assert counters.most_left_nm == (300, 500)
    counters.count_made(0, 10, now[0])
    assert counters.most_left_nm == (300, 500)
    now[0] += 2 * period
    assert counters.most_left_nm == (0, 500)


def test_a_chunk_says_the_most_that_is_left_at_any_of_its_points(
    ur10: Calibration, active_of: Callable[..., Active]
) -> None:
    active, path = active_of(ur10, largest_rad=1.5e-3), through_the_wrist(200)
    apart, together = Stream(), Stream()
    left = []
    for k, q in enumerate(path):
        now = 10**12 + 2 * MS * k
        data = wire.encode_setpoints(
            q[None], joints=6, seq=k, t_send_ns=now, t_apply_ns=0, flags=RESET if k == 0 else 0
        )
        answer = apart.answer(data, now, active)
        assert answer is not None
        left.append(wire.decode_answer(answer).left_nm)
    data = wire.encode_setpoints(path, joints=6, seq=0, t_send_ns=10**12, t_apply_ns=0, flags=RESET, step_ns=2 * MS)
    answer = together.answer(data, 10**12, active)
    assert answer is not None
    assert wire.decode_answer(answer).left_nm == max(left)
    assert len(set(left)) > 10


def test_a_chunk_equals_its_points(active: Active) -> None:
    points = np.array(Q) + 0.01 * np.sin(np.arange(40))[:, None]
    one = Controller(active)
    single = [one.send(list(p), flags=RESET if k == 0 else 0).values[0] for k, p in enumerate(points)]
    many = Controller(active)
    many.send(list(points[0]), flags=RESET)
    many.now += 2 * MS
    data = wire.encode_setpoints(
        points[1:], joints=5, seq=2, t_send_ns=many.now + many.clock, t_apply_ns=0, step_ns=2 * MS
    )
    answer = many.raw(data)
    assert answer.header.kind == Kind.CHUNK
    assert np.allclose(answer.values, single[1:], rtol=0, atol=1e-12)


def test_a_chunk_with_one_bad_point_is_refused_as_a_whole(active: Active) -> None:
    points = np.tile(Q, (5, 1))
    points[3, 1] = 9.0
    controller = Controller(active)
    first = controller.send(flags=RESET)
    controller.now += 2 * MS
    sent = controller.now + controller.clock
    data = wire.encode_setpoints(points, joints=5, seq=2, t_send_ns=sent, t_apply_ns=0, step_ns=MS)
    refused = controller.raw(data)
    assert (refused.status, refused.limit_mask) == (Status.JOINT_LIMIT, 0b10)
    assert np.allclose(controller.send(seq=3).values, first.values, rtol=0, atol=1e-7)


def test_sequence_gap_repetition_and_reset(active: Active) -> None:
    controller = Controller(active)
    assert controller.send(flags=RESET).status == Status.OK
    assert controller.send(seq=5).status == Status.SEQ_GAP
    assert controller.send(seq=6).status == Status.OK
    assert controller.send(seq=6).status == Status.SEQ_BACK
    assert controller.send(seq=2).status == Status.SEQ_BACK
    assert controller.send(seq=9, overloaded=True).status == Status.OVERLOAD
    assert controller.send(seq=1, flags=Flag.RESET).status == Status.OK
    assert controller.send().status == Status.OK


def test_two_controllers_on_one_key_never_both_get_numbers(active: Active) -> None:
    controller = Controller(active)
    controller.send(flags=RESET)
    first = [controller.send(seq=s).status for s in (2, 3)]
    second = [controller.send(seq=s).status for pair in ((1002, 4), (1003, 5), (1004, 6)) for s in pair]
    assert first == [Status.OK, Status.OK]
    assert second == [Status.SEQ_GAP, Status.OK] * 3
    assert [controller.send(seq=s).status for s in (1005, 1006)] == [Status.SEQ_GAP, Status.OK]  # the first one is gone


def test_a_burst_after_a_hang_is_stale(active: Active) -> None:
    controller = Controller(active)
    controller.send(flags=RESET)
    assert controller.send(late_ns=20 * MS).status == Status.OK
    hang = 8 * 10**9
    stale = [controller.send(late_ns=hang - k * 2 * MS).status for k in range(100)]
    assert set(stale) == {Status.STALE}
    assert controller.send().status == Status.OK


def test_nothing_to_correct_with(active: Active) -> None:
    controller = Controller(None)
    assert controller.send(flags=RESET).status == Status.NO_VERSION
    controller.active = active
    assert controller.send().status == Status.OK
    controller.active = None
    assert controller.send().status == Status.NO_VERSION


def test_another_version_or_robot_is_a_mismatch(active: Active) -> None:
    controller = Controller(active)
    assert controller.send(flags=RESET, version=active.number).status == Status.OK
    assert controller.send(version=active.number ^ 1).status == Status.VERSION_MISMATCH
    assert controller.send([0.0] * 6).status == Status.VERSION_MISMATCH


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 4])
def test_numbers_that_are_none(active: Active, bad: float, place: int) -> None:
    controller = Controller(active)
    controller.send(flags=RESET)
    q = [*Q]
    q[place] = bad
    assert controller.send(q).status == Status.NOT_FINITE


def test_limits_and_leaps(active: Active) -> None:
    controller = Controller(active)
    controller.send(flags=RESET)
    low = controller.send([0.1, -3.0, 0.4, 9.0, 0.2])
    assert (low.status, low.limit_mask) == (Status.JOINT_LIMIT, 0b01010)
    leap = controller.send([0.1, 0.6, -0.4, 0.3, 0.2])
    assert (leap.status, leap.limit_mask) == (Status.RATE_LIMIT, 0b00100)
    assert controller.send().status == Status.OK


def test_joint_limits_hold_after_the_correction(katana: Calibration, active_of: Callable[..., Active]) -> None:
    active = active_of(katana, at_limit="refuse")
    controller = Controller(active)
    delta = controller.send(flags=RESET).values[0] - Q
    upper = active.program.array[active.program.moves + 1 : -1, 1]
    lower = active.program.array[active.program.moves + 1 : -1, 0]
    j = int(np.argmax(np.abs(delta)))
    (upper if delta[j] > 0 else lower)[j] = Q[j]
    answer = Controller(active).send(flags=RESET)
    assert (answer.status, answer.limit_mask) == (Status.JOINT_LIMIT, 1 << j)
    active.program.array[-1, layout.SATURATES] = 1.0
    answer = Controller(active).send(flags=RESET)
    assert answer.status == Status.OK
    assert answer.header.flags & Flag.SATURATED
    assert np.all(answer.values[0] <= upper)
    assert np.all(answer.values[0] >= lower)


def test_a_correction_beyond_the_version_s_limit_is_refused(
    katana: Calibration, active_of: Callable[..., Active]
) -> None:
    answer = Controller(active_of(katana, largest_rad=1e-5, at_limit="refuse")).send(flags=RESET)
    assert answer.status == Status.CORRECTION_TOO_LARGE
    answer = Controller(active_of(katana, largest_rad=1e-5)).send(flags=RESET)
    assert answer.status == Status.OK
    assert answer.header.flags & Flag.SATURATED
    assert answer.left_nm > 0


def test_a_change_of_version_flips_between_samples_and_ramps(
    calibration_of: MakeCalibration, katana: Calibration, active_of: Callable[..., Active]
) -> None:
    old, new = active_of(katana, 1), active_of(calibration_of("katana450-chapter4", seed=5), 2)
    controller = Controller(old)
    before = controller.send(flags=RESET)
    controller.active = new
    after = controller.send()
    assert (before.epoch, after.epoch) == (1, 2)
    assert after.header.flags & Flag.RAMPING
    assert np.abs(after.values - before.values).max() < math.radians(0.5) * 0.01
    for _ in range(1200):
        after = controller.send()
    assert not after.header.flags & Flag.RAMPING
    assert np.abs(after.values - before.values).max() > 1e-6


def test_a_controller_cannot_loosen_the_rate_limit_by_its_clock(active: Active) -> None:
    for at in (10**15, -(10**15)):
        controller = Controller(active)
        controller.send(flags=RESET)
        leap = [Q[0], Q[1], Q[2] - 4.0 * math.pi * (0.002 + Rules().time_slack_s) - 0.01, *Q[3:]]
        controller.clock += at
        assert controller.send(leap).status == Status.RATE_LIMIT


def test_counters_say_what_happened(active: Active) -> None:
    controller = Controller(active)
    controller.send(flags=RESET)
    controller.send(seq=9)
    document = controller.stream.counters.document()
    assert document["received"] == 2
    assert document["counters"]["OK"] == document["counters"]["SEQ_GAP"] == 1
    assert document["last_status"] == "SEQ_GAP"


def test_of_two_controllers_on_one_key_one_at_most_gets_numbers(active: Active) -> None:
    """Their sequences cross: whoever is not the follow-up of the last frame gets a refusal, which carries no numbers."""
    controller = Controller(active)
    for seq in range(1, 11):
        controller.send(seq=seq, flags=RESET if seq == 1 else 0)
    controller.send(seq=1, flags=RESET)  # the second one starts
    for k in range(5):
        statuses = [controller.send(seq=11 + k).status, controller.send(seq=2 + k).status]
        assert statuses.count(Status.OK) <= 1
        assert Status.SEQ_BACK in statuses


def damage(stream: Stream, active: Active, count: int, seed: int) -> int:
    """Send ``count`` damaged frames: no crash, numbers only where the frame was a good one after all; how many were."""
    rng = random.Random(seed)
    points = wire.encode_setpoints(np.array([Q]), joints=5, seq=1, t_send_ns=0, t_apply_ns=0, flags=RESET)
    chunk = wire.encode_setpoints(np.array([Q, Q]), joints=5, seq=1, t_send_ns=0, t_apply_ns=0, flags=RESET, step_ns=MS)
    taken = 0
    for k in range(count):
        data = bytearray(chunk if k % 8 == 0 else points)
        for _ in range(rng.randrange(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        if rng.random() < 0.3:
            data = data[: rng.randrange(len(data))]
        answer = stream.answer(bytes(data), 0, active)
        if answer is None:
            continue
        if answer[5] == 0:  # no joints: the length says that there are no numbers
            assert len(answer) == wire.HEADER.size + wire.VERDICT.size
            assert wire.VERDICT.unpack_from(answer, wire.HEADER.size)[2] != Status.OK
            continue
        decoded = wire.decode_answer(answer)
        assert decoded.status == Status.OK
        assert np.all(np.isfinite(decoded.values))
        assert decoded.values.shape[1] == 5
        taken += 1
    return taken


def test_malformed_frames_are_answered_without_numbers(active: Active) -> None:
    assert 0 < damage(Stream(), active, 50_000, 1) < 50_000


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_million_malformed_frames_are_answered_without_numbers(active: Active) -> None:
    assert 0 < damage(Stream(), active, 1_000_000, 2) < 1_000_000


def test_the_fast_path_of_plain_setpoints_is_the_full_path(active: Active, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(8)
    fast, full = Stream(), Stream()
    monkeypatch.setattr(full._fast, "adopt_clock", lambda clock: False)
    rest, refused = fast._full_path, [0]

    def counting(*frame: Any) -> bytes | None:
        refused[0] += 1
        return rest(*frame)

    monkeypatch.setattr(fast, "_full_path", counting)
    seq, now, clock = 0, 10**12, 10**13
    for k in range(6000):
        what = rng.integers(0, 40)
        seq = 7 if what == 2 else seq + (2 if what == 0 else 0 if what == 1 else 1)  # a reset starts anew
        now += int(rng.integers(1, 4)) * MS
        clock += {11: 60 * MS, 12: -60 * MS, 13: 1000 * MS, 14: -1000 * MS, 15: -3 * MS}.get(int(what), 0)
        flags = RESET if k == 0 or what == 2 else int(rng.choice([0, Flag.QD, Flag.QD | Flag.QDD]))
        q = np.array(Q) + 0.2 * np.sin(0.01 * k)
        q[1] = {3: math.nan, 4: 9.0}.get(int(what), q[1])
        values = np.concatenate([q, *(0.1 * rng.normal(size=5) for _ in range(wire.width(flags) - 1))])
        data = wire.encode_setpoints(
            values[None], joints=5, seq=seq, t_send_ns=now + clock, t_apply_ns=now if what % 2 else 0, flags=flags,
            version=active.number + (k % 2) if what == 5 else None,
        )  # fmt: skip
        if what == 6:
            damaged = bytearray(data)
            damaged[rng.integers(0, len(data))] ^= 1 << rng.integers(0, 8)
            data = bytes(damaged)
        if what == 7:
            data = data[: rng.integers(0, len(data))]
        if what == 16:  # another sender's
            data = data[:8] + rng.bytes(8) + data[16:]
        late = 80 * MS if what == 8 else 0
        version = None if what == 9 else active
        one, other = (stream.answer(data, now + late, version, what == 10) for stream in (fast, full))
        assert (one is None) == (other is None)
        if one is not None and other is not None:  # all but the time spent on it
            assert (one[:48], one[52:]) == (other[:48], other[52:]), k
        seq = max(seq, full._sequence.clock.seq)
    assert refused[0] < 3000
    first, second = fast.counters, full.counters
    assert (first.by_status, first.held_back_counts) == (second.by_status, second.held_back_counts)
    assert first.most_left_nm == second.most_left_nm
    assert sum(count > 0 for count in first.by_status) >= 7
