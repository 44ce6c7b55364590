"""Commands that come late to a Franka robot: none is sent, so that robot and simulator take the same motion for granted."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from types import SimpleNamespace

import numpy as np
import pytest

from kilter_client.bridges.correction import Correction, Guard, Line, pair
from kilter_client.bridges.fci import Fci, Rejoined
from kilter_client.bridges.plan import Setpoints, Table
from kilter_core.correct.file import from_bytes, to_bytes
from tests.clients.bridges.franka_arm import table
from tests.clients.bridges.franka_judge import CYCLE_S, MOST_RAD_S2, MOST_RAD_S3, NONE, Floats, Judge
from tests.core.correct.test_c_corrector import program_of

ROWS = table(8.0, 0.3)
PROGRAM = to_bytes(program_of("panda"), version_id="v0", number=1, robot="cell7")
Stall = Callable[[int], float]


@pytest.fixture
def line() -> Iterator[Line]:
    ours, theirs = pair()
    with theirs:
        yield ours
        ours.close()


@pytest.fixture(scope="module")
def undisturbed() -> Judge:
    ours, theirs = pair()
    with theirs:
        judge = moved(ours, lambda _: 0.0002)[0]
        ours.close()
    return judge


def franka(judge: Judge) -> SimpleNamespace:
    """The robot's library, as far as a bridge uses it."""
    return SimpleNamespace(
        RealtimeConfig=SimpleNamespace(kIgnore=0, kEnforce=1),
        ControllerMode=SimpleNamespace(JointImpedance=0),
        FrankaException=RuntimeError,
        JointPositions=lambda q: SimpleNamespace(q=q, motion_finished=False),
        Robot=lambda *_: SimpleNamespace(start_joint_position_control=lambda _: judge),
    )


class Stalled(Correction):
    """A correction, and the time that passes while it computes: that of a busy machine."""

    def stall(self, judge: Judge, seconds: Stall) -> None:
        self._judge, self._seconds, self._cycles = judge, seconds, 0

    def step(self, q: object, cycles: int = 1) -> tuple[float, ...]:
        self._cycles += 1
        self._judge.now_s += self._seconds(self._cycles)
        return super().step(q, cycles)  # type: ignore[arg-type]


def moved(
    line: Line,
    seconds: Stall,
    drops: bool = False,
    held_s: Mapping[int, float] = NONE,
    stands_s: Mapping[int, float] = NONE,
) -> tuple[Judge, Fci]:
    """The table played by a bridge that takes so long for its answers, and has states so long after they came."""
    rows = [tuple(row) for row in ROWS[:, 1:].tolist()]
    judge = Judge(rows[0], drops, held_s, stands_s)
    guard = Guard(7, math.radians(1.0), math.radians(5.0), 0.2, CYCLE_S)
    correction = Stalled(from_bytes(PROGRAM), "cell7", guard, CYCLE_S, makes_up=True)
    correction.stall(judge, seconds)
    setpoints = Setpoints(Table(ROWS[:, 0].tolist(), rows), math.radians(200.0), CYCLE_S)
    fci = Fci(franka(judge), "robot", setpoints, correction, line, realtime=False, clock=lambda: judge.now_s)
    fci.run()
    return judge, fci


def apart(one: Judge, other: Judge) -> float:
    """The largest distance of two motions, rad; both ran by the same cycles."""
    rows = min(len(one.told), len(other.told))
    return float(np.abs(np.array(one.told[:rows]) - np.array(other.told[:rows])).max())


@pytest.mark.parametrize(
    ("stall_ms", "drops"),
    [([1.5], True), ([4.5, 1.2], False), ([9.5, 1.2, 1.2], True), ([17.5], True), ([17.5], False)],
)
def test_answers_that_are_late_are_not_sent_and_the_arm_stays_on_its_way(
    line: Line, undisturbed: Judge, stall_ms: list[float], drops: bool
) -> None:
    """By the simulator that goes back for a late one and by the robot that drops it."""
    late = {at + k: 0.001 * one for at in (2500, 3700, 4900) for k, one in enumerate(stall_ms)}
    judge, fci = moved(line, lambda cycle: late.get(cycle, 0.0002), drops)
    assert (
        len(late) <= fci.counts["late"] <= len(late) + 3
    )  # one whose state waited in the socket while another was late
    assert max(judge.curves) < 0.7 * MOST_RAD_S2
    assert max(judge.jerks) < 0.2 * MOST_RAD_S3
    assert apart(judge, undisturbed) < 2.5e-5


@pytest.mark.parametrize(
    ("held_ms", "then_ms", "drops"), [(2.3, 0.2, True), (2.3, 1.2, False), (9.5, 0.2, False), (9.5, 1.2, True)]
)
def test_held_up_while_it_waits_it_answers_no_state_whose_cycle_is_over(
    line: Line, undisturbed: Judge, held_ms: float, then_ms: float, drops: bool
) -> None:
    """It is woken late with a state that came in time, and cannot tell by how long it took for the answer."""
    held = dict.fromkeys((2500, 3700, 4900), 0.001 * held_ms)
    slow = {at + 1: 0.001 * then_ms for at in held}
    judge, fci = moved(line, lambda cycle: slow.get(cycle, 0.0002), drops, held)
    assert fci.counts["late"] >= len(held)
    assert max(judge.curves) < 0.7 * MOST_RAD_S2
    assert max(judge.jerks) < 0.2 * MOST_RAD_S3
    assert apart(judge, undisturbed) < 2.5e-5


@pytest.mark.parametrize("drops", [True, False])
def test_a_machine_that_stays_slow_after_it_was_held_up_does_not_lose_the_robot(line: Line, drops: bool) -> None:
    """As one was seen to, simulator and bridge: 13 ms, then answers that take several times as long and become faster again."""
    slow_ms = [2.2, 1.7, 1.2, 1.1, 1.0, 0.9, 0.9, *[0.85] * 10, *[0.7] * 25]
    slow = {at + k: 0.001 * one for at in (2500, 4900) for k, one in enumerate(slow_ms)}
    judge, fci = moved(line, lambda cycle: slow.get(cycle, 0.0002), drops, stands_s=dict.fromkeys((2500, 4900), 0.013))
    assert fci.counts["late"] > 20
    assert judge.most_missed < 20
    assert max(judge.curves) < MOST_RAD_S2
    assert max(judge.jerks) < MOST_RAD_S3


def test_a_robot_that_stands_still_for_a_while_is_answered_again_at_its_next_state(
    line: Line, undisturbed: Judge
) -> None:
    """Its late state is the newest and looks like one that had to wait: one cycle is lost, no more."""
    stands = {2500: 0.0044, 3700: 0.0044, 4900: 0.05}
    judge, fci = moved(line, lambda _: 0.0002, stands_s=stands)
    assert fci.counts["late"] == len(stands)
    assert max(judge.curves) < 0.7 * MOST_RAD_S2
    assert apart(judge, undisturbed) < 2.5e-5


def test_without_that_the_simulator_finds_a_jump_of_speed() -> None:
    """Sent late, and the next one too: it goes on from the late one by one cycle, and judges that by all that passed."""
    rows: Floats = ROWS[:, 1:]
    rejoined, judge, at, answers = Rejoined(), Judge(tuple(rows[0])), 0, 0
    while at < 4000:
        state, passed = judge.readOnce()
        cycles = round(passed.to_sec() / CYCLE_S) if at else 1
        at, answers = at + cycles, answers + 1
        command = rejoined.command(tuple(rows[at]), cycles, state)
        judge.now_s += {3700: 0.0045, 3701: 0.0012}.get(answers, 0.0002)
        judge.writeOnce(SimpleNamespace(q=command))
    assert max(judge.curves) > MOST_RAD_S2
