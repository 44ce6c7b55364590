"""Frames, rotations and twists as tuples of numbers, compiled: what the kernels of the arm and of the correction share.

A frame is (R row by row, p), twelve numbers.
"""

from __future__ import annotations

import math

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel

# pi/2 in two parts, the first short enough that small multiples of it are exact.
HALF_PI_HIGH, HALF_PI_LOW = 1.57079632673412561417e00, 6.07710050650619224932e-11


@compile_kernel(**EXACT)
def cross(a0, a1, a2, b0, b1, b2):
    """Cross product of two vectors."""
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@compile_kernel(**EXACT)
def product(A, B):
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


@compile_kernel(**EXACT)
def rotated_z(A, s, c):
    """Frame A rotated about its z by the angle of sine s and cosine c."""
    return (
        c * A[0] + s * A[1],
        c * A[1] - s * A[0],
        A[2],
        c * A[3] + s * A[4],
        c * A[4] - s * A[3],
        A[5],
        c * A[6] + s * A[7],
        c * A[7] - s * A[6],
        A[8],
        A[9],
        A[10],
        A[11],
    )


@compile_kernel(**EXACT)
def shifted_z(A, d):
    """Frame A shifted along its z by d."""
    return (
        A[0],
        A[1],
        A[2],
        A[3],
        A[4],
        A[5],
        A[6],
        A[7],
        A[8],
        A[9] + A[2] * d,
        A[10] + A[5] * d,
        A[11] + A[8] * d,
    )


@compile_kernel(**EXACT)
def sine_cosine_octant(x):
    """Sine and cosine up to pi/4."""
    z = x * x
    s = x * (
        1.0
        + z
        * (
            -1.6666666666666666e-1
            + z
            * (
                8.333333333333333e-3
                + z
                * (
                    -1.984126984126984e-4
                    + z
                    * (
                        2.7557319223985893e-6
                        + z * (-2.505210838544172e-8 + z * (1.6059043836821613e-10 - z * 7.647163731819816e-13))
                    )
                )
            )
        )
    )
    c = 1.0 + z * (
        -0.5
        + z
        * (
            4.1666666666666664e-2
            + z
            * (
                -1.388888888888889e-3
                + z
                * (
                    2.48015873015873e-5
                    + z
                    * (
                        -2.755731922398589e-7
                        + z * (2.08767569878681e-9 + z * (-1.1470745597729725e-11 + z * 4.779477332387385e-14))
                    )
                )
            )
        )
    )
    return s, c


@compile_kernel(**EXACT)
def sine_cosine(x):
    """Sine and cosine of an angle of some revolutions, to the last digit or two."""
    k = math.floor(x * (2.0 / math.pi) + 0.5)
    if not abs(k) <= 1e5:  # a NaN has no quadrant
        return math.sin(x), math.cos(x)
    s, c = sine_cosine_octant((x - k * HALF_PI_HIGH) - k * HALF_PI_LOW)
    quadrant = int(k) & 3
    if quadrant == 0:
        return s, c
    if quadrant == 1:
        return c, -s
    if quadrant == 2:
        return -s, -c
    return -c, s


@compile_kernel(**EXACT)
def sine_cosine_near(s, c, d):
    """Sine and cosine of a + d from those of a: the series is exact to 1e-17 up to 0.03 rad."""
    if abs(d) < 0.03:
        d2 = d * d
        sd = d * (1.0 - d2 * (1.0 / 6.0 - d2 * (1.0 / 120.0 - d2 / 5040.0)))
        cd = 1.0 - d2 * (0.5 - d2 * (1.0 / 24.0 - d2 * (1.0 / 720.0 - d2 / 40320.0)))
    else:
        sd = math.sin(d)
        cd = math.cos(d)
    return s * cd + c * sd, c * cd - s * sd


@compile_kernel(**EXACT)
def angle_series(t2):
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


@compile_kernel(**EXACT)
def rotate_about_xy(T, x, y):
    """Frame T rotated about its own x and y by the rotation vector (x, y, 0)."""
    a, b, _ = angle_series(x * x + y * y)
    xx, yy, xy, sx, sy = 1.0 - b * y * y, 1.0 - b * x * x, b * x * y, a * x, a * y
    zz = 1.0 - b * (x * x + y * y)
    return (
        T[0] * xx + T[1] * xy - T[2] * sy,
        T[0] * xy + T[1] * yy + T[2] * sx,
        T[0] * sy - T[1] * sx + T[2] * zz,
        T[3] * xx + T[4] * xy - T[5] * sy,
        T[3] * xy + T[4] * yy + T[5] * sx,
        T[3] * sy - T[4] * sx + T[5] * zz,
        T[6] * xx + T[7] * xy - T[8] * sy,
        T[6] * xy + T[7] * yy + T[8] * sx,
        T[6] * sy - T[7] * sx + T[8] * zz,
        T[9],
        T[10],
        T[11],
    )


@compile_kernel(**EXACT)
def exponential(v0, v1, v2, w0, w1, w2):
    """exp of the twist (v, w) as a frame."""
    a, b, c = angle_series(w0 * w0 + w1 * w1 + w2 * w2)
    d = w0 * v0 + w1 * v1 + w2 * v2  # left Jacobian of SO(3) times v
    return (
        1.0 - b * (w1 * w1 + w2 * w2),
        b * w0 * w1 - a * w2,
        b * w0 * w2 + a * w1,
        b * w0 * w1 + a * w2,
        1.0 - b * (w0 * w0 + w2 * w2),
        b * w1 * w2 - a * w0,
        b * w0 * w2 - a * w1,
        b * w1 * w2 + a * w0,
        1.0 - b * (w0 * w0 + w1 * w1),
        a * v0 + b * (w1 * v2 - w2 * v1) + c * d * w0,
        a * v1 + b * (w2 * v0 - w0 * v2) + c * d * w1,
        a * v2 + b * (w0 * v1 - w1 * v0) + c * d * w2,
    )


@compile_kernel(**EXACT)
def rotation_between(A, B):
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
