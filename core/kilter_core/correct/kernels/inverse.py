"""The inverse (thesis eq. 5.22, iterated), compiled: the command whose identified pose is the wanted one.

With J the identified Jacobian at the command, the correction is J' y where (J J' + D) y is the wanted pose less the one
without correction. Task "position" holds the tool point: D is zero in its rows, and damps those of the orientation where
the posture makes a rotation of the tool weak. So the answer is the least correction that holds the point and rotates
the tool as far as that is worth it; it does not depend on how it was reached, also where joints are redundant, for J is
taken anew until nothing moves. Along a stream the guess goes on from the last corrections, and one evaluation is mostly
enough; else it is the wanted joints.
"""

from __future__ import annotations

import math

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel
from kilter_core.arm.kernels.se3 import cross, rotation_between, sine_cosine
from kilter_core.correct.kernels.chain import hanging_frames, identified_tool, load_frames, wanted_tool
from kilter_core.correct.kernels.effects import deflections, kept_signs, own_signs, sign_effects
from kilter_core.correct.kernels.layout import (
    ADDED,
    BEHIND_TWIST,
    COLUMN,
    COMMAND,
    COSINE,
    CURVES,
    DAMPED,
    DYNAMIC,
    ERROR,
    FIRST,
    FREE,
    GUESSED,
    HANGING,
    HANGING_SIDED,
    JOINT,
    KIND,
    LEFT,
    LEFT_TURN,
    LINE,
    LOAD_CHAIN,
    LOADED,
    MOMENT,
    RATIO,
    REACHED,
    REMOVED,
    RESIDUAL,
    ROWS,
    SATURATED,
    SINE,
    STEP,
    STEPPED,
    TURNED,
    WANTED,
    WEIGHT,
)
from kilter_core.correct.kernels.newton_euler import load_moments
from kilter_core.correct.kernels.solver import aim, expand, factor_task, joint_step, normal_matrix

# Moments and Jacobian are taken anew while the command still moves by more than this; then they stand still.
SETTLED_RAD = 1e-7
# Along a stream the first step may be larger by this: it is the change of the correction against its prediction, and
# what is left after it is smaller by a factor of a hundred away from sign changes, of two within them.
GUESS_STEP = 10.0
# After this many rounds the signs stand still even if they flip back and forth around zero moment.
SIGN_ROUNDS = 4
# After this many rounds steps are halved: near a singular posture whole ones may go back and forth.
NEWTON_ROUNDS = 6
# Places at which a way is looked at first, and how exactly its best one is then found.
WAYPOINTS, WAY_STEP = 16, 1e-6


@compile_kernel(**EXACT)
def _jacobian(P, W, S, T, n, m, oj, rows):
    """Weighted task rows of the identified Jacobian by joint, column r of the joint rows (rotations in the tool frame).

    A joint that is left as it is has no column, so that no step moves it.
    """
    for i in range(n):
        for r in range(6):
            W[oj + i, COLUMN + r] = 0.0
    weight = P[S, WEIGHT + 3]
    for k in range(m):
        j = oj + int(P[k, JOINT])
        ratio = P[k, RATIO] * P[j, FREE]
        z0, z1, z2 = W[k, LINE], W[k, LINE + 1], W[k, LINE + 2]
        if P[k, KIND] == 0.0:
            v0, v1, v2 = cross(z0, z1, z2, T[9] - W[k, LINE + 3], T[10] - W[k, LINE + 4], T[11] - W[k, LINE + 5])
            if rows > 3:
                rotation = ratio * weight
                W[j, COLUMN + 3] += rotation * (T[0] * z0 + T[3] * z1 + T[6] * z2)
                W[j, COLUMN + 4] += rotation * (T[1] * z0 + T[4] * z1 + T[7] * z2)
                if rows > 5:
                    W[j, COLUMN + 5] += rotation * (T[2] * z0 + T[5] * z1 + T[8] * z2)
        else:
            v0, v1, v2 = z0, z1, z2
        for r, v in enumerate((v0, v1, v2)):
            W[j, COLUMN + r] += ratio * v


@compile_kernel(**EXACT)
def _residual(P, W, S, og, rows, wanted, actual):
    """Weighted task errors into the task rows; returns the distance of the tool points by axis."""
    d0, d1, d2 = wanted[9] - actual[9], wanted[10] - actual[10], wanted[11] - actual[11]
    W[og, ERROR], W[og + 1, ERROR], W[og + 2, ERROR] = d0, d1, d2
    if rows > 3:
        t0, t1, t2 = rotation_between(actual, wanted)
        W[og + 3, ERROR] = P[S, WEIGHT + 3] * t0
        W[og + 4, ERROR] = P[S, WEIGHT + 3] * t1
        if rows > 5:
            W[og + 5, ERROR] = P[S, WEIGHT + 3] * t2
    return d0, d1, d2


@compile_kernel(**EXACT)
def _command(W, n, oj, og, share):
    """Commands from the multipliers, or a share of the way there; returns the largest change of a joint."""
    largest = 0.0
    for j in range(oj, oj + n):
        W[j, STEPPED] = share * (W[j, WANTED] + joint_step(W, j, og) - W[j, COMMAND])
        largest = max(largest, abs(W[j, STEPPED]))
        W[j, COMMAND] += W[j, STEPPED]
    return largest


@compile_kernel(**EXACT)
def _loads_where_it_hangs(P, W, S, n, m, oj, dynamic):
    """Load moments at the frames now in W, then where these loads leave the arm with backlash and clearance in their middle."""
    load_moments(P, W, S, m, oj, dynamic, 0)
    for _ in range(int(P[S, HANGING])):
        deflections(P, W, n, m, oj, False)
        hanging_frames(P, W, int(P[S, LOAD_CHAIN]), m, oj)
        load_moments(P, W, S, m, oj, dynamic, BEHIND_TWIST)


@compile_kernel(**EXACT)
def _settle_on_sides(P, W, S, n, m, oj, dynamic):
    """What every joint adds with the sides now in W, and the loads where that leaves the arm."""
    deflections(P, W, n, m, oj, True)
    for _ in range(int(P[S, HANGING_SIDED])):
        hanging_frames(P, W, int(P[S, LOAD_CHAIN]), m, oj)
        load_moments(P, W, S, m, oj, dynamic, BEHIND_TWIST)
        deflections(P, W, n, m, oj, True)


@compile_kernel(**EXACT)
def prepare(P, W, n, m, oj):
    """Start the search at the wanted joints plus the guess."""
    for i in range(n):
        W[oj + i, COMMAND] = W[oj + i, WANTED] + W[oj + i, GUESSED]
        for k in range(3):
            W[oj + i, MOMENT + k] = 0.0
    for k in range(m):
        if P[k, KIND] == 0.0:
            s, c = sine_cosine(P[k, RATIO] * W[oj + int(P[k, JOINT]), WANTED])
            W[k, SINE], W[k, COSINE] = s, c


@compile_kernel(**EXACT)
def solve(P, W, state, info, n, m, dynamic, dt, warm, rounds):
    """Find the command whose identified pose is the wanted one, in at most ``rounds``; leaves it in W, returns the flags."""
    oj, og, S = m + 1, m + 1 + n, P.shape[0] - 1
    rows, at = int(P[S, ROWS]), int(P[S, LOAD_CHAIN])
    flags = DYNAMIC if dynamic else 0
    loaded = P[S, LOADED] != 0.0
    signs = 0
    largest, made = math.inf, 0
    prepare(P, W, n, m, oj)
    wanted = load_frames(P, W, at, m, oj)
    if warm or at > 0:
        wanted = wanted_tool(P, W, m, oj, False)
    for it in range(rounds):
        if it == 0 or (loaded and largest > SETTLED_RAD):
            if it > 0:
                load_frames(P, W, at, m, oj)
            if loaded:
                _loads_where_it_hangs(P, W, S, n, m, oj, dynamic)
            if it < SIGN_ROUNDS:
                signs = sign_effects(P, W, state, n, oj, dt)
            _settle_on_sides(P, W, S, n, m, oj, dynamic)
        elif P[S, CURVES] != 0.0:
            deflections(P, W, n, m, oj, True)
        actual = identified_tool(P, W, m, oj)
        d = _residual(P, W, S, og, rows, wanted, actual)
        if it == 0 or largest > SETTLED_RAD:
            _jacobian(P, W, S, actual, n, m, oj, rows)
            normal_matrix(W, n, oj, og, rows)
            factor_task(P, W, S, n, og, rows)
        else:
            expand(W, n, oj, og, rows)
        if it == 0:
            for i in range(3):
                info[REMOVED + i] = W[og + i, ERROR] + W[og + i, ADDED]
        made = aim(P, W, S, n, oj, og, rows)
        before = largest
        largest = _command(W, n, oj, og, 1.0 if it < NEWTON_ROUNDS else 0.5)
        info[7] = it + 1.0
        # Steps shrink by a constant factor: the next one would be largest * largest / before.
        if largest < P[S, STEP] * (GUESS_STEP if warm and it == 0 else 1.0) or (
            it > 0 and largest < before and largest * largest < 0.1 * P[S, STEP] * before
        ):
            break
    if it + 1 < rounds:
        _left_after_step(P, W, S, info, n, oj, rows, d, rotation_between(actual, wanted))
    else:
        evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted, False)
    if made & (SATURATED | DAMPED):
        shorten(P, W, S, info, n, m, dynamic, wanted)
    return flags | made | signs | _report(P, W, S, info, n, oj, og, rows)


@compile_kernel(**EXACT)
def _left_after_step(P, W, S, info, n, oj, rows, d, rotation):
    """What is left after the last step of the search, which was small: its Jacobian tells the step's share."""
    square = 0.0
    for r in range(6):
        step = 0.0
        if r < rows:
            for j in range(oj, oj + n):
                step += W[j, COLUMN + r] * W[j, STEPPED]
        if r < 3:
            info[LEFT + r] = step - d[r]
        else:
            rest = rotation[r - 3] - step / P[S, WEIGHT + 3]
            square += rest * rest
    info[LEFT_TURN] = math.sqrt(square)


@compile_kernel(**EXACT)
def evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted, own):
    """What is left of the tool's error at the commands in W, evaluated there; ``own``: by the signs of the version itself."""
    at = int(P[S, LOAD_CHAIN])
    if P[S, LOADED] != 0.0:
        load_frames(P, W, at, m, oj)
        _loads_where_it_hangs(P, W, S, n, m, oj, dynamic)
    if own:
        own_signs(P, W, n, oj)
    _settle_on_sides(P, W, S, n, m, oj, dynamic)
    if own:
        kept_signs(W, n, oj)
    actual = identified_tool(P, W, m, oj)
    for r in range(3):
        info[LEFT + r] = actual[9 + r] - wanted[9 + r]
    x, y, z = rotation_between(actual, wanted)
    info[LEFT_TURN] = math.sqrt(x * x + y * y + z * z)


@compile_kernel(**EXACT)
def _left_on_way(P, W, S, info, n, m, dynamic, wanted, share):
    """What is left of the point's error (3,) with a share of the correction in W."""
    oj = m + 1
    for j in range(oj, oj + n):
        W[j, COMMAND] = W[j, WANTED] + share * W[j, STEPPED]
    evaluate_remaining_error(P, W, S, info, n, m, oj, dynamic, wanted, False)
    return info[LEFT], info[LEFT + 1], info[LEFT + 2]


@compile_kernel(**EXACT)
def _square(share, none, half, whole):
    """Squared distance of the point on the parabola through its places with none, half and the whole of a correction."""
    total = 0.0
    for r in range(3):
        a, b, c = none[r], half[r], whole[r]
        e = a + share * (4.0 * b - 3.0 * a - c + share * 2.0 * (a - 2.0 * b + c))
        total += e * e
    return total


@compile_kernel(**EXACT)
def shorten(P, W, S, info, n, m, dynamic, wanted):
    """Of a correction that does not reach, keep the share that brings the point closest: its way may bend past that.

    Near a stretched elbow the whole of it can leave more than none. Returns the share.
    """
    if math.sqrt(info[LEFT] ** 2 + info[LEFT + 1] ** 2 + info[LEFT + 2] ** 2) <= P[S, REACHED]:
        return 1.0
    oj = m + 1
    for j in range(oj, oj + n):
        W[j, STEPPED] = W[j, COMMAND] - W[j, WANTED]
    none = _left_on_way(P, W, S, info, n, m, dynamic, wanted, 0.0)
    half = _left_on_way(P, W, S, info, n, m, dynamic, wanted, 0.5)
    whole = _left_on_way(P, W, S, info, n, m, dynamic, wanted, 1.0)
    at, least = 1.0, _square(1.0, none, half, whole)
    for k in range(WAYPOINTS):
        square = _square(k / WAYPOINTS, none, half, whole)
        if square < least:
            at, least = k / WAYPOINTS, square
    low, high = max(0.0, at - 1.0 / WAYPOINTS), min(1.0, at + 1.0 / WAYPOINTS)
    while high - low > WAY_STEP:
        a, b = low + (high - low) / 3.0, high - (high - low) / 3.0
        if _square(a, none, half, whole) < _square(b, none, half, whole):
            high = b
        else:
            low = a
    if high == 1.0:
        return 1.0
    _left_on_way(P, W, S, info, n, m, dynamic, wanted, high)
    return high


@compile_kernel(**EXACT)
def _report(P, W, S, info, n, oj, og, rows):
    """Residual of the tool point and of the first task; returns the flags of what is left."""
    first, total = int(P[S, FIRST]), 0.0
    info[2] = math.sqrt(info[LEFT] ** 2 + info[LEFT + 1] ** 2 + info[LEFT + 2] ** 2)
    for r in range(first):
        total += W[og + r, ERROR] * W[og + r, ERROR]
    info[3] = math.sqrt(total) if first > 3 else info[2]
    flags = 0 if info[3] <= P[S, REACHED] else RESIDUAL
    if first < rows and n >= 6 and info[LEFT_TURN] > P[S, TURNED]:
        flags |= DAMPED
    return flags
