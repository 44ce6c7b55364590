"""The one way along a trajectory, whether a file, a query, a message of ROS 2 or a chunk of a stream brought it.

:meth:`Track.follow` decides what is continuous: directions, ramps, rates, limits. This module decides the rest: how times
become steps, what a refused point means for the others, when load, temperature and tilt of the base change. Whoever calls
it only decodes and encodes, so that a trajectory gives the same numbers however it came.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kilter_core.correct.kernels import layout
from kilter_core.correct.program import CorrectionOptions, CorrectionProgram, Track, compile_program
from kilter_core.errors import ObservationError
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.types import Floats, Ints

Stretches = Sequence[tuple[slice, CorrectionProgram]]  # rows under one load and temperature, with their program

_REMOVED, _LEFT = slice(layout.REMOVED, layout.REMOVED + 3), slice(layout.LEFT, layout.LEFT + 3)

MOST_CONDITIONS = 200
MOST_STATED = 2000  # where a tilt of the base or masses on links are stated, which may be others in every row
SLICE = 64


@dataclass(frozen=True)
class Refusal:
    """The first point that was refused: its index from 0, its status, the bits of the joints concerned."""

    index: int
    status: int
    limit_mask: int


@dataclass(frozen=True)
class Walked:
    """N corrected points: ``q (N, n)`` rad or m, NaN where refused; ``info (N, INFO)`` of the kernel; ``status (N,)``.

    ``done`` points came before the first refusal. ``left (N, 3)`` m and ``left_rad (N,)`` are the remaining error of the
    tool, actual minus wanted, in the wanted base frame, and its angle; NaN where refused.
    """

    q: Floats
    info: Floats
    status: Ints
    done: int

    @property
    def refusal(self) -> Refusal | None:
        """The first refusal, if there is one."""
        if self.done == len(self.q):
            return None
        return Refusal(self.done, int(self.status[self.done]), int(self.info[self.done, 1]))

    @property
    def remaining_error_m(self) -> Floats:
        """What is left of the error of the tool (N, 3) m."""
        return self.info[:, layout.LEFT : layout.LEFT + 3]

    @property
    def left_rad(self) -> Floats:
        """The angle that is left (N,) rad."""
        return self.info[:, layout.LEFT_TURN]

    @property
    def flags(self) -> Ints:
        """How each point was corrected (N,); 0 where refused."""
        return np.where(self.status == layout.OK, self.info[:, 0], 0.0).astype(np.int64)

    @property
    def limit_mask(self) -> Ints:
        """Bits (N,) of the joints at a limit; 0 in points that were not looked at."""
        return np.where(self.status >= 0, self.info[:, 1], 0.0).astype(np.int64)

    @property
    def all_flags(self) -> int:
        """How the points before the first refusal were corrected, all flags together."""
        return int(np.bitwise_or.reduce(self.flags[: self.done]))


@dataclass(frozen=True)
class CorrectedTrajectory:
    """Rows as they were wanted, and corrected; effects that were left out, by id.

    ``q (N, n)`` rad or m, ``error_removed (N, 3)`` m, ``left (N, 3)`` m and ``left_rad (N,)`` are NaN where
    ``status (N,)`` is not 0. ``left`` is what remains of the error of the tool, actual minus wanted, in the wanted base
    frame, and ``left_rad`` its angle; ``flags (N,)`` say how a row was corrected; ``limit_mask (N,)`` has the bits of the
    joints at a limit. ``where_stated`` are effects left out that rows which state more are corrected for, by name with the
    quantities that they must state.
    """

    wanted: Observations
    q: Floats
    error_removed: Floats
    left: Floats
    left_rad: Floats
    status: Ints
    flags: Ints
    limit_mask: Ints
    not_corrected: tuple[str, ...]
    reversal_band: float
    where_stated: Mapping[str, tuple[str, ...]]

    @property
    def follow_one_another(self) -> bool:
        """Whether the rows are one motion: they have times, and name no directions."""
        return _follow_one_another(self.wanted)

    @cached_property
    def direction(self) -> Floats:
        """Last motion (N, n) of each joint that the correction reckoned with; 0 in rows of a stream that were refused."""
        if not _follow_one_another(self.wanted):
            return _motion_directions(self.wanted, self.reversal_band)
        direction, good = np.zeros_like(self.q), self.status == layout.OK
        direction[good] = headings(self.wanted.q[good], self.reversal_band)
        return direction


def side_by_side(q: Floats, qd: Floats | None, qdd: Floats | None) -> tuple[Floats, int]:
    """Joints, speeds and accelerations as the kernel takes them, with the number of vectors; no qdd without qd."""
    parts = [q] if qd is None else [q, qd] if qdd is None else [q, qd, qdd]
    # In C order: for any other the kernel would be compiled anew, for seconds.
    return np.ascontiguousarray(np.hstack(parts), dtype=np.float64), len(parts)


def time_steps(t: Floats) -> Floats:
    """Seconds (N,) since the point before, 0 for the first.

    Raises:
        ObservationError: the time goes back, or is not a number.

    """
    steps = np.diff(t, prepend=t[:1])
    wrong = np.flatnonzero(~(steps >= 0.0))
    if len(wrong):
        row = int(wrong[0]) + 1
        raise ObservationError(f"Row {row}, column 't_s': the time goes back.", row=row, column="t_s")
    return steps


def walk_whole(track: Track, x: Floats, width: int, steps: Floats) -> Walked:
    """Correct all points ``x (N, width * n)`` or none: a refusal leaves the memory of the track as it was."""
    done, q, info, status = track.follow(x, width, steps, atomic=True)
    if done < len(q):
        q[:], info[:, layout.REMOVED :] = np.nan, np.nan
    return Walked(q, info, status, done)


def walk_from_rest(program: CorrectionProgram, x: Floats, width: int, t: Floats) -> Walked:
    """Correct a motion at times ``t (N,)`` s, all points or none; the arm rests at the first of them.

    Raises:
        ObservationError: the time goes back.

    """
    return walk_whole(Track(program, settled=True), x, width, time_steps(t))


def walk_past_refusals(stretches: Stretches, x: Floats, width: int, t: Floats) -> Walked:
    """Correct a motion as :func:`walk_from_rest`, but go on after a refusal, from the last point that was answered.

    Raises:
        ObservationError: the time goes back.

    """
    time_steps(t)
    track = Track(stretches[0][1], settled=True)
    q, info = np.empty((len(x), track.program.n_joints)), np.empty((len(x), layout.INFO))
    status = np.empty(len(x), dtype=np.int64)
    answered = t[0]
    for where, program in stretches:
        if program is not track.program:
            track.change(program)
        at, size = where.start, SLICE
        while at < where.stop:
            end = min(at + size, where.stop)
            done, *found = track.follow(x[at:end], width, np.diff(t[at:end], prepend=answered))
            taken = slice(at, min(at + done + 1, end))  # the refused point as well
            for whole, part in zip((q, info, status), found, strict=True):
                whole[taken] = part[: taken.stop - at]
            if done:
                answered = t[at + done - 1]
            # Where many are refused the kernel is called often: small slices keep what it leaves out small.
            size = 4 * size if done == end - at else SLICE
            at = taken.stop
    return _each(q, info, status)


def walk_apart(stretches: Stretches, x: Floats, width: int, direction: Floats) -> Walked:
    """Correct points that do not follow one another: each as the first of a stream, with the direction it names."""
    parts = [_correct_independent_rows(program, x[where], width, direction[where]) for where, program in stretches]
    q, info, status = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _each(q, info, status)


def _correct_independent_rows(
    program: CorrectionProgram, x: Floats, width: int, direction: Floats
) -> tuple[Floats, Floats, Ints]:
    n = program.n_joints
    given = [x[:, k * n : (k + 1) * n] for k in range(width)]
    found = program.correct_rows(
        given[0], qd=given[1] if width == 3 else None, qdd=given[2] if width == 3 else None, direction=direction
    )
    info = np.zeros((len(x), layout.INFO))
    info[:, 0], info[:, 1] = found.flags, found.limit_mask
    info[:, _REMOVED], info[:, _LEFT], info[:, layout.LEFT_TURN] = -found.error_removed, found.left, found.left_rad
    # What a stream refuses before it corrects is refused here too.
    joints = program.array[program.moves + 1 : program.moves + 1 + n]
    outside = ~((given[0] >= joints[:, layout.LOWER]) & (given[0] <= joints[:, layout.UPPER]))
    info[:, 1] = np.where(outside.any(axis=1), outside @ (1 << np.arange(n)), info[:, 1])
    status = np.where(outside.any(axis=1), layout.JOINT_LIMIT, found.status)
    return found.q, info, np.where(np.isfinite(x).all(axis=1), status, layout.NOT_FINITE)


def _each(q: Floats, info: Floats, status: Ints) -> Walked:
    """Points that are refused one by one: those keep no numbers."""
    refused = status != layout.OK
    q[refused], info[refused, layout.REMOVED :] = np.nan, np.nan
    return Walked(q, info, status, int(refused.argmax()) if refused.any() else len(q))


def headings(q: Floats, band: float) -> Floats:
    """Direction {-1, 0, 1} in which each joint moved last, (N, n), by the rule of the stream.

    A joint reverses when it comes back by more than ``band``; 0 before it moved that far.
    """
    return np.array([_heading(column, band) for column in q.T.tolist()]).T.reshape(q.shape)


def _heading(places: Sequence[float], band: float) -> list[float]:
    sign, signs = 0.0, []
    turn = places[0] if places else 0.0
    for x in places:
        if x > turn + band or (sign > 0.0 and x > turn):
            sign, turn = 1.0, x
        elif x < turn - band or (sign < 0.0 and x < turn):
            sign, turn = -1.0, x
        signs.append(sign)
    return signs


def correct_trajectory(
    calibration: Calibration, rows: Observations, options: CorrectionOptions | None = None
) -> CorrectedTrajectory:
    """Correct rows: with times as a stream that rests at the first of them, without times each by itself.

    Rows that name directions are also taken by themselves, for a stream finds out directions from its own past. Rows
    that name no load carry that of the options, else the robot's default load.

    Raises:
        ObservationError: times that go back, or load, temperature and tilt of the base that change too often.

    """
    options = options or CorrectionOptions()
    stretches = _stretches(calibration, rows, options)
    x, width = side_by_side(rows.q, rows.qd, rows.qdd)
    if _follow_one_another(rows):
        walked = walk_past_refusals(stretches, x, width, np.asarray(rows.t))
    else:
        walked = walk_apart(stretches, x, width, _motion_directions(rows, options.reversal_band))
    left_out = tuple(sorted({name for _, program in stretches for name in program.unsupported}))
    return CorrectedTrajectory(
        rows,
        walked.q,
        -walked.info[:, _REMOVED],
        walked.remaining_error_m,
        walked.left_rad,
        walked.status,
        walked.flags,
        walked.limit_mask,
        left_out,
        options.reversal_band,
        {name: asked for _, program in stretches for name, asked in program.where_stated.items()},
    )


def _follow_one_another(rows: Observations) -> bool:
    return rows.t is not None and rows.direction is None


def _motion_directions(rows: Observations, band: float) -> Floats:
    return headings(rows.q, band) if rows.direction is None else rows.direction


def _stretches(calibration: Calibration, rows: Observations, options: CorrectionOptions) -> Stretches:
    """Rows under one load, temperature and tilt of the base, each stretch with its program."""
    read = calibration.model.needs
    tilts = (rows.base_tilt_x, rows.base_tilt_y) if "base_tilt_x" in read else (None, None)
    masses = rows.link_mass if "moments" in read and rows.link_mass is not None else np.zeros((len(rows), 0, 4))
    payload_com = np.zeros((len(rows), 3)) if rows.payload_com is None else rows.payload_com
    columns = (rows.payload_kg, *payload_com.T, rows.temperature_c, *tilts, *masses.reshape(len(rows), -1).T)
    conditions = np.column_stack([np.full(len(rows), math.nan) if one is None else one for one in columns])
    same = (conditions[1:] == conditions[:-1]) | (np.isnan(conditions[1:]) & np.isnan(conditions[:-1]))
    starts = [0, *(np.flatnonzero(~same.all(axis=1)) + 1).tolist()]
    stated = tilts[0] is not None or masses.size > 0
    most = MOST_STATED if stated else MOST_CONDITIONS
    if len(starts) > most:
        what = "Payload, temperature, tilt of the base or masses on links" if stated else "Payload or temperature"
        raise ObservationError(
            f"{what} changes {len(starts) - 1} times: a trajectory may do so {most - 1} times. "
            "Round them, or split the trajectory."
        )
    programs = []
    for start in starts:
        payload, x, y, z, temperature, *tilt = conditions[start, :7].tolist()
        here = options if math.isnan(payload) else replace(options, payload_kg=payload, payload_com=(x, y, z))
        if not math.isnan(temperature):
            here = replace(here, temperature_c=temperature)
        if not math.isnan(sum(tilt)):
            here = replace(here, base_tilt=(tilt[0], tilt[1]))
        if masses.size:
            here = replace(here, link_masses=tuple(map(tuple, masses[start].tolist())))
        programs.append(compile_program(calibration, here))
    slices = [slice(start, end) for start, end in zip(starts, [*starts[1:], len(rows)], strict=True)]
    return list(zip(slices, programs, strict=True))
