"""Load wrench on every joint from gravity, motion, payload and an external wrench, compiled.

The recursion of Newton and Euler (Craig, ch. 6) written in base coordinates: out along the elements for velocities and
accelerations, back for forces. The result is the *load*: what the outboard links do to the joint, the negative of the
reaction that a textbook recursion returns (thesis eq. 4.21 and 5.14, corrected: forces rotated into one frame first).
"""

from __future__ import annotations

import numpy as np

from kilter_core.arm.kernels.compiled import UNCOUNTED, compile_kernel
from kilter_core.arm.kernels.frames import (
    add_cross,
    in_frame,
    motion_coefficients,
    move,
    reset_to_base_frame,
    right_multiply,
    rotate,
)
from kilter_core.arm.kernels.joint_frames import add_twist, mark_frames, mark_starts, next_joint


@compile_kernel(**UNCOUNTED)
def _carry(r, w, dw, acc, t):
    """Carry an acceleration from a point of a rotating body to the point r further: acc += dw x r + w x (w x r)."""
    add_cross(dw, r, acc)
    t[:] = 0.0
    add_cross(w, r, t)
    add_cross(w, t, acc)


@compile_kernel(**UNCOUNTED)
def _add_body(mass, com, R, p, w, dw, acc, gravity, force, moment, r, f, t):
    """Add the load of a point mass: its force, and the force's moment about the base origin. r, f, t are scratch."""
    rotate(R, com, r)
    for i in range(3):
        f[i] = acc[i]
    _carry(r, w, dw, f, t)
    for i in range(3):
        f[i] = mass * (gravity[i] - f[i])
        force[i] += f[i]
        r[i] += p[i]
    add_cross(r, f, moment)


@compile_kernel(**UNCOUNTED)
def _add_inertia(inertia, R, w, dw, moment, a, b, h, t):
    """Subtract the rate of spin of a body, I dw + w x I w, from ``moment``. a, b, h, t are scratch."""
    for i in range(3):
        a[i] = R[0, i] * w[0] + R[1, i] * w[1] + R[2, i] * w[2]
        b[i] = R[0, i] * dw[0] + R[1, i] * dw[1] + R[2, i] * dw[2]
    rotate(inertia, b, h)
    rotate(inertia, a, t)
    h[0] += a[1] * t[2] - a[2] * t[1]
    h[1] += a[2] * t[0] - a[0] * t[2]
    h[2] += a[0] * t[1] - a[1] * t[0]
    rotate(R, h, t)
    for i in range(3):
        moment[i] -= t[i]


@compile_kernel(**UNCOUNTED)
def _put_amounts(axis, value, out):
    """Write what :func:`move` takes (E, 2) of elements that no joint moves."""
    for e in range(axis.shape[0]):
        out[e, 0], out[e, 1] = motion_coefficients(axis[e], value[e])


@compile_kernel(**UNCOUNTED)
def _advance(axis, amount, speed, rate, moving, R, p, w, dw, acc, z, r, t):
    """Walk along one element: its frame and, where the arm is moving, velocity and acceleration. z, r, t are scratch.

    ``amount (2,)`` is what :func:`move` takes.
    """
    for i in range(3):
        z[i] = R[i, axis % 3]
        r[i] = p[i]
    move(axis, amount[0], amount[1], R, p)
    if not moving:
        return
    if axis < 3:
        for i in range(3):
            r[i] = p[i] - r[i]
        _carry(r, w, dw, acc, t)
    t[:] = 0.0
    add_cross(w, z, t)
    for i in range(3):
        if axis < 3:
            acc[i] += 2.0 * speed * t[i] + rate * z[i]
        else:
            dw[i] += rate * z[i] + speed * t[i]
            w[i] += speed * z[i]


@compile_kernel(**UNCOUNTED)
def _add_at_tool(row, payload, payload_com, external, R, p, w, dw, acc, gravity, force, moment, r, f, t):
    """Add the loads that act in the tool frame: the payload's and the external wrench. r, f, t are scratch."""
    if payload[row] != 0.0:
        _add_body(payload[row], payload_com[row], R, p, w, dw, acc, gravity, force, moment, r, f, t)
    if external.shape[0] > 0:
        rotate(R, external[row, :3], f)
        rotate(R, external[row, 3:], t)
        for i in range(3):
            force[i] += f[i]
            moment[i] += t[i]
        add_cross(p, f, moment)


@compile_kernel(**UNCOUNTED)
def _put_wrenches(row, primary, frames, links, origins, starts, flange, forces, moments, out, end, base, t):
    """Sum the loads inwards and write them: on the joints, on the ends of their links, on the base. t is scratch."""
    elements = forces.shape[0] - 1
    for e in range(elements - 1, -1, -1):
        for i in range(3):
            forces[e, i] += forces[e + 1, i]
            moments[e, i] += moments[e + 1, i]
    for i in range(3):
        base[row, i] = forces[0, i]
        base[row, 3 + i] = moments[0, i]
    for i in range(primary.shape[0]):
        in_frame(frames[i], origins[i], forces[primary[i]], moments[primary[i]], out[row, i], t)
        k = next_joint(primary, i)
        where, following = (flange, elements) if k < 0 else (starts[k], primary[k])
        in_frame(links[i], where, forces[following], moments[following], end[row, i], t)


@compile_kernel()
def load_wrenches(
    axis,
    joint,
    ratio,
    value,
    primary,
    joint_frame,
    link_element,
    mass,
    com,
    inertia,
    gravity,
    tool,
    payload,
    payload_com,
    external,
    q,
    qd,
    qdd,
    slot,
    xi,
    out,
    end,
    base,
    point,
):
    """Load wrench (force N, moment N·m about the joint) on each joint in its joint frame.

    ``primary (n,)`` is the element of each joint, ``joint_frame (n, 3, 3)`` rotates the frame after it so that z is the
    joint axis. ``link_element (L,)`` is the element whose frame the link's ``com (L, 3)`` and ``inertia (L, 3, 3)`` are
    given in. ``payload (N,)`` kg at ``payload_com (N, 3)`` and ``external (N, 6)`` (force, moment about the tool point)
    are in the tool frame, which stands after the last element. ``qd, qdd`` may be empty: then the load is static.
    ``xi (N, S, 6)`` are twists behind elements, ``slot (E,)`` says which of them, -1 none; the links behind ride on them.
    It may be empty.
    Writes ``out (N, n, 6)``; ``end (N, n, 6)``, the load of what follows on the end of each link (where the next joint
    stands before it moves, the flange for the last), in the frame of the link's own joint behind its twist; ``base
    (N, 6)``, the load on the base about its origin, in the base frame; and ``point (N, 3)``, the tool point in the base frame.
    """
    elements, n, moving = axis.shape[0], primary.shape[0], qd.shape[0] > 0
    R, p, z, r = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    f, t, flange = np.empty(3), np.empty(3), np.empty(3)
    w, dw, acc, J3 = np.zeros(3), np.zeros(3), np.zeros(3), np.empty((3, 3))
    scratch, forces, moments = np.empty((4, 3)), np.empty((elements + 1, 3)), np.empty((elements + 1, 3))
    frames, origins, starts = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3))
    links, behind, step_R, step_p = np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    tool_R, tool_p = np.ascontiguousarray(tool[:3, :3]), np.ascontiguousarray(tool[:3, 3])
    amount = np.empty((elements, 2))
    _put_amounts(axis, value, amount)  # of constant elements it is the same in every row
    for row in range(q.shape[0]):
        forces[:], moments[:] = 0.0, 0.0
        reset_to_base_frame(R, p, w, dw, acc)
        for e in range(elements):
            j = joint[e]
            if j >= 0:
                amount[e, 0], amount[e, 1] = motion_coefficients(axis[e], value[e] + ratio[e] * q[row, j])
            speed = ratio[e] * qd[row, j] if moving and j >= 0 else 0.0
            rate = ratio[e] * qdd[row, j] if moving and j >= 0 else 0.0
            mark_starts(primary, e, p, starts)
            _advance(axis[e], amount[e], speed, rate, moving, R, p, w, dw, acc, z, r, t)
            mark_frames(primary, joint_frame, e, R, p, frames, origins)
            r[:] = p
            add_twist(slot, row, e, xi, R, p, step_R, step_p, J3)
            mark_frames(primary, joint_frame, e, R, p, links, behind)
            if moving:
                for i in range(3):
                    r[i] = p[i] - r[i]
                _carry(r, w, dw, acc, t)
            for b in range(mass.shape[0]):
                if link_element[b] == e:
                    _add_body(mass[b], com[b], R, p, w, dw, acc, gravity, forces[e], moments[e], r, f, t)
                    if moving:
                        _add_inertia(inertia[b], R, w, dw, moments[e], scratch[0], scratch[1], scratch[2], scratch[3])
        flange[:] = p
        rotate(R, tool_p, r)
        if moving:
            _carry(r, w, dw, acc, t)
        right_multiply(R, p, tool_R, tool_p)
        point[row] = p
        _add_at_tool(
            row, payload, payload_com, external, R, p, w, dw, acc, gravity, forces[elements], moments[elements], r, f, t
        )
        _put_wrenches(row, primary, frames, links, origins, starts, flange, forces, moments, out, end, base, t)
