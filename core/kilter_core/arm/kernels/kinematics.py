"""Poses and screw columns of a chain of elementary transforms, compiled, one pose after another.

A chain is a program of E elements. Element e moves along or about one axis (codes 0..5 = Tx Ty Tz Rx Ry Rz) by
``value[e]`` or, when ``joint[e] >= 0``, by ``ratio[e] * (q + dq)[joint[e]] + value[e]``. After element e the small
twist ``xi[slot[e]]`` is inserted as ``exp(xi)`` when ``slot[e] >= 0``. The constant tool pose stands before element
``tool_at``. Angles rad, lengths m.

Screw columns are the derivative of the tool point and of the tool orientation (as a rotation vector in the frame of
the measurements) with respect to each element's motion; for a twist, the left Jacobian of SE(3) makes them exact at
any size of the twist (Barfoot, State Estimation for Robotics, 7.1.5).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def _move(axis, c, s, R, p):
    """Right-multiply the frame (R, p) by a shift c or by a turn of cosine c and sine s, in place."""
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


@njit(cache=True)
def _constants(axis, value, move):
    """Write shifts, or cosines and sines, of the elements at their constants: those no joint moves keep them."""
    for e in range(axis.shape[0]):
        if axis[e] < 3:
            move[e, 0] = value[e]
        else:
            move[e, 0] = math.cos(value[e])
            move[e, 1] = math.sin(value[e])


@njit(cache=True)
def _at_joints(axis, joint, ratio, value, q, dq, move):
    """Write shifts, or cosines and sines, of the elements that joints move, at ``q, dq (n,)``."""
    for e in range(axis.shape[0]):
        if joint[e] >= 0:
            amount = value[e] + ratio[e] * (q[joint[e]] + dq[joint[e]])
            if axis[e] < 3:
                move[e, 0] = amount
            else:
                move[e, 0] = math.cos(amount)
                move[e, 1] = math.sin(amount)


@njit(cache=True)
def _set_frame(T, R, p):
    """Copy the pose T (4, 4) into the frame (R, p)."""
    for i in range(3):
        p[i] = T[i, 3]
        for j in range(3):
            R[i, j] = T[i, j]


@njit(cache=True)
def _right_multiply(R, p, R2, p2):
    """Right-multiply the frame (R, p) by the frame (R2, p2), in place."""
    for i in range(3):
        a = R[i, 0]
        b = R[i, 1]
        c = R[i, 2]
        p[i] += a * p2[0] + b * p2[1] + c * p2[2]
        for j in range(3):
            R[i, j] = a * R2[0, j] + b * R2[1, j] + c * R2[2, j]


@njit(cache=True)
def _exponential(xi, R, p, J):
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


@njit(cache=True)
def _left_jacobian(xi, J3, J6):
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


@njit(cache=True)
def poses(axis, joint, ratio, value, slot, tool_at, base, tool, q, dq, xi, position, rotation):
    """Tool poses of N rows. ``q, dq (N, n)``, ``xi (N, S, 6)``; writes ``position (N, 3)``, ``rotation (N, 3, 3)``."""
    elements = axis.shape[0]
    R = np.empty((3, 3))
    p = np.empty(3)
    R2 = np.empty((3, 3))
    p2 = np.empty(3)
    tool_R = np.empty((3, 3))
    tool_p = np.empty(3)
    J3 = np.empty((3, 3))
    move = np.zeros((elements, 2))
    _constants(axis, value, move)
    _set_frame(tool, tool_R, tool_p)
    for row in range(q.shape[0]):
        _set_frame(base, R, p)
        _at_joints(axis, joint, ratio, value, q[row], dq[row], move)
        for e in range(elements + 1):
            if e == tool_at:
                _right_multiply(R, p, tool_R, tool_p)
            if e == elements:
                break
            _move(axis[e], move[e, 0], move[e, 1], R, p)
            s = slot[e]
            if s >= 0 and xi.shape[0] > 0:
                _exponential(xi[row, s], R2, p2, J3)
                _right_multiply(R, p, R2, p2)
        for i in range(3):
            position[row, i] = p[i]
            for k in range(3):
                rotation[row, i, k] = R[i, k]


@njit(cache=True)
def screws(axis, joint, ratio, value, slot, tool_at, base, tool, q, dq, xi, column, position, rotation, JE, JQ, JX):
    """As :func:`poses`, with the screw columns.

    ``column (E,)`` places element e in ``JE (N, 6, C)`` or leaves it out (-1); ``JQ (N, 6, n)`` is the derivative for
    the joints, ``JX (N, 6, 6 S)`` for the twists (left out when empty). Rows 0-2 move the tool point, 3-5 turn it and
    are left out where the three have three rows.
    """
    elements = axis.shape[0]
    slots = xi.shape[1]
    twists = xi.shape[0] > 0 and JX.shape[0] > 0
    turns = JQ.shape[1] == 6
    R = np.empty((3, 3))
    p = np.empty(3)
    R2 = np.empty((3, 3))
    p2 = np.empty(3)
    tool_R = np.empty((3, 3))
    tool_p = np.empty(3)
    J3 = np.empty((3, 3))
    J6 = np.empty((6, 6))
    lines = np.empty((elements, 6))
    twist_R = np.empty((slots, 3, 3))
    twist_p = np.empty((slots, 3))
    move = np.zeros((elements, 2))
    _constants(axis, value, move)
    _set_frame(tool, tool_R, tool_p)
    for row in range(q.shape[0]):
        _set_frame(base, R, p)
        _at_joints(axis, joint, ratio, value, q[row], dq[row], move)
        for e in range(elements + 1):
            if e == tool_at:
                _right_multiply(R, p, tool_R, tool_p)
            if e == elements:
                break
            k = axis[e] % 3
            for i in range(3):
                lines[e, i] = R[i, k]
                lines[e, 3 + i] = p[i]
            _move(axis[e], move[e, 0], move[e, 1], R, p)
            s = slot[e]
            if s >= 0:
                twist_R[s] = R
                twist_p[s] = p
                if xi.shape[0] > 0:
                    _exponential(xi[row, s], R2, p2, J3)
                    _right_multiply(R, p, R2, p2)
        for i in range(3):
            position[row, i] = p[i]
            for k in range(3):
                rotation[row, i, k] = R[i, k]
        JQ[row] = 0.0
        for e in range(elements):
            a0 = lines[e, 0]
            a1 = lines[e, 1]
            a2 = lines[e, 2]
            c = column[e]
            j = joint[e]
            if c < 0 and j < 0:
                continue
            if axis[e] < 3:
                v0 = a0
                v1 = a1
                v2 = a2
                w = 0.0
            else:
                r0 = p[0] - lines[e, 3]
                r1 = p[1] - lines[e, 4]
                r2 = p[2] - lines[e, 5]
                v0 = a1 * r2 - a2 * r1
                v1 = a2 * r0 - a0 * r2
                v2 = a0 * r1 - a1 * r0
                w = 1.0
            if c >= 0:
                JE[row, 0, c] = v0
                JE[row, 1, c] = v1
                JE[row, 2, c] = v2
                if turns:
                    JE[row, 3, c] = w * a0
                    JE[row, 4, c] = w * a1
                    JE[row, 5, c] = w * a2
            if j >= 0:
                g = ratio[e]
                JQ[row, 0, j] += g * v0
                JQ[row, 1, j] += g * v1
                JQ[row, 2, j] += g * v2
                if turns:
                    JQ[row, 3, j] += g * w * a0
                    JQ[row, 4, j] += g * w * a1
                    JQ[row, 5, j] += g * w * a2
        if not twists:
            continue
        for s in range(slots):
            _exponential(xi[row, s], R2, p2, J3)
            _left_jacobian(xi[row, s], J3, J6)
            r0 = p[0] - twist_p[s, 0]
            r1 = p[1] - twist_p[s, 1]
            r2 = p[2] - twist_p[s, 2]
            for m in range(6):
                v0 = 0.0
                v1 = 0.0
                v2 = 0.0
                w0 = 0.0
                w1 = 0.0
                w2 = 0.0
                for k in range(3):
                    v0 += twist_R[s, 0, k] * J6[k, m]
                    v1 += twist_R[s, 1, k] * J6[k, m]
                    v2 += twist_R[s, 2, k] * J6[k, m]
                    w0 += twist_R[s, 0, k] * J6[3 + k, m]
                    w1 += twist_R[s, 1, k] * J6[3 + k, m]
                    w2 += twist_R[s, 2, k] * J6[3 + k, m]
                c = 6 * s + m
                JX[row, 0, c] = v0 + w1 * r2 - w2 * r1
                JX[row, 1, c] = v1 + w2 * r0 - w0 * r2
                JX[row, 2, c] = v2 + w0 * r1 - w1 * r0
                if turns:
                    JX[row, 3, c] = w0
                    JX[row, 4, c] = w1
                    JX[row, 5, c] = w2
