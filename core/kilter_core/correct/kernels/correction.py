"""The whole correction of a setpoint, compiled, without allocation: one call from wanted joints to corrected joints.

``program`` (rows, COLUMNS) is what :func:`kilter_core.correct.program.compile_program` makes of a calibration: one row per move (a
joint element with the constant transform before it), one for the constant transform up to the tool, one per joint, one
per curve of a joint, two per bending link, M + 1 with the constants of the chain that loads are taken on where it is not
the nominal one, one for a pedestal that gives way, one of scalars. Every move is turned so that it is about or along z;
frame k is the joint frame after move k. ``memory`` holds the program, scratch
(M + 1 + n + 6 rows), the memory of one stream (n + 1 rows), and one row each for joints out and info: one array,
because every array that crosses from Python costs a tenth of a microsecond.
Angles rad, lengths m, masses kg, times s. Base frame throughout: the pose of the base cancels out of the task.

The inverse (thesis eq. 5.22, iterated): with J the identified Jacobian at the first guess of the command, the command
is q + J' y where (J J' + λ²) y solves the wanted pose; λ is zero away from singularities. With joints to spare J is that
of the nominal arm at the wanted joints, so that the answer does not depend on how it was reached. Along a stream the
guess goes on from the last corrections, and one evaluation is mostly enough; else it is the wanted joints.
"""

from __future__ import annotations

import math
from typing import Any

from numba import njit

COLUMNS = 48
INFO = 8  # flags, limit mask, residual m, residual of all rows, error removed x y z m, iterations

# move rows
NOMINAL, IDENTIFIED, KIND, JOINT, RATIO, PRIMARY, MASS, COM, INERTIA = 0, 12, 24, 25, 26, 27, 28, 29, 32
# joint rows
LOWER, UPPER, DQ, XI, TILT, TILT_SOFT, TILT_SHARE, PLAY, PLAY_SOFT = 0, 1, 2, 3, 9, 10, 11, 12, 13
REVERSAL, COMPLIANCE, RATE, LARGEST, SPEED, RADIAL, TWISTED, HARDENING, SIDED = 14, 15, 16, 17, 18, 19, 20, 21, 22
# curve rows: a shape of the joint ``DRIVER`` added to the joint ``CURVED``
CURVED, SHAPE, DRIVER, AMPLITUDE_A, AMPLITUDE_B, FACTOR, EXTRA, POWERS, HIGHEST = 0, 1, 2, 3, 4, 5, 6, 8, 20
WAVE, LINEAR, SPRING, SINES, LAG, POLYNOMIAL = 0.0, 1.0, 2.0, 3.0, 4.0, 5.0
# beam rows: twist per wrench on the joint (6, 6), then the same per wrench on the end of the link; link vector
BEAM, BEAM_JOINT, BEAM_LINK = 0, 36, 37
# pedestal row: constant transform of the base, then the one up to the first move; compliances, constant moment
FOOT, ABOVE, PEDESTAL_X, PEDESTAL_Y, STANDING_X, STANDING_Y = 0, 12, 24, 25, 26, 27
# scalars
GRAVITY, ROWS, WEIGHT, ITERATIONS, STEP, SINGULAR, FARTHEST, RAMP, FILTER = 0, 3, 10, 16, 17, 18, 19, 20, 21
HYSTERESIS, LOADED, REACHED, N, M, WEAK, CURVES, BEAMS, PEDESTAL, LOAD_CHAIN = 22, 23, 24, 25, 26, 27, 28, 29, 30, 31
# scratch of a move: frame of the load chain, identified joint line, sine, cosine wanted, load of its body (M: payload)
LINE, SINE, COSINE, LOAD, ON_BASE = 12, 18, 19, 20, 26
# scratch of a joint
WANTED, COMMAND, SHIFT, LEAN_A, LEAN_B, SIDE, MOMENT, SPEED_NOW, ACCEL_NOW, SIGN = 0, 1, 2, 3, 4, 5, 6, 9, 10, 11
COLUMN, TURN_NEW, SMOOTH_NEW, SMOOTH_SPEED_NEW, GUESSED, TWIST, ROOT, END = 12, 18, 19, 20, 21, 22, 28, 34
# scratch of a task row: factor row, residual, multiplier, right-hand side, then damping, matrix and eigenvector rows,
# and what the first guess adds to the residual
ERROR, MULTIPLIER, RIGHT, DAMPING, MATRIX, VECTOR, ADDED = 6, 7, 8, 9, 15, 21, 27
# state of a joint, and of the stream (row n)
LAST_A, LAST_B, LAST_SIDE, LAST_Q, TURN, HEADING = 0, 1, 2, 3, 4, 5
OFFSET, LAST_DELTA, SMOOTH, SMOOTH_SPEED, GUESS, SLOPE = 6, 7, 8, 9, 10, 11
STARTED, REBASE, REMAINING, LENGTH = 0, 1, 2, 3

OK, NOT_FINITE, JOINT_LIMIT, TOO_LARGE, RATE_LIMIT = 0, 5, 6, 7, 8
DYNAMIC, RAMPING, LIMITED, DAMPED, RESIDUAL = 0x0100, 0x0200, 0x0400, 0x0800, 0x1000

# Below this moment a sign would be that of rounding noise.
NO_MOMENT = 1e-9
# Moments are taken anew while the command still moves by more than this; then the effects stand still.
SETTLED_RAD = 1e-7
# A singularity may ask a joint for this part of the largest correction; damping overshoots it by up to 16 %.
BOUND = 0.85
# Along a stream the first step may be larger by this: it is the change of the correction against its prediction, and
# what is left after it is smaller by a factor of a hundred away from sign changes, of two within them.
GUESS_STEP = 10.0
# A guess looks ahead no further than this.
LOOK_AHEAD_S, LOOK_AHEAD_RAD = 0.05, 1e-3
# How things are compiled. Arrays are not counted: they outlive every call, and counting takes a third of the time.
# FAST: sums may be contracted and rearranged; NaN and infinity keep their meaning, for they are refused. ORDERED: sums
# keep their order, or else short ones over the joints are gathered from all over the memory, which is slower.
EXACT: dict[str, Any] = {"cache": True, "error_model": "numpy", "_nrt": False}
FAST: dict[str, Any] = {**EXACT, "fastmath": {"contract", "reassoc", "nsz", "arcp"}}
ORDERED: dict[str, Any] = {**EXACT, "fastmath": {"contract", "nsz", "arcp"}}
# pi/2 in two parts, the first short enough that small multiples of it are exact.
HALF_PI_HIGH, HALF_PI_LOW = 1.57079632673412561417e00, 6.07710050650619224932e-11
# After this many rounds the signs stand still even if they flip back and forth around zero moment.
SIGN_ROUNDS = 4


@njit(**FAST)
def _cross(a0, a1, a2, b0, b1, b2):
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@njit(**EXACT)
def _constant(P, k, c):
    """Constant transform in P[k, c:c + 12] as (R row by row, p)."""
    return (
        P[k, c], P[k, c + 1], P[k, c + 2], P[k, c + 3], P[k, c + 4], P[k, c + 5],
        P[k, c + 6], P[k, c + 7], P[k, c + 8], P[k, c + 9], P[k, c + 10], P[k, c + 11],
    )  # fmt: skip


@njit(**FAST)
def _product(A, B):
    """Product of two frames."""
    return (
        A[0] * B[0] + A[1] * B[3] + A[2] * B[6],
        A[0] * B[1] + A[1] * B[4] + A[2] * B[7],
        A[0] * B[2] + A[1] * B[5] + A[2] * B[8],
        A[3] * B[0] + A[4] * B[3] + A[5] * B[6],
        A[3] * B[1] + A[4] * B[4] + A[5] * B[7],
        A[3] * B[2] + A[4] * B[5] + A[5] * B[8],
        A[6] * B[0] + A[7] * B[3] + A[8] * B[6],
        A[6] * B[1] + A[7] * B[4] + A[8] * B[7],
        A[6] * B[2] + A[7] * B[5] + A[8] * B[8],
        A[0] * B[9] + A[1] * B[10] + A[2] * B[11] + A[9],
        A[3] * B[9] + A[4] * B[10] + A[5] * B[11] + A[10],
        A[6] * B[9] + A[7] * B[10] + A[8] * B[11] + A[11],
    )


@njit(**FAST)
def _turned(A, s, c):
    """Frame A turned about its z by the angle of sine s and cosine c."""
    return (
        c * A[0] + s * A[1], c * A[1] - s * A[0], A[2],
        c * A[3] + s * A[4], c * A[4] - s * A[3], A[5],
        c * A[6] + s * A[7], c * A[7] - s * A[6], A[8],
        A[9], A[10], A[11],
    )  # fmt: skip


@njit(**FAST)
def _moved(A, d):
    """Frame A moved along its z by d."""
    return (
        A[0], A[1], A[2], A[3], A[4], A[5], A[6], A[7], A[8],
        A[9] + A[2] * d, A[10] + A[5] * d, A[11] + A[8] * d,
    )  # fmt: skip


@njit(**FAST)
def _quarter(x):
    """Sine and cosine up to pi/4."""
    z = x * x
    s = x * (1.0 + z * (-1.6666666666666666e-1 + z * (8.333333333333333e-3 + z * (-1.984126984126984e-4 + z * (
        2.7557319223985893e-6 + z * (-2.505210838544172e-8 + z * (1.6059043836821613e-10 - z * 7.647163731819816e-13
    )))))))  # fmt: skip
    c = 1.0 + z * (-0.5 + z * (4.1666666666666664e-2 + z * (-1.388888888888889e-3 + z * (2.48015873015873e-5 + z * (
        -2.755731922398589e-7 + z * (2.08767569878681e-9 + z * (-1.1470745597729725e-11 + z * 4.779477332387385e-14
    )))))))  # fmt: skip
    return s, c


@njit(**EXACT)
def _sine_cosine(x):
    """Sine and cosine of an angle of some turns, to the last digit or two."""
    k = math.floor(x * (2.0 / math.pi) + 0.5)
    if abs(k) > 1e5:
        return math.sin(x), math.cos(x)
    s, c = _quarter((x - k * HALF_PI_HIGH) - k * HALF_PI_LOW)
    quadrant = int(k) & 3
    if quadrant == 0:
        return s, c
    if quadrant == 1:
        return c, -s
    if quadrant == 2:
        return -s, -c
    return -c, s


@njit(**FAST)
def _small_turn(s, c, d):
    """Sine and cosine of a + d from those of a: the series is exact to 1e-17 up to 0.03 rad."""
    if abs(d) < 0.03:
        d2 = d * d
        sd = d * (1.0 - d2 * (1.0 / 6.0 - d2 * (1.0 / 120.0 - d2 / 5040.0)))
        cd = 1.0 - d2 * (0.5 - d2 * (1.0 / 24.0 - d2 * (1.0 / 720.0 - d2 / 40320.0)))
    else:
        sd = math.sin(d)
        cd = math.cos(d)
    return s * cd + c * sd, c * cd - s * sd


@njit(**FAST)
def _angle_series(t2):
    """sin t / t, (1 - cos t) / t² and (t - sin t) / t³ of the square of an angle."""
    if t2 < 1e-3:  # exact here, and the closed forms would lose digits to cancellation
        a = 1.0 - t2 * (1.0 / 6.0 - t2 * (1.0 / 120.0 - t2 / 5040.0))
        b = 0.5 - t2 * (1.0 / 24.0 - t2 * (1.0 / 720.0 - t2 / 40320.0))
        c = 1.0 / 6.0 - t2 * (1.0 / 120.0 - t2 * (1.0 / 5040.0 - t2 / 362880.0))
    else:
        t = math.sqrt(t2)
        a = math.sin(t) / t
        b = (1.0 - math.cos(t)) / t2
        c = (1.0 - a) / t2
    return a, b, c


@njit(**FAST)
def _leaned(T, x, y):
    """Frame T turned about its own x and y by the rotation vector (x, y, 0)."""
    a, b, _ = _angle_series(x * x + y * y)
    xx, yy, xy, sx, sy = 1.0 - b * y * y, 1.0 - b * x * x, b * x * y, a * x, a * y
    zz = 1.0 - b * (x * x + y * y)
    return (
        T[0] * xx + T[1] * xy - T[2] * sy, T[0] * xy + T[1] * yy + T[2] * sx, T[0] * sy - T[1] * sx + T[2] * zz,
        T[3] * xx + T[4] * xy - T[5] * sy, T[3] * xy + T[4] * yy + T[5] * sx, T[3] * sy - T[4] * sx + T[5] * zz,
        T[6] * xx + T[7] * xy - T[8] * sy, T[6] * xy + T[7] * yy + T[8] * sx, T[6] * sy - T[7] * sx + T[8] * zz,
        T[9], T[10], T[11],
    )  # fmt: skip


@njit(**FAST)
def _exponential(v0, v1, v2, w0, w1, w2):
    """exp of the twist (v, w) as a frame."""
    a, b, c = _angle_series(w0 * w0 + w1 * w1 + w2 * w2)
    d = w0 * v0 + w1 * v1 + w2 * v2  # left Jacobian of SO(3) times v
    return (
        1.0 - b * (w1 * w1 + w2 * w2), b * w0 * w1 - a * w2, b * w0 * w2 + a * w1,
        b * w0 * w1 + a * w2, 1.0 - b * (w0 * w0 + w2 * w2), b * w1 * w2 - a * w0,
        b * w0 * w2 - a * w1, b * w1 * w2 + a * w0, 1.0 - b * (w0 * w0 + w1 * w1),
        a * v0 + b * (w1 * v2 - w2 * v1) + c * d * w0,
        a * v1 + b * (w2 * v0 - w0 * v2) + c * d * w1,
        a * v2 + b * (w0 * v1 - w1 * v0) + c * d * w2,
    )  # fmt: skip


@njit(**FAST)
def _wanted_tool(P, W, m, oj, lines):
    """Tool frame of the nominal chain at the wanted joints; writes nothing but, when told to, the joint lines."""
    T = _constant(P, 0, NOMINAL)
    for k in range(m):
        if k > 0:
            T = _product(T, _constant(P, k, NOMINAL))
        if P[k, KIND] == 0.0:
            T = _turned(T, W[k, SINE], W[k, COSINE])
        else:
            T = _moved(T, P[k, RATIO] * W[oj + int(P[k, JOINT]), WANTED])
        if lines:
            W[k, LINE], W[k, LINE + 1], W[k, LINE + 2] = T[2], T[5], T[8]
            W[k, LINE + 3], W[k, LINE + 4], W[k, LINE + 5] = T[9], T[10], T[11]
    return _product(T, _constant(P, m, NOMINAL))


@njit(**FAST)
def _load_frames(P, W, at, m, oj):
    """Frames of the load chain, in rows from ``at`` on (0: the nominal one), at the command into W; returns the tool."""
    T = _constant(P, at, NOMINAL)
    for k in range(m):
        if k > 0:
            T = _product(T, _constant(P, at + k, NOMINAL))
        j = oj + int(P[k, JOINT])
        shift = P[k, RATIO] * (W[j, COMMAND] - W[j, WANTED])
        if P[k, KIND] == 0.0:
            s, c = _small_turn(W[k, SINE], W[k, COSINE], shift)
            T = _turned(T, s, c)
        else:
            T = _moved(T, P[k, RATIO] * W[j, COMMAND])
        W[k, 0], W[k, 1], W[k, 2], W[k, 3], W[k, 4], W[k, 5] = T[0], T[1], T[2], T[3], T[4], T[5]
        W[k, 6], W[k, 7], W[k, 8], W[k, 9], W[k, 10], W[k, 11] = T[6], T[7], T[8], T[9], T[10], T[11]
    return _product(T, _constant(P, at + m, NOMINAL))


@njit(**FAST)
def _foot(P, W, m):
    """Start of the identified chain: a pedestal that gives way tilts it by the load on the base."""
    S = P.shape[0] - 1
    if P[S, PEDESTAL] == 0.0:
        return _constant(P, 0, IDENTIFIED)
    x = P[S - 1, PEDESTAL_X] * (W[m, ON_BASE] + P[S - 1, STANDING_X])
    y = P[S - 1, PEDESTAL_Y] * (W[m, ON_BASE + 1] + P[S - 1, STANDING_Y])
    return _product(_leaned(_constant(P, S - 1, FOOT), x, y), _constant(P, S - 1, ABOVE))


@njit(**FAST)
def _identified(P, W, m, oj):
    """Tool frame of the identified chain at the command, with the local corrections in W; joint lines into W."""
    T = _foot(P, W, m)
    for k in range(m):
        if k > 0:
            T = _product(T, _constant(P, k, IDENTIFIED))
        j = oj + int(P[k, JOINT])
        shift = P[k, RATIO] * (W[j, COMMAND] - W[j, WANTED] + W[j, SHIFT])
        if P[k, KIND] == 0.0:
            s, c = _small_turn(W[k, SINE], W[k, COSINE], shift)
            T = _turned(T, s, c)
        else:
            T = _moved(T, P[k, RATIO] * (W[j, COMMAND] + W[j, SHIFT]))
        W[k, LINE], W[k, LINE + 1], W[k, LINE + 2] = T[2], T[5], T[8]
        W[k, LINE + 3], W[k, LINE + 4], W[k, LINE + 5] = T[9], T[10], T[11]
        if P[k, PRIMARY] >= 0.0:
            if P[j, TWISTED] != 0.0:
                t = W[j]
                T = _product(
                    T,
                    _exponential(t[TWIST], t[TWIST + 1], t[TWIST + 2], t[TWIST + 3], t[TWIST + 4], t[TWIST + 5]),
                )
            else:
                T = _leaned(T, W[j, TWIST + 3], W[j, TWIST + 4])
    return _product(T, _constant(P, m, IDENTIFIED))


@njit(**FAST)
def _static_moments(P, W, S, m, oj):
    """Load moments in the joint frames from gravity alone: mass and first moment, from the tool inwards."""
    g0, g1, g2 = P[S, GRAVITY], P[S, GRAVITY + 1], P[S, GRAVITY + 2]
    mass = P[m, MASS]
    s0, s1, s2 = _point(W, m - 1, P[m, COM], P[m, COM + 1], P[m, COM + 2])
    s0, s1, s2 = mass * s0, mass * s1, mass * s2
    for k in range(m - 1, -1, -1):
        body = P[k, MASS]
        if body != 0.0:
            c0, c1, c2 = _point(W, k, P[k, COM], P[k, COM + 1], P[k, COM + 2])
            mass += body
            s0, s1, s2 = s0 + body * c0, s1 + body * c1, s2 + body * c2
        if P[k, PRIMARY] >= 0.0:
            r0, r1, r2 = s0 - mass * W[k, 9], s1 - mass * W[k, 10], s2 - mass * W[k, 11]
            t0, t1, t2 = _cross(r0, r1, r2, g0, g1, g2)
            _to_joint(P, W, k, oj + int(P[k, JOINT]), t0, t1, t2, mass * g0, mass * g1, mass * g2)


@njit(**FAST)
def _point(W, k, x, y, z):
    """Base coordinates of a point of frame k."""
    return (
        W[k, 0] * x + W[k, 1] * y + W[k, 2] * z + W[k, 9],
        W[k, 3] * x + W[k, 4] * y + W[k, 5] * z + W[k, 10],
        W[k, 6] * x + W[k, 7] * y + W[k, 8] * z + W[k, 11],
    )


@njit(**FAST)
def _to_joint(P, W, k, j, x, y, z, f0, f1, f2):
    """Turn a load in base coordinates into frame k and keep it for joint row j: two moments across, one along the axis.

    Along the axis a joint that turns feels a moment, one that slides a force.
    """
    W[j, MOMENT] = W[k, 0] * x + W[k, 3] * y + W[k, 6] * z
    W[j, MOMENT + 1] = W[k, 1] * x + W[k, 4] * y + W[k, 7] * z
    if P[k, KIND] == 0.0:
        W[j, MOMENT + 2] = W[k, 2] * x + W[k, 5] * y + W[k, 8] * z
    else:
        W[j, MOMENT + 2] = W[k, 2] * f0 + W[k, 5] * f1 + W[k, 8] * f2


@njit(**FAST)
def _swing(w, dw, r0, r1, r2):
    """Acceleration of a point at r on a body that turns with w and dw: dw x r + w x (w x r)."""
    a0, a1, a2 = _cross(dw[0], dw[1], dw[2], r0, r1, r2)
    t0, t1, t2 = _cross(w[0], w[1], w[2], r0, r1, r2)
    u0, u1, u2 = _cross(w[0], w[1], w[2], t0, t1, t2)
    return a0 + u0, a1 + u1, a2 + u2


@njit(**FAST)
def _inward(W, k, x, y, z):
    """A vector in base coordinates turned into frame k."""
    return (
        W[k, 0] * x + W[k, 3] * y + W[k, 6] * z,
        W[k, 1] * x + W[k, 4] * y + W[k, 7] * z,
        W[k, 2] * x + W[k, 5] * y + W[k, 8] * z,
    )


@njit(**FAST)
def _body_load(P, row, w, dw, a):
    """Force and moment about the origin of its frame of the body in row ``row``, in the axes of that frame (d'Alembert).

    ``w``, ``dw`` and ``a`` (gravity minus acceleration of the origin) are in the same axes.
    """
    mass = P[row, MASS]
    c0, c1, c2 = P[row, COM], P[row, COM + 1], P[row, COM + 2]
    s0, s1, s2 = _swing(w, dw, c0, c1, c2)
    f0, f1, f2 = mass * (a[0] - s0), mass * (a[1] - s1), mass * (a[2] - s2)
    xx, yy, zz = P[row, INERTIA], P[row, INERTIA + 1], P[row, INERTIA + 2]
    xy, xz, yz = P[row, INERTIA + 3], P[row, INERTIA + 4], P[row, INERTIA + 5]
    h0, h1, h2 = (
        xx * w[0] + xy * w[1] + xz * w[2], xy * w[0] + yy * w[1] + yz * w[2], xz * w[0] + yz * w[1] + zz * w[2],
    )  # fmt: skip
    t0, t1, t2 = _cross(w[0], w[1], w[2], h0, h1, h2)
    m0, m1, m2 = _cross(c0, c1, c2, f0, f1, f2)
    m0 -= t0 + xx * dw[0] + xy * dw[1] + xz * dw[2]
    m1 -= t1 + xy * dw[0] + yy * dw[1] + yz * dw[2]
    m2 -= t2 + xz * dw[0] + yz * dw[1] + zz * dw[2]
    return f0, f1, f2, m0, m1, m2


@njit(**FAST)
def _carry_load(P, W, row, k, w, dw, a):
    """Load of the body in row ``row`` that rides on frame k, about the base origin in base coordinates, into W."""
    if P[row, MASS] == 0.0:
        for i in range(6):
            W[row, LOAD + i] = 0.0
        return
    x0, x1, x2, y0, y1, y2 = _body_load(P, row, w, dw, a)
    f0 = W[k, 0] * x0 + W[k, 1] * x1 + W[k, 2] * x2
    f1 = W[k, 3] * x0 + W[k, 4] * x1 + W[k, 5] * x2
    f2 = W[k, 6] * x0 + W[k, 7] * x1 + W[k, 8] * x2
    t0, t1, t2 = _cross(W[k, 9], W[k, 10], W[k, 11], f0, f1, f2)
    W[row, LOAD], W[row, LOAD + 1], W[row, LOAD + 2] = f0, f1, f2
    W[row, LOAD + 3] = t0 + W[k, 0] * y0 + W[k, 1] * y1 + W[k, 2] * y2
    W[row, LOAD + 4] = t1 + W[k, 3] * y0 + W[k, 4] * y1 + W[k, 5] * y2
    W[row, LOAD + 5] = t2 + W[k, 6] * y0 + W[k, 7] * y1 + W[k, 8] * y2


@njit(**FAST)
def _moving_bodies(P, W, S, m, oj):
    """Outward pass of Newton and Euler in base coordinates: load of every body into W."""
    g0, g1, g2 = P[S, GRAVITY], P[S, GRAVITY + 1], P[S, GRAVITY + 2]
    w = (0.0, 0.0, 0.0)
    dw = (0.0, 0.0, 0.0)
    acc = (0.0, 0.0, 0.0)
    p = (0.0, 0.0, 0.0)
    for k in range(m):
        j = oj + int(P[k, JOINT])
        speed = P[k, RATIO] * W[j, SPEED_NOW]
        rate = P[k, RATIO] * W[j, ACCEL_NOW]
        z0, z1, z2 = W[k, 2], W[k, 5], W[k, 8]
        s0, s1, s2 = _swing(w, dw, W[k, 9] - p[0], W[k, 10] - p[1], W[k, 11] - p[2])
        acc = (acc[0] + s0, acc[1] + s1, acc[2] + s2)
        t0, t1, t2 = _cross(w[0], w[1], w[2], z0, z1, z2)
        if P[k, KIND] == 0.0:
            dw = (dw[0] + rate * z0 + speed * t0, dw[1] + rate * z1 + speed * t1, dw[2] + rate * z2 + speed * t2)
            w = (w[0] + speed * z0, w[1] + speed * z1, w[2] + speed * z2)
        else:
            twice = 2.0 * speed
            acc = (acc[0] + twice * t0 + rate * z0, acc[1] + twice * t1 + rate * z1, acc[2] + twice * t2 + rate * z2)
        p = (W[k, 9], W[k, 10], W[k, 11])
        inside = _inward(W, k, w[0], w[1], w[2])
        turning = _inward(W, k, dw[0], dw[1], dw[2])
        falling = _inward(W, k, g0 - acc[0], g1 - acc[1], g2 - acc[2])
        _carry_load(P, W, k, k, inside, turning, falling)
        if k == m - 1:
            _carry_load(P, W, m, k, inside, turning, falling)


@njit(**FAST)
def _dynamic_moments(P, W, S, m, oj):
    """Load moments in the joint frames from gravity and motion (thesis eq. 5.14, with the sign of the load)."""
    _moving_bodies(P, W, S, m, oj)
    beams = P[S, BEAMS] != 0.0
    f = (W[m, LOAD], W[m, LOAD + 1], W[m, LOAD + 2])
    t = (W[m, LOAD + 3], W[m, LOAD + 4], W[m, LOAD + 5])
    beyond, turned = f, t
    for k in range(m - 1, -1, -1):
        f = (f[0] + W[k, LOAD], f[1] + W[k, LOAD + 1], f[2] + W[k, LOAD + 2])
        t = (t[0] + W[k, LOAD + 3], t[1] + W[k, LOAD + 4], t[2] + W[k, LOAD + 5])
        if P[k, PRIMARY] >= 0.0:
            j = oj + int(P[k, JOINT])
            s0, s1, s2 = _cross(W[k, 9], W[k, 10], W[k, 11], f[0], f[1], f[2])
            _to_joint(P, W, k, j, t[0] - s0, t[1] - s1, t[2] - s2, f[0], f[1], f[2])
            if beams:
                _keep_wrench(W, k, j, ROOT, f, t)
                _keep_wrench(W, k, j, END, beyond, turned)
                beyond, turned = f, t
    W[m, ON_BASE], W[m, ON_BASE + 1] = t[0], t[1]


@njit(**FAST)
def _keep_wrench(W, k, j, column, f, t):
    """A wrench about the base origin as one about the origin and in the axes of frame k, for joint row j."""
    s0, s1, s2 = _cross(W[k, 9], W[k, 10], W[k, 11], f[0], f[1], f[2])
    a = _inward(W, k, f[0], f[1], f[2])
    b = _inward(W, k, t[0] - s0, t[1] - s1, t[2] - s2)
    for i in range(3):
        W[j, column + i] = a[i]
        W[j, column + 3 + i] = b[i]


@njit(**FAST)
def _soft_sign(x, width):
    """sign(x), or tanh(x / width): beyond 19.1 widths the two are the same number."""
    size = abs(x)
    if size >= 19.1 * width:
        return math.copysign(1.0, x) if x != 0.0 else 0.0
    return math.copysign(1.0 - 2.0 / (math.exp(2.0 * size / width) + 1.0), x)


@njit(**FAST)
def _bounded(a):
    """a / sqrt(1 + a²); the series is exact up to a degree."""
    z = a * a
    if z < 4e-4:
        return a * (1.0 - z * (0.5 - z * (0.375 - z * (0.3125 - z * 0.2734375))))
    return a / math.sqrt(1.0 + z)


@njit(**FAST)
def _lean(P, j, x, y):
    """Tilt of a joint in its clearance (thesis eq. 5.16-5.18) towards the transverse load (x, y)."""
    t = P[j, TILT]
    ax, ay = abs(x), abs(y)
    total = ax + ay
    if t == 0.0 or total <= NO_MOMENT:
        return 0.0, 0.0
    if P[j, TILT_SHARE] == 0.0:
        if ax < ay:
            s, c = _quarter(ax / total * (0.5 * math.pi))
        else:
            c, s = _quarter(ay / total * (0.5 * math.pi))
    else:
        h = 1.0 / math.sqrt(x * x + y * y)
        s, c = ax * h, ay * h
    soft = P[j, TILT_SOFT]
    return _bounded(t * s * _soft_sign(x, soft)), _bounded(t * c * _soft_sign(y, soft))


@njit(**EXACT)
def _towards(last, target, reach):
    """``target``, or as far towards it from ``last`` as ``reach`` allows."""
    change = target - last
    if abs(change) <= reach:
        return target
    return last + math.copysign(reach, change)


@njit(**EXACT)
def _signs(P, W, state, n, oj, dt):
    """Effects with a sign: tilt and backlash of every joint, held to its rate from the last answer; whether one was."""
    limited = False
    for i in range(n):
        j = oj + i
        a, b = _lean(P, j, W[j, MOMENT], W[j, MOMENT + 1])
        about = W[j, MOMENT + 2]
        side = (0.5 * P[j, REVERSAL] + P[j, SIDED] * about) * W[j, SIGN]
        if P[j, PLAY] != 0.0 and abs(about) > NO_MOMENT:
            side += P[j, PLAY] * _soft_sign(about, P[j, PLAY_SOFT])
        if dt < math.inf:
            reach = P[j, RATE] * dt
            W[j, LEAN_A] = _towards(state[i, LAST_A], a, reach)
            W[j, LEAN_B] = _towards(state[i, LAST_B], b, reach)
            W[j, SIDE] = _towards(state[i, LAST_SIDE], side, reach)
            limited |= W[j, LEAN_A] != a or W[j, LEAN_B] != b or W[j, SIDE] != side
        else:
            W[j, LEAN_A], W[j, LEAN_B], W[j, SIDE] = a, b, side
    return limited


@njit(**FAST)
def _curves(P, W, n, m, oj):
    """Add what the curves of the joints say at the command."""
    first = m + 1 + n
    for row in range(first, first + int(P[P.shape[0] - 1, CURVES])):
        j = oj + int(P[row, CURVED])
        shape = P[row, SHAPE]
        d = oj + int(P[row, DRIVER])
        q = W[d, COMMAND]
        if shape == WAVE:
            s, c = _sine_cosine(P[row, FACTOR] * q)
            W[j, SHIFT] += P[row, AMPLITUDE_A] * s + P[row, AMPLITUDE_B] * c
        elif shape == LINEAR:
            W[j, SHIFT] += P[row, AMPLITUDE_A] * q
        elif shape == LAG:
            W[j, SHIFT] -= P[row, AMPLITUDE_A] * W[d, SPEED_NOW]
        elif shape == SINES:
            W[j, SHIFT] += P[row, AMPLITUDE_A] * math.sin(q) * math.sin(W[j, COMMAND])
        elif shape == POLYNOMIAL:
            u, total = min(1.0, max(-1.0, (q - P[row, EXTRA]) / P[row, EXTRA + 1])), 0.0
            for k in range(HIGHEST - POWERS + 1):
                total = total * u + P[row, HIGHEST - k]
            W[j, SHIFT] += total
        else:
            a, b = P[row, EXTRA], P[row, EXTRA + 1]
            s, c = _sine_cosine(q + P[row, EXTRA + 2])
            length = math.sqrt(a * a + b * b - 2.0 * a * b * c)
            W[j, SHIFT] -= P[row, AMPLITUDE_A] * s * (1.0 - P[row, EXTRA + 3] / length)


@njit(**FAST)
def _beams(P, W, n, m, oj):
    """Add the twist by which every bending link gives way to the loads on its joint and on its end."""
    S = P.shape[0] - 1
    first = m + 1 + n + int(P[S, CURVES])
    for b in range(int(P[S, BEAMS])):
        row = first + 2 * b
        j = oj + int(P[row, BEAM_JOINT])
        l0, l1, l2 = P[row, BEAM_LINK], P[row, BEAM_LINK + 1], P[row, BEAM_LINK + 2]
        t0, t1, t2 = _cross(l0, l1, l2, W[j, END], W[j, END + 1], W[j, END + 2])
        for i, t in enumerate((t0, t1, t2)):
            W[j, END + 3 + i] -= t
        for r in range(6):
            total = 0.0
            for c in range(6):
                total += P[row, BEAM + 6 * r + c] * W[j, ROOT + c] + P[row + 1, BEAM + 6 * r + c] * W[j, END + c]
            W[j, TWIST + r] += total


@njit(**FAST)
def _give_way(P, W, n, m, oj):
    """What every joint adds to its command, and the twist behind it, at the loads and signs now in W."""
    for i in range(n):
        j = oj + i
        about = W[j, MOMENT + 2]
        W[j, SHIFT] = P[j, DQ] + W[j, SIDE] + (P[j, COMPLIANCE] - P[j, HARDENING] * abs(about)) * about
        for k in range(6):
            W[j, TWIST + k] = P[j, XI + k]
        W[j, TWIST + 3] += W[j, LEAN_A] + P[j, RADIAL] * W[j, MOMENT]
        W[j, TWIST + 4] += W[j, LEAN_B] + P[j, RADIAL] * W[j, MOMENT + 1]
    S = P.shape[0] - 1
    if P[S, CURVES] != 0.0:
        _curves(P, W, n, m, oj)
    if P[S, BEAMS] != 0.0:
        _beams(P, W, n, m, oj)


@njit(**FAST)
def _jacobian(P, W, S, T, n, m, oj, rows):
    """Weighted task rows of the identified Jacobian by joint, column r of the joint rows (turns in the tool frame)."""
    for i in range(n):
        for r in range(6):
            W[oj + i, COLUMN + r] = 0.0
    weight = P[S, WEIGHT + 3]
    for k in range(m):
        j = oj + int(P[k, JOINT])
        ratio = P[k, RATIO]
        z0, z1, z2 = W[k, LINE], W[k, LINE + 1], W[k, LINE + 2]
        if P[k, KIND] == 0.0:
            v0, v1, v2 = _cross(z0, z1, z2, T[9] - W[k, LINE + 3], T[10] - W[k, LINE + 4], T[11] - W[k, LINE + 5])
            if rows > 3:
                turn = ratio * weight
                W[j, COLUMN + 3] += turn * (T[0] * z0 + T[3] * z1 + T[6] * z2)
                W[j, COLUMN + 4] += turn * (T[1] * z0 + T[4] * z1 + T[7] * z2)
                if rows > 5:
                    W[j, COLUMN + 5] += turn * (T[2] * z0 + T[5] * z1 + T[8] * z2)
        else:
            v0, v1, v2 = z0, z1, z2
        for r, v in enumerate((v0, v1, v2)):
            W[j, COLUMN + r] += ratio * v


@njit(**ORDERED)
def _matrix(W, n, oj, og, rows):
    """J J' into the lower half of the task rows, and what the first guess adds to the residual.

    All six rows always, written out: rows the task does not hold have no Jacobian and get a one on the diagonal.
    """
    a00 = a10 = a11 = a20 = a21 = a22 = a30 = a31 = a32 = a33 = 0.0
    a40 = a41 = a42 = a43 = a44 = a50 = a51 = a52 = a53 = a54 = a55 = 0.0
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0
    for j in range(oj, oj + n):
        g = W[j, GUESSED]
        c0, c1, c2 = W[j, COLUMN], W[j, COLUMN + 1], W[j, COLUMN + 2]
        c3, c4, c5 = W[j, COLUMN + 3], W[j, COLUMN + 4], W[j, COLUMN + 5]
        a00, a10, a11 = a00 + c0 * c0, a10 + c1 * c0, a11 + c1 * c1
        a20, a21, a22 = a20 + c2 * c0, a21 + c2 * c1, a22 + c2 * c2
        a30, a31, a32, a33 = a30 + c3 * c0, a31 + c3 * c1, a32 + c3 * c2, a33 + c3 * c3
        a40, a41, a42, a43, a44 = a40 + c4 * c0, a41 + c4 * c1, a42 + c4 * c2, a43 + c4 * c3, a44 + c4 * c4
        a50, a51, a52, a53, a54 = a50 + c5 * c0, a51 + c5 * c1, a52 + c5 * c2, a53 + c5 * c3, a54 + c5 * c4
        a55 += c5 * c5
        g0, g1, g2, g3, g4, g5 = g0 + c0 * g, g1 + c1 * g, g2 + c2 * g, g3 + c3 * g, g4 + c4 * g, g5 + c5 * g
    t = MATRIX
    W[og, t] = a00
    W[og + 1, t], W[og + 1, t + 1] = a10, a11
    W[og + 2, t], W[og + 2, t + 1], W[og + 2, t + 2] = a20, a21, a22
    W[og + 3, t], W[og + 3, t + 1], W[og + 3, t + 2], W[og + 3, t + 3] = a30, a31, a32, a33
    W[og + 4, t], W[og + 4, t + 1], W[og + 4, t + 2], W[og + 4, t + 3], W[og + 4, t + 4] = a40, a41, a42, a43, a44
    W[og + 5, t], W[og + 5, t + 1], W[og + 5, t + 2], W[og + 5, t + 3] = a50, a51, a52, a53
    W[og + 5, t + 4], W[og + 5, t + 5] = a54, a55
    for r, g in enumerate((g0, g1, g2, g3, g4, g5)):
        W[og + r, ADDED] = g
    for r in range(rows, 6):
        W[og + r, t + r] = 1.0


@njit(**FAST)
def _damped_matrix(W, og):
    """Add the damping to J J'."""
    for r in range(6):
        for c in range(r + 1):
            W[og + r, MATRIX + c] += W[og + r, DAMPING + c]


@njit(**FAST)
def _factor(W, og):
    """LDL' of J J' into the task rows, 1 / d on the diagonal; returns the smallest pivot, 0 when there is none."""
    t = MATRIX
    d0 = W[og, t]
    i0 = 1.0 / d0
    u10, u20, u30, u40, u50 = W[og + 1, t], W[og + 2, t], W[og + 3, t], W[og + 4, t], W[og + 5, t]
    l10, l20, l30, l40, l50 = u10 * i0, u20 * i0, u30 * i0, u40 * i0, u50 * i0
    d1 = W[og + 1, t + 1] - l10 * u10
    i1 = 1.0 / d1
    u21, u31 = W[og + 2, t + 1] - l10 * u20, W[og + 3, t + 1] - l10 * u30
    u41, u51 = W[og + 4, t + 1] - l10 * u40, W[og + 5, t + 1] - l10 * u50
    l21, l31, l41, l51 = u21 * i1, u31 * i1, u41 * i1, u51 * i1
    d2 = W[og + 2, t + 2] - l20 * u20 - l21 * u21
    i2 = 1.0 / d2
    u32 = W[og + 3, t + 2] - l20 * u30 - l21 * u31
    u42 = W[og + 4, t + 2] - l20 * u40 - l21 * u41
    u52 = W[og + 5, t + 2] - l20 * u50 - l21 * u51
    l32, l42, l52 = u32 * i2, u42 * i2, u52 * i2
    d3 = W[og + 3, t + 3] - l30 * u30 - l31 * u31 - l32 * u32
    i3 = 1.0 / d3
    u43 = W[og + 4, t + 3] - l30 * u40 - l31 * u41 - l32 * u42
    u53 = W[og + 5, t + 3] - l30 * u50 - l31 * u51 - l32 * u52
    l43, l53 = u43 * i3, u53 * i3
    d4 = W[og + 4, t + 4] - l40 * u40 - l41 * u41 - l42 * u42 - l43 * u43
    i4 = 1.0 / d4
    u54 = W[og + 5, t + 4] - l40 * u50 - l41 * u51 - l42 * u52 - l43 * u53
    l54 = u54 * i4
    d5 = W[og + 5, t + 5] - l50 * u50 - l51 * u51 - l52 * u52 - l53 * u53 - l54 * u54
    smallest = min(min(min(d0, d1), min(d2, d3)), min(d4, d5))
    if not smallest > 1e-12:
        return 0.0
    W[og, 0] = i0
    W[og + 1, 0], W[og + 1, 1] = l10, i1
    W[og + 2, 0], W[og + 2, 1], W[og + 2, 2] = l20, l21, i2
    W[og + 3, 0], W[og + 3, 1], W[og + 3, 2], W[og + 3, 3] = l30, l31, l32, i3
    W[og + 4, 0], W[og + 4, 1], W[og + 4, 2], W[og + 4, 3], W[og + 4, 4] = l40, l41, l42, l43, i4
    W[og + 5, 0], W[og + 5, 1], W[og + 5, 2], W[og + 5, 3], W[og + 5, 4] = l50, l51, l52, l53, l54
    W[og + 5, 5] = 1.0 / d5
    return smallest


@njit(**FAST)
def _multipliers(W, og, damped, first):
    """Step of the multipliers: (J J' + damping) step = error - damping * multipliers; the first one starts from zero."""
    for r in range(6):
        total = W[og + r, ERROR]
        if first:
            total += W[og + r, ADDED]
        if damped:
            for k in range(6):
                total -= W[og + r, DAMPING + k] * W[og + k, MULTIPLIER]
        W[og + r, RIGHT] = total
    a, b, c, d = og, og + 1, og + 2, og + 3
    e, f = og + 4, og + 5
    y0 = W[a, RIGHT]
    y1 = W[b, RIGHT] - W[b, 0] * y0
    y2 = W[c, RIGHT] - W[c, 0] * y0 - W[c, 1] * y1
    y3 = W[d, RIGHT] - W[d, 0] * y0 - W[d, 1] * y1 - W[d, 2] * y2
    y4 = W[e, RIGHT] - W[e, 0] * y0 - W[e, 1] * y1 - W[e, 2] * y2 - W[e, 3] * y3
    y5 = W[f, RIGHT] - W[f, 0] * y0 - W[f, 1] * y1 - W[f, 2] * y2 - W[f, 3] * y3 - W[f, 4] * y4
    y5 = y5 * W[f, 5]
    y4 = y4 * W[e, 4] - W[f, 4] * y5
    y3 = y3 * W[d, 3] - W[e, 3] * y4 - W[f, 3] * y5
    y2 = y2 * W[c, 2] - W[d, 2] * y3 - W[e, 2] * y4 - W[f, 2] * y5
    y1 = y1 * W[b, 1] - W[c, 1] * y2 - W[d, 1] * y3 - W[e, 1] * y4 - W[f, 1] * y5
    y0 = y0 * W[a, 0] - W[b, 0] * y1 - W[c, 0] * y2 - W[d, 0] * y3 - W[e, 0] * y4 - W[f, 0] * y5
    for r, y in enumerate((y0, y1, y2, y3, y4, y5)):
        W[og + r, MULTIPLIER] += y


@njit(**EXACT)
def _rotate_pair(W, og, rows, a, b):
    """One Jacobi rotation that clears element (a, b) of the factor rows, which hold a symmetric matrix here."""
    off = W[og + a, b]
    if off == 0.0:
        return
    theta = 0.5 * (W[og + b, b] - W[og + a, a]) / off
    t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    for k in range(rows):
        x, y = W[og + k, a], W[og + k, b]
        W[og + k, a] = c * x - s * y
        W[og + k, b] = s * x + c * y
        x, y = W[og + k, VECTOR + a], W[og + k, VECTOR + b]
        W[og + k, VECTOR + a] = c * x - s * y
        W[og + k, VECTOR + b] = s * x + c * y
    for k in range(rows):
        x, y = W[og + a, k], W[og + b, k]
        W[og + a, k] = c * x - s * y
        W[og + b, k] = s * x + c * y


@njit(**EXACT)
def _eigenvectors(W, og, rows):
    """Eigenvalues of J J' on the diagonal of the factor rows, eigenvectors in the vector columns (cyclic Jacobi)."""
    for r in range(rows):
        for c in range(rows):
            W[og + r, c] = W[og + max(r, c), MATRIX + min(r, c)]
            W[og + r, VECTOR + c] = 1.0 if r == c else 0.0
    for _ in range(8):
        for a in range(rows - 1):
            for b in range(a + 1, rows):
                _rotate_pair(W, og, rows, a, b)


@njit(**EXACT)
def _damp(P, W, n, oj, og, rows):
    """Damp the directions that a singularity makes weak, and no others; whether there was one.

    A direction of singular value s below the weak limit would ask the joints for error / s. Where that exceeds the
    bound, its damping grows smoothly from zero (after Maciejewski and Klein 1988), so that the answer is continuous,
    keeps to about the bound and fades out at the singularity itself.
    """
    S = P.shape[0] - 1
    bound = math.inf
    for i in range(n):
        bound = min(bound, BOUND * P[oj + i, LARGEST])
    _eigenvectors(W, og, rows)
    for r in range(6):
        for c in range(6):
            W[og + r, DAMPING + c] = 0.0
    damped = False
    for v in range(rows):
        square = max(W[og + v, v], 0.0)
        if square >= P[S, WEAK]:
            continue
        along = 0.0
        for r in range(rows):
            along += W[og + r, VECTOR + v] * (W[og + r, ERROR] + W[og + r, ADDED])
        limit = max(along * along / (bound * bound), P[S, SINGULAR])
        if square >= limit:
            continue
        damped = True
        amount = 0.25 * (limit - square)
        for r in range(rows):
            for c in range(rows):
                W[og + r, DAMPING + c] += amount * W[og + r, VECTOR + v] * W[og + c, VECTOR + v]
    return damped


@njit(**FAST)
def _shift(W, j, og):
    """Change of the command of joint row j that the multipliers ask for."""
    return (
        W[j, COLUMN] * W[og, MULTIPLIER] + W[j, COLUMN + 1] * W[og + 1, MULTIPLIER]
        + W[j, COLUMN + 2] * W[og + 2, MULTIPLIER] + W[j, COLUMN + 3] * W[og + 3, MULTIPLIER]
        + W[j, COLUMN + 4] * W[og + 4, MULTIPLIER] + W[j, COLUMN + 5] * W[og + 5, MULTIPLIER]
    )  # fmt: skip


@njit(**EXACT)
def _linearise(P, W, S, actual, n, m, oj, og, rows):
    """Jacobian, its factor and the first multipliers; whether a singularity had to be damped."""
    _jacobian(P, W, S, actual, n, m, oj, rows)
    _matrix(W, n, oj, og, rows)
    if _factor(W, og) > P[S, SINGULAR]:
        _multipliers(W, og, False, True)
        bound, strain = math.inf, 0.0
        for j in range(oj, oj + n):
            bound = min(bound, BOUND * P[j, LARGEST])
            strain += _shift(W, j, og) ** 2
        if strain <= bound * bound:
            return False
    for r in range(rows):
        W[og + r, MULTIPLIER] = 0.0
    damped = _damp(P, W, n, oj, og, rows)
    _damped_matrix(W, og)
    if _factor(W, og) <= 0.0:
        for r in range(rows):
            W[og + r, MATRIX + r] += P[S, SINGULAR]
            W[og + r, DAMPING + r] += P[S, SINGULAR]
        _factor(W, og)
    _multipliers(W, og, damped, True)
    return damped


@njit(**FAST)
def _turn_between(A, B):
    """Rotation vector from frame A to frame B, in A."""
    x = 0.5 * (A[2] * B[1] + A[5] * B[4] + A[8] * B[7] - A[1] * B[2] - A[4] * B[5] - A[7] * B[8])
    y = 0.5 * (A[0] * B[2] + A[3] * B[5] + A[6] * B[8] - A[2] * B[0] - A[5] * B[3] - A[8] * B[6])
    z = 0.5 * (A[1] * B[0] + A[4] * B[3] + A[7] * B[6] - A[0] * B[1] - A[3] * B[4] - A[6] * B[7])
    s2 = x * x + y * y + z * z
    if s2 < 1e-6:
        f = 1.0 + s2 / 6.0 * (1.0 + 0.45 * s2)
    else:
        s = math.sqrt(s2)
        trace = 0.0
        for i in range(9):
            trace += A[i] * B[i]
        f = math.atan2(s, 0.5 * (trace - 1.0)) / s
    return f * x, f * y, f * z


@njit(**FAST)
def _residual(P, W, S, og, rows, wanted, actual):
    """Weighted task errors into the task rows; returns the distance of the tool points by axis."""
    d0, d1, d2 = wanted[9] - actual[9], wanted[10] - actual[10], wanted[11] - actual[11]
    W[og, ERROR], W[og + 1, ERROR], W[og + 2, ERROR] = d0, d1, d2
    if rows > 3:
        t0, t1, t2 = _turn_between(actual, wanted)
        W[og + 3, ERROR] = P[S, WEIGHT + 3] * t0
        W[og + 4, ERROR] = P[S, WEIGHT + 3] * t1
        if rows > 5:
            W[og + 5, ERROR] = P[S, WEIGHT + 3] * t2
    return d0, d1, d2


@njit(**FAST)
def _command(W, n, oj, og):
    """Commands from the multipliers; returns the largest change of a joint."""
    largest = 0.0
    for j in range(oj, oj + n):
        new = W[j, WANTED] + _shift(W, j, og)
        largest = max(largest, abs(new - W[j, COMMAND]))
        W[j, COMMAND] = new
    return largest


@njit(**FAST)
def _loads(P, W, S, m, oj, dynamic):
    """Load moments at the frames now in W; bending and pedestal need whole wrenches, which the general pass has."""
    if dynamic or P[S, BEAMS] != 0.0 or P[S, PEDESTAL] != 0.0:
        _dynamic_moments(P, W, S, m, oj)
    else:
        _static_moments(P, W, S, m, oj)


@njit(**FAST)
def _prepare(P, W, n, m, oj, og, rows):
    """Start the search at the wanted joints plus the guess."""
    for i in range(n):
        W[oj + i, COMMAND] = W[oj + i, WANTED] + W[oj + i, GUESSED]
        for k in range(3):
            W[oj + i, MOMENT + k] = 0.0
    for k in range(m):
        if P[k, KIND] == 0.0:
            s, c = _sine_cosine(P[k, RATIO] * W[oj + int(P[k, JOINT]), WANTED])
            W[k, SINE], W[k, COSINE] = s, c
    for r in range(rows):
        W[og + r, MULTIPLIER] = 0.0


@njit(**EXACT)
def _solve(P, W, state, info, n, m, dynamic, dt, warm):
    """Find the command whose identified pose is the wanted one; leaves it in W and returns the flags."""
    oj, og, S = m + 1, m + 1 + n, P.shape[0] - 1
    rows, at = int(P[S, ROWS]), int(P[S, LOAD_CHAIN])
    flags = DYNAMIC if dynamic else 0
    loaded = P[S, LOADED] != 0.0
    damped = False
    limited = False
    largest = math.inf
    _prepare(P, W, n, m, oj, og, rows)
    wanted = _load_frames(P, W, at, m, oj)
    if warm or at > 0:
        wanted = _wanted_tool(P, W, m, oj, False)
    rounds = int(P[S, ITERATIONS])
    for it in range(rounds):
        if it == 0 or (loaded and largest > SETTLED_RAD):
            if it > 0:
                _load_frames(P, W, at, m, oj)
            if loaded:
                _loads(P, W, S, m, oj, dynamic)
            if it < SIGN_ROUNDS:
                limited = _signs(P, W, state, n, oj, dt)
            _give_way(P, W, n, m, oj)
        elif P[S, CURVES] != 0.0:
            _give_way(P, W, n, m, oj)
        actual = _identified(P, W, m, oj)
        d = _residual(P, W, S, og, rows, wanted, actual)
        if it == 0:
            if rows < n:  # which of many answers must not depend on the guess: nor then may the Jacobian
                _wanted_tool(P, W, m, oj, True)
            damped = _linearise(P, W, S, wanted if rows < n else actual, n, m, oj, og, rows)
            for i in range(3):
                info[4 + i] = W[og + i, ERROR] + W[og + i, ADDED]
        else:
            _multipliers(W, og, damped, False)
        before = largest
        largest = _command(W, n, oj, og)
        info[7] = it + 1.0
        # Steps shrink by a constant factor: the next one would be largest * largest / before.
        if largest < P[S, STEP] * (GUESS_STEP if warm and it == 0 else 1.0) or (
            it > 0 and largest < before and largest * largest < 0.1 * P[S, STEP] * before
        ):
            break
    _report(W, info, og, rows, d)
    if not info[3] <= P[S, REACHED]:
        flags |= RESIDUAL
    return flags | (LIMITED if limited else 0) | (DAMPED if damped else 0)


@njit(**EXACT)
def _report(W, info, og, rows, d):
    """Residual of the tool point and of all task rows, as of the last evaluation."""
    total = 0.0
    for r in range(rows):
        total += W[og + r, ERROR] * W[og + r, ERROR]
    info[2] = math.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    info[3] = math.sqrt(total)


@njit(**EXACT)
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


@njit(**EXACT)
def _heading(state, W, j, i, x, band, started):
    """Direction of the last motion of a joint: it turns when the joint comes back by more than the band."""
    sign = state[i, HEADING] if started else 0.0
    turn = state[i, TURN] if started else x
    if x > turn + band or (sign > 0.0 and x > turn):
        sign, turn = 1.0, x
    elif x < turn - band or (sign < 0.0 and x < turn):
        sign, turn = -1.0, x
    W[j, SIGN], W[j, TURN_NEW] = sign, turn


@njit(**EXACT)
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


@njit(**EXACT)
def _motion(P, W, state, x, n, m, width, dt):
    """Wanted joints, speeds, accelerations and directions into W; whether the load is dynamic."""
    S = P.shape[0] - 1
    started = state[n, STARTED] != 0.0
    omega = P[S, FILTER]
    for i in range(n):
        j = m + 1 + i
        W[j, WANTED] = x[i]
        _heading(state, W, j, i, x[i], P[S, HYSTERESIS], started)
        if omega > 0.0:
            _smooth(state, W, j, i, x[i], omega, dt, started)
        if width == 3:
            W[j, SPEED_NOW], W[j, ACCEL_NOW] = x[n + i], x[2 * n + i]
        elif omega <= 0.0:
            W[j, SPEED_NOW], W[j, ACCEL_NOW] = 0.0, 0.0
    return width == 3 or omega > 0.0


@njit(**EXACT)
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


@njit(**EXACT)
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
    far = math.sqrt(info[4] * info[4] + info[5] * info[5] + info[6] * info[6])
    if large != 0 or not far <= P[S, FARTHEST]:
        info[1] = large
        return TOO_LARGE
    info[1] = outside
    return JOINT_LIMIT if outside != 0 else OK


@njit(**EXACT)
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


@njit(**EXACT)
def _commit(P, W, state, out, remaining, length, n, m, dt, fresh):
    """Remember what was answered."""
    for i in range(n):
        j = m + 1 + i
        state[i, LAST_A], state[i, LAST_B], state[i, LAST_SIDE] = W[j, LEAN_A], W[j, LEAN_B], W[j, SIDE]
        state[i, LAST_Q] = W[j, WANTED]
        state[i, TURN] = W[j, TURN_NEW]
        state[i, HEADING] = W[j, SIGN]
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


@njit(**EXACT)
def _one(P, W, state, x, width, dt, out, info):
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
    flags = _solve(P, W, state, info, n, m, dynamic, math.inf if fresh else dt, warm)
    remaining, length = _ramp(P, W, state, n, m, dt)
    status = _verdict(P, W, info, out, remaining, n, m)
    info[0] = flags | (RAMPING if remaining > 0.0 else 0)
    if status == OK:
        _commit(P, W, state, out, remaining, length, n, m, dt, fresh)
    else:
        for i in range(n):
            out[i] = math.nan
    return status


@njit(**EXACT)
def step(memory, program_rows, n, x, width, dt):
    """Correct one setpoint of a stream and return its status; only status 0 leaves numbers and changes the memory.

    ``x (width * n,)`` holds q, then qd and qdd; ``dt`` is the time since the last answer. The joints are left in the
    last row but one of ``memory``, the info in the last.
    """
    rows = memory.shape[0]
    P = memory[:program_rows]
    W = memory[program_rows : rows - n - 3]
    return _one(P, W, memory[rows - n - 3 : rows - 2], x, width, dt, memory[rows - 2], memory[rows - 1])


@njit(**EXACT)
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
        status[row] = _one(P, W, state, x[row], width, dt[row], out[row], info[row])
        if status[row] != OK:
            status[row + 1 :] = -1
            return row
    return x.shape[0]


@njit(**EXACT)
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
        flags = _solve(P, W, state, info[row], n, m, width == 3, math.inf, False)
        status[row] = _verdict(P, W, info[row], out[row], 0.0, n, m)
        info[row, 0] = flags
