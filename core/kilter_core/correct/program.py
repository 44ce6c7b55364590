"""From a calibration to the flat program of the correction kernel, and the calls that use it.

The stream, the trajectory query and the correction over HTTP all run the same kernel.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from kilter_core.arm.chain import Axis, Chain, Element
from kilter_core.arm.load_slopes import with_masses, with_payload
from kilter_core.arm.load_wrenches import HANGING_ROUNDS, SIDED_ROUNDS, axial_loads, joint_loads
from kilter_core.arm.robot import Joint, Link, Payload, Robot
from kilter_core.arm.run_time import Conditions, RunTimeForm
from kilter_core.correct.kernels import layout, stream
from kilter_core.correct.program_rows import (
    bending_rows,
    collapse_chains,
    collapse_constants,
    curve_rows,
    doubt_rows,
    fixed_links_moment,
    joint_rows,
    load_rows,
    nominal_values,
    write_base,
    write_bodies,
    write_moves,
)
from kilter_core.errors import OptionError
from kilter_core.model import Calibration, RobotModel
from kilter_core.types import Floats, Ints

# Conditions that rows may state, with values that are tried; each as the names of its quantities.
_STATED = (
    (("temperature_c",), {"temperature_c": 20.0}),
    (("base_tilt_x", "base_tilt_y"), {"base_tilt": (0.0, 0.0)}),
)


@dataclass(frozen=True)
class AtRunTime:
    """The effects as the correction has them: ids of those ``supported``, names of the ``unsupported`` others.

    ``loaded``: one of them needs loads. ``where_stated`` are the unsupported ones that are made up for where rows state
    more, by name with the quantities that they must state.
    """

    form: RunTimeForm
    supported: tuple[str, ...]
    unsupported: tuple[str, ...]
    loaded: bool
    where_stated: Mapping[str, tuple[str, ...]]


def at_run_time(model: RobotModel, values: Floats, conditions: Conditions) -> AtRunTime:
    """What the effects of a model with these ``values (P,)`` do under these conditions."""
    form = RunTimeForm.empty(model.load_robot, conditions)
    supported: list[str] = []
    unsupported: list[str] = []
    where_stated: dict[str, tuple[str, ...]] = {}
    loaded = False
    for k, (key, where) in enumerate(model.effect_slices().items()):
        effect = model.effects[k]
        if effect.at_run_time(form, values[where]):
            supported.append(effect.id)
            loaded |= "moments" in effect.needs
            continue
        unsupported.append(key)
        asked = _required_quantities(model, k, values[where], conditions)
        if asked:
            where_stated[key] = asked
    return AtRunTime(form, tuple(dict.fromkeys(supported)), tuple(unsupported), loaded, where_stated)


def _required_quantities(model: RobotModel, which: int, values: Floats, conditions: Conditions) -> tuple[str, ...]:
    """Quantities that must be stated for an effect to be made up for; empty: no statement helps."""
    effect = model.effects[which]
    for quantities, tried in _STATED:
        if effect.needs.issuperset(quantities):
            form = RunTimeForm.empty(model.load_robot, replace(conditions, **tried))
            if effect.at_run_time(form, values):
                return quantities
    return ()


# How soft the signs of loads are in a correction: a joint must not jump from one side of its backlash to the other.
#
# A sign that is too soft leaves the backlash of a lightly loaded joint uncorrected, so what is soft for a shoulder
# is not for a wrist: the width follows the load that each joint carries.

SHARE = 0.005  # of the largest load of a joint
LEAST_NM = 1e-6
POSES = 64
UNBOUNDED_RAD, UNBOUNDED_M = math.pi, 0.5


def softening(form: RunTimeForm, robot: Robot, load: Payload, most_nm: float) -> tuple[Floats, Floats]:
    """Half-widths (n,) N·m of the signs of the load across each joint, and of that about it.

    The effect's own, and at least the smaller of ``most_nm`` and a share of the largest load of the joint over its range.
    """
    own = [np.array([getattr(joint, name) for joint in form.joints]) for name in _WIDTHS]
    if most_nm <= 0.0 or not any(joint.tilt or joint.backlash for joint in form.joints):
        return own[0], own[1]
    q = _poses(robot)
    com = np.tile(np.asarray(load.com, dtype=np.float64), (len(q), 1))
    loads = joint_loads(robot, q, payload_kg=np.full(len(q), load.mass), payload_com=com)
    across = np.linalg.norm(loads.joints[:, :, 3:5], axis=2).max(axis=0)
    about = np.abs(axial_loads(robot, loads)).max(axis=0)
    least = [np.clip(SHARE * largest, min(LEAST_NM, most_nm), most_nm) for largest in (across, about)]
    return np.maximum(own[0], least[0]), np.maximum(own[1], least[1])


_WIDTHS = ("tilt_softening_nm", "backlash_softening_nm")


def _poses(robot: Robot) -> Floats:
    """Joints (POSES, n) spread evenly over the ranges, the same at every call."""
    wide = np.array([UNBOUNDED_RAD if joint.kind == "revolute" else UNBOUNDED_M for joint in robot.joints])
    lower = np.maximum(np.array([joint.lower for joint in robot.joints]), -wide)
    upper = np.minimum(np.array([joint.upper for joint in robot.joints]), wide)
    return np.asarray(lower + (upper - lower) * np.random.default_rng(0).uniform(size=(POSES, robot.n_joints)))


Task = Literal["auto", "position", "axis", "pose"]

# Rows of the tasks, and how many of them come first.
_ROWS: Mapping[str, tuple[int, int]] = {"position": (6, 3), "axis": (5, 5), "pose": (6, 6)}
DEFAULT_TASK: Task = "position"  # which "auto" is
ROW_NAMES = ("x", "y", "z", "rx", "ry", "rz")  # rotations are about the axes of the tool


_POSITIVE = (
    "rate_rad_s",
    "rate_m_s",
    "change_rad_s",
    "change_m_s",
    "change_rad_s2",
    "change_m_s2",
    "orientation_weight_m",
    "largest_rad",
    "largest_m",
    "farthest_m",
    "least_leverage",
    "iterations",
    "row_iterations",
)


@dataclass(frozen=True)
class CorrectionOptions:
    """How a correction is made and bounded.

    ``task`` "position", which "auto" is, holds the tool point and then rotates the tool as well as the joints can: where
    the posture makes a rotation weak (a radian of the joints rotates the tool by less than ``least_leverage``), or where both
    exceed a limit, the rotation is given up. "axis" (point and direction of the tool's z) and "pose" hold all their rows alike;
    ``orientation_weight_m`` is what a radian of the tool counts in metres there.
    Limits: ``largest_rad`` and ``largest_m`` per joint, ``farthest_m`` at the tool point. ``at_limit`` "saturate" goes as
    far as they allow and says what is left, "refuse" refuses the row. ``held_joints`` (from 0) stay as they are wanted, as a
    rail or a positioner that other axes follow. ``change_rad_s``, ``change_m_s`` and, of the
    acceleration, ``change_rad_s2``, ``change_m_s2`` bound how fast the whole correction changes along a stream, joint by
    joint: what drives need beside the path. ``rate_rad_s`` and ``rate_m_s`` bound the part of the effects with a sign
    (clearance, backlash), and changes of version; ``least_softening_nm`` softens their sign where the effect itself does
    not, but by no more than half a per cent of the largest load of the joint. ``ramp_s`` is the least time of a change of
    version. ``payload_kg`` hangs at ``payload_com`` m in the tool frame, the tool point when None; without a mass the
    robot's default load does. ``temperature_c`` is that of the arm, for thermal growth; without it that effect stays
    uncorrected. ``base_tilt`` rad is what the inclinometer on the base reads about its x and y, the same for a measured
    tilt. ``link_masses`` hang on the links beyond their own, of each joint kg and place m in the frame of its link.
    ``filter_hz`` > 0 derives speeds and accelerations of setpoints that bring none; it looks back by
    1 / (pi filter_hz) seconds. ``iterations`` bound the work on a setpoint of a stream, ``row_iterations`` that on a row
    by itself. A point further off than ``reached_m`` is flagged, as is a tool rotated by more than ``turned_rad`` on an arm
    that could rotate it.
    """

    task: Task = "auto"
    orientation_weight_m: float = 0.2
    payload_kg: float | None = None
    payload_com: tuple[float, float, float] | None = None
    temperature_c: float | None = None
    base_tilt: tuple[float, float] | None = None
    link_masses: tuple[tuple[float, ...], ...] = ()
    largest_rad: float = math.radians(1.0)
    largest_m: float = 0.005
    farthest_m: float = 0.005
    rate_rad_s: float = math.radians(0.5)
    rate_m_s: float = 0.001
    change_rad_s: float = math.radians(5.0)
    change_m_s: float = 0.025
    change_rad_s2: float = math.radians(250.0)
    change_m_s2: float = 1.25
    at_limit: Literal["saturate", "refuse"] = "saturate"
    held_joints: tuple[int, ...] = ()
    speed_rad_s: float = 4.0 * math.pi
    speed_m_s: float = 5.0
    ramp_s: float = 1.0
    least_softening_nm: float = 0.05
    filter_hz: float = 0.0
    reversal_band: float = 1e-5
    singular_m: float = 1e-5
    weak_m: float = 0.1
    least_leverage: float = 0.2
    reached_m: float = 1e-6
    turned_rad: float = 1e-4
    step: float = 1e-8
    iterations: int = 12
    row_iterations: int = 60

    def load(self, robot: Robot) -> Payload:
        """What hangs on the tool: as stated, else the robot's default load, else nothing."""
        default = robot.load or Payload(0.0)
        if self.payload_kg is None:
            return Payload(default.mass, self.payload_com or default.com)
        return Payload(self.payload_kg, self.payload_com or (0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        if self.task != "auto" and self.task not in _ROWS:
            raise OptionError(f"task is {self.task!r}: give auto, position, axis or pose.", option="task")
        if self.at_limit not in ("saturate", "refuse"):
            raise OptionError(f"at_limit is {self.at_limit!r}: give saturate or refuse.", option="at_limit")
        for name in _POSITIVE:
            if not getattr(self, name) > 0:
                raise OptionError(f"{name} is {getattr(self, name)!r}: give a positive number.", option=name)


@dataclass(frozen=True)
class CorrectedRows:
    """Corrected joints of N rows that do not follow one another.

    ``q (N, n)``; ``error_removed (N, 3)`` m, the tool error predicted without correction, in the wanted base frame;
    ``residual (N,)`` m, what remains of it; ``status (N,)`` as in the stream; ``flags (N,)``; ``limit_mask (N,)`` bits
    of the joints concerned. ``left (N, 3)`` m and ``left_rad (N,)`` are the remaining error of the tool, actual minus
    wanted, in the wanted base frame, and its angle.
    """

    q: Floats
    error_removed: Floats
    residual: Floats
    status: Ints
    flags: Ints
    limit_mask: Ints
    left: Floats
    left_rad: Floats


@dataclass(frozen=True)
class CorrectionProgram:
    """A calibration as the flat array of the kernel; ``unsupported`` effects are left out and named.

    ``where_stated`` are those of them that it makes up for where quantities are stated, by name with these quantities.
    """

    array: Floats
    n_joints: int
    moves: int
    first: int
    supported: tuple[str, ...]
    unsupported: tuple[str, ...]
    where_stated: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the numbers."""
        return hashlib.sha256(self.array.tobytes()).hexdigest()

    @property
    def held_rows(self) -> tuple[str, ...]:
        """Rows of the pose that the correction holds, by name; what comes second is not among them."""
        return ROW_NAMES[: self.first]

    @property
    def change(self) -> Floats:
        """How fast the correction of each joint changes along a stream at most (n,) rad/s or m/s."""
        return self.array[self.moves + 1 : self.moves + 1 + self.n_joints, layout.CHANGE]

    def memory(self) -> Floats:
        """Fresh memory for the kernel: the program, scratch, the state of a stream, joints out and info."""
        scratch = self.moves + 1 + self.n_joints + 6
        return np.vstack([self.array, np.zeros((scratch + self.n_joints + 3, layout.COLUMNS))])

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
        out, info = np.empty((rows, n)), np.empty((rows, layout.INFO))
        status = np.empty(rows, dtype=np.int64)
        signs = np.zeros((rows, n)) if direction is None else np.require(direction, np.float64, ["C", "W"])
        stream.correct_rows(self.memory(), len(self.array), n, x, width, signs, out, info, status)
        return CorrectedRows(
            q=out,
            error_removed=-info[:, layout.REMOVED : layout.REMOVED + 3],
            residual=info[:, 2],
            status=status,
            flags=info[:, 0].astype(np.int64),
            limit_mask=info[:, 1].astype(np.int64),
            left=info[:, layout.LEFT : layout.LEFT + 3],
            left_rad=info[:, layout.LEFT_TURN],
        )


class Track:
    """Memory of one stream or trajectory: the correction is continuous along it.

    ``settled``: the arm rests at the first setpoint, which gets the whole correction at once; else it ramps in.
    """

    def __init__(self, program: CorrectionProgram, *, settled: bool = False) -> None:
        self._load(program)
        self.restart(settled=settled)

    def _load(self, program: CorrectionProgram) -> None:
        """Fresh memory for a program, and the rows of it that the outside looks at."""
        self.program = program
        n = program.n_joints
        self.memory = program.memory()
        self._rows = len(program.array)
        self.state = self.memory[-(n + 3) : -2]
        self.out = self.memory[-2, :n]
        self.info = self.memory[-1, : layout.INFO]

    def restart(self, *, settled: bool = False) -> None:
        """Forget the past."""
        self.state[:] = 0.0
        self.state[-1, layout.REBASE] = 0.0 if settled else 1.0

    def change(self, program: CorrectionProgram) -> None:
        """Go on with another version of the same robot; the difference is ramped out.

        Raises:
            OptionError: the version is of another number of joints.

        """
        if program.n_joints != self.program.n_joints:
            raise OptionError(f"A version for {program.n_joints} joints cannot follow one for {self.program.n_joints}.")
        before = self.state
        self._load(program)
        self.state[:] = before
        self.state[-1, layout.REBASE] = 1.0

    def step(self, x: Floats, width: int, dt: float) -> int:
        """Correct one setpoint into ``self.out`` and ``self.info``; returns the status.

        ``x (width * n,)`` holds q, then qd and qdd; ``dt`` s since the last answer.
        """
        return int(stream.step(self.memory, self._rows, self.program.n_joints, x, width, dt))

    def follow(self, x: Floats, width: int, dt: Floats, *, atomic: bool = False) -> tuple[int, Floats, Floats, Ints]:
        """Correct points ``x (K, width * n)`` in turn, ``dt (K,)`` s each after the one before.

        Returns the number of points before the first refusal, the joints (K, n), the info (K, INFO) and the status
        (K,), -1 after a refusal. ``atomic``: a refusal leaves the memory as it was.
        """
        n = self.program.n_joints
        out, info = np.empty((len(x), n)), np.empty((len(x), layout.INFO))
        status = np.empty(len(x), dtype=np.int64)
        before = self.state.copy() if atomic else self.state
        done = int(stream.follow(self.memory, self._rows, n, x, width, dt, out, info, status))
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
    """q, qd and qdd as the kernel takes them, with the number of vectors.

    Of rows that may not be written to, as Arrow's are, the kernel would be compiled anew.
    """
    if qd is None or qdd is None:
        return np.require(q, np.float64, ["C", "W"]), 1
    return np.ascontiguousarray(np.hstack([q, qd, qdd]), dtype=np.float64), 3


def compile_program(calibration: Calibration, options: CorrectionOptions | None = None) -> CorrectionProgram:
    """Make the kernel's program of a calibration.

    Raises:
        OptionError: more task rows than joints.

    """
    options = options or CorrectionOptions()
    robot = calibration.robot
    n = robot.n_joints
    task = options.task if options.task != "auto" else DEFAULT_TASK
    beyond = [j + 1 for j in options.held_joints if not 0 <= j < n]
    if beyond or n <= len(set(options.held_joints)):
        which = f"joint {beyond[0]} is to be held, of {n}" if beyond else "every joint is held"
        raise OptionError(f"{which}: name joints from 1 to {n}, and leave one to correct with.", option="held_joints")
    rows, first = _ROWS[task]
    if first > max(n, 3):
        message = f"task {task!r} holds {first} rows, the robot has {n} joints: give position."
        raise OptionError(message, option="task")
    arm = calibration.with_effects([e for e in calibration.model.effects if e.stage != "measurement"])
    model, values = arm.model.absorb_frame_increments(arm.values)
    load = options.load(robot)
    conditions = Conditions(load.mass, options.temperature_c, options.base_tilt)
    made = at_run_time(model, values, conditions)
    form, loaded = made.form, made.loaded
    chains = collapse_chains(calibration, model, values)
    weighed = model.load_robot if form.link_errors is None else with_masses(model.load_robot, form.link_errors.tolist())
    weighed = _with_more(weighed, options.link_masses)
    loads = chains.nominal
    if model.load_chain is not None:
        loads = collapse_constants(weighed, nominal_values(weighed), np.eye(4), weighed.T_tool)
    m = len(chains.nominal.constants) - 1
    head = np.zeros((m + 1, layout.COLUMNS))
    write_moves(head, chains.nominal, chains.identified)
    write_bodies(head, weighed, loads, *with_payload(load.mass, load.com, form.payload_errors.tolist()))
    scalars = _scalars(weighed, options, (rows, first), m)
    scalars[layout.LOADED] = float(loaded)
    if loaded and model.load_chain is not None and model.load_chain.effects:
        scalars[layout.HANGING] = HANGING_ROUNDS
        sided = any(effect.sided and np.any(values[at]) for effect, at in model.effects_with_slices)
        scalars[layout.HANGING_SIDED] = SIDED_ROUNDS if sided else 0
    scalars[layout.CURVES], scalars[layout.BENDINGS] = len(form.curves), len(form.bending)
    widths = softening(form, weighed, load, options.least_softening_nm)
    mount = write_base(head, scalars, form, chains.base, fixed_links_moment(weighed, loads))
    parts = [head, _with_limits(joint_rows(form, widths), robot, options), curve_rows(form), bending_rows(form)]
    if loads is not chains.nominal:
        scalars[layout.LOAD_CHAIN] = sum(len(part) for part in parts)
        parts.append(load_rows(loads))
    scalars[layout.DOUBT_AT], scalars[layout.DOUBTS] = sum(len(part) for part in parts), len(calibration.doubts)
    parts.append(doubt_rows(calibration.doubts, n))
    array = np.vstack([*parts, *mount, scalars])
    return CorrectionProgram(array, n, m, first, made.supported, made.unsupported, made.where_stated)


def _with_more(robot: Robot, masses: tuple[tuple[float, ...], ...]) -> Robot:
    """The robot with more masses on its links: loads are linear in them, so that bodies of their own do."""
    more = [Link(robot.chain.primary[j], kg, np.array(place)) for j, (kg, *place) in enumerate(masses) if kg != 0.0]
    return replace(robot, links=(*robot.links, *more)) if more else robot


def _with_limits(rows: Floats, robot: Robot, options: CorrectionOptions) -> Floats:
    for number, (row, joint) in enumerate(zip(rows, robot.joints, strict=True)):
        revolute = joint.kind == "revolute"
        row[layout.FREE] = float(number not in options.held_joints)
        row[layout.LOWER], row[layout.UPPER] = joint.lower, joint.upper
        row[layout.RATE] = options.rate_rad_s if revolute else options.rate_m_s
        row[layout.LARGEST] = options.largest_rad if revolute else options.largest_m
        row[layout.CHANGE] = options.change_rad_s if revolute else options.change_m_s
        row[layout.SPURT] = options.change_rad_s2 if revolute else options.change_m_s2
        row[layout.SPEED] = options.speed_rad_s if revolute else options.speed_m_s
    return rows


def _scalars(robot: Robot, options: CorrectionOptions, task: tuple[int, int], moves: int) -> Floats:
    row = np.zeros(layout.COLUMNS)
    row[layout.GRAVITY : layout.GRAVITY + 3] = robot.gravity
    rows, first = task
    row[layout.ROWS], row[layout.FIRST] = rows, first
    # What comes second is in rad: leverage is without a unit.
    turn = options.orientation_weight_m if first == rows else 1.0
    row[layout.WEIGHT : layout.WEIGHT + rows] = [1.0 if r < 3 else turn for r in range(rows)]
    row[layout.LEVERAGE] = options.least_leverage**2
    row[layout.TURNED] = options.turned_rad
    row[layout.SATURATES] = float(options.at_limit == "saturate")
    row[layout.ROUNDS] = options.row_iterations
    row[layout.ITERATIONS] = options.iterations
    row[layout.STEP] = options.step
    row[layout.SINGULAR] = options.singular_m**2
    row[layout.WEAK] = options.weak_m**2
    row[layout.FARTHEST] = options.farthest_m
    row[layout.RAMP] = options.ramp_s
    row[layout.FILTER] = 2.0 * math.pi * options.filter_hz
    row[layout.HYSTERESIS] = options.reversal_band
    row[layout.REACHED] = options.reached_m
    row[layout.N] = robot.n_joints
    row[layout.M] = moves
    return row
