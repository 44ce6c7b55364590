"""What the effects add to every joint at the loads, signs and angles of now, compiled."""

from __future__ import annotations

import math

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel
from kilter_core.arm.kernels.se3 import cross, sine_cosine, sine_cosine_octant
from kilter_core.correct.kernels.layout import (
    AMPLITUDE_A,
    AMPLITUDE_B,
    BENDING,
    BENDING_JOINT,
    BENDING_LINK,
    BENDINGS,
    COMMAND,
    COMPLIANCE,
    CURVED,
    CURVES,
    DQ,
    DRIVER,
    END,
    EXTRA,
    FACTOR,
    FADE,
    FROM,
    HARDENING,
    HIGHEST,
    KEPT,
    LAG,
    LAST_A,
    LAST_B,
    LAST_SIDE,
    LINEAR,
    MEAN,
    MOMENT,
    MOVED,
    NEAR_REVERSAL,
    OF_AXIS,
    PLAY,
    PLAY_OWN,
    PLAY_SOFT,
    POLYNOMIAL,
    POWER,
    POWERS,
    RADIAL,
    RATE,
    REVERSAL,
    REVERSING,
    ROOT,
    ROOTED,
    SHAPE,
    SHIFT,
    SIDE,
    SIDED,
    SIGN,
    SINES,
    SPEED_NOW,
    TILT,
    TILT_A,
    TILT_B,
    TILT_OWN,
    TILT_SHARE,
    TILT_SOFT,
    TO,
    TWIST,
    WAVE,
    WAY,
    XI,
)

# Below this moment a sign would be that of rounding noise.
NO_MOMENT = 1e-9
# Beyond this many half-widths a soft sign is one within 1e-3, and a difference that counts (rad): a third of a micrometre at
# a metre. What is said to be left is then evaluated once more.
SOFT, COUNTS = 3.8, 3e-7


@compile_kernel(**EXACT)
def _soft_sign(x, width):
    """sign(x), or tanh(x / width): beyond 19.1 widths the two are the same number."""
    size = abs(x)
    if size >= 19.1 * width:
        return math.copysign(1.0, x) if x != 0.0 else 0.0
    return math.copysign(1.0 - 2.0 / (math.exp(2.0 * size / width) + 1.0), x)


@compile_kernel(**EXACT)
def _soft_saturation(a):
    """a / sqrt(1 + a²); the series is exact up to a degree."""
    z = a * a
    if z < 4e-4:
        return a * (1.0 - z * (0.5 - z * (0.375 - z * (0.3125 - z * 0.2734375))))
    return a / math.sqrt(1.0 + z)


@compile_kernel(**EXACT)
def _clearance_tilt(P, j, x, y, soft):
    """Tilt of a joint in its clearance (thesis eq. 5.16-5.18) towards the transverse load (x, y)."""
    t = P[j, TILT]
    ax, ay = abs(x), abs(y)
    total = ax + ay
    if t == 0.0 or total <= NO_MOMENT:
        return 0.0, 0.0
    if P[j, TILT_SHARE] == 0.0:
        if ax < ay:
            s, c = sine_cosine_octant(ax / total * (0.5 * math.pi))
        else:
            c, s = sine_cosine_octant(ay / total * (0.5 * math.pi))
    else:
        h = 1.0 / math.sqrt(x * x + y * y)
        s, c = ax * h, ay * h
    return _soft_saturation(t * s * _soft_sign(x, soft)), _soft_saturation(t * c * _soft_sign(y, soft))


@compile_kernel(**EXACT)
def _rate_limited(last, target, reach):
    """``target``, or as far towards it from ``last`` as ``reach`` allows."""
    change = target - last
    if abs(change) <= reach:
        return target
    return last + math.copysign(reach, change)


@compile_kernel(**EXACT)
def _signs(P, W, j, tilt_soft, play_soft):
    """Tilt about x and y of a joint and the side of its backlash, at the loads and the direction of now."""
    a, b = _clearance_tilt(P, j, W[j, MOMENT], W[j, MOMENT + 1], tilt_soft)
    about = W[j, MOMENT + 2]
    side = (0.5 * P[j, REVERSAL] + P[j, SIDED] * about) * W[j, SIGN]
    if P[j, PLAY] != 0.0 and abs(about) > NO_MOMENT:
        side += P[j, PLAY] * _soft_sign(about, play_soft)
    return a, b, side


@compile_kernel(**EXACT)
def _is_sign_softened(P, W, j, a, b, side):
    """Whether a sign of a joint is softer now than the version has it, by as much as counts."""
    soft, about = P[j, TILT_SOFT], abs(W[j, MOMENT + 2])
    near = P[j, TILT] != 0.0 and min(abs(W[j, MOMENT]), abs(W[j, MOMENT + 1])) < SOFT * soft and soft > P[j, TILT_OWN]
    if not near:
        soft = P[j, PLAY_SOFT]
        near = P[j, PLAY] != 0.0 and about < SOFT * soft and soft > P[j, PLAY_OWN]
    if not near:
        return False
    own_a, own_b, own_side = _signs(P, W, j, P[j, TILT_OWN], P[j, PLAY_OWN])
    return max(max(abs(own_a - a), abs(own_b - b)), abs(own_side - side)) > COUNTS


@compile_kernel(**EXACT)
def sign_effects(P, W, state, n, oj, dt):
    """Effects with a sign: tilt and backlash of every joint, held to its rate from the last answer; flags of that."""
    flags = 0
    for i in range(n):
        j = oj + i
        a, b, side = _signs(P, W, j, P[j, TILT_SOFT], P[j, PLAY_SOFT])
        if _is_sign_softened(P, W, j, a, b, side):
            flags |= NEAR_REVERSAL
        if dt < math.inf:
            reach = P[j, RATE] * dt
            W[j, TILT_A] = _rate_limited(state[i, LAST_A], a, reach)
            W[j, TILT_B] = _rate_limited(state[i, LAST_B], b, reach)
            W[j, SIDE] = _rate_limited(state[i, LAST_SIDE], side, reach)
            if W[j, TILT_A] != a or W[j, TILT_B] != b or W[j, SIDE] != side:
                flags |= REVERSING
        else:
            W[j, TILT_A], W[j, TILT_B], W[j, SIDE] = a, b, side
    return flags


@compile_kernel(**EXACT)
def own_signs(P, W, n, oj):
    """Tilts and sides as the version has them at the loads of now, neither softened nor held; the others are kept."""
    for j in range(oj, oj + n):
        W[j, KEPT], W[j, KEPT + 1], W[j, KEPT + 2] = W[j, TILT_A], W[j, TILT_B], W[j, SIDE]
        W[j, TILT_A], W[j, TILT_B], W[j, SIDE] = _signs(P, W, j, P[j, TILT_OWN], P[j, PLAY_OWN])


@compile_kernel(**EXACT)
def kept_signs(W, n, oj):
    """Tilts and sides as they were before :func:`own_signs`."""
    for j in range(oj, oj + n):
        W[j, TILT_A], W[j, TILT_B], W[j, SIDE] = W[j, KEPT], W[j, KEPT + 1], W[j, KEPT + 2]


@compile_kernel(**EXACT)
def _curve(P, W, row, oj):
    """What a curve says at the command."""
    shape = P[row, SHAPE]
    d = oj + int(P[row, DRIVER])
    q = W[d, COMMAND]
    if P[row, FADE] > 0.0:
        q = min(max(q, P[row, FROM]), P[row, TO])
    if shape == WAVE:
        s, c = sine_cosine(P[row, FACTOR] * q)
        return P[row, AMPLITUDE_A] * s + P[row, AMPLITUDE_B] * c
    if shape == LINEAR:
        return P[row, AMPLITUDE_A] * q
    if shape == LAG:
        return -P[row, AMPLITUDE_A] * W[d, SPEED_NOW]
    if shape == SINES:
        return P[row, AMPLITUDE_A] * math.sin(q) * math.sin(W[oj + int(P[row, CURVED]), COMMAND])
    if shape == POLYNOMIAL:
        u, total = min(1.0, max(-1.0, (q - P[row, EXTRA]) / P[row, EXTRA + 1])), 0.0
        for k in range(HIGHEST - POWERS + 1):
            total = total * u + P[row, HIGHEST - k]
        return total
    a, b = P[row, EXTRA], P[row, EXTRA + 1]
    s, c = sine_cosine(q + P[row, EXTRA + 2])
    length = math.sqrt(a * a + b * b - 2.0 * a * b * c)
    return -P[row, AMPLITUDE_A] * s * (1.0 - P[row, EXTRA + 3] / length)


@compile_kernel(**EXACT)
def _joint_curves(P, W, n, m, oj):
    """Add what the curves of the joints say at the command, to it or to the twist behind it."""
    first = m + 1 + n
    for row in range(first, first + int(P[P.shape[0] - 1, CURVES])):
        j = oj + int(P[row, CURVED])
        moved = int(P[row, MOVED])
        at = SHIFT if moved == 0 else TWIST + moved - 1
        value = _curve(P, W, row, oj)
        if P[row, FADE] > 0.0:
            q = W[oj + int(P[row, DRIVER]), COMMAND]
            beyond = min(max(max(P[row, FROM] - q, q - P[row, TO]), 0.0) / P[row, FADE], 1.0)
            value -= beyond * beyond * (3.0 - 2.0 * beyond) * (value - P[row, MEAN])
        W[j, at] += value


@compile_kernel(**EXACT)
def _reach(P, W, row, j):
    """Power of the length that stands out at joint row j; 1 where a bending row has none."""
    length = max(0.0, P[row, WAY] * (W[j, COMMAND] - P[row, ROOTED]))
    out = 1.0
    for _ in range(int(P[row, POWER])):
        out *= length
    return out


@compile_kernel(**EXACT)
def _bending_rows(P, W, n, m, oj):
    """Add the twists of the bending rows: linear in the loads on a joint and on the end of its link."""
    S = P.shape[0] - 1
    first = m + 1 + n + int(P[S, CURVES])
    for b in range(int(P[S, BENDINGS])):
        row = first + 2 * b
        j = oj + int(P[row, BENDING_JOINT])
        l0, l1, l2 = P[row, BENDING_LINK], P[row, BENDING_LINK + 1], P[row, BENDING_LINK + 2]
        f = (W[j, END], W[j, END + 1], W[j, END + 2])
        t0, t1, t2 = cross(l0, l1, l2, f[0], f[1], f[2])
        t = (W[j, END + 3] - t0, W[j, END + 4] - t1, W[j, END + 5] - t2)
        reach = _reach(P, W, row, j)
        for r in range(6):
            total = 0.0
            for c in range(6):
                total += P[row, BENDING + 6 * r + c] * W[j, ROOT + c]
            for c in range(3):
                total += P[row + 1, BENDING + 6 * r + c] * f[c] + P[row + 1, BENDING + 6 * r + 3 + c] * t[c]
            at = SHIFT if r + 1 == int(P[row, OF_AXIS]) else TWIST + r
            W[j, at] += reach * total


@compile_kernel(**EXACT)
def deflections(P, W, n, m, oj, sided):
    """What every joint adds to its command, and the twist behind it, at the loads and signs now in W.

    Not ``sided``: with every backlash and clearance in its middle.
    """
    for i in range(n):
        j = oj + i
        about = W[j, MOMENT + 2]
        side = W[j, SIDE] if sided else 0.0
        a = W[j, TILT_A] if sided else 0.0
        b = W[j, TILT_B] if sided else 0.0
        W[j, SHIFT] = P[j, DQ] + side + (P[j, COMPLIANCE] - P[j, HARDENING] * abs(about)) * about
        for k in range(6):
            W[j, TWIST + k] = P[j, XI + k]
        W[j, TWIST + 3] += a + P[j, RADIAL] * W[j, MOMENT]
        W[j, TWIST + 4] += b + P[j, RADIAL] * W[j, MOMENT + 1]
    S = P.shape[0] - 1
    if P[S, CURVES] != 0.0:
        _joint_curves(P, W, n, m, oj)
    if P[S, BENDINGS] != 0.0:
        _bending_rows(P, W, n, m, oj)
