"""Franka Control Interface: joint positions at 1 kHz through libfranka. The bridge plays a table, corrected."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from kilter_client.bridges.loop import without_collections
from kilter_client.bridges.news import Line
from kilter_client.bridges.plan import Setpoints, smooth
from kilter_client.errors import KilterError

if TYPE_CHECKING:
    from kilter_client.bridges.correction import Correction

CYCLE_S = 0.001
JOINTS = 7
REJOIN_S = 0.1
Joints = tuple[float, ...]
BRAKE_S = 1.0  # in which the plan is brought to rest when the bridge is ended


class FrankaError(KilterError):
    """The robot does not answer, or it stopped the motion."""

    default_code = "robot_stopped"
    default_title = "Robot stopped"


class Rejoined:
    """Commands that go on smoothly where cycles were lost.

    The robot extrapolates what it misses. What it is off from the intended joints then, in position and speed, fades out
    over ``REJOIN_S``; without losses the command is what was intended.
    """

    def __init__(self) -> None:
        self._intended: Joints = ()
        self._off: Joints = ()
        self._off_rad_s: Joints = ()
        self._speed: Joints = ()  # to go on with; that of what is intended is known at the next cycle
        self._since_s = REJOIN_S

    def command(self, intended: Joints, cycles: int, state: Any) -> Joints:
        """Return the joints (n,) rad to send for those intended, ``cycles`` after the last ones."""
        before, self._intended = self._intended, intended
        if cycles > 1 and before:
            return self._go_on(intended, state)
        if self._speed:
            step_s = cycles * CYCLE_S
            aims = [(new - old) / step_s for new, old in zip(intended, before, strict=True)]
            self._off_rad_s = tuple(now - aim for now, aim in zip(self._speed, aims, strict=True))
            self._speed = ()
        self._since_s += cycles * CYCLE_S
        if self._since_s >= REJOIN_S:
            return intended
        u = self._since_s / REJOIN_S
        place = 1.0 - smooth(u)
        slope = REJOIN_S * (u + u**3 * (-6.0 + u * (8.0 - 3.0 * u)))  # from slope 1 to 0; all else is 0 at both ends
        return tuple(
            aim + place * off + slope * off_rad_s
            for aim, off, off_rad_s in zip(intended, self._off, self._off_rad_s, strict=True)
        )

    def _go_on(self, intended: Joints, state: Any) -> Joints:
        """Go on from where the robot extrapolated to, as it moves there."""
        speed, self._speed = (
            tuple(dq + cycles * CYCLE_S * ddq for dq, ddq in zip(state.dq_d, state.ddq_d, strict=True))
            for cycles in (1, 2)
        )
        command = tuple(q + CYCLE_S * dq for q, dq in zip(state.q_d, speed, strict=True))
        self._off = tuple(q - aim for q, aim in zip(command, intended, strict=True))
        self._since_s = 0.0
        return command


class Fci:
    """One motion of one robot: from where it stands along the plan, and to rest.

    Args:
        franka: the module ``pylibfranka``.
        address: of the robot.
        setpoints: what is played; its cycle is that of the interface.
        correction: what offsets the joints.
        line: to the companion.
        realtime: refuse to run without a real-time kernel and priority, as libfranka does by itself.

    """

    def __init__(
        self, franka: Any, address: str, setpoints: Setpoints, correction: Correction, line: Line, realtime: bool
    ) -> None:
        self._franka, self._address, self._realtime = franka, address, realtime
        self._setpoints, self._correction, self._line = setpoints, correction, line
        self._pace, self._leaving = 1.0, False
        self._success: float | None = None
        self._rejoined = Rejoined()
        self.counts: Counter[str] = Counter()

    def leave(self) -> None:
        """Bring the plan to rest and fade the offsets out, then end."""
        self._leaving = True

    def run(self) -> None:
        """Move to the end of the plan, or until :meth:`leave`.

        Raises:
            FrankaError: the robot does not answer, or it stopped the motion.

        """
        realtime = self._franka.RealtimeConfig.kEnforce if self._realtime else self._franka.RealtimeConfig.kIgnore
        try:
            with without_collections():
                robot = self._franka.Robot(self._address, realtime)
                control = robot.start_joint_position_control(self._franka.ControllerMode.JointImpedance)
                while not self._cycle(control):
                    pass
        except (self._franka.FrankaException, RuntimeError) as error:  # most of its exceptions are only the latter
            raise FrankaError(f"The robot at {self._address} stopped: {error}") from error

    def _cycle(self, control: Any) -> bool:
        """One cycle; whether the motion is over."""
        state, passed = control.readOnce()
        cycles = max(1, round(passed.to_sec() / CYCLE_S)) if self.counts["answered"] else 1
        self.counts["lost"] += cycles - 1
        if not self.counts["answered"]:
            self._begin(state)
        wanted = self._setpoints.step(cycles, self._pace) or tuple(state.q_d)
        offset = self._correction.step(wanted, cycles)
        intended = tuple(q + one for q, one in zip(wanted, offset, strict=True))
        self._success = float(state.control_command_success_rate)
        command = self._franka.JointPositions(list(self._rejoined.command(intended, cycles, state)))
        at_rest = self._setpoints.ended or self._pace == 0.0
        if at_rest:
            self._correction.off = "the motion is over"
        command.motion_finished = over = at_rest and self._correction.out
        control.writeOnce(command)
        self.counts["answered"] += 1
        if self._leaving:
            self._pace = max(0.0, self._pace - cycles * CYCLE_S / BRAKE_S)
        while (packet := self._line.receive()) is not None:
            self._correction.hear(*packet)
        self._line.tell(self.document)
        return bool(over)

    def _begin(self, state: Any) -> None:
        """Stand where the robot is told to stand already."""
        self._correction.begin()
        self._setpoints.begin(state.q_d)

    def document(self) -> dict[str, Any]:
        """The state, JSON-able."""
        return self._correction.document() | {
            "controller": self._address,
            "counts": dict(self.counts + self._setpoints.counts),
            "controller_missed": None,
            "command_success_rate": self._success,
            "cycle_s": CYCLE_S,
        }
