"""Tool that sits elsewhere in every session: markers, reflector, camera or board mounted again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.effects.base import TOOL, TWIST, Derivative, Effect, Local, linear, option
from kilter_core.effects.batch import Batch
from kilter_core.effects.physical import TOOL_SHIFT
from kilter_core.errors import OptionError
from kilter_core.observations import Observations
from kilter_core.parameters import Parameter
from kilter_core.types import Floats

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
        return linear(batch, values, [Derivative(k, TOOL, xi=xi) for k, xi in enumerate(shifts)])
