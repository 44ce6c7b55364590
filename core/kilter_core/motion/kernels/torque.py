"""The torques of one setpoint, compiled: rigid bodies outward and inward (Newton and Euler), then what each joint adds.

``P`` has a row for each element of the chain, one for each joint and one for gravity. A body has ten numbers: mass, first
moment, inertia about the origin of its frame. They may be those of no real body, since base parameters are sums.
``tools.c_corrector`` translates it to C.
"""

from __future__ import annotations

import math

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel

TORQUE_COLUMNS = 22
# rows of elements: whether it rotates, its axis and the two that follow, sine and cosine (or length) of a constant, joint (-1:
# none), ratio, zero; whether the drive carries the load on it; the body behind it
ROTATES, ALONG, SECOND, THIRD, SINE, COSINE, JOINT, RATIO, ZERO, CARRIES, BODY = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10
# rows of joints: amplitudes of the effects, whether anything is known of it, then what their columns are made of
OFFSET, COULOMB, VISCOUS, STRIBECK, ROOT, QUADRATIC, ONE_SIDED, LOADED, ROTOR, GAIN = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
RIPPLE, SPRING, BALANCE, CABLE, KNOWN, WIDTH, LOOSE, MIDDLE, ORDER = 10, 12, 13, 15, 17, 18, 19, 20, 21
# scratch: angular velocity, its rate, acceleration less gravity, sine and cosine (or length), force and moment of the body
SPIN, SPUN, FALL, MOVED, FORCE, MOMENT = 0, 3, 6, 9, 11, 14


@compile_kernel(**EXACT)
def feed_forward(P, W, m, n, x, out):
    """Torques ``out`` (n) of the setpoint ``x``: joints, speeds, accelerations; NaN at joints of which nothing is known.

    m elements; W has a row more than these.
    """
    for i in range(3):
        W[0, SPIN + i], W[0, SPUN + i], W[0, FALL + i] = 0.0, 0.0, -P[m + n, i]
    for k in range(m):
        _move_outward(P, W, k, n, x)
        _load_body(P, W, k)
    for i in range(n):
        out[i] = 0.0
    _add_inward(P, W, m, out)
    for i in range(n):
        load = out[i]
        out[i] = _joint_torque(P, m + i, x[i], x[n + i], x[2 * n + i], load) if P[m + i, KNOWN] != 0.0 else math.nan


@compile_kernel(**EXACT)
def _move_outward(P, W, k, n, x):
    """Motion of the frame behind element k from that before it, both in their own axes."""
    i, a, b = int(P[k, ALONG]), int(P[k, SECOND]), int(P[k, THIRD])
    j = int(P[k, JOINT])
    amount, speed, rate = 0.0, 0.0, 0.0
    if j >= 0:
        ratio = P[k, RATIO]
        amount, speed, rate = ratio * x[j] + P[k, ZERO], ratio * x[n + j], ratio * x[2 * n + j]
    if P[k, ROTATES] != 0.0:
        W[k, SPUN + a] += speed * W[k, SPIN + b]
        W[k, SPUN + b] -= speed * W[k, SPIN + a]
        W[k, SPIN + i] += speed
        W[k, SPUN + i] += rate
        W[k, MOVED] = math.sin(amount) if j >= 0 else P[k, SINE]
        W[k, MOVED + 1] = math.cos(amount) if j >= 0 else P[k, COSINE]
        s, c = W[k, MOVED], W[k, MOVED + 1]
        for at in range(SPIN, MOVED, 3):
            W[k + 1, at + i] = W[k, at + i]
            W[k + 1, at + a] = c * W[k, at + a] + s * W[k, at + b]
            W[k + 1, at + b] = c * W[k, at + b] - s * W[k, at + a]
        return
    d = amount if j >= 0 else P[k, SINE]
    W[k, MOVED] = d
    for column in range(SPIN, MOVED):
        W[k + 1, column] = W[k, column]
    w0, w1, w2 = W[k, SPIN + i], W[k, SPIN + a], W[k, SPIN + b]
    W[k + 1, FALL + i] += rate - d * (w1 * w1 + w2 * w2)
    W[k + 1, FALL + a] += d * (W[k, SPUN + b] + w0 * w1) + 2.0 * speed * w2
    W[k + 1, FALL + b] += d * (w0 * w2 - W[k, SPUN + a]) - 2.0 * speed * w1


@compile_kernel(**EXACT)
def _load_body(P, W, k):
    """Force and moment about the origin that move the body behind element k."""
    mass, s0, s1, s2 = P[k, BODY], P[k, BODY + 1], P[k, BODY + 2], P[k, BODY + 3]
    xx, xy, xz, yy, yz, zz = (
        P[k, BODY + 4],
        P[k, BODY + 5],
        P[k, BODY + 6],
        P[k, BODY + 7],
        P[k, BODY + 8],
        P[k, BODY + 9],
    )
    w0, w1, w2 = W[k + 1, SPIN], W[k + 1, SPIN + 1], W[k + 1, SPIN + 2]
    d0, d1, d2 = W[k + 1, SPUN], W[k + 1, SPUN + 1], W[k + 1, SPUN + 2]
    a0, a1, a2 = W[k + 1, FALL], W[k + 1, FALL + 1], W[k + 1, FALL + 2]
    u0, u1, u2 = w1 * s2 - w2 * s1, w2 * s0 - w0 * s2, w0 * s1 - w1 * s0
    W[k, FORCE] = mass * a0 + d1 * s2 - d2 * s1 + w1 * u2 - w2 * u1
    W[k, FORCE + 1] = mass * a1 + d2 * s0 - d0 * s2 + w2 * u0 - w0 * u2
    W[k, FORCE + 2] = mass * a2 + d0 * s1 - d1 * s0 + w0 * u1 - w1 * u0
    h0, h1, h2 = xx * w0 + xy * w1 + xz * w2, xy * w0 + yy * w1 + yz * w2, xz * w0 + yz * w1 + zz * w2
    W[k, MOMENT] = s1 * a2 - s2 * a1 + xx * d0 + xy * d1 + xz * d2 + w1 * h2 - w2 * h1
    W[k, MOMENT + 1] = s2 * a0 - s0 * a2 + xy * d0 + yy * d1 + yz * d2 + w2 * h0 - w0 * h2
    W[k, MOMENT + 2] = s0 * a1 - s1 * a0 + xz * d0 + yz * d1 + zz * d2 + w0 * h1 - w1 * h0


@compile_kernel(**EXACT)
def _add_inward(P, W, m, out):
    """Add the loads of the bodies from the last element inward, and what each drive carries of them to ``out``."""
    for k in range(m - 1, -1, -1):
        i, a, b = int(P[k, ALONG]), int(P[k, SECOND]), int(P[k, THIRD])
        rotates = P[k, ROTATES] != 0.0
        if P[k, CARRIES] != 0.0:
            out[int(P[k, JOINT])] += P[k, RATIO] * (W[k, MOMENT + i] if rotates else W[k, FORCE + i])
        if k == 0:
            return
        if rotates:
            s, c = W[k, MOVED], W[k, MOVED + 1]
            for at in range(FORCE, MOMENT + 1, 3):
                W[k - 1, at + i] += W[k, at + i]
                W[k - 1, at + a] += c * W[k, at + a] - s * W[k, at + b]
                W[k - 1, at + b] += s * W[k, at + a] + c * W[k, at + b]
        else:
            d = W[k, MOVED]
            for column in range(FORCE, MOMENT + 3):
                W[k - 1, column] += W[k, column]
            W[k - 1, MOMENT + a] -= d * W[k, FORCE + b]
            W[k - 1, MOMENT + b] += d * W[k, FORCE + a]


@compile_kernel(**EXACT)
def _joint_torque(P, row, q, qd, qdd, load):
    """Torque of a joint: the load of its bodies with friction and all else that was found of it."""
    sign, fast = math.tanh(qd / P[row, WIDTH]), abs(qd)
    away, slow = q - P[row, MIDDLE], qd / P[row, LOOSE]
    model = load + P[row, OFFSET] + P[row, COULOMB] * sign + P[row, VISCOUS] * qd
    out = model + P[row, GAIN] * model + P[row, ROTOR] * qdd
    out += sign * (P[row, STRIBECK] * math.exp(-slow * slow) + P[row, ROOT] * math.sqrt(fast))
    out += P[row, QUADRATIC] * qd * fast + P[row, ONE_SIDED] * fast + P[row, LOADED] * abs(load) * sign
    phase = P[row, ORDER] * q
    out += P[row, RIPPLE] * math.sin(phase) + P[row, RIPPLE + 1] * math.cos(phase)
    out += P[row, SPRING] * away + P[row, BALANCE] * math.sin(q) + P[row, BALANCE + 1] * math.cos(q)
    return out + (P[row, CABLE] + P[row, CABLE + 1] * away) * away * away
