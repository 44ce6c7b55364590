"""From a calibration to the flat program of the correction kernel, and the calls that use it.

The stream, the trajectory query and the correction over HTTP all run the same kernel; :mod:`core.compensate` is the
readable twin it is tested against.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from core.chain import Axis, Chain, Element
from core.effects import Effect
from core.effects.axial_compliance import AxialCompliance
from core.effects.backlash import Backlash
from core.effects.backlash_load import BacklashLoad
from core.effects.clearance_tilt import ClearanceTilt
from core.errors import OptionError
from core.folding import fold, write_bodies, write_moves
from core.kernels import correction as kernel
from core.model import Calibration
from core.robot import Joint, Robot

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Task = Literal["auto", "position", "axis", "pose"]

_ROWS: Mapping[str, tuple[int, ...]] = {"position": (0, 1, 2), "axis": (0, 1, 2, 3, 4), "pose": (0, 1, 2, 3, 4, 5)}
ROW_NAMES = ("x", "y", "z", "rx", "ry", "rz")  # turns are about the axes of the tool


@dataclass(frozen=True)
class CorrectionOptions:
    """How a correction is made and bounded.

    ``task`` "position" holds the tool point, "axis" also the direction of the tool's z, "pose" all six rows; "auto" is
    "pose" from six joints on, else "position". ``orientation_weight_m`` is what a radian of the tool counts in metres.
    Limits: ``largest_rad`` and ``largest_m`` per joint, ``farthest_m`` at the tool point. ``rate_rad_s`` and
    ``rate_m_s`` bound how fast the effects with a sign (clearance, backlash) may change the correction;
    ``least_softening_nm`` softens their sign where the effect itself does not. ``ramp_s`` is the time of a change of
    version. ``filter_hz`` > 0 derives speeds and accelerations of setpoints that bring none; it looks back by
    1 / (pi filter_hz) seconds.
    """

    task: Task = "auto"
    orientation_weight_m: float = 0.2
    payload_kg: float = 0.0
    payload_com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    largest_rad: float = math.radians(1.0)
    largest_m: float = 0.005
    farthest_m: float = 0.005
    rate_rad_s: float = math.radians(0.5)
    rate_m_s: float = 0.001
    speed_rad_s: float = 4.0 * math.pi
    speed_m_s: float = 5.0
    ramp_s: float = 1.0
    least_softening_nm: float = 0.05
    filter_hz: float = 0.0
    reversal_band: float = 1e-5
    singular_m: float = 1e-5
    weak_m: float = 0.1
    reached_m: float = 1e-6
    step: float = 1e-8
    iterations: int = 12

    def __post_init__(self) -> None:
        if self.task != "auto" and self.task not in _ROWS:
            raise OptionError(f"task is {self.task!r}: give auto, position, axis or pose.", option="task")
        for name in ("rate_rad_s", "rate_m_s", "orientation_weight_m", "largest_rad", "largest_m", "iterations"):
            if not getattr(self, name) > 0:
                raise OptionError(f"{name} is {getattr(self, name)!r}: give a positive number.", option=name)


@dataclass(frozen=True)
class CorrectedRows:
    """Corrected joints of N rows that do not follow one another.

    ``q (N, n)``; ``error_removed (N, 3)`` m, the tool error predicted without correction, in the wanted base frame;
    ``residual (N,)`` m, what remains of it; ``status (N,)`` as in the stream; ``flags (N,)``; ``limit_mask (N,)`` bits
    of the joints concerned.
    """

    q: Floats
    error_removed: Floats
    residual: Floats
    status: Ints
    flags: Ints
    limit_mask: Ints


@dataclass(frozen=True)
class CorrectionProgram:
    """A calibration as the flat array of the kernel; ``unsupported`` effects are left out and named."""

    array: Floats
    n_joints: int
    moves: int
    rows: tuple[int, ...]
    supported: tuple[str, ...]
    unsupported: tuple[str, ...]

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the numbers."""
        return hashlib.sha256(self.array.tobytes()).hexdigest()

    @property
    def held_rows(self) -> tuple[str, ...]:
        """Rows of the pose that the correction holds, by name."""
        return tuple(ROW_NAMES[r] for r in self.rows)

    def scratch(self) -> Floats:
        """Fresh scratch for the kernel."""
        return np.zeros((self.moves + 1 + self.n_joints + 6, kernel.COLUMNS))

    def correct_rows(
        self, q: Floats, *, qd: Floats | None = None, qdd: Floats | None = None, direction: Floats | None = None
    ) -> CorrectedRows:
        """Correct rows that do not follow one another, without ramps or rate limits.

        Args:
            q: wanted joints (N, n), rad or m.
            qd: speeds (N, n); with ``qdd`` the loads are dynamic, else static.
            qdd: accelerations (N, n).
            direction: last motion of each joint (N, n) in {-1, 0, 1}; 0 when None.

        """
        x, width = _side_by_side(q, qd, qdd)
        rows, n = len(x), self.n_joints
        out, info = np.empty((rows, n)), np.empty((rows, kernel.INFO))
        status = np.empty(rows, dtype=np.int64)
        signs = np.zeros((rows, n)) if direction is None else np.ascontiguousarray(direction, dtype=np.float64)
        state = np.zeros((n + 1, kernel.STATE))
        kernel.correct_rows(self.array, self.scratch(), state, x, width, signs, out, info, status)
        return CorrectedRows(
            q=out,
            error_removed=-info[:, 4:7],
            residual=info[:, 2],
            status=status,
            flags=info[:, 0].astype(np.int64),
            limit_mask=info[:, 1].astype(np.int64),
        )


class Track:
    """Memory of one stream or trajectory: the correction is continuous along it.

    ``settled``: the arm rests at the first setpoint, which gets the whole correction at once; else it ramps in.
    """

    def __init__(self, program: CorrectionProgram, *, settled: bool = False) -> None:
        self.program = program
        self.state = np.zeros((program.n_joints + 1, kernel.STATE))
        self._work = program.scratch()
        self.out = np.empty(program.n_joints)
        self.info = np.empty(kernel.INFO)
        self.restart(settled=settled)

    def restart(self, *, settled: bool = False) -> None:
        """Forget the past."""
        self.state[:] = 0.0
        self.state[-1, kernel.REBASE] = 0.0 if settled else 1.0

    def change(self, program: CorrectionProgram) -> None:
        """Go on with another version of the same robot; the difference is ramped out.

        Raises:
            OptionError: the version is of another number of joints.

        """
        if program.n_joints != self.program.n_joints:
            raise OptionError(f"A version for {program.n_joints} joints cannot follow one for {self.program.n_joints}.")
        self.program = program
        self._work = program.scratch()
        self.state[-1, kernel.REBASE] = 1.0

    def step(self, x: Floats, width: int, dt: float) -> int:
        """Correct one setpoint into ``self.out`` and ``self.info``; returns the status.

        ``x (width * n,)`` holds q, then qd and qdd; ``dt`` s since the last answer.
        """
        return int(kernel.step(self.program.array, self._work, self.state, x, width, dt, self.out, self.info))

    def follow(self, x: Floats, width: int, dt: Floats, *, atomic: bool = False) -> tuple[int, Floats, Floats, Ints]:
        """Correct points ``x (K, width * n)`` in turn, ``dt (K,)`` s each after the one before.

        Returns the number of points before the first refusal, the joints (K, n), the info (K, INFO) and the status
        (K,), -1 after a refusal. ``atomic``: a refusal leaves the memory as it was.
        """
        n = self.program.n_joints
        out, info = np.empty((len(x), n)), np.empty((len(x), kernel.INFO))
        status = np.empty(len(x), dtype=np.int64)
        before = self.state.copy() if atomic else self.state
        done = int(kernel.follow(self.program.array, self._work, self.state, x, width, dt, out, info, status))
        if atomic and done < len(x):
            self.state[:] = before
        return done, out, info, status


def warm_up() -> None:
    """Compile every kernel, or load it from the cache: a first setpoint must not wait seconds for that."""
    chain = Chain((Element(Axis.RZ, joint=0),), 1)
    robot = Robot("warm", (Joint("j1", lower=-1.0, upper=1.0),), chain)
    program = compile_program(Calibration.nominal(robot), CorrectionOptions())
    Track(program).step(np.zeros(1), 1, 0.0)
    Track(program).follow(np.zeros((1, 1)), 1, np.zeros(1))
    program.correct_rows(np.zeros((1, 1)))


def _side_by_side(q: Floats, qd: Floats | None, qdd: Floats | None) -> tuple[Floats, int]:
    """q, qd and qdd as the kernel takes them, with the number of vectors."""
    if qd is None or qdd is None:
        return np.ascontiguousarray(q, dtype=np.float64), 1
    return np.ascontiguousarray(np.hstack([q, qd, qdd]), dtype=np.float64), 3


def compile_program(calibration: Calibration, options: CorrectionOptions | None = None) -> CorrectionProgram:
    """Fold a calibration into the kernel's program.

    Raises:
        OptionError: more task rows than joints.

    """
    options = options or CorrectionOptions()
    robot = calibration.robot
    n = robot.n_joints
    task = options.task if options.task != "auto" else ("pose" if n >= 6 else "position")
    rows = _ROWS[task]
    if len(rows) > n and options.task != "auto":
        message = f"task {task!r} holds {len(rows)} rows, the robot has {n} joints: give position."
        raise OptionError(message, option="task")
    arm = calibration.with_effects([e for e in calibration.model.effects if e.stage != "measurement"])
    folded, values = arm.model.folded(arm.values)
    moved = dict(zip(folded.names, values.tolist(), strict=True))
    ideal = calibration.wanted().model
    nominal = fold(robot, [e.value for e in robot.chain.elements], np.eye(4), np.asarray(ideal.T_tool))
    # Seen from the wanted base, so that the frames, too, are part of the error.
    seen = np.linalg.solve(np.asarray(ideal.T_base), np.asarray(folded.T_base))
    actual = fold(
        robot, [moved[e.name] if e.name else e.value for e in robot.chain.elements], seen, np.asarray(folded.T_tool)
    )
    m = len(nominal.constants) - 1
    P = np.zeros((m + 1 + n + 1, kernel.COLUMNS))
    write_moves(P, nominal, actual)
    write_bodies(P, robot, nominal, options.payload_kg, options.payload_com)
    _write_joints(P[m + 1 : m + 1 + n], robot, options)
    _write_scalars(P[-1], robot, options, rows, m)
    joints = P[m + 1 : m + 1 + n]
    supported, unsupported = _write_effects(joints, folded.effects, folded.effect_slices(), values, options)
    P[-1, kernel.LOADED] = float(any("moments" in e.needs for e in folded.effects if e.id in supported))
    return CorrectionProgram(P, n, m, rows, supported, unsupported)


def _write_joints(rows: Floats, robot: Robot, options: CorrectionOptions) -> None:
    for row, joint in zip(rows, robot.joints, strict=True):
        turns = joint.kind == "revolute"
        row[kernel.LOWER], row[kernel.UPPER] = joint.lower, joint.upper
        row[kernel.RATE] = options.rate_rad_s if turns else options.rate_m_s
        row[kernel.LARGEST] = options.largest_rad if turns else options.largest_m
        row[kernel.SPEED] = options.speed_rad_s if turns else options.speed_m_s


def _write_scalars(row: Floats, robot: Robot, options: CorrectionOptions, rows: tuple[int, ...], moves: int) -> None:
    row[kernel.GRAVITY : kernel.GRAVITY + 3] = robot.gravity
    row[kernel.ROWS] = len(rows)
    row[kernel.ROW : kernel.ROW + len(rows)] = rows
    row[kernel.WEIGHT : kernel.WEIGHT + len(rows)] = [1.0 if r < 3 else options.orientation_weight_m for r in rows]
    row[kernel.ITERATIONS] = options.iterations
    row[kernel.STEP] = options.step
    row[kernel.SINGULAR] = options.singular_m**2
    row[kernel.WEAK] = options.weak_m**2
    row[kernel.FARTHEST] = options.farthest_m
    row[kernel.RAMP] = options.ramp_s
    row[kernel.FILTER] = 2.0 * math.pi * options.filter_hz
    row[kernel.HYSTERESIS] = options.reversal_band
    row[kernel.REACHED] = options.reached_m
    row[kernel.N] = robot.n_joints
    row[kernel.M] = moves


def _tilt(row: Floats, effect: Any, value: float, options: CorrectionOptions) -> None:
    row[kernel.TILT] = math.tan(value)
    row[kernel.TILT_SHARE] = 0.0 if effect.share == "thesis" else 1.0
    row[kernel.TILT_SOFT] = max(effect.softening_nm, options.least_softening_nm)


def _play(row: Floats, effect: Any, value: float, options: CorrectionOptions) -> None:
    row[kernel.PLAY] = value
    row[kernel.PLAY_SOFT] = max(effect.softening_nm, options.least_softening_nm)


def _reversal(row: Floats, effect: Any, value: float, options: CorrectionOptions) -> None:
    row[kernel.REVERSAL] = value


def _compliance(row: Floats, effect: Any, value: float, options: CorrectionOptions) -> None:
    row[kernel.COMPLIANCE] = value


_Writer = Callable[[Floats, Any, float, CorrectionOptions], None]
_WRITERS: Mapping[str, tuple[int, _Writer]] = {
    ClearanceTilt.id: (kernel.TILT, _tilt),
    BacklashLoad.id: (kernel.PLAY, _play),
    Backlash.id: (kernel.REVERSAL, _reversal),
    AxialCompliance.id: (kernel.COMPLIANCE, _compliance),
}


def _write_effects(
    rows: Floats,
    effects: tuple[Effect, ...],
    slices: Mapping[str, slice],
    values: Floats,
    options: CorrectionOptions,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Write the effects the kernel knows; returns their ids and the names of the others."""
    supported: list[str] = []
    unsupported: list[str] = []
    for effect, (key, where) in zip(effects, slices.items(), strict=True):
        entry = _WRITERS.get(effect.id)
        joints = list(effect.acting(len(rows)))
        # Two effects of one kind on one joint have no place in the program: the second is named, not dropped silently.
        if entry is None or np.any(rows[joints, entry[0]] != 0.0):
            unsupported.append(key)
            continue
        for joint, value in zip(joints, values[where], strict=True):
            entry[1](rows[joint], effect, float(value), options)
        supported.append(effect.id)
    return tuple(dict.fromkeys(supported)), tuple(unsupported)
