"""The two chains of the correction, compiled: the nominal one at the wanted joints, the identified one at the command."""

from __future__ import annotations

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel
from kilter_core.arm.kernels.se3 import exponential, product, rotate_about_xy, rotated_z, shifted_z, sine_cosine_near
from kilter_core.correct.kernels.layout import (
    BASE_FRAME,
    BEHIND_TWIST,
    COMMAND,
    COSINE,
    FIRST_MOVE,
    FIXED_MOMENT_X,
    FIXED_MOMENT_Y,
    IDENTIFIED,
    JOINT,
    KIND,
    LINE,
    MOUNT,
    MOUNT_X,
    MOUNT_Y,
    NOMINAL,
    ON_BASE,
    PRIMARY,
    RATIO,
    SHIFT,
    SINE,
    TWIST,
    TWISTED,
    WANTED,
)


@compile_kernel(**EXACT)
def _constant(P, k, c):
    """Constant transform in P[k, c:c + 12] as (R row by row, p)."""
    return (
        P[k, c],
        P[k, c + 1],
        P[k, c + 2],
        P[k, c + 3],
        P[k, c + 4],
        P[k, c + 5],
        P[k, c + 6],
        P[k, c + 7],
        P[k, c + 8],
        P[k, c + 9],
        P[k, c + 10],
        P[k, c + 11],
    )


@compile_kernel(**EXACT)
def wanted_tool(P, W, m, oj, lines):
    """Tool frame of the nominal chain at the wanted joints; writes nothing but, when told to, the joint lines."""
    T = _constant(P, 0, NOMINAL)
    for k in range(m):
        if k > 0:
            T = product(T, _constant(P, k, NOMINAL))
        if P[k, KIND] == 0.0:
            T = rotated_z(T, W[k, SINE], W[k, COSINE])
        else:
            T = shifted_z(T, P[k, RATIO] * W[oj + int(P[k, JOINT]), WANTED])
        if lines:
            W[k, LINE], W[k, LINE + 1], W[k, LINE + 2] = T[2], T[5], T[8]
            W[k, LINE + 3], W[k, LINE + 4], W[k, LINE + 5] = T[9], T[10], T[11]
    return product(T, _constant(P, m, NOMINAL))


@compile_kernel(**EXACT)
def load_frames(P, W, at, m, oj):
    """Frames of the load chain, in rows from ``at`` on (0: the nominal one), at the command into W; returns the tool."""
    T = _constant(P, at, NOMINAL)
    for k in range(m):
        if k > 0:
            T = product(T, _constant(P, at + k, NOMINAL))
        j = oj + int(P[k, JOINT])
        shift = P[k, RATIO] * (W[j, COMMAND] - W[j, WANTED])
        if P[k, KIND] == 0.0:
            s, c = sine_cosine_near(W[k, SINE], W[k, COSINE], shift)
            T = rotated_z(T, s, c)
        else:
            T = shifted_z(T, P[k, RATIO] * W[j, COMMAND])
        _put_frame(W, k, 0, T)
    return product(T, _constant(P, at + m, NOMINAL))


@compile_kernel(**EXACT)
def _frame_after_move(P, W, k, j, T):
    """Frame T behind move k at the command of joint row j with its local correction."""
    if P[k, KIND] == 0.0:
        shift = P[k, RATIO] * (W[j, COMMAND] - W[j, WANTED] + W[j, SHIFT])
        s, c = sine_cosine_near(W[k, SINE], W[k, COSINE], shift)
        return rotated_z(T, s, c)
    return shifted_z(T, P[k, RATIO] * (W[j, COMMAND] + W[j, SHIFT]))


@compile_kernel(**EXACT)
def hanging_frames(P, W, at, m, oj):
    """Frames of the load chain at the command with the local corrections in W, and those behind the twists, into W."""
    T = _constant(P, at, NOMINAL)
    for k in range(m):
        if k > 0:
            T = product(T, _constant(P, at + k, NOMINAL))
        j = oj + int(P[k, JOINT])
        T = _frame_after_move(P, W, k, j, T)
        _put_frame(W, k, 0, T)
        if P[k, PRIMARY] >= 0.0:
            T = _frame_after_twist(P, W, j, T)
        _put_frame(W, k, BEHIND_TWIST, T)


@compile_kernel(**EXACT)
def _put_frame(W, k, c, T):
    """Write the frame T to W[k, c:c + 12]."""
    W[k, c], W[k, c + 1], W[k, c + 2], W[k, c + 3] = T[0], T[1], T[2], T[3]
    W[k, c + 4], W[k, c + 5], W[k, c + 6], W[k, c + 7] = T[4], T[5], T[6], T[7]
    W[k, c + 8], W[k, c + 9], W[k, c + 10], W[k, c + 11] = T[8], T[9], T[10], T[11]


@compile_kernel(**EXACT)
def _frame_after_twist(P, W, j, T):
    """Frame T behind the twist of joint row j."""
    if P[j, TWISTED] != 0.0:
        t = W[j]
        return product(
            T,
            exponential(t[TWIST], t[TWIST + 1], t[TWIST + 2], t[TWIST + 3], t[TWIST + 4], t[TWIST + 5]),
        )
    return rotate_about_xy(T, W[j, TWIST + 3], W[j, TWIST + 4])


@compile_kernel(**EXACT)
def _base_frame(P, W, m):
    """Start of the identified chain: a base mount that deflects tilts it by the load on the base."""
    S = P.shape[0] - 1
    if P[S, MOUNT] == 0.0:
        return _constant(P, 0, IDENTIFIED)
    x = P[S - 1, MOUNT_X] * (W[m, ON_BASE] + P[S - 1, FIXED_MOMENT_X])
    y = P[S - 1, MOUNT_Y] * (W[m, ON_BASE + 1] + P[S - 1, FIXED_MOMENT_Y])
    return product(rotate_about_xy(_constant(P, S - 1, BASE_FRAME), x, y), _constant(P, S - 1, FIRST_MOVE))


@compile_kernel(**EXACT)
def identified_tool(P, W, m, oj):
    """Tool frame of the identified chain at the command, with the local corrections in W; joint lines into W."""
    T = _base_frame(P, W, m)
    for k in range(m):
        if k > 0:
            T = product(T, _constant(P, k, IDENTIFIED))
        j = oj + int(P[k, JOINT])
        T = _frame_after_move(P, W, k, j, T)
        W[k, LINE], W[k, LINE + 1], W[k, LINE + 2] = T[2], T[5], T[8]
        W[k, LINE + 3], W[k, LINE + 4], W[k, LINE + 5] = T[9], T[10], T[11]
        if P[k, PRIMARY] >= 0.0:
            T = _frame_after_twist(P, W, j, T)
    return product(T, _constant(P, m, IDENTIFIED))
