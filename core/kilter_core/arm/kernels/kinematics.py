"""Poses and screw columns of a chain of elementary transforms, compiled, one pose after another.

A chain is a program of E elements. Element e moves along or about one axis (codes 0..5 = Tx Ty Tz Rx Ry Rz) by
``value[e]`` or, when ``joint[e] >= 0``, by ``ratio[e] * (q + dq)[joint[e]] + value[e]``. After element e the small
twist ``xi[slot[e]]`` is inserted as ``exp(xi)`` when ``slot[e] >= 0``. The constant tool pose stands before element
``tool_at``. Angles rad, lengths m.

Screw columns are the derivative of the tool point and of the tool orientation (as a rotation vector in the frame of
the measurements) with respect to each element's motion; for a twist, the left Jacobian of SE(3) makes them exact at
any size of the twist (Barfoot, State Estimation for Robotics, 7.1.5).

The chain rule of effects, row by row: what local corrections move of the tool, compiled.
"""

from __future__ import annotations

import numpy as np

from kilter_core.arm.kernels.compiled import UNCOUNTED, compile_kernel
from kilter_core.arm.kernels.frames import (
    exponential,
    left_jacobian,
    motion_coefficients,
    move,
    right_multiply,
    set_frame,
)


@compile_kernel(**UNCOUNTED)
def _constants(axis, value, motion):
    """Write shifts, or cosines and sines, of the elements at their constants: those no joint moves keep them."""
    for e in range(axis.shape[0]):
        motion[e, 0], motion[e, 1] = motion_coefficients(axis[e], value[e])


@compile_kernel(**UNCOUNTED)
def _at_joints(axis, joint, ratio, value, q, dq, motion):
    """Write shifts, or cosines and sines, of the elements that joints move, at ``q, dq (n,)``."""
    for e in range(axis.shape[0]):
        if joint[e] >= 0:
            amount = value[e] + ratio[e] * (q[joint[e]] + dq[joint[e]])
            motion[e, 0], motion[e, 1] = motion_coefficients(axis[e], amount)


@compile_kernel()
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
    motion = np.zeros((elements, 2))
    _constants(axis, value, motion)
    set_frame(tool, tool_R, tool_p)
    for row in range(q.shape[0]):
        set_frame(base, R, p)
        _at_joints(axis, joint, ratio, value, q[row], dq[row], motion)
        for e in range(elements + 1):
            if e == tool_at:
                right_multiply(R, p, tool_R, tool_p)
            if e == elements:
                break
            move(axis[e], motion[e, 0], motion[e, 1], R, p)
            s = slot[e]
            if s >= 0 and xi.shape[0] > 0:
                exponential(xi[row, s], R2, p2, J3)
                right_multiply(R, p, R2, p2)
        _put_pose(row, R, p, position, rotation)


@compile_kernel(**UNCOUNTED)
def _put_pose(row, R, p, position, rotation):
    """Write the frame (R, p) as the pose of a row."""
    for i in range(3):
        position[row, i] = p[i]
        for k in range(3):
            rotation[row, i, k] = R[i, k]


@compile_kernel()
def screws(axis, joint, ratio, value, slot, tool_at, base, tool, q, dq, xi, column, position, rotation, JE, JQ, JX):
    """As :func:`poses`, with the screw columns.

    ``column (E,)`` places element e in ``JE (N, 6, C)`` or leaves it out (-1); ``JQ (N, 6, n)`` is the derivative for
    the joints, ``JX (N, 6, 6 S)`` for the twists (left out when empty). Rows 0-2 move the tool point, 3-5 rotate it and
    are left out where the three have three rows.
    """
    elements = axis.shape[0]
    slots = xi.shape[1]
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
    motion = np.zeros((elements, 2))
    _constants(axis, value, motion)
    set_frame(tool, tool_R, tool_p)
    for row in range(q.shape[0]):
        set_frame(base, R, p)
        _at_joints(axis, joint, ratio, value, q[row], dq[row], motion)
        for e in range(elements + 1):
            if e == tool_at:
                right_multiply(R, p, tool_R, tool_p)
            if e == elements:
                break
            for i in range(3):
                lines[e, i] = R[i, axis[e] % 3]
                lines[e, 3 + i] = p[i]
            move(axis[e], motion[e, 0], motion[e, 1], R, p)
            s = slot[e]
            if s >= 0:
                twist_R[s] = R
                twist_p[s] = p
                if xi.shape[0] > 0:
                    exponential(xi[row, s], R2, p2, J3)
                    right_multiply(R, p, R2, p2)
        _put_pose(row, R, p, position, rotation)
        _element_columns(row, axis, joint, ratio, column, lines, p, JE, JQ)
        if xi.shape[0] > 0 and JX.shape[0] > 0:
            for s in range(slots):
                exponential(xi[row, s], R2, p2, J3)
                left_jacobian(xi[row, s], J3, J6)
                _twist_columns(row, s, twist_R[s], twist_p[s], J6, p, JX)


@compile_kernel(**UNCOUNTED)
def _element_columns(row, axis, joint, ratio, column, lines, p, JE, JQ):
    """Screw columns of the elements, and their sums by joint, at the tool point p."""
    rotations = JQ.shape[1] == 6
    JQ[row] = 0.0
    for e in range(axis.shape[0]):
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
            if rotations:
                JE[row, 3, c] = w * a0
                JE[row, 4, c] = w * a1
                JE[row, 5, c] = w * a2
        if j >= 0:
            g = ratio[e]
            JQ[row, 0, j] += g * v0
            JQ[row, 1, j] += g * v1
            JQ[row, 2, j] += g * v2
            if rotations:
                JQ[row, 3, j] += g * w * a0
                JQ[row, 4, j] += g * w * a1
                JQ[row, 5, j] += g * w * a2


@compile_kernel(**UNCOUNTED)
def _twist_columns(row, s, R, origin, J6, p, JX):
    """Screw columns of the twist in slot s, which stands at the frame (R, origin)."""
    rotations = JX.shape[1] == 6
    r0 = p[0] - origin[0]
    r1 = p[1] - origin[1]
    r2 = p[2] - origin[2]
    for m in range(6):
        v0 = 0.0
        v1 = 0.0
        v2 = 0.0
        w0 = 0.0
        w1 = 0.0
        w2 = 0.0
        for k in range(3):
            v0 += R[0, k] * J6[k, m]
            v1 += R[1, k] * J6[k, m]
            v2 += R[2, k] * J6[k, m]
            w0 += R[0, k] * J6[3 + k, m]
            w1 += R[1, k] * J6[3 + k, m]
            w2 += R[2, k] * J6[3 + k, m]
        c = 6 * s + m
        JX[row, 0, c] = v0 + w1 * r2 - w2 * r1
        JX[row, 1, c] = v1 + w2 * r0 - w0 * r2
        JX[row, 2, c] = v2 + w0 * r1 - w1 * r0
        if rotations:
            JX[row, 3, c] = w0
            JX[row, 4, c] = w1
            JX[row, 5, c] = w2


@compile_kernel()
def put_turn(out, column, JQ, joint, dq):
    """Add to ``out[:, :, column]`` what ``dq (N,)`` of a joint moves by ``JQ (N, m, n)``."""
    for row in range(out.shape[0]):
        for i in range(JQ.shape[1]):
            out[row, i, column] += JQ[row, i, joint] * dq[row]


@compile_kernel()
def put_twist(out, column, JX, slot, frame, xi):
    """The same of twists ``xi (N, 6)``, rotated by ``frame (3, 3)``, at a slot of ``JX (N, m, 6 S)``."""
    for row in range(out.shape[0]):
        for half in range(2):
            for a in range(3):
                v = 0.0
                for b in range(3):
                    v += frame[a, b] * xi[row, 3 * half + b]
                if v == 0.0:
                    continue
                for i in range(JX.shape[1]):
                    out[row, i, column] += JX[row, i, 6 * slot + 3 * half + a] * v


@compile_kernel()
def put_loads(out, places, moved, load, errors):
    """Add ``moved (N, m)`` times row ``errors[k]`` of ``load (K, N)`` to each column ``places[k]`` of ``out (N, m, P)``."""
    for row in range(out.shape[0]):
        for k in range(places.shape[0]):
            by = load[errors[k], row]
            for i in range(moved.shape[1]):
                out[row, i, places[k]] += moved[row, i] * by
