"""Frames as arrays (R, p) that are changed in place, compiled: what the kernels of the arm share."""

from __future__ import annotations

import math

from kilter_core.arm.kernels.compiled import UNCOUNTED, compile_kernel


@compile_kernel(inline="always")
def motion_coefficients(axis, amount):
    """What :func:`move` takes for a motion along or about an axis: a shift and 0, or cosine and sine."""
    if axis < 3:
        return amount, 0.0
    return math.cos(amount), math.sin(amount)


@compile_kernel(inline="always")
def move(axis, c, s, R, p):
    """Right-multiply the frame (R, p) by a shift c or by a rotation of cosine c and sine s, in place."""
    # One branch per axis, for constant columns compile to much less than computed ones.
    for i in range(3):
        x = R[i, 0]
        y = R[i, 1]
        z = R[i, 2]
        if axis == 0:
            p[i] += x * c
        elif axis == 1:
            p[i] += y * c
        elif axis == 2:
            p[i] += z * c
        elif axis == 3:
            R[i, 1] = c * y + s * z
            R[i, 2] = c * z - s * y
        elif axis == 4:
            R[i, 2] = c * z + s * x
            R[i, 0] = c * x - s * z
        else:
            R[i, 0] = c * x + s * y
            R[i, 1] = c * y - s * x


@compile_kernel(**UNCOUNTED)
def set_frame(T, R, p):
    """Copy the pose T (4, 4) into the frame (R, p)."""
    for i in range(3):
        p[i] = T[i, 3]
        for j in range(3):
            R[i, j] = T[i, j]


@compile_kernel(**UNCOUNTED)
def right_multiply(R, p, R2, p2):
    """Right-multiply the frame (R, p) by the frame (R2, p2), in place."""
    for i in range(3):
        a = R[i, 0]
        b = R[i, 1]
        c = R[i, 2]
        p[i] += a * p2[0] + b * p2[1] + c * p2[2]
        for j in range(3):
            R[i, j] = a * R2[0, j] + b * R2[1, j] + c * R2[2, j]


@compile_kernel(**UNCOUNTED)
def exponential(xi, R, p, J):
    """exp of a twist (v, w) as (R, p); J (3, 3) is the left Jacobian of SO(3) at w, which also carries v to p."""
    w0 = xi[3]
    w1 = xi[4]
    w2 = xi[5]
    t2 = w0 * w0 + w1 * w1 + w2 * w2
    if t2 < 1e-6:  # series: the closed forms lose digits to cancellation here
        a = 1.0 - t2 / 6.0
        b = 0.5 - t2 / 24.0
        c = 1.0 / 6.0 - t2 / 120.0
    else:
        t = math.sqrt(t2)
        a = math.sin(t) / t
        b = (1.0 - math.cos(t)) / t2
        c = (1.0 - a) / t2
    for i in range(3):
        for j in range(3):
            outer = xi[3 + i] * xi[3 + j]
            square = outer - t2 if i == j else outer
            cross = 0.0
            if i != j:
                k = 3 - i - j
                cross = xi[3 + k] if (j + 1) % 3 == i else -xi[3 + k]
            eye = 1.0 if i == j else 0.0
            R[i, j] = eye + a * cross + b * square
            J[i, j] = eye + b * cross + c * square
    for i in range(3):
        p[i] = J[i, 0] * xi[0] + J[i, 1] * xi[1] + J[i, 2] * xi[2]


@compile_kernel(**UNCOUNTED)
def left_jacobian(xi, J3, J6):
    """Left Jacobian of SE(3) at xi, 6x6; the coupling block by its series, 13 terms, 1e-16 below 1 rad.

    The powers of the twist's bracket are taken row by row: a row times a cross-product matrix is a cross product.
    """
    for i in range(3):
        for j in range(3):
            J6[i, j] = J3[i, j]
            J6[i, 3 + j] = 0.0
            J6[3 + i, j] = 0.0
            J6[3 + i, 3 + j] = J3[i, j]
    v0, v1, v2 = xi[0], xi[1], xi[2]
    w0, w1, w2 = xi[3], xi[4], xi[5]
    if v0 == 0.0 and v1 == 0.0 and v2 == 0.0:
        return
    for i in range(3):
        a0 = 1.0 if i == 0 else 0.0
        a1 = 1.0 if i == 1 else 0.0
        a2 = 1.0 if i == 2 else 0.0
        b0 = 0.0
        b1 = 0.0
        b2 = 0.0
        for k in range(1, 14):
            f = 1.0 / (k + 1.0)
            c0 = (a1 * v2 - a2 * v1 + b1 * w2 - b2 * w1) * f
            c1 = (a2 * v0 - a0 * v2 + b2 * w0 - b0 * w2) * f
            c2 = (a0 * v1 - a1 * v0 + b0 * w1 - b1 * w0) * f
            d0 = (a1 * w2 - a2 * w1) * f
            d1 = (a2 * w0 - a0 * w2) * f
            d2 = (a0 * w1 - a1 * w0) * f
            J6[i, 3] += c0
            J6[i, 4] += c1
            J6[i, 5] += c2
            a0, a1, a2, b0, b1, b2 = d0, d1, d2, c0, c1, c2


@compile_kernel(inline="always")
def add_cross(a, b, out):
    """out += a x b."""
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@compile_kernel(inline="always")
def rotate(R, v, out):
    """out = R v."""
    for i in range(3):
        out[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]


@compile_kernel(**UNCOUNTED)
def in_frame(frame, origin, force, moment, out, t):
    """Write a wrench about the base origin as one about ``origin`` in ``frame``. t is scratch."""
    t[:] = 0.0
    add_cross(origin, force, t)
    for a in range(3):
        out[a] = frame[0, a] * force[0] + frame[1, a] * force[1] + frame[2, a] * force[2]
        out[3 + a] = (
            frame[0, a] * (moment[0] - t[0]) + frame[1, a] * (moment[1] - t[1]) + frame[2, a] * (moment[2] - t[2])
        )


@compile_kernel(**UNCOUNTED)
def reset_to_base_frame(R, p, w, dw, acc):
    """Set a frame to the base frame at rest."""
    for i in range(3):
        p[i] = 0.0
        w[i] = 0.0
        dw[i] = 0.0
        acc[i] = 0.0
        for k in range(3):
            R[i, k] = 1.0 if i == k else 0.0
