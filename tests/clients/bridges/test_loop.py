"""What a bridge does with what it should not get: offsets stay bounded, and each case has its count or its word."""

from __future__ import annotations

import gc
import json
import math
import re
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import pytest

from kilter_client.bridges.correction import Correction, Guard, Kind, Line, pair
from kilter_client.bridges.egm import From, RsiWire
from kilter_client.bridges.loop import Loop, Request, without_collections
from kilter_core.correct.file import from_bytes, to_bytes
from tests.clients.bridges.udp_peer import Floats
from tests.core.correct.test_c_corrector import program_of

CYCLE_S, GONE_S, RATE_RAD_S, LARGEST_RAD = 0.004, 1.0, 0.05, math.radians(1.0)
Q_DEG = (10.0, -60.0, 80.0, 20.0, 40.0, 5.0)


def content(seed: int = 0, robot: str = "cell7", preset: str = "ur10") -> bytes:
    return to_bytes(
        program_of(preset, "clearance_tilt", seed=seed), version_id=f"v{seed}", number=seed + 1, robot=robot
    )


@pytest.fixture
def guard() -> Guard:
    return Guard(6, LARGEST_RAD, RATE_RAD_S, 0.1, CYCLE_S)


@pytest.fixture
def correction(guard: Guard) -> Correction:
    return Correction(from_bytes(content()), "cell7", guard, CYCLE_S)


def message(ipoc: int, axes: Sequence[object] = Q_DEG, element: str = "ASPos") -> bytes:
    named = " ".join(f'A{k}="{value}"' for k, value in enumerate(axes, 1))
    return f'<Rob TYPE="KUKA"><{element} {named}/><Delay D="3"/><IPOC>{ipoc}</IPOC></Rob>'.encode()


def offsets(answer: bytes) -> list[float]:
    return [float(value) for value in re.findall(rb'A\d="(.*?)"', answer)]


def until_quiet(loop: Loop) -> None:
    """Wait until the loop has seen that nobody asks."""
    end = time.monotonic() + 30.0
    while loop.document()["state"] != "waiting":
        assert time.monotonic() < end, loop.document()
        time.sleep(0.02)


class Controller:
    """Asks by hand."""

    def __init__(self, address: tuple[str, int]) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(address)

    def ask(self, data: bytes, wait_s: float = 10.0) -> bytes | None:
        self.socket.settimeout(wait_s)
        self.socket.send(data)
        try:
            return self.socket.recv(2048)
        except TimeoutError:
            return None


Make = Callable[[tuple[str, int]], Controller]


@pytest.fixture
def controllers() -> Iterator[Make]:
    """Makes controllers, and closes them."""
    made: list[Controller] = []

    def make(address: tuple[str, int]) -> Controller:
        made.append(Controller(address))
        return made[-1]

    yield make
    for one in made:
        one.socket.close()


@contextmanager
def looping(
    correction: Correction, wire: RsiWire | None = None, expected: tuple[str, int] | None = None
) -> Iterator[tuple[Loop, tuple[str, int], Line]]:
    """A loop in a thread, quiet long enough to take a controller; its address, and the companion's end."""
    ours, theirs = pair()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        loop = Loop(port, wire or RsiWire([1.0] * 6), correction, ours, CYCLE_S, GONE_S, expected)
        thread = threading.Thread(target=loop.run)
        thread.start()
        try:
            until_quiet(loop)
            yield loop, port.getsockname(), Line(theirs)
        finally:
            loop.leave()
            thread.join(10)
            ours.close()
            theirs.close()


def elbow_off_mm(q: Floats, offset: Floats) -> float:
    """How far the tool of a planar arm with two wrong links and a wrong zero is from where a nominal one has it, mm."""

    def tip(first: float, second: float, a: float, b: float) -> complex:
        return a * complex(math.cos(first), math.sin(first)) + b * complex(
            math.cos(first + second), math.sin(first + second)
        )

    return abs(tip(q[0] + offset[0], q[1] + offset[1] + 0.0014, 300.6, 199.5) - tip(q[0], q[1], 300.0, 200.0))


def elbow_offsets(elbow: float) -> Floats:
    """The two offsets that bring that tool where a nominal arm has it, in closed form: with the elbow on the same side."""
    a, b = 300.6, 199.5
    reach = math.sqrt(300.0**2 + 200.0**2 + 2 * 300.0 * 200.0 * math.cos(elbow))
    real = math.copysign(math.acos((reach * reach - a * a - b * b) / (2 * a * b)), elbow)
    before = math.atan2(200.0 * math.sin(elbow), 300.0 + 200.0 * math.cos(elbow))
    after = math.atan2(b * math.sin(real), a + b * math.cos(real))
    return np.array([before - after, real - elbow - 0.0014])


def test_where_offsets_are_held_back_the_arm_is_off_less_than_without_them() -> None:
    """Near a stretched elbow two large offsets make up for each other: none may go ahead of the other."""
    for largest_deg, rate_deg_s in ((5.0, 0.2), (0.1, 100.0)):
        guard = Guard(2, math.radians(largest_deg), math.radians(rate_deg_s), 0.1, CYCLE_S)
        held, off_mm, without_mm = 0, 0.0, 0.0
        for k in range(2500):
            q = np.array([0.5, math.radians(20.0 - 14.0 * math.sin(1.5 * k * CYCLE_S))])
            wanted = elbow_offsets(float(q[1]))
            assert elbow_off_mm(q, wanted) < 1e-9
            offset = np.array(guard.follow(wanted.tolist()))
            if k > 50:  # it is ramped in
                held += bool(np.abs(offset - wanted).max() > 1e-4)
                off_mm, without_mm = max(off_mm, elbow_off_mm(q, offset)), max(without_mm, elbow_off_mm(q, 0 * q))
        assert held > 1000
        assert off_mm < 0.75 * without_mm


def test_the_guard_bounds_whatever_it_is_given(guard: Guard) -> None:
    rng = np.random.default_rng(1)
    before = np.zeros(6)
    for k in range(4000):
        wanted = rng.normal(size=6) * 10.0 ** rng.uniform(-6, 3)
        wanted[rng.integers(6)] = rng.choice([math.nan, math.inf, -math.inf, 0.0, 1e-3])
        offset = np.array(guard.follow(None if k % 7 == 0 else wanted.tolist()))
        assert np.isfinite(offset).all()
        assert np.abs(offset).max() <= LARGEST_RAD
        assert np.abs(offset - before).max() <= RATE_RAD_S * CYCLE_S * (1 + 1e-9)
        before = offset
    assert before.any()
    steps = 0
    while not guard.out:
        guard.follow(None)
        steps += 1
    assert steps <= round(LARGEST_RAD / RATE_RAD_S / CYCLE_S) + 26


def settle(correction: Correction, q: Sequence[float] | None, cycles: int = 600) -> np.ndarray:
    """Offsets after so many cycles; none of them jumps."""
    found = [np.array(correction.step(q)) for _ in range(cycles)]
    assert np.abs(np.diff(found, axis=0)).max() <= RATE_RAD_S * CYCLE_S * (1 + 1e-9)
    return found[-1]


def test_a_version_that_is_off_foreign_or_damaged_gives_nothing_until_a_good_one_comes(correction: Correction) -> None:
    q = [math.radians(value) for value in Q_DEG]
    first = settle(correction, q)
    assert np.abs(first).max() > 1e-5
    for kind, text, said in (
        (Kind.OFF, b"version v0 is retired", "is retired"),
        (Kind.PROGRAM, content(3, robot="cell8"), "is of robot cell8, not of cell7"),
        (Kind.PROGRAM, content(4, preset="katana450-chapter4"), "is for 5 joints, not 6"),
        (Kind.PROGRAM, content(5)[:-9], "cannot be used.*cut off"),
    ):
        correction.hear(kind, text)
        assert not settle(correction, q).any()
        document = correction.document()
        assert document["state"] == "off"
        assert re.search(said, document["why"])
        assert document["version_id"] == "v0"
        correction.hear(Kind.PROGRAM, content())
        assert np.allclose(settle(correction, q), first, atol=1e-9)
        assert correction.document()["state"] == "correcting"
    correction.hear(Kind.PROGRAM, content(9))
    assert np.abs(settle(correction, q) - first).max() > 1e-5  # another version, ramped to
    assert correction.document()["version_id"] == "v9"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (content(robot="cell8"), "version v0 is of robot cell8, not of cell7"),
        (content(preset="katana450-chapter4", robot="cell8"), "version v0 is of robot cell8, not of cell7"),
        (content(preset="katana450-chapter4"), "version v0 is for 5 joints, not 6"),
    ],
)
def test_one_that_begins_with_the_version_of_another_arm_says_so_and_offsets_nothing(
    correction: Correction, text: bytes, said: str
) -> None:
    q = [math.radians(value) for value in Q_DEG]
    wrong = Correction(from_bytes(text), "cell7", Guard(6, LARGEST_RAD, RATE_RAD_S, 0.1, CYCLE_S), CYCLE_S)
    assert wrong.joints == 6
    assert settle(wrong, q).tolist() == [0.0] * 6
    assert wrong.document()["state"] == "off"
    assert wrong.document()["why"] == said
    wrong.hear(Kind.PROGRAM, content())
    assert np.allclose(settle(wrong, q), settle(correction, q), atol=1e-9)
    assert wrong.document()["version_id"] == "v0"


def test_a_controller_that_sends_nonsense_gets_bounded_offsets_that_go_out(
    correction: Correction, controllers: Make
) -> None:
    with looping(correction) as (loop, address, _):
        controller, ipoc = controllers(address), 1800
        for k in range(1000, ipoc, 4):
            assert controller.ask(message(k)) is not None
        good = np.array(correction.offset)
        assert np.abs(good).max() > 1e-5
        for wrong in (Q_DEG[:5], ("nan", *Q_DEG[1:]), ("1e999", *Q_DEG[1:]), ("x", *Q_DEG[1:]), (400.0, *Q_DEG[1:])):
            before = np.array(correction.offset)
            answer = controller.ask(message(ipoc := ipoc + 4, wrong))
            assert answer is not None
            assert f"<IPOC>{ipoc}</IPOC>".encode() in answer
            assert np.abs(np.radians(offsets(answer)) - before).max() <= RATE_RAD_S * CYCLE_S + 1e-8
        for rubbish in (b"", b"\0" * 1400, b"<Rob>", b"<Sen><IPOC>5</IPOC></Sen>", message(ipoc + 8)[:-12]):
            assert controller.ask(rubbish, 0.1) is None
        for _ in range(200):
            controller.ask(message(ipoc := ipoc + 4, Q_DEG[:5]))
        assert correction.out
        assert controller.ask(message(ipoc), 0.1) is None  # an old stamp
        document = json.loads(json.dumps(loop.document()))
        assert document["counts"]["malformed"] == 5
        assert document["counts"]["old_stamp"] == 1
        assert document["controller_missed"] == 3
        assert document["refused"]["BAD_FRAME"] >= 202
        assert document["refused"]["NOT_FINITE"] == 2
        assert document["refused"]["JOINT_LIMIT"] + document["refused"].get("RATE_LIMIT", 0) >= 1


def test_a_second_controller_gets_no_answer_until_the_first_has_gone(correction: Correction, controllers: Make) -> None:
    with looping(correction) as (loop, address, _):
        first, second = controllers(address), controllers(address)
        for k in range(1, 100):
            assert first.ask(message(4 * k)) is not None
            if k % 33 == 0:
                assert second.ask(message(4 * k + 2), 0.1) is None
        assert loop.counts["other_controller"] == 3
        until_quiet(loop)
        answer = second.ask(message(4))
        assert answer is not None
        assert np.abs(np.radians(offsets(answer))).max() <= RATE_RAD_S * CYCLE_S + 1e-8  # begins at nothing


@pytest.mark.parametrize("lost", [1, 10, 50, 100])
def test_lost_cycles_are_counted_and_the_offsets_go_on_from_where_they_are(
    correction: Correction, controllers: Make, lost: int
) -> None:
    with looping(correction) as (loop, address, _):
        controller, ipoc = controllers(address), 600
        for k in range(4, ipoc, 4):
            assert controller.ask(message(k)) is not None
        before, counted = np.array(correction.offset), loop.counts["lost"]
        time.sleep((lost + 0.5) * CYCLE_S)
        answer = controller.ask(message(ipoc + 4 * lost))
        assert answer is not None
        if (loop.counts["lost"] - counted + 1) * CYCLE_S < GONE_S:  # a busy machine may have made it a restart
            assert np.abs(np.radians(offsets(answer)) - before).max() <= RATE_RAD_S * CYCLE_S + 1e-8
        assert loop.counts["lost"] - counted >= lost - 1


class HeldUp(RsiWire):
    """Messages whose first answer takes as long as the test wants."""

    def __init__(self, go_on: threading.Event) -> None:
        super().__init__([1.0] * 6)
        self._go_on = go_on

    def answer(self, request: Request, offset: Sequence[float]) -> bytes:
        self._go_on.wait(10.0)
        return super().answer(request, offset)


@pytest.mark.parametrize("held_up_s", [0.0, 2 * GONE_S])
def test_of_requests_that_wait_only_the_newest_is_answered_and_none_after_a_long_pause_of_the_bridge(
    correction: Correction, controllers: Make, held_up_s: float
) -> None:
    go_on = threading.Event()
    with looping(correction, HeldUp(go_on)) as (loop, address, _):
        controller = controllers(address)
        for k in range(1, 22):
            controller.socket.send(message(4 * k))
            time.sleep(0.02 if k == 1 else 0.0)
        time.sleep(held_up_s)
        go_on.set()
        controller.socket.settimeout(10.0)
        assert b"<IPOC>4</IPOC>" in controller.socket.recv(2048)
        controller.socket.settimeout(0.1)
        if held_up_s:  # it may have stopped meanwhile, and hold nothing any more
            assert controller.ask(message(100), 0.2) is None
            assert loop.document()["state"] == "refusing"
            until_quiet(loop)
            answer = controller.ask(message(200))
            assert answer is not None
            assert np.abs(np.radians(offsets(answer))).max() <= RATE_RAD_S * CYCLE_S + 1e-8
        else:
            controller.socket.settimeout(10.0)
            assert b"<IPOC>84</IPOC>" in controller.socket.recv(2048)
            controller.socket.settimeout(0.1)
            with pytest.raises(TimeoutError):
                controller.socket.recv(2048)
        assert loop.counts["late"] >= 19


def test_a_request_is_late_where_its_answer_is_sent_more_than_a_cycle_after_it_came(
    correction: Correction, controllers: Make
) -> None:
    go_on = threading.Event()
    with looping(correction, HeldUp(go_on)) as (loop, address, _):
        controller = controllers(address)
        controller.socket.settimeout(10.0)
        controller.socket.send(message(4))
        time.sleep(0.05)
        controller.socket.send(message(8))  # it waits while the first is held up, and is then answered at once
        time.sleep(10 * CYCLE_S)
        go_on.set()
        for ipoc in (b"4", b"8"):
            assert b"<IPOC>" + ipoc + b"</IPOC>" in controller.socket.recv(2048)
        end = time.monotonic() + 10.0
        while loop.counts["answered"] < 2:
            assert time.monotonic() < end
            time.sleep(0.01)
        assert loop.counts["late"] == 2


def test_a_companion_that_is_killed_or_hangs_does_not_stop_the_answers(
    correction: Correction, controllers: Make
) -> None:
    with looping(correction) as (_, address, line):
        controller = controllers(address)
        correction.server = "x" * 100_000  # states that nobody reads fill the line
        for k in range(1, 40):
            if k == 20:
                line.close()
            assert controller.ask(message(4 * k)) is not None
            time.sleep(0.05)


def test_axes_that_turn_the_other_way_and_actual_joints() -> None:
    wire = RsiWire([1.0, -1.0], From.ACTUAL)
    request = wire.read(message(8, (10.0, 20.0), "AIPos"))
    assert request is not None
    assert np.allclose(np.degrees(request.joints or ()), (10.0, -20.0))
    answer = wire.answer(request, np.radians([0.5, 0.25]).tolist())
    assert offsets(answer) == [0.5, -0.25, 0, 0, 0, 0]
    request = wire.read(message(12, (10.5, 19.75), "AIPos"))  # the arm follows
    assert request is not None
    assert np.allclose(np.degrees(request.joints or ()), (10.0, -20.0))


@pytest.mark.parametrize(("apart", "cycles"), [(4, 1), (12, 3), (1, None), (6, None)])
def test_stamps_tell_the_cycles_where_they_count_milliseconds(apart: int, cycles: int | None) -> None:
    assert RsiWire([1.0]).cycles(apart) == cycles


def test_who_makes_lost_cycles_up_may_change_the_offset_by_what_they_allow() -> None:
    """A bridge that smooths what comes after a loss: bounded by the time that passed, one that does not by a cycle."""
    slow, fast = (Guard(2, LARGEST_RAD, RATE_RAD_S, CYCLE_S, CYCLE_S) for _ in range(2))
    wanted = (0.9 * LARGEST_RAD, -0.4 * LARGEST_RAD)
    one, ten = np.array(slow.follow(wanted)), np.array(fast.follow(wanted, 10))
    assert np.abs(one).max() == pytest.approx(RATE_RAD_S * CYCLE_S)
    assert ten == pytest.approx(10.0 * one)
    ramped = Guard(2, LARGEST_RAD, 100.0, 10 * CYCLE_S, CYCLE_S)
    ramped.follow(wanted, 5)
    assert ramped.share == pytest.approx(0.5)


@pytest.mark.parametrize("late_ones_count", [False, True])
def test_answers_that_a_controller_misses_make_no_larger_step_of_the_one_that_it_takes(late_ones_count: bool) -> None:
    """It holds its offset meanwhile: the next answer must not be two steps away, whether or not late ones count after all."""
    rng = np.random.default_rng(7)
    guard = Guard(2, LARGEST_RAD, RATE_RAD_S, 0.1, CYCLE_S)
    force, missed, steps, wanted = np.zeros(2), False, [], np.zeros(2)
    for k in range(4000):
        if k % 50 == 0:
            wanted = rng.uniform(-1.5, 1.5, 2) * LARGEST_RAD
        late = np.array(guard.offset)
        new = np.array(guard.follow(wanted.tolist(), taken=not missed))
        if missed and late_ones_count:
            steps.append(np.abs(late - force).max())
            force = late
        missed = bool(rng.random() < 0.3)
        if not missed:
            steps.append(np.abs(new - force).max())
            force = new
    assert max(steps) <= RATE_RAD_S * CYCLE_S * (1 + 1e-9)
    assert np.abs(force).max() > 0.0


def test_a_controller_that_counts_missed_answers_is_led_on_from_the_offset_that_it_holds(
    correction: Correction, controllers: Make
) -> None:
    with looping(correction) as (_, address, _):
        controller, force, steps, missed = controllers(address), np.zeros(6), [], 0
        for k in range(120):
            asked = message(1000 + 4 * k).replace(b'D="3"', f'D="{missed}"'.encode())
            answer = controller.ask(asked)
            assert answer is not None
            if k % 3 == 1:  # it comes too late for the controller
                missed += 1
                continue
            new = np.radians(offsets(answer))
            steps.append(np.abs(new - force).max())
            force = new
        assert force.any()
        assert max(steps) <= RATE_RAD_S * CYCLE_S * 1.001 + 2e-8  # of the digits of an answer


def test_it_ends_once_the_controller_had_the_answer_that_takes_the_offsets_out(
    correction: Correction, controllers: Make
) -> None:
    with looping(correction) as (loop, address, _):
        controller, force, missed, zeros = controllers(address), [1.0], 0, 0
        for k in range(3000):
            if k == 100:
                loop.leave()
            asked = message(1000 + 4 * k).replace(b'D="3"', f'D="{missed}"'.encode())
            answer = controller.ask(asked, 2.0)
            if answer is None:
                break
            zeros += not any(offsets(answer))
            if zeros in (1, 2, 3) and k > 100:  # these come too late for the controller
                missed += 1
            else:
                force = offsets(answer)
        assert k < 2999
        assert missed == 3
        assert not any(force)


def test_the_controller_is_answered_though_another_one_asked_while_the_bridge_was_held_up(
    correction: Correction, controllers: Make
) -> None:
    go_on = threading.Event()
    with looping(correction, HeldUp(go_on)) as (loop, address, _):
        first, second = controllers(address), controllers(address)
        first.socket.settimeout(10.0)
        first.socket.send(message(4))
        time.sleep(0.05)
        second.socket.send(message(8))
        time.sleep(0.05)
        first.socket.send(message(8))
        second.socket.send(message(12))
        time.sleep(0.05)
        go_on.set()
        for ipoc in (b"4", b"8"):
            assert b"<IPOC>" + ipoc + b"</IPOC>" in first.socket.recv(2048)
        second.socket.settimeout(0.2)
        with pytest.raises(TimeoutError):
            second.socket.recv(2048)
        assert loop.counts["other_controller"] == 2


def test_off_is_said_once_nothing_is_offset(correction: Correction, guard: Guard) -> None:
    """Offsets that came in over seconds go out no faster, however short the ramp is."""
    q = np.radians(Q_DEG)
    for _ in range(2000):
        correction.step(q.tolist())
    assert correction.document()["state"] == "correcting"
    correction.hear(Kind.OFF, b"asked for")
    states = []
    for _ in range(2000):
        offset = correction.step(q.tolist())
        states.append(correction.document()["state"])
        assert (states[-1] == "off") == (not any(offset))
        assert guard.out == (states[-1] == "off")
    assert states[0] == "fading out"
    assert states[-1] == "off"


def test_a_loop_without_collections_leaves_what_its_process_has_frozen() -> None:
    frozen = gc.get_freeze_count()
    assert frozen > 0, "tests/conftest.py has frozen what was imported"
    with without_collections():
        assert not gc.isenabled()
    assert gc.isenabled()
    assert gc.get_freeze_count() == frozen
