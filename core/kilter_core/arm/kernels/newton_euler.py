"""Load wrench on every joint from gravity, motion, payload and an external wrench, compiled.

The recursion of Newton and Euler (Craig, ch. 6) written in base coordinates: out along the elements for velocities and
accelerations, back for forces. The result is the *load*: what the outboard links do to the joint, the negative of the
reaction that a textbook recursion returns (thesis eq. 4.21 and 5.14, corrected: forces rotated into one frame first).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, inline="always")
def _move(axis, amount, R, p):
    """Right-multiply the frame (R, p) by one elementary transform, in place."""
    if axis < 3:
        for i in range(3):
            p[i] += R[i, axis] * amount
        return
    c = math.cos(amount)
    s = math.sin(amount)
    k = axis - 3
    a = (k + 1) % 3
    b = (k + 2) % 3
    for i in range(3):
        u = R[i, a]
        v = R[i, b]
        R[i, a] = c * u + s * v
        R[i, b] = c * v - s * u


@njit(cache=True, inline="always")
def _add_cross(a, b, out):
    """out += a x b."""
    out[0] += a[1] * b[2] - a[2] * b[1]
    out[1] += a[2] * b[0] - a[0] * b[2]
    out[2] += a[0] * b[1] - a[1] * b[0]


@njit(cache=True, inline="always")
def _turn(R, v, out):
    """out = R v."""
    for i in range(3):
        out[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]


@njit(cache=True)
def _carry(r, w, dw, acc, t):
    """Carry an acceleration from a point of a turning body to the point r further: acc += dw x r + w x (w x r)."""
    _add_cross(dw, r, acc)
    t[:] = 0.0
    _add_cross(w, r, t)
    _add_cross(w, t, acc)


@njit(cache=True)
def _add_body(mass, com, R, p, w, dw, acc, gravity, force, moment, r, f, t):
    """Add the load of a point mass: its force, and the force's moment about the base origin. r, f, t are scratch."""
    _turn(R, com, r)
    f[:] = acc
    _carry(r, w, dw, f, t)
    for i in range(3):
        f[i] = mass * (gravity[i] - f[i])
        force[i] += f[i]
        r[i] += p[i]
    _add_cross(r, f, moment)


@njit(cache=True)
def _add_inertia(inertia, R, w, dw, moment, a, b, h, t):
    """Subtract the rate of spin of a body, I dw + w x I w, from ``moment``. a, b, h, t are scratch."""
    for i in range(3):
        a[i] = R[0, i] * w[0] + R[1, i] * w[1] + R[2, i] * w[2]
        b[i] = R[0, i] * dw[0] + R[1, i] * dw[1] + R[2, i] * dw[2]
    _turn(inertia, b, h)
    _turn(inertia, a, t)
    h[0] += a[1] * t[2] - a[2] * t[1]
    h[1] += a[2] * t[0] - a[0] * t[2]
    h[2] += a[0] * t[1] - a[1] * t[0]
    _turn(R, h, t)
    for i in range(3):
        moment[i] -= t[i]


@njit(cache=True)
def _in_frame(frame, origin, force, moment, out, t):
    """Write a wrench about the base origin as one about ``origin`` in ``frame``. t is scratch."""
    t[:] = 0.0
    _add_cross(origin, force, t)
    for a in range(3):
        out[a] = frame[0, a] * force[0] + frame[1, a] * force[1] + frame[2, a] * force[2]
        out[3 + a] = (
            frame[0, a] * (moment[0] - t[0]) + frame[1, a] * (moment[1] - t[1]) + frame[2, a] * (moment[2] - t[2])
        )


@njit(cache=True)
def _at_rest(R, p, w, dw, acc):
    """Set a frame to the base frame at rest."""
    for i in range(3):
        p[i] = 0.0
        w[i] = 0.0
        dw[i] = 0.0
        acc[i] = 0.0
        for k in range(3):
            R[i, k] = 1.0 if i == k else 0.0


@njit(cache=True)
def _next_joint(primary, i):
    """Joint whose element follows that of joint i, -1 for the last; mimic elements can make it another than i + 1."""
    found = -1
    for k in range(primary.shape[0]):
        if primary[k] > primary[i] and (found < 0 or primary[k] < primary[found]):
            found = k
    return found


@njit(cache=True)
def load_wrenches(
    axis, joint, ratio, value, primary, joint_frame, link_element, mass, com, inertia, gravity, tool,
    payload, payload_com, external, q, qd, qdd, out, end, base, point,
):  # fmt: skip
    """Load wrench (force N, moment N·m about the joint) on each joint in its joint frame.

    ``primary (n,)`` is the element of each joint, ``joint_frame (n, 3, 3)`` turns the frame after it so that z is the
    joint axis. ``link_element (L,)`` is the element whose frame the link's ``com (L, 3)`` and ``inertia (L, 3, 3)`` are
    given in. ``payload (N,)`` kg at ``payload_com (N, 3)`` and ``external (N, 6)`` (force, moment about the tool point)
    are in the tool frame, which stands after the last element. ``qd, qdd`` may be empty: then the load is static.
    Writes ``out (N, n, 6)``; ``end (N, n, 6)``, the load of what follows on the end of each link (where the next joint
    stands before it moves, the flange for the last), still in the frame of the link's own joint; ``base (N, 6)``, the
    load on the base about its origin, in the base frame; and ``point (N, 3)``, the tool point in the base frame.
    """
    elements = axis.shape[0]
    n = primary.shape[0]
    moving = qd.shape[0] > 0
    R = np.empty((3, 3))
    p = np.empty(3)
    z = np.empty(3)
    r = np.empty(3)
    f = np.empty(3)
    t = np.empty(3)
    w = np.zeros(3)
    dw = np.zeros(3)
    acc = np.zeros(3)
    scratch = np.empty((4, 3))
    forces = np.empty((elements + 1, 3))
    moments = np.empty((elements + 1, 3))
    frames = np.empty((n, 3, 3))
    origins = np.empty((n, 3))
    feet = np.empty((n, 3))
    flange = np.empty(3)
    tool_R = np.ascontiguousarray(tool[:3, :3])
    tool_p = np.ascontiguousarray(tool[:3, 3])
    for row in range(q.shape[0]):
        forces[:] = 0.0
        moments[:] = 0.0
        _at_rest(R, p, w, dw, acc)
        for e in range(elements):
            j = joint[e]
            k = axis[e] % 3
            amount = value[e]
            speed = 0.0
            rate = 0.0
            if j >= 0:
                amount += ratio[e] * q[row, j]
                if moving:
                    speed = ratio[e] * qd[row, j]
                    rate = ratio[e] * qdd[row, j]
            for i in range(3):
                z[i] = R[i, k]
                r[i] = p[i]
            for i in range(n):
                if primary[i] == e:
                    feet[i] = p
            _move(axis[e], amount, R, p)
            if moving and axis[e] < 3:
                for i in range(3):
                    r[i] = p[i] - r[i]
                _carry(r, w, dw, acc, t)
                t[:] = 0.0
                _add_cross(w, z, t)
                for i in range(3):
                    acc[i] += 2.0 * speed * t[i] + rate * z[i]
            elif moving and j >= 0:
                t[:] = 0.0
                _add_cross(w, z, t)
                for i in range(3):
                    dw[i] += rate * z[i] + speed * t[i]
                    w[i] += speed * z[i]
            for i in range(n):
                if primary[i] == e:
                    for a in range(3):
                        origins[i, a] = p[a]
                        for b in range(3):
                            F = joint_frame[i]
                            frames[i, a, b] = R[a, 0] * F[0, b] + R[a, 1] * F[1, b] + R[a, 2] * F[2, b]
            for b in range(mass.shape[0]):
                if link_element[b] == e:
                    _add_body(mass[b], com[b], R, p, w, dw, acc, gravity, forces[e], moments[e], r, f, t)
                    if moving:
                        _add_inertia(inertia[b], R, w, dw, moments[e], scratch[0], scratch[1], scratch[2], scratch[3])
        _turn(R, tool_p, r)
        for i in range(3):
            flange[i] = p[i]
            point[row, i] = p[i] + r[i]
        if moving:
            _carry(r, w, dw, acc, t)
        for i in range(3):
            p[i] += r[i]
        for i in range(3):
            u = R[i, 0]
            v = R[i, 1]
            x = R[i, 2]
            for k in range(3):
                R[i, k] = u * tool_R[0, k] + v * tool_R[1, k] + x * tool_R[2, k]
        if payload[row] != 0.0:
            _add_body(
                payload[row], payload_com[row], R, p, w, dw, acc, gravity, forces[elements], moments[elements], r, f, t
            )
        if external.shape[0] > 0:
            _turn(R, external[row, :3], f)
            _turn(R, external[row, 3:], t)
            for i in range(3):
                forces[elements, i] += f[i]
                moments[elements, i] += t[i]
            _add_cross(p, f, moments[elements])
        for e in range(elements - 1, -1, -1):
            for i in range(3):
                forces[e, i] += forces[e + 1, i]
                moments[e, i] += moments[e + 1, i]
        for i in range(3):
            base[row, i] = forces[0, i]
            base[row, 3 + i] = moments[0, i]
        for i in range(n):
            _in_frame(frames[i], origins[i], forces[primary[i]], moments[primary[i]], out[row, i], t)
            k = _next_joint(primary, i)
            where, following = (flange, elements) if k < 0 else (feet[k], primary[k])
            _in_frame(frames[i], where, forces[following], moments[following], end[row, i], t)


@njit(cache=True)
def load_slopes(
    axis, joint, ratio, value, primary, joint_frame, body_element, com, gravity, tool, carried, payload, payload_com,
    q, where, parts, change, out,
):  # fmt: skip
    """Derivatives of static loads by the mass, then by the first moment along x, y, z, of each body; the payload last.

    ``body_element (B,)`` is the element in whose frame the place ``com (B, 3)`` of a link's unit mass is given.
    ``carried (N,)`` is 1 in rows with a payload, of ``payload (N,)`` kg at ``payload_com (N, 3)`` in the tool frame: its
    first moment counts per metre of shift. ``where (n,)`` says of which point of each joint: 0 of the joint itself, 1 of
    the end of its link, 2 of the base (then n is 1). Writes ``out (C, K, N, n)``, components ``parts (n, C)`` (0-2 force,
    3-5 moment) as :func:`load_wrenches` orders them; without columns of the payload it is left out. With a ``change (K,)``
    of the K masses and moments it writes what that changes, ``out (C, 1, N, n)``.
    """
    elements = axis.shape[0]
    bodies = body_element.shape[0]
    summed = change.shape[0] > 0
    each = 1 if summed else 4
    laden = (change.shape[0] if summed else out.shape[1]) > 4 * bodies
    count = each * (bodies + 1 if laden else bodies)
    R = np.empty((3, 3))
    turned = np.empty((3, 3))
    p = np.empty(3)
    r = np.empty(3)
    still = np.zeros(3)
    about = np.empty(3)
    frames = np.zeros((where.shape[0], 3, 3))
    points = np.zeros((where.shape[0], 3))
    feet = np.empty((primary.shape[0], 3))
    first = np.zeros(where.shape[0], dtype=np.int64)
    own = np.empty((2, 4, 3))
    force = np.empty((count, 3))
    moment = np.empty((count, 3))
    for i in range(where.shape[0]):
        k = _next_joint(primary, i)
        first[i] = 0 if where[i] == 2 else primary[i] if where[i] == 0 else elements if k < 0 else primary[k]
        if where[i] == 2:
            for a in range(3):
                frames[i, a, a] = 1.0
    for row in range(q.shape[0]):
        _at_rest(R, p, still, still, still)
        for e in range(elements):
            for i in range(primary.shape[0]):
                if primary[i] == e:
                    for a in range(3):
                        feet[i, a] = p[a]
            _move(axis[e], value[e] + (ratio[e] * q[row, joint[e]] if joint[e] >= 0 else 0.0), R, p)
            for i in range(where.shape[0]):
                if where[i] != 2 and primary[i] == e:
                    for a in range(3):
                        points[i, a] = p[a]
                        for b in range(3):
                            F = joint_frame[i]
                            frames[i, a, b] = R[a, 0] * F[0, b] + R[a, 1] * F[1, b] + R[a, 2] * F[2, b]
            for b in range(bodies):
                if body_element[b] == e:
                    _slopes_of(R, p, com[b], gravity, 1.0, 1.0, own[0], own[1], r)
                    _put_slopes(own, change, 4 * b, force, moment, each * b)
        for i in range(where.shape[0]):
            if where[i] == 1:
                k = _next_joint(primary, i)
                for a in range(3):
                    points[i, a] = p[a] if k < 0 else feet[k, a]
        if laden:
            for a in range(3):
                p[a] += R[a, 0] * tool[0, 3] + R[a, 1] * tool[1, 3] + R[a, 2] * tool[2, 3]
                for b in range(3):
                    turned[a, b] = R[a, 0] * tool[0, b] + R[a, 1] * tool[1, b] + R[a, 2] * tool[2, b]
            _slopes_of(turned, p, payload_com[row], gravity, carried[row], payload[row], own[0], own[1], r)
            _put_slopes(own, change, 4 * bodies, force, moment, each * bodies)
        for i in range(where.shape[0]):
            for m in range(parts.shape[1]):
                out[m, 0, row, i] = 0.0
            for c in range(count):
                column = 0 if summed else c
                if c // each < bodies and body_element[c // each] < first[i]:
                    for m in range(0 if summed else parts.shape[1]):
                        out[m, column, row, i] = 0.0
                    continue
                about[:] = 0.0
                _add_cross(points[i], force[c], about)
                for m in range(parts.shape[1]):
                    a = parts[i, m] % 3
                    total = out[m, 0, row, i] if summed else 0.0
                    for k in range(3):
                        total += frames[i, k, a] * (force[c, k] if parts[i, m] < 3 else moment[c, k] - about[k])
                    out[m, column, row, i] = total


@njit(cache=True)
def _slopes_of(R, p, com, gravity, mass, shift, force, moment, r):
    """Force (4, 3), and moment about the base origin, of ``mass`` at a place and of ``shift`` along each axis from it."""
    force[:] = 0.0
    moment[:] = 0.0
    for i in range(3):
        force[0, i] = mass * gravity[i]
        r[i] = mass * (p[i] + R[i, 0] * com[0] + R[i, 1] * com[1] + R[i, 2] * com[2])
    _add_cross(r, gravity, moment[0])
    for c in range(3):
        for i in range(3):
            r[i] = shift * R[i, c]
        _add_cross(r, gravity, moment[c + 1])


@njit(cache=True)
def _put_slopes(own, change, at, force, moment, to):
    """Put the four columns of a body, or what its part of ``change`` makes of them, in their place."""
    if change.shape[0] == 0:
        force[to : to + 4] = own[0]
        moment[to : to + 4] = own[1]
        return
    for i in range(3):
        force[to, i] = 0.0
        moment[to, i] = 0.0
        for c in range(4):
            force[to, i] += change[at + c] * own[0, c, i]
            moment[to, i] += change[at + c] * own[1, c, i]
