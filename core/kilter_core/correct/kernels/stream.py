"""From wanted joints to corrected joints in one call, compiled, without allocation: setpoints, chunks, and rows apart.

Where a version is less sure than it says: boxes of wanted joint values, compiled.
"""

from __future__ import annotations

import math

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel
from kilter_core.correct.kernels.chain import wanted_tool
from kilter_core.correct.kernels.inverse import evaluate_remaining_error, shorten, solve
from kilter_core.correct.kernels.layout import (
    ACCEL_NOW,
    AIMED,
    BEHIND,
    COMMAND,
    DOUBT_AT,
    DOUBTS,
    FILTER,
    GUESS,
    GUESSED,
    HIGHEST_OF_BOX,
    HYSTERESIS,
    INFO,
    ITERATIONS,
    JOINT_LIMIT,
    LARGEST,
    LAST_A,
    LAST_B,
    LAST_DELTA,
    LAST_Q,
    LAST_SIDE,
    LAST_SIGN,
    LEFT,
    LENGTH,
    LOWER,
    LOWEST_OF_BOX,
    NEAR_REVERSAL,
    NEXT,
    NOT_FINITE,
    OFFSET,
    OK,
    RAMP,
    RAMPED,
    RAMPING,
    RATE,
    RATE_LIMIT,
    REACHED,
    REBASE,
    REMAINING,
    REMOVED,
    RESIDUAL,
    REVERSED_AT,
    REVERSED_AT_NEW,
    REVERSING,
    ROUNDS,
    SATURATED,
    SATURATES,
    SIDE,
    SIGN,
    SLOPE,
    SLOWED,
    SMOOTH,
    SMOOTH_NEW,
    SMOOTH_SPEED,
    SMOOTH_SPEED_NEW,
    SPEED,
    SPEED_NOW,
    STARTED,
    TARGET,
    TILT_A,
    TILT_B,
    TOO_LARGE,
    TOTAL,
    UNSURE,
    UPPER,
    VELOCITY,
    WANTED,
    M,
    N,
)
from kilter_core.correct.kernels.rates import CAUGHT_UP, SLOWED_BY, bound_change

# Metres and radians, added up, that no correction is: what a version of nonsense asks for, and what is not a number.
NONSENSE = 1e3
# A guess looks ahead no further than this.
LOOK_AHEAD_S, LOOK_AHEAD_RAD = 0.05, 1e-3
# A setpoint that comes sooner than this after another is not refused for its speed: that is jitter of the times.
JITTER_S = 1e-3
# And what is divided by a time takes it for no shorter.
LEAST_STEP_S = 1e-6


@compile_kernel(**EXACT)
def _setpoint_status(P, state, info, x, n, m, width, dt):
    """Status of a setpoint before anything is computed: numbers, limits, speed."""
    for i in range(n * width):
        if not abs(x[i]) < math.inf:
            return NOT_FINITE
    mask = 0
    for i in range(n):
        if not P[m + 1 + i, LOWER] <= x[i] <= P[m + 1 + i, UPPER]:
            mask |= 1 << i
    if mask != 0:
        info[1] = mask
        return JOINT_LIMIT
    if state[n, STARTED] != 0.0:
        for i in range(n):
            if abs(x[i] - state[i, LAST_Q]) > P[m + 1 + i, SPEED] * max(dt, JITTER_S):
                mask |= 1 << i
    info[1] = mask
    return RATE_LIMIT if mask != 0 else OK


@compile_kernel(**EXACT)
def _direction(state, W, j, i, x, band, started):
    """Direction of the last motion of a joint: it reverses when the joint comes back by more than the band."""
    sign = state[i, LAST_SIGN] if started else 0.0
    place = state[i, REVERSED_AT] if started else x
    if x > place + band or (sign > 0.0 and x > place):
        sign, place = 1.0, x
    elif x < place - band or (sign < 0.0 and x < place):
        sign, place = -1.0, x
    W[j, SIGN], W[j, REVERSED_AT_NEW] = sign, place


@compile_kernel(**EXACT)
def _smooth(state, W, j, i, x, omega, dt, started):
    """Speed and acceleration of a joint by a critically damped filter that looks back only; it lags by 2 / omega."""
    place = state[i, SMOOTH] if started else x
    speed = state[i, SMOOTH_SPEED] if started else 0.0
    step = min(dt, 0.1)
    new = (speed + step * omega * omega * (x - place)) / (1.0 + 2.0 * omega * step + (omega * step) ** 2)
    W[j, SPEED_NOW] = new
    W[j, ACCEL_NOW] = (new - speed) / step if step > 0.0 else 0.0
    W[j, SMOOTH_NEW] = place + step * new
    W[j, SMOOTH_SPEED_NEW] = new


@compile_kernel(**EXACT)
def _motion(P, W, state, x, n, m, width, dt):
    """Wanted joints, speeds, accelerations and directions into W; whether the load is dynamic."""
    S = P.shape[0] - 1
    started = state[n, STARTED] != 0.0
    omega = P[S, FILTER]
    for i in range(n):
        j = m + 1 + i
        W[j, WANTED] = x[i]
        _direction(state, W, j, i, x[i], P[S, HYSTERESIS], started)
        if omega > 0.0:
            _smooth(state, W, j, i, x[i], omega, dt, started)
        if width == 3:
            W[j, SPEED_NOW], W[j, ACCEL_NOW] = x[n + i], x[2 * n + i]
        elif omega <= 0.0:
            W[j, SPEED_NOW], W[j, ACCEL_NOW] = 0.0, 0.0
    return width == 3 or omega > 0.0


@compile_kernel(**EXACT)
def _ramp(P, W, state, n, m, dt):
    """Advance the ramp from the last version, or from no correction; returns the part that remains, and its length.

    The whole correction goes into W. It is eased in and out, so its rate is at most 1.5 times that of a straight ramp.
    """
    S = P.shape[0] - 1
    length = state[n, LENGTH]
    if state[n, REBASE] != 0.0:
        length = P[S, RAMP]
        for i in range(n):
            j = m + 1 + i
            W[j, RAMPED] = state[i, LAST_DELTA] - (W[j, COMMAND] - W[j, WANTED])
            length = max(length, 1.5 * abs(W[j, RAMPED]) / P[j, RATE])
        remaining = 1.0
    else:
        for i in range(n):
            W[m + 1 + i, RAMPED] = state[i, OFFSET]
        remaining = max(0.0, state[n, REMAINING] - dt / length) if length > 0.0 else 0.0
    share = remaining * remaining * (3.0 - 2.0 * remaining)
    for j in range(m + 1, m + 1 + n):
        W[j, TOTAL] = W[j, COMMAND] - W[j, WANTED] + share * W[j, RAMPED]
    return remaining, length


@compile_kernel(**EXACT)
def _verdict(P, W, info, out, flags, n, m):
    """Corrected joints into ``out`` within the limits of correction and joints, and what was held at them into the info.

    A correction that exceeds a limit is scaled in all joints by one factor, so that the tool stays between where it is
    with and without it. Returns the status: where the options refuse what exceeds a limit, it is not OK, and never for
    a correction that is not finite or that no arm has.
    """
    S = P.shape[0] - 1
    large, outside, share, size = 0, 0, 1.0, 0.0
    flags |= flag_doubts(P, W, S, n, m)
    for k in range(3):
        size += abs(info[REMOVED + k]) + abs(info[LEFT + k])
    for i in range(n):
        size += abs(W[m + 1 + i, NEXT])
    if not size < NONSENSE:
        info[0] = flags
        return TOO_LARGE
    for i in range(n):
        j = m + 1 + i
        delta = W[j, NEXT]
        if not abs(delta) < P[j, LARGEST] * (1.0 - 1e-9):
            large |= 1 << i
            if abs(delta) > P[j, LARGEST] * (1.0 + 1e-9):
                flags |= SATURATED
                share = min(share, P[j, LARGEST] / abs(delta))
        if not P[j, LOWER] <= W[j, WANTED] + delta <= P[j, UPPER]:
            outside |= 1 << i
            room = (P[j, UPPER] if delta > 0.0 else P[j, LOWER]) - W[j, WANTED]
            share = min(share, max(0.0, room / delta)) if delta != 0.0 else 0.0
    for i in range(n):
        j = m + 1 + i
        out[i] = min(max(W[j, WANTED] + share * W[j, NEXT], P[j, LOWER]), P[j, UPPER])
    info[0] = flags | (SATURATED if outside != 0 else 0)
    if outside == 0 and not flags & SATURATED:
        return OK
    if P[S, SATURATES] != 0.0:
        info[1] = large | outside
        return OK
    info[1] = large if flags & SATURATED else outside
    return TOO_LARGE if flags & SATURATED else JOINT_LIMIT


@compile_kernel(**EXACT)
def _look_ahead(W, state, n, m, dt, fresh):
    """Guess the correction from the last ones; whether there was anything to go by."""
    if fresh:
        for i in range(n):
            W[m + 1 + i, GUESSED] = 0.0
        return False
    ahead = dt if dt < LOOK_AHEAD_S else 0.0
    for i in range(n):
        step = min(max(state[i, SLOPE] * ahead, -LOOK_AHEAD_RAD), LOOK_AHEAD_RAD)
        W[m + 1 + i, GUESSED] = state[i, GUESS] + step
    return True


@compile_kernel(**EXACT)
def _commit(P, W, state, out, remaining, length, behind, n, m, dt, fresh):
    """Remember what was answered."""
    started = state[n, STARTED] != 0.0
    for i in range(n):
        j = m + 1 + i
        state[i, LAST_A], state[i, LAST_B], state[i, LAST_SIDE] = W[j, TILT_A], W[j, TILT_B], W[j, SIDE]
        state[i, LAST_Q] = W[j, WANTED]
        state[i, REVERSED_AT] = W[j, REVERSED_AT_NEW]
        state[i, LAST_SIGN] = W[j, SIGN]
        state[i, OFFSET] = W[j, RAMPED] if remaining > 0.0 else 0.0
        answered = out[i] - W[j, WANTED]
        state[i, VELOCITY] = (answered - state[i, LAST_DELTA]) / max(dt, LEAST_STEP_S) if started else 0.0
        state[i, LAST_DELTA] = answered
        state[i, TARGET], state[i, AIMED] = W[j, TOTAL], W[j, AIMED]
        state[i, SMOOTH], state[i, SMOOTH_SPEED] = W[j, SMOOTH_NEW], W[j, SMOOTH_SPEED_NEW]
        delta = W[j, COMMAND] - W[j, WANTED]
        state[i, SLOPE] = 0.0 if fresh or dt < 1e-6 else (delta - state[i, GUESS]) / dt
        state[i, GUESS] = delta
    state[n, STARTED] = 2.0 if started else 1.0
    state[n, REBASE] = 0.0
    state[n, REMAINING] = remaining
    state[n, LENGTH] = length
    state[n, BEHIND] = 0.0 if behind <= CAUGHT_UP else 1.0


@compile_kernel(**EXACT)
def _report_remaining_error(P, W, S, info, out, n, m, dynamic, near):
    """What is left of the tool's error at the joints that are answered, by the signs of the version itself, into the info.

    ``near``: a sign is softened or held to its rate, which is said where it leaves something.
    """
    oj = m + 1
    for i in range(n):
        W[oj + i, COMMAND] = out[i]
    evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted_tool(P, W, m, oj, False), True)
    info[2] = math.sqrt(info[LEFT] ** 2 + info[LEFT + 1] ** 2 + info[LEFT + 2] ** 2)
    if not info[2] <= P[S, REACHED]:
        info[0] = int(info[0]) | RESIDUAL | (REVERSING if near else 0)


@compile_kernel(**EXACT)
def _hold_short(P, W, S, info, out, n, m, dynamic):
    """Go no further to a limit than brings the point closest; the joints into ``out``."""
    oj = m + 1
    for i in range(n):
        W[oj + i, COMMAND] = out[i]
    wanted = wanted_tool(P, W, m, oj, False)
    evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted, False)
    shorten(P, W, S, info, n, m, dynamic, wanted)
    for i in range(n):
        out[i] = W[oj + i, COMMAND]


@compile_kernel(**EXACT)
def correct_setpoint(P, W, state, x, width, dt, out, info):
    """Correct one setpoint of a stream and return its status; only status 0 leaves numbers and changes ``state``."""
    S = P.shape[0] - 1
    n = int(P[S, N])
    m = int(P[S, M])
    for i in range(INFO):
        info[i] = 0.0
    for i in range(n):
        out[i] = math.nan
    status = _setpoint_status(P, state, info, x, n, m, width, dt)
    if status != OK:
        return status
    dynamic = _motion(P, W, state, x, n, m, width, dt)
    fresh = state[n, STARTED] == 0.0 or state[n, REBASE] != 0.0
    warm = _look_ahead(W, state, n, m, dt, fresh)
    flags = solve(P, W, state, info, n, m, dynamic, math.inf if fresh else dt, warm, int(P[S, ITERATIONS]))
    near, flags = flags & (NEAR_REVERSAL | REVERSING) != 0, flags & ~NEAR_REVERSAL
    remaining, length = _ramp(P, W, state, n, m, dt)
    behind = 0.0
    if state[n, STARTED] != 0.0:
        step_s = max(dt, LEAST_STEP_S)
        behind = bound_change(P, W, S, state, info, n, m, dynamic, step_s, fresh, remaining > 0.0)
    else:
        for j in range(m + 1, m + 1 + n):
            W[j, AIMED] = W[j, NEXT] = W[j, TOTAL]
    if remaining > 0.0:
        flags |= RAMPING
    if behind > SLOWED_BY:
        flags |= SLOWED
    status = _verdict(P, W, info, out, flags, n, m)
    if status == OK:
        _commit(P, W, state, out, remaining, length, behind, n, m, dt, fresh)
        if remaining > 0.0 or behind > 0.0 or info[1] != 0.0 or near:
            _report_remaining_error(P, W, S, info, out, n, m, dynamic, near)
    else:
        for i in range(n):
            out[i] = math.nan
    return status


@compile_kernel(**EXACT)
def step(memory, program_rows, n, x, width, dt):
    """Correct one setpoint of a stream and return its status; only status 0 leaves numbers and changes the memory.

    ``x (width * n,)`` holds q, then qd and qdd; ``dt`` is the time since the last answer. The joints are left in the
    last row but one of ``memory``, the info in the last.
    """
    rows = memory.shape[0]
    P = memory[:program_rows]
    W = memory[program_rows : rows - n - 3]
    return correct_setpoint(P, W, memory[rows - n - 3 : rows - 2], x, width, dt, memory[rows - 2], memory[rows - 1])


@compile_kernel(**EXACT)
def follow(memory, program_rows, n, x, width, dt, out, info, status):
    """Correct the points of a chunk or trajectory one after another; returns how many came before the first refusal.

    ``x (K, width * n)``, ``dt (K,)``; writes ``out (K, n)``, ``info (K, INFO)`` and ``status (K,)``. After a refusal
    the rest is left out, with status -1.
    """
    rows = memory.shape[0]
    P = memory[:program_rows]
    W = memory[program_rows : rows - n - 3]
    state = memory[rows - n - 3 : rows - 2]
    for row in range(x.shape[0]):
        status[row] = correct_setpoint(P, W, state, x[row], width, dt[row], out[row], info[row])
        if status[row] != OK:
            status[row + 1 :] = -1
            return row
    return x.shape[0]


@compile_kernel(**EXACT)
def correct_row(P, W, state, x, width, direction, out, info, n, m):
    """Correct one row that follows no other: no ramp, no rate limits; returns its status.

    A row too large or outside the limits keeps its numbers: nothing moves by them.
    """
    S = P.shape[0] - 1
    for i in range(INFO):
        info[i] = 0.0
    for i in range(n):
        j = m + 1 + i
        W[j, WANTED], W[j, GUESSED], W[j, SIGN] = x[i], 0.0, direction[i]
        W[j, SPEED_NOW] = x[n + i] if width == 3 else 0.0
        W[j, ACCEL_NOW] = x[2 * n + i] if width == 3 else 0.0
    flags = solve(P, W, state, info, n, m, width == 3, math.inf, False, int(P[S, ROUNDS]))
    near, flags = flags & NEAR_REVERSAL != 0, flags & ~NEAR_REVERSAL
    for j in range(m + 1, m + 1 + n):
        W[j, NEXT] = W[j, COMMAND] - W[j, WANTED]
    status = _verdict(P, W, info, out, flags, n, m)
    if info[1] != 0.0:
        _hold_short(P, W, S, info, out, n, m, width == 3)
    if info[1] != 0.0 or near:
        _report_remaining_error(P, W, S, info, out, n, m, width == 3, near)
    for i in range(n):
        if not P[m + 1 + i, LOWER] <= x[i] <= P[m + 1 + i, UPPER]:
            status = JOINT_LIMIT
    return status


@compile_kernel(**EXACT)
def correct_rows(memory, program_rows, n, x, width, direction, out, info, status):
    """Correct N rows that do not follow one another; writes ``out (N, n)``, ``info (N, INFO)`` and ``status (N,)``."""
    rows = memory.shape[0]
    P = memory[:program_rows]
    W = memory[program_rows : rows - n - 3]
    state = memory[rows - n - 3 : rows - 2]
    m = int(P[program_rows - 1, M])
    for row in range(x.shape[0]):
        status[row] = correct_row(P, W, state, x[row], width, direction[row], out[row], info[row], n, m)


@compile_kernel(**EXACT)
def flag_doubts(P, W, S, n, m):
    """Return the flag UNSURE where the wanted joints are in a box of doubt, else 0."""
    first = int(P[S, DOUBT_AT])
    bounded = min(n, HIGHEST_OF_BOX - LOWEST_OF_BOX)
    for row in range(first, first + int(P[S, DOUBTS])):
        inside = 1
        for i in range(bounded):
            wanted = W[m + 1 + i, WANTED]
            if not P[row, LOWEST_OF_BOX + i] <= wanted <= P[row, HIGHEST_OF_BOX + i]:
                inside = 0
        if inside != 0:
            return UNSURE
    return 0
