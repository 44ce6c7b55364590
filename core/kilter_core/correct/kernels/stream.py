"""From wanted joints to corrected joints in one call, compiled, without allocation: setpoints, chunks, and rows apart."""

from __future__ import annotations

import math

from kilter_core.arm.kernels.compiled import EXACT, compiled
from kilter_core.correct.kernels.chain import wanted_tool
from kilter_core.correct.kernels.inverse import left_at, solve
from kilter_core.correct.kernels.layout import (
    ACCEL_NOW,
    COLUMN,
    COMMAND,
    FARTHEST,
    FILTER,
    GUESS,
    GUESSED,
    HYSTERESIS,
    INFO,
    JOINT_LIMIT,
    LARGEST,
    LAST_A,
    LAST_B,
    LAST_DELTA,
    LAST_Q,
    LAST_SIDE,
    LAST_SIGN,
    LENGTH,
    LOWER,
    NOT_FINITE,
    OFFSET,
    OK,
    RAMP,
    RAMPING,
    RATE,
    RATE_LIMIT,
    REBASE,
    REMAINING,
    REMOVED,
    REVERSED_AT,
    REVERSED_AT_NEW,
    SIDE,
    SIGN,
    SLOPE,
    SMOOTH,
    SMOOTH_NEW,
    SMOOTH_SPEED,
    SMOOTH_SPEED_NEW,
    SPEED,
    SPEED_NOW,
    STARTED,
    TILT_A,
    TILT_B,
    TOO_LARGE,
    UPPER,
    WANTED,
    M,
    N,
)

# A guess looks ahead no further than this.
LOOK_AHEAD_S, LOOK_AHEAD_RAD = 0.05, 1e-3


@compiled(**EXACT)
def _refused(P, state, info, x, n, m, width, dt):
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
            if abs(x[i] - state[i, LAST_Q]) > P[m + 1 + i, SPEED] * max(dt, 1e-3):
                mask |= 1 << i
    info[1] = mask
    return RATE_LIMIT if mask != 0 else OK


@compiled(**EXACT)
def _direction(state, W, j, i, x, band, started):
    """Direction of the last motion of a joint: it reverses when the joint comes back by more than the band."""
    sign = state[i, LAST_SIGN] if started else 0.0
    turn = state[i, REVERSED_AT] if started else x
    if x > turn + band or (sign > 0.0 and x > turn):
        sign, turn = 1.0, x
    elif x < turn - band or (sign < 0.0 and x < turn):
        sign, turn = -1.0, x
    W[j, SIGN], W[j, REVERSED_AT_NEW] = sign, turn


@compiled(**EXACT)
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


@compiled(**EXACT)
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


@compiled(**EXACT)
def _ramp(P, W, state, n, m, dt):
    """Advance the ramp from the last version, or from no correction; returns the part that remains, and its length."""
    S = P.shape[0] - 1
    if state[n, REBASE] != 0.0:
        length = P[S, RAMP]
        for i in range(n):
            j = m + 1 + i
            offset = state[i, LAST_DELTA] - (W[j, COMMAND] - W[j, WANTED])
            W[j, COLUMN] = offset
            length = max(length, abs(offset) / P[j, RATE])
        return 1.0, length
    for i in range(n):
        W[m + 1 + i, COLUMN] = state[i, OFFSET]
    length = state[n, LENGTH]
    if length <= 0.0:
        return 0.0, 0.0
    return max(0.0, state[n, REMAINING] - dt / length), length


@compiled(**EXACT)
def _verdict(P, W, info, out, remaining, n, m):
    """Corrected joints into ``out`` and their status: size of the correction, then limits of the joints."""
    large = 0
    outside = 0
    for i in range(n):
        j = m + 1 + i
        delta = W[j, COMMAND] - W[j, WANTED]
        if remaining > 0.0:
            delta += remaining * W[j, COLUMN]
        out[i] = W[j, WANTED] + delta
        if not abs(delta) <= P[j, LARGEST]:
            large |= 1 << i
        if not P[j, LOWER] <= out[i] <= P[j, UPPER]:
            outside |= 1 << i
    S = P.shape[0] - 1
    far = math.sqrt(info[REMOVED] ** 2 + info[REMOVED + 1] ** 2 + info[REMOVED + 2] ** 2)
    if large != 0 or not far <= P[S, FARTHEST]:
        info[1] = large
        return TOO_LARGE
    info[1] = outside
    return JOINT_LIMIT if outside != 0 else OK


@compiled(**EXACT)
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


@compiled(**EXACT)
def _commit(P, W, state, out, remaining, length, n, m, dt, fresh):
    """Remember what was answered."""
    for i in range(n):
        j = m + 1 + i
        state[i, LAST_A], state[i, LAST_B], state[i, LAST_SIDE] = W[j, TILT_A], W[j, TILT_B], W[j, SIDE]
        state[i, LAST_Q] = W[j, WANTED]
        state[i, REVERSED_AT] = W[j, REVERSED_AT_NEW]
        state[i, LAST_SIGN] = W[j, SIGN]
        state[i, OFFSET] = W[j, COLUMN] if remaining > 0.0 else 0.0
        state[i, LAST_DELTA] = out[i] - W[j, WANTED]
        state[i, SMOOTH], state[i, SMOOTH_SPEED] = W[j, SMOOTH_NEW], W[j, SMOOTH_SPEED_NEW]
        delta = W[j, COMMAND] - W[j, WANTED]
        state[i, SLOPE] = 0.0 if fresh or dt < 1e-6 else (delta - state[i, GUESS]) / dt
        state[i, GUESS] = delta
    state[n, STARTED] = 1.0
    state[n, REBASE] = 0.0
    state[n, REMAINING] = remaining
    state[n, LENGTH] = length


@compiled(**EXACT)
def _tell_left(P, W, S, info, out, n, m, dynamic):
    """What is left of the tool's error at joints that are not those of the search, into the info."""
    oj = m + 1
    for i in range(n):
        W[oj + i, COMMAND] = out[i]
    left_at(P, W, S, info, n, m, oj, dynamic, wanted_tool(P, W, m, oj, False))


@compiled(**EXACT)
def correct_setpoint(P, W, state, x, width, dt, out, info):
    """Correct one setpoint of a stream and return its status; only status 0 leaves numbers and changes ``state``."""
    S = P.shape[0] - 1
    n = int(P[S, N])
    m = int(P[S, M])
    for i in range(INFO):
        info[i] = 0.0
    for i in range(n):
        out[i] = math.nan
    status = _refused(P, state, info, x, n, m, width, dt)
    if status != OK:
        return status
    dynamic = _motion(P, W, state, x, n, m, width, dt)
    fresh = state[n, STARTED] == 0.0 or state[n, REBASE] != 0.0
    warm = _look_ahead(W, state, n, m, dt, fresh)
    flags = solve(P, W, state, info, n, m, dynamic, math.inf if fresh else dt, warm)
    remaining, length = _ramp(P, W, state, n, m, dt)
    status = _verdict(P, W, info, out, remaining, n, m)
    info[0] = flags | (RAMPING if remaining > 0.0 else 0)
    if status == OK:
        _commit(P, W, state, out, remaining, length, n, m, dt, fresh)
        if remaining > 0.0:
            _tell_left(P, W, S, info, out, n, m, dynamic)
    else:
        for i in range(n):
            out[i] = math.nan
    return status


@compiled(**EXACT)
def step(memory, program_rows, n, x, width, dt):
    """Correct one setpoint of a stream and return its status; only status 0 leaves numbers and changes the memory.

    ``x (width * n,)`` holds q, then qd and qdd; ``dt`` is the time since the last answer. The joints are left in the
    last row but one of ``memory``, the info in the last.
    """
    rows = memory.shape[0]
    P = memory[:program_rows]
    W = memory[program_rows : rows - n - 3]
    return correct_setpoint(P, W, memory[rows - n - 3 : rows - 2], x, width, dt, memory[rows - 2], memory[rows - 1])


@compiled(**EXACT)
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


@compiled(**EXACT)
def correct_rows(memory, program_rows, n, x, width, direction, out, info, status):
    """Correct N rows that do not follow one another: no ramp, no rate limits; ``direction (N, n)`` as it was measured.

    Writes ``out (N, n)``, ``info (N, INFO)`` and ``status (N,)``. A row too large or outside the limits keeps its
    numbers: nothing moves by them.
    """
    rows = memory.shape[0]
    P = memory[:program_rows]
    W = memory[program_rows : rows - n - 3]
    state = memory[rows - n - 3 : rows - 2]
    m = int(P[program_rows - 1, M])
    for row in range(x.shape[0]):
        info[row, :] = 0.0
        for i in range(n):
            j = m + 1 + i
            W[j, WANTED] = x[row, i]
            W[j, GUESSED] = 0.0
            W[j, SIGN] = direction[row, i]
            W[j, SPEED_NOW] = x[row, n + i] if width == 3 else 0.0
            W[j, ACCEL_NOW] = x[row, 2 * n + i] if width == 3 else 0.0
        flags = solve(P, W, state, info[row], n, m, width == 3, math.inf, False)
        status[row] = _verdict(P, W, info[row], out[row], 0.0, n, m)
        info[row, 0] = flags
