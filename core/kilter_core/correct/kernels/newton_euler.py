"""Loads on the joints from gravity and motion, compiled, in the frames of the moves (thesis eq. 5.14)."""

from __future__ import annotations

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel
from kilter_core.arm.kernels.se3 import cross
from kilter_core.correct.kernels.layout import (
    ACCEL_NOW,
    BENDINGS,
    CARRIED,
    COM,
    END,
    GRAVITY,
    INERTIA,
    JOINT,
    KIND,
    LOAD,
    MASS,
    MOMENT,
    MOUNT,
    ON_BASE,
    PRIMARY,
    RATIO,
    ROOT,
    SPEED_NOW,
)


@compile_kernel(**EXACT)
def load_moments(P, W, S, m, oj, dynamic, ride):
    """Load moments at the frames now in W; bending rows and the base mount need whole wrenches, which the general pass has.

    The bodies ride on the frames from column ``ride`` on: 0, those of the joints, or ``BEHIND_TWIST``.
    """
    if dynamic or P[S, BENDINGS] != 0.0 or P[S, MOUNT] != 0.0:
        _dynamic_moments(P, W, S, m, oj, ride)
    else:
        _static_moments(P, W, S, m, oj, ride)


@compile_kernel(**EXACT)
def _static_moments(P, W, S, m, oj, ride):
    """Load moments in the joint frames from gravity alone: mass and first moment, from the tool inwards."""
    g0, g1, g2 = P[S, GRAVITY], P[S, GRAVITY + 1], P[S, GRAVITY + 2]
    mass = P[m, MASS]
    s0, s1, s2 = _point(W, m - 1, ride, P[m, COM], P[m, COM + 1], P[m, COM + 2])
    s0, s1, s2 = mass * s0, mass * s1, mass * s2
    for k in range(m - 1, -1, -1):
        body = P[k, MASS]
        if body != 0.0:
            c0, c1, c2 = _point(W, k, ride, P[k, COM], P[k, COM + 1], P[k, COM + 2])
            mass += body
            s0, s1, s2 = s0 + body * c0, s1 + body * c1, s2 + body * c2
        if P[k, PRIMARY] >= 0.0:
            r0, r1, r2 = s0 - mass * W[k, 9], s1 - mass * W[k, 10], s2 - mass * W[k, 11]
            t0, t1, t2 = cross(r0, r1, r2, g0, g1, g2)
            _to_joint(P, W, k, oj + int(P[k, JOINT]), t0, t1, t2, mass * g0, mass * g1, mass * g2)
    if P[m, CARRIED] != 0.0:
        _static_linkages(P, W, S, m, oj, ride)


@compile_kernel(**EXACT)
def _static_linkages(P, W, S, m, oj, ride):
    """Add what works on the joints through linkages from gravity alone, see :func:`_static_moments`."""
    g0, g1, g2 = P[S, GRAVITY], P[S, GRAVITY + 1], P[S, GRAVITY + 2]
    mass = P[m, MASS]
    s0, s1, s2 = _point(W, m - 1, ride, P[m, COM], P[m, COM + 1], P[m, COM + 2])
    s0, s1, s2 = mass * s0, mass * s1, mass * s2
    for k in range(m - 1, -1, -1):
        body = P[k, MASS]
        if body != 0.0:
            c0, c1, c2 = _point(W, k, ride, P[k, COM], P[k, COM + 1], P[k, COM + 2])
            mass += body
            s0, s1, s2 = s0 + body * c0, s1 + body * c1, s2 + body * c2
        if P[k, CARRIED] != 0.0:
            r0, r1, r2 = s0 - mass * W[k, 9], s1 - mass * W[k, 10], s2 - mass * W[k, 11]
            t0, t1, t2 = cross(r0, r1, r2, g0, g1, g2)
            _through_linkage(P, W, k, oj + int(P[k, JOINT]), t0, t1, t2, mass * g0, mass * g1, mass * g2)


@compile_kernel(**EXACT)
def _through_linkage(P, W, k, j, x, y, z, f0, f1, f2):
    """Add what of a load on axis k, in base coordinates, works on joint row j through a linkage (virtual work)."""
    if P[k, KIND] == 0.0:
        W[j, MOMENT + 2] += P[k, CARRIED] * (W[k, 2] * x + W[k, 5] * y + W[k, 8] * z)
    else:
        W[j, MOMENT + 2] += P[k, CARRIED] * (W[k, 2] * f0 + W[k, 5] * f1 + W[k, 8] * f2)


@compile_kernel(**EXACT)
def _point(W, k, ride, x, y, z):
    """Base coordinates of a point of the frame of row k from column ride on."""
    return (
        W[k, ride] * x + W[k, ride + 1] * y + W[k, ride + 2] * z + W[k, ride + 9],
        W[k, ride + 3] * x + W[k, ride + 4] * y + W[k, ride + 5] * z + W[k, ride + 10],
        W[k, ride + 6] * x + W[k, ride + 7] * y + W[k, ride + 8] * z + W[k, ride + 11],
    )


@compile_kernel(**EXACT)
def _to_joint(P, W, k, j, x, y, z, f0, f1, f2):
    """Rotate a load in base coordinates into frame k and keep it for joint row j: two moments across, one along the axis.

    Along the axis a revolute joint feels a moment, a prismatic one a force.
    """
    W[j, MOMENT] = W[k, 0] * x + W[k, 3] * y + W[k, 6] * z
    W[j, MOMENT + 1] = W[k, 1] * x + W[k, 4] * y + W[k, 7] * z
    if P[k, KIND] == 0.0:
        W[j, MOMENT + 2] = W[k, 2] * x + W[k, 5] * y + W[k, 8] * z
    else:
        W[j, MOMENT + 2] = W[k, 2] * f0 + W[k, 5] * f1 + W[k, 8] * f2


@compile_kernel(**EXACT)
def _point_acceleration(w, dw, r0, r1, r2):
    """Acceleration of a point at r on a body that rotates with w and dw: dw x r + w x (w x r)."""
    a0, a1, a2 = cross(dw[0], dw[1], dw[2], r0, r1, r2)
    t0, t1, t2 = cross(w[0], w[1], w[2], r0, r1, r2)
    u0, u1, u2 = cross(w[0], w[1], w[2], t0, t1, t2)
    return a0 + u0, a1 + u1, a2 + u2


@compile_kernel(**EXACT)
def _inward(W, k, ride, x, y, z):
    """A vector in base coordinates rotated into the frame of row k from column ride on."""
    return (
        W[k, ride] * x + W[k, ride + 3] * y + W[k, ride + 6] * z,
        W[k, ride + 1] * x + W[k, ride + 4] * y + W[k, ride + 7] * z,
        W[k, ride + 2] * x + W[k, ride + 5] * y + W[k, ride + 8] * z,
    )


@compile_kernel(**EXACT)
def _body_load(P, row, w, dw, a):
    """Force and moment about the origin of its frame of the body in row ``row``, in the axes of that frame (d'Alembert).

    ``w``, ``dw`` and ``a`` (gravity minus acceleration of the origin) are in the same axes.
    """
    mass = P[row, MASS]
    c0, c1, c2 = P[row, COM], P[row, COM + 1], P[row, COM + 2]
    s0, s1, s2 = _point_acceleration(w, dw, c0, c1, c2)
    f0, f1, f2 = mass * (a[0] - s0), mass * (a[1] - s1), mass * (a[2] - s2)
    xx, yy, zz = P[row, INERTIA], P[row, INERTIA + 1], P[row, INERTIA + 2]
    xy, xz, yz = P[row, INERTIA + 3], P[row, INERTIA + 4], P[row, INERTIA + 5]
    h0, h1, h2 = (
        xx * w[0] + xy * w[1] + xz * w[2],
        xy * w[0] + yy * w[1] + yz * w[2],
        xz * w[0] + yz * w[1] + zz * w[2],
    )
    t0, t1, t2 = cross(w[0], w[1], w[2], h0, h1, h2)
    m0, m1, m2 = cross(c0, c1, c2, f0, f1, f2)
    m0 -= t0 + xx * dw[0] + xy * dw[1] + xz * dw[2]
    m1 -= t1 + xy * dw[0] + yy * dw[1] + yz * dw[2]
    m2 -= t2 + xz * dw[0] + yz * dw[1] + zz * dw[2]
    return f0, f1, f2, m0, m1, m2


@compile_kernel(**EXACT)
def _body_wrench(P, W, row, k, ride, w, dw, a):
    """Load of the body in row ``row`` that rides on the frame of row k, column ride, about the base origin and in its axes."""
    if P[row, MASS] == 0.0:
        for i in range(6):
            W[row, LOAD + i] = 0.0
        return
    x0, x1, x2, y0, y1, y2 = _body_load(P, row, w, dw, a)
    f0 = W[k, ride] * x0 + W[k, ride + 1] * x1 + W[k, ride + 2] * x2
    f1 = W[k, ride + 3] * x0 + W[k, ride + 4] * x1 + W[k, ride + 5] * x2
    f2 = W[k, ride + 6] * x0 + W[k, ride + 7] * x1 + W[k, ride + 8] * x2
    t0, t1, t2 = cross(W[k, ride + 9], W[k, ride + 10], W[k, ride + 11], f0, f1, f2)
    W[row, LOAD], W[row, LOAD + 1], W[row, LOAD + 2] = f0, f1, f2
    W[row, LOAD + 3] = t0 + W[k, ride] * y0 + W[k, ride + 1] * y1 + W[k, ride + 2] * y2
    W[row, LOAD + 4] = t1 + W[k, ride + 3] * y0 + W[k, ride + 4] * y1 + W[k, ride + 5] * y2
    W[row, LOAD + 5] = t2 + W[k, ride + 6] * y0 + W[k, ride + 7] * y1 + W[k, ride + 8] * y2


@compile_kernel(**EXACT)
def _moving_bodies(P, W, S, m, oj, ride):
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
        s0, s1, s2 = _point_acceleration(w, dw, W[k, 9] - p[0], W[k, 10] - p[1], W[k, 11] - p[2])
        acc = (acc[0] + s0, acc[1] + s1, acc[2] + s2)
        t0, t1, t2 = cross(w[0], w[1], w[2], z0, z1, z2)
        if P[k, KIND] == 0.0:
            dw = (dw[0] + rate * z0 + speed * t0, dw[1] + rate * z1 + speed * t1, dw[2] + rate * z2 + speed * t2)
            w = (w[0] + speed * z0, w[1] + speed * z1, w[2] + speed * z2)
        else:
            twice = 2.0 * speed
            acc = (acc[0] + twice * t0 + rate * z0, acc[1] + twice * t1 + rate * z1, acc[2] + twice * t2 + rate * z2)
        p = (W[k, ride + 9], W[k, ride + 10], W[k, ride + 11])
        if ride > 0:
            s0, s1, s2 = _point_acceleration(w, dw, p[0] - W[k, 9], p[1] - W[k, 10], p[2] - W[k, 11])
            acc = (acc[0] + s0, acc[1] + s1, acc[2] + s2)
        inside = _inward(W, k, ride, w[0], w[1], w[2])
        turning = _inward(W, k, ride, dw[0], dw[1], dw[2])
        falling = _inward(W, k, ride, g0 - acc[0], g1 - acc[1], g2 - acc[2])
        _body_wrench(P, W, k, k, ride, inside, turning, falling)
        if k == m - 1:
            _body_wrench(P, W, m, k, ride, inside, turning, falling)


@compile_kernel(**EXACT)
def _dynamic_moments(P, W, S, m, oj, ride):
    """Load moments in the joint frames from gravity and motion (thesis eq. 5.14, with the sign of the load)."""
    _moving_bodies(P, W, S, m, oj, ride)
    bending = P[S, BENDINGS] != 0.0
    f = (W[m, LOAD], W[m, LOAD + 1], W[m, LOAD + 2])
    t = (W[m, LOAD + 3], W[m, LOAD + 4], W[m, LOAD + 5])
    beyond, turned = f, t
    for k in range(m - 1, -1, -1):
        f = (f[0] + W[k, LOAD], f[1] + W[k, LOAD + 1], f[2] + W[k, LOAD + 2])
        t = (t[0] + W[k, LOAD + 3], t[1] + W[k, LOAD + 4], t[2] + W[k, LOAD + 5])
        if P[k, PRIMARY] >= 0.0:
            j = oj + int(P[k, JOINT])
            s0, s1, s2 = cross(W[k, 9], W[k, 10], W[k, 11], f[0], f[1], f[2])
            _to_joint(P, W, k, j, t[0] - s0, t[1] - s1, t[2] - s2, f[0], f[1], f[2])
            if bending:
                _keep_wrench(W, k, 0, j, ROOT, f, t)
                _keep_wrench(W, k, ride, j, END, beyond, turned)
                beyond, turned = f, t
    W[m, ON_BASE], W[m, ON_BASE + 1] = t[0], t[1]
    if P[m, CARRIED] != 0.0:
        _dynamic_linkages(P, W, m, oj)


@compile_kernel(**EXACT)
def _dynamic_linkages(P, W, m, oj):
    """Add what works on the joints through linkages, from the loads of the bodies in W."""
    f = (W[m, LOAD], W[m, LOAD + 1], W[m, LOAD + 2])
    t = (W[m, LOAD + 3], W[m, LOAD + 4], W[m, LOAD + 5])
    for k in range(m - 1, -1, -1):
        f = (f[0] + W[k, LOAD], f[1] + W[k, LOAD + 1], f[2] + W[k, LOAD + 2])
        t = (t[0] + W[k, LOAD + 3], t[1] + W[k, LOAD + 4], t[2] + W[k, LOAD + 5])
        if P[k, CARRIED] != 0.0:
            s0, s1, s2 = cross(W[k, 9], W[k, 10], W[k, 11], f[0], f[1], f[2])
            _through_linkage(P, W, k, oj + int(P[k, JOINT]), t[0] - s0, t[1] - s1, t[2] - s2, f[0], f[1], f[2])


@compile_kernel(**EXACT)
def _keep_wrench(W, k, ride, j, column, f, t):
    """A wrench about the base origin as one about and in the frame of row k from column ride on, for joint row j."""
    s0, s1, s2 = cross(W[k, ride + 9], W[k, ride + 10], W[k, ride + 11], f[0], f[1], f[2])
    force = _inward(W, k, ride, f[0], f[1], f[2])
    moment = _inward(W, k, ride, t[0] - s0, t[1] - s1, t[2] - s2)
    for i in range(3):
        W[j, column + i] = force[i]
        W[j, column + 3 + i] = moment[i]
