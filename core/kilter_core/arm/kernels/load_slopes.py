"""How static loads follow the masses and first moments of the bodies, compiled."""

from __future__ import annotations

import numpy as np

from kilter_core.arm.kernels.compiled import UNCOUNTED, compile_kernel
from kilter_core.arm.kernels.frames import (
    add_cross,
    motion_coefficients,
    move,
    reset_to_base_frame,
    right_multiply,
    set_frame,
)
from kilter_core.arm.kernels.joint_frames import add_twist, mark_frames, mark_starts, next_joint

JOINT, LINK_END, BASE = 0, 1, 2  # of which point loads are asked


@compile_kernel()
def load_slopes(
    axis,
    joint,
    ratio,
    value,
    primary,
    joint_frame,
    body_element,
    com,
    gravity,
    tool,
    carried,
    payload,
    payload_com,
    q,
    slot,
    xi,
    where,
    parts,
    change,
    out,
):
    """Derivatives of static loads by the mass, then by the first moment along x, y, z, of each body; the payload last.

    ``body_element (B,)`` is the element in whose frame the place ``com (B, 3)`` of a link's unit mass is given.
    ``carried (N,)`` is 1 in rows with a payload, of ``payload (N,)`` kg at ``payload_com (N, 3)`` in the tool frame: its
    first moment counts per metre of shift. ``slot (E,)`` and ``xi (N, S, 6)`` are as :func:`load_wrenches` has them.
    ``where (n,)`` says of which point of each joint: 0 of the joint itself, 1 of
    the end of its link, 2 of the base (then n is 1). Writes ``out (C, K, N, n)``, components ``parts (n, C)`` (0-2 force,
    3-5 moment) as :func:`load_wrenches` orders them; without columns of the payload it is left out. With a ``change (K,)``
    of the K masses and moments it writes what that changes, ``out (C, 1, N, n)``.
    """
    elements, bodies, places = axis.shape[0], body_element.shape[0], where.shape[0]
    summed = change.shape[0] > 0
    each = 1 if summed else 4
    laden = (change.shape[0] if summed else out.shape[1]) > 4 * bodies
    count = each * (bodies + 1 if laden else bodies)
    R, p, r, still, about = np.empty((3, 3)), np.empty(3), np.empty(3), np.zeros(3), np.empty(3)
    tool_R, tool_p = np.empty((3, 3)), np.empty(3)
    frames, points = np.zeros((places, 3, 3)), np.zeros((places, 3))
    joints = primary.shape[0]
    all_frames, origins, starts = np.empty((joints, 3, 3)), np.empty((joints, 3)), np.empty((joints, 3))
    links, behind, step_R, step_p = np.empty((joints, 3, 3)), np.empty((joints, 3)), np.empty((3, 3)), np.empty(3)
    J3 = np.empty((3, 3))
    first = np.zeros(places, dtype=np.int64)
    own, force, moment = np.empty((2, 4, 3)), np.empty((count, 3)), np.empty((count, 3))
    set_frame(tool, tool_R, tool_p)
    _first_elements(primary, where, elements, first, frames)
    for row in range(q.shape[0]):
        reset_to_base_frame(R, p, still, still, still)
        for e in range(elements):
            mark_starts(primary, e, p, starts)
            amount = value[e] + (ratio[e] * q[row, joint[e]] if joint[e] >= 0 else 0.0)
            c, s = motion_coefficients(axis[e], amount)
            move(axis[e], c, s, R, p)
            mark_frames(primary, joint_frame, e, R, p, all_frames, origins)
            add_twist(slot, row, e, xi, R, p, step_R, step_p, J3)
            mark_frames(primary, joint_frame, e, R, p, links, behind)
            for b in range(bodies):
                if body_element[b] == e:
                    _fill_gravity_wrenches(R, p, com[b], gravity, 1.0, 1.0, own[0], own[1], r)
                    _put_slopes(own, change, 4 * b, force, moment, each * b)
        _points(primary, where, all_frames, links, origins, starts, p, frames, points)
        if laden:
            right_multiply(R, p, tool_R, tool_p)
            _fill_gravity_wrenches(R, p, payload_com[row], gravity, carried[row], payload[row], own[0], own[1], r)
            _put_slopes(own, change, 4 * bodies, force, moment, each * bodies)
        _put_at_points(row, each, body_element, first, summed, parts, frames, points, force, moment, about, out)


@compile_kernel(**UNCOUNTED)
def _first_elements(primary, where, elements, first, frames):
    """First element whose bodies load each point: at the joint, at the end of its link, or all for the base."""
    for i in range(where.shape[0]):
        k = next_joint(primary, i)
        first[i] = 0 if where[i] == BASE else primary[i] if where[i] == JOINT else elements if k < 0 else primary[k]
        if where[i] == BASE:
            for a in range(3):
                frames[i, a, a] = 1.0


@compile_kernel(**UNCOUNTED)
def _points(primary, where, all_frames, links, origins, starts, flange, frames, points):
    """Points that loads are asked of, and the frames they are written in; those of the base stay as they are."""
    for i in range(where.shape[0]):
        if where[i] == BASE:
            continue
        k = next_joint(primary, i)
        for a in range(3):
            points[i, a] = origins[i, a] if where[i] == JOINT else flange[a] if k < 0 else starts[k, a]
            for b in range(3):
                frames[i, a, b] = all_frames[i, a, b] if where[i] == JOINT else links[i, a, b]


@compile_kernel(**UNCOUNTED)
def _put_at_points(row, each, body_element, first, summed, parts, frames, points, force, moment, about, out):
    """Write the components that are asked for. about is scratch."""
    bodies = body_element.shape[0]
    for i in range(first.shape[0]):
        for m in range(parts.shape[1]):
            out[m, 0, row, i] = 0.0
        for c in range(force.shape[0]):
            column = 0 if summed else c
            if c // each < bodies and body_element[c // each] < first[i]:
                for m in range(0 if summed else parts.shape[1]):
                    out[m, column, row, i] = 0.0
                continue
            about[:] = 0.0
            add_cross(points[i], force[c], about)
            for m in range(parts.shape[1]):
                a = parts[i, m] % 3
                total = out[m, 0, row, i] if summed else 0.0
                for k in range(3):
                    total += frames[i, k, a] * (force[c, k] if parts[i, m] < 3 else moment[c, k] - about[k])
                out[m, column, row, i] = total


@compile_kernel(**UNCOUNTED)
def _fill_gravity_wrenches(R, p, com, gravity, mass, shift, force, moment, r):
    """Force (4, 3), and moment about the base origin, of ``mass`` at a place and of ``shift`` along each axis from it."""
    force[:] = 0.0
    moment[:] = 0.0
    for i in range(3):
        force[0, i] = mass * gravity[i]
        r[i] = mass * (p[i] + R[i, 0] * com[0] + R[i, 1] * com[1] + R[i, 2] * com[2])
    add_cross(r, gravity, moment[0])
    for c in range(3):
        for i in range(3):
            r[i] = shift * R[i, c]
        add_cross(r, gravity, moment[c + 1])


@compile_kernel(**UNCOUNTED)
def _put_slopes(own, change, at, force, moment, to):
    """Put the four columns of a body, or what its part of ``change`` makes of them, in their place."""
    if change.shape[0] == 0:
        for c in range(4):
            for i in range(3):
                force[to + c, i] = own[0, c, i]
                moment[to + c, i] = own[1, c, i]
        return
    for i in range(3):
        force[to, i] = 0.0
        moment[to, i] = 0.0
        for c in range(4):
            force[to, i] += change[at + c] * own[0, c, i]
            moment[to, i] += change[at + c] * own[1, c, i]
