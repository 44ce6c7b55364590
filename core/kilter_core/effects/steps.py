"""What moved once, or sits elsewhere in every session: base, tool, and the zero of a joint."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.arm.run_time import RunTimeForm
from kilter_core.effects.base import BASE, TOOL, TWIST, Effect, Local, frame_twists, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.laws import Step
from kilter_core.effects.physical import JOINT_ZERO, STATION, TOOL_SHIFT
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats


@dataclass(frozen=True)
class FrameStep(Step):
    """A frame moved by a twist between two rows, in its own axes."""

    frame: ClassVar[str]
    place: ClassVar[int]
    at_joints = False

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """How far it moved along x, y, z of its own axes, m, then about them, rad."""
        return tuple(
            Parameter(f"step_{self.frame}_{k}", unit, 0.0, 5e-3, -0.1, 0.1, f"how far the {self.frame} moved: its {k}")
            for k, unit in TWIST
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the frame and its derivatives by how far it moved."""
        before = -batch.before_event_indicator(self.at_s, self.at_row)
        return frame_twists(batch, values, self.place, np.eye(6)[:, None, :] * before[:, None])


@dataclass(frozen=True)
class BaseStep(FrameStep):
    """The base frame moved by a twist between two rows, in its own axes."""

    id = "base_step"
    summary = "base or instrument moved once, between two rows"
    physical = STATION
    stage = "base"
    aliases = ("drift", "settling", "random_walk", "zero_step")
    remedy = "give the rows before and after it a session each, and let every session have a base of its own"
    frame, place = "base", BASE

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add nothing: what moves now does so after it."""
        return True


@dataclass(frozen=True)
class ToolStep(FrameStep):
    """The tool frame moved by a twist between two rows, in its own axes.

    Points of one reflector show no rotation about it.
    """

    id = "tool_step"
    summary = "tool, marker or nest moved once, between two rows"
    physical = TOOL_SHIFT
    stage = "measurement"
    aliases = ("session_shift", "base_step")
    remedy = "give the rows before and after it a session each, and let every session have a tool of its own"
    frame, place = "tool", TOOL


@dataclass(frozen=True)
class ZeroStep(Step):
    """The zero of a joint jumped by d between two rows: dq was less by d before it."""

    id = "zero_step"
    summary = "zero of a joint jumped once, between two rows"
    physical = JOINT_ZERO
    stage = "joint"
    aliases = ("zero_drift", "zero_thermal", "base_step")
    remedy = "measure again without what came before it, and find out what knocked or slipped"

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Jump d per joint, rad."""
        return self.per_joint(robot, "zero_step", "rad", 5e-3, -0.2, 0.2, "jump of the joint's zero")

    def local(self, batch: Batch, values: Floats) -> Local:
        """Joint correction and its derivative by the jump."""
        before = -batch.before_event_indicator(self.at_s, self.at_row)
        return self.joint_angle(batch, values, np.broadcast_to(before[:, None], batch.q.shape))

    def at_run_time(self, form: RunTimeForm, values: Floats) -> bool:
        """Add nothing: what moves now does so after it."""
        return True


WIDTHS = {"m": (1e-3, -0.01, 0.01), "rad": (1e-2, -0.1, 0.1)}  # prior sigma and plausible range, by unit


@dataclass(frozen=True)
class SessionShift(Effect):
    """A constant twist of the tool frame, in its own axes, for each of the ``sessions`` after the first.

    The first session is the reference, as is any session that is not named. Points of one reflector show no rotation.
    """

    id = "session_shift"
    summary = "markers or reflector mounted anew between sessions"
    physical = TOOL_SHIFT
    source = "marker misplacement: constant in the tool frame per session"
    needs = frozenset({"session"})
    stage = "measurement"
    aliases = ("drift",)
    remedy = "repeat some poses of the first session in every other one, with a session number in every row"
    at_joints = False

    sessions: tuple[int, ...] = option(
        (), "Session numbers, the reference first; a session that is not named counts as the reference."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "sessions", tuple(int(code) for code in self.sessions))
        if len(self.sessions) == 1 or len(set(self.sessions)) < len(self.sessions):
            raise OptionError("session_shift needs two or more different sessions.", effect=self.id)

    def configure_for_robot(self, robot: Robot, rows: Observations | None = None) -> Self:
        """Take the sessions from the rows, in ascending order."""
        if self.sessions or rows is None or rows.session is None:
            return self
        return replace(self, sessions=tuple(np.unique(rows.session).tolist()))

    def parameters(self, robot: Robot) -> tuple[Parameter, ...]:
        """Shift along x, y, z of the tool frame per later session, m, then rotation about them, rad.

        Raises:
            OptionError: no sessions are known.

        """
        if not self.sessions:
            raise OptionError(
                "session_shift needs sessions: upload a session in every row, or give the session numbers.",
                effect=self.id,
            )
        return tuple(
            Parameter(f"session_{code}_{k}", unit, 0.0, *WIDTHS[unit], f"how the tool moved to session {code}: its {k}")
            for code in self.sessions[1:]
            for k, unit in TWIST
        )

    def local(self, batch: Batch, values: Floats) -> Local:
        """Twist of the tool and its derivatives by how it moved."""
        session = self.column(batch, "session")
        shifts = [axis * (session == code)[:, None] for code in self.sessions[1:] for axis in np.eye(6)]
        return frame_twists(batch, values, TOOL, shifts)
