"""Rate and acceleration of the correction along a stream, compiled: what the drives are asked for beside the path.

Where the wanted correction changes too fast, the joints follow it together at half of both bounds; what that costs the
tool point is given back by the least motion that holds the point, and only that sum is held to the whole bounds. So the
rotation of the tool is given up first and its point last. Whatever is held back is held back in all joints by one factor: on
the straight way from one correction to another the tool stays between what both of them leave. Before a joint comes to the
limit of its correction it brakes: it is there at rest.
"""

from __future__ import annotations

import math

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel
from kilter_core.correct.kernels.chain import wanted_tool
from kilter_core.correct.kernels.inverse import evaluate_remaining_error
from kilter_core.correct.kernels.layout import (
    AIMED,
    BEHIND,
    CHANGE,
    COLUMN,
    COMMAND,
    LARGEST,
    LAST_DELTA,
    LEFT,
    NEXT,
    SINGULAR,
    SPURT,
    STARTED,
    TARGET,
    TOTAL,
    VELOCITY,
    WANTED,
    WEAK,
    WISH,
)
from kilter_core.correct.kernels.solver import solve_point

# A correction that is further behind than this costs something; below the other it has caught up.
SLOWED_BY, CAUGHT_UP = 1e-6, 1e-10
# Braking is planned with this share of the acceleration: the next steps may be shorter than this one.
BRAKE = 0.9
# Joints that have nothing to do with a limit wait for the one that brakes by this factor at most.
MOST_BRAKE = 10.0
# A joint that is this near to its limit is there (rad or m).
THERE = 1e-12


@compile_kernel(**EXACT)
def _room(P, state, i, j, rate, dt):
    """The most rate at which a joint that goes the way of ``rate`` can still stop at the limit of its correction.

    In steps: from n times the change of rate of one step, n in k to k + 1, it stops after (k + 1) n - k (k + 1) / 2 of them.
    """
    spurt = BRAKE * P[j, SPURT] * dt
    room = (max(0.0, P[j, LARGEST] - math.copysign(1.0, rate) * state[i, LAST_DELTA]) + THERE) / (spurt * dt)
    k = math.floor(math.sqrt(0.25 + 2.0 * room) - 0.5)
    return spurt * (room + 0.5 * k * (k + 1.0)) / (k + 1.0)


@compile_kernel(**EXACT)
def _toward(P, W, state, n, oj, aim, before, share, dt, fresh, stops):
    """Next place of all joints on the way to column ``aim`` of W, which was at column ``before`` of the state, into NEXT.

    The way that is behind is made up no faster than the joints can brake, so they do not swing beyond. Changes of rate
    are scaled by one factor for all joints, as are rates. ``stops``: no joint comes faster than it can stop at its limit.
    """
    late, fast, sudden = 0.0, 1.0, 1.0
    for i in range(n):
        j = oj + i
        W[j, NEXT] = 0.0 if fresh else state[i, before] - state[i, LAST_DELTA]
        late = max(late, abs(W[j, NEXT]) / (share * P[j, SPURT]))
    # In a time of 1 / close, what is behind would be made up.
    close = min(1.0 / dt, (math.sqrt(0.25 * dt * dt + 2.0 * late) - 0.5 * dt) / late) if late > 0.0 else 0.0
    for i in range(n):
        j = oj + i
        was = state[i, LAST_DELTA] if fresh else state[i, before]
        W[j, WISH] = (W[j, aim] - was) / dt + W[j, NEXT] * close
        fast = max(fast, abs(W[j, WISH]) / (share * P[j, CHANGE]))
        if stops:
            room = _room(P, state, i, j, W[j, WISH], dt)
            if abs(W[j, WISH]) > room:
                fast = max(fast, min(MOST_BRAKE, abs(W[j, WISH]) / room))
    for i in range(n):
        j = oj + i
        W[j, WISH] = W[j, WISH] / fast - state[i, VELOCITY]
        sudden = max(sudden, abs(W[j, WISH]) / (share * P[j, SPURT] * dt))
    for i in range(n):
        j = oj + i
        rate = state[i, VELOCITY] + W[j, WISH] / sudden
        if stops:
            room = _room(P, state, i, j, rate, dt)
            if abs(rate) > room:  # on the way to a limit the acceleration of another joint may hold back its braking
                spurt = P[j, SPURT] * dt
                slower = max(room, abs(state[i, VELOCITY]) - spurt)
                rate = math.copysign(min(abs(rate), slower), rate)
        W[j, NEXT] = state[i, LAST_DELTA] + rate * dt


@compile_kernel(**EXACT)
def _keeps_up(P, W, state, n, oj, dt):
    """Whether the wanted correction itself keeps to the bounds."""
    if state[n, BEHIND] != 0.0:
        return False
    moving = state[n, STARTED] > 1.0  # before its second setpoint a stream has no rate that could change
    for i in range(n):
        j = oj + i
        step = W[j, TOTAL] - state[i, LAST_DELTA]
        if not abs(step) <= P[j, CHANGE] * dt:
            return False
        # Far from the limit, which is mostly so, this needs no root.
        spurt = BRAKE * P[j, SPURT] * dt * dt
        room = P[j, LARGEST] - math.copysign(1.0, step) * state[i, LAST_DELTA]
        if not (abs(step) + 0.5 * spurt) ** 2 <= 2.0 * spurt * room and abs(step) > dt * _room(
            P, state, i, j, step, dt
        ):
            return False
        if moving and not abs(step - state[i, VELOCITY] * dt) <= P[j, SPURT] * dt * dt:
            return False
    return True


@compile_kernel(**EXACT)
def _hold_point(P, W, S, info, n, m, dynamic, wanted):
    """Take back from the aim what the tool point is off there, beside what the search left: the rotation is not quite small."""
    oj, og = m + 1, m + 1 + n
    l0, l1, l2 = info[LEFT], info[LEFT + 1], info[LEFT + 2]
    for j in range(oj, oj + n):
        W[j, COMMAND] = W[j, WANTED] + W[j, AIMED]
    evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted, False)
    # Near a singular posture of the point this would ask for too much.
    floor = 0.01 * P[S, WEAK]
    y0, y1, y2 = solve_point(W, og, info[LEFT] - l0, info[LEFT + 1] - l1, info[LEFT + 2] - l2, floor)
    for j in range(oj, oj + n):
        W[j, COMMAND] = W[j, WANTED] + W[j, TOTAL]
        W[j, AIMED] -= W[j, COLUMN] * y0 + W[j, COLUMN + 1] * y1 + W[j, COLUMN + 2] * y2


@compile_kernel(**EXACT)
def bound_change(P, W, S, state, info, n, m, dynamic, dt, fresh, ramping):
    """Bound the change of the whole correction, from wanted in W to answered; by how much it falls behind."""
    oj, og = m + 1, m + 1 + n
    if _keeps_up(P, W, state, n, oj, dt):
        for j in range(oj, oj + n):
            W[j, AIMED] = W[j, NEXT] = W[j, TOTAL]
        return 0.0
    _toward(P, W, state, n, oj, TOTAL, TARGET, 0.5, dt, fresh, False)
    g0 = g1 = g2 = 0.0
    for j in range(oj, oj + n):
        behind = W[j, TOTAL] - W[j, NEXT]
        g0, g1, g2 = g0 + W[j, COLUMN] * behind, g1 + W[j, COLUMN + 1] * behind, g2 + W[j, COLUMN + 2] * behind
    y0, y1, y2 = solve_point(W, og, g0, g1, g2, P[S, SINGULAR])
    for j in range(oj, oj + n):
        W[j, AIMED] = W[j, NEXT] + W[j, COLUMN] * y0 + W[j, COLUMN + 1] * y1 + W[j, COLUMN + 2] * y2
    if not ramping:
        _hold_point(P, W, S, info, n, m, dynamic, wanted_tool(P, W, m, oj, False))
    for j in range(oj, oj + n):
        W[j, AIMED] = min(max(W[j, AIMED], -P[j, LARGEST]), P[j, LARGEST])
    _toward(P, W, state, n, oj, AIMED, AIMED, 1.0, dt, fresh, True)
    most = 0.0
    for j in range(oj, oj + n):
        most = max(most, abs(W[j, TOTAL] - W[j, NEXT]))
    return most
