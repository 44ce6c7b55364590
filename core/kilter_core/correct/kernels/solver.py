"""The linear system of a step, compiled: J J' of six task rows, its factor, and its solution.

All six rows always, written out: rows that the task does not hold have no Jacobian and a one on the diagonal.

The correction that a step asks for, within its limits, compiled: the tool point first, its orientation second.

The multipliers y of the task rows stand for the correction J' y. What of it the tool point needs is the least one that
holds the point, J_p' y_p; the rest rotates the tool while the point stands still. Where both together ask too much of a
joint the rest is cut, and where the point alone does, the point is given up: near a singular posture only along the
direction that the posture makes weak, elsewhere as a whole. All of it is continuous in error and posture.
"""

from __future__ import annotations

import math

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel
from kilter_core.correct.kernels.layout import (
    ADDED,
    COLUMN,
    COMMAND,
    DAMPED,
    ERROR,
    FARTHEST,
    FIRST,
    LARGEST,
    LEVERAGE,
    MATRIX,
    MULTIPLIER,
    RIGHT,
    SATURATED,
    SINGULAR,
    WANTED,
    WEAK,
)

# No pivot is taken for smaller than this.
TINY = 1e-12


@compile_kernel(**EXACT)
def normal_matrix(W, n, oj, og, rows):
    """J J' into the lower half of the task rows, and what the present correction adds to the residual.

    All six rows always, written out: rows the task does not hold have no Jacobian and get a one on the diagonal.
    """
    a00 = a10 = a11 = a20 = a21 = a22 = a30 = a31 = a32 = a33 = 0.0
    a40 = a41 = a42 = a43 = a44 = a50 = a51 = a52 = a53 = a54 = a55 = 0.0
    g0 = g1 = g2 = g3 = g4 = g5 = 0.0
    for j in range(oj, oj + n):
        g = W[j, COMMAND] - W[j, WANTED]
        c0, c1, c2 = W[j, COLUMN], W[j, COLUMN + 1], W[j, COLUMN + 2]
        c3, c4, c5 = W[j, COLUMN + 3], W[j, COLUMN + 4], W[j, COLUMN + 5]
        a00, a10, a11 = a00 + c0 * c0, a10 + c1 * c0, a11 + c1 * c1
        a20, a21, a22 = a20 + c2 * c0, a21 + c2 * c1, a22 + c2 * c2
        a30, a31, a32, a33 = a30 + c3 * c0, a31 + c3 * c1, a32 + c3 * c2, a33 + c3 * c3
        a40, a41, a42, a43, a44 = a40 + c4 * c0, a41 + c4 * c1, a42 + c4 * c2, a43 + c4 * c3, a44 + c4 * c4
        a50, a51, a52, a53, a54 = a50 + c5 * c0, a51 + c5 * c1, a52 + c5 * c2, a53 + c5 * c3, a54 + c5 * c4
        a55 += c5 * c5
        g0, g1, g2, g3, g4, g5 = g0 + c0 * g, g1 + c1 * g, g2 + c2 * g, g3 + c3 * g, g4 + c4 * g, g5 + c5 * g
    t = MATRIX
    W[og, t] = a00
    W[og + 1, t], W[og + 1, t + 1] = a10, a11
    W[og + 2, t], W[og + 2, t + 1], W[og + 2, t + 2] = a20, a21, a22
    W[og + 3, t], W[og + 3, t + 1], W[og + 3, t + 2], W[og + 3, t + 3] = a30, a31, a32, a33
    W[og + 4, t], W[og + 4, t + 1], W[og + 4, t + 2], W[og + 4, t + 3], W[og + 4, t + 4] = a40, a41, a42, a43, a44
    W[og + 5, t], W[og + 5, t + 1], W[og + 5, t + 2], W[og + 5, t + 3] = a50, a51, a52, a53
    W[og + 5, t + 4], W[og + 5, t + 5] = a54, a55
    for r, g in enumerate((g0, g1, g2, g3, g4, g5)):
        W[og + r, ADDED] = g
    for r in range(rows, 6):
        W[og + r, t + r] = 1.0


@compile_kernel(**EXACT)
def factor(W, og):
    """LDL' of J J' into the task rows, 1 / d on the diagonal; returns the smallest pivot, 0 when there is none."""
    t = MATRIX
    d0 = W[og, t]
    i0 = 1.0 / d0
    u10, u20, u30, u40, u50 = W[og + 1, t], W[og + 2, t], W[og + 3, t], W[og + 4, t], W[og + 5, t]
    l10, l20, l30, l40, l50 = u10 * i0, u20 * i0, u30 * i0, u40 * i0, u50 * i0
    d1 = W[og + 1, t + 1] - l10 * u10
    i1 = 1.0 / d1
    u21, u31 = W[og + 2, t + 1] - l10 * u20, W[og + 3, t + 1] - l10 * u30
    u41, u51 = W[og + 4, t + 1] - l10 * u40, W[og + 5, t + 1] - l10 * u50
    l21, l31, l41, l51 = u21 * i1, u31 * i1, u41 * i1, u51 * i1
    d2 = W[og + 2, t + 2] - l20 * u20 - l21 * u21
    i2 = 1.0 / d2
    u32 = W[og + 3, t + 2] - l20 * u30 - l21 * u31
    u42 = W[og + 4, t + 2] - l20 * u40 - l21 * u41
    u52 = W[og + 5, t + 2] - l20 * u50 - l21 * u51
    l32, l42, l52 = u32 * i2, u42 * i2, u52 * i2
    d3 = W[og + 3, t + 3] - l30 * u30 - l31 * u31 - l32 * u32
    i3 = 1.0 / d3
    u43 = W[og + 4, t + 3] - l30 * u40 - l31 * u41 - l32 * u42
    u53 = W[og + 5, t + 3] - l30 * u50 - l31 * u51 - l32 * u52
    l43, l53 = u43 * i3, u53 * i3
    d4 = W[og + 4, t + 4] - l40 * u40 - l41 * u41 - l42 * u42 - l43 * u43
    i4 = 1.0 / d4
    u54 = W[og + 5, t + 4] - l40 * u50 - l41 * u51 - l42 * u52 - l43 * u53
    l54 = u54 * i4
    d5 = W[og + 5, t + 5] - l50 * u50 - l51 * u51 - l52 * u52 - l53 * u53 - l54 * u54
    smallest = min(min(min(d0, d1), min(d2, d3)), min(d4, d5))
    if not smallest > TINY:
        return 0.0
    W[og, 0] = i0
    W[og + 1, 0], W[og + 1, 1] = l10, i1
    W[og + 2, 0], W[og + 2, 1], W[og + 2, 2] = l20, l21, i2
    W[og + 3, 0], W[og + 3, 1], W[og + 3, 2], W[og + 3, 3] = l30, l31, l32, i3
    W[og + 4, 0], W[og + 4, 1], W[og + 4, 2], W[og + 4, 3], W[og + 4, 4] = l40, l41, l42, l43, i4
    W[og + 5, 0], W[og + 5, 1], W[og + 5, 2], W[og + 5, 3], W[og + 5, 4] = l50, l51, l52, l53, l54
    W[og + 5, 5] = 1.0 / d5
    return smallest


@compile_kernel(**EXACT)
def expand(W, n, oj, og, rows):
    """What the present correction adds to the residual: J times it."""
    for r in range(6):
        W[og + r, ADDED] = 0.0
    for j in range(oj, oj + n):
        g = W[j, COMMAND] - W[j, WANTED]
        for r in range(rows):
            W[og + r, ADDED] += W[j, COLUMN + r] * g


@compile_kernel(**EXACT)
def damp(W, og, first, last, amount):
    """Add ``amount`` to the diagonal of J J' in the rows from ``first`` to before ``last``."""
    for r in range(first, last):
        W[og + r, MATRIX + r] += amount


@compile_kernel(**EXACT)
def leverage(W, og):
    """How far, squared, a radian of the joints rotates the tool in its weakest direction while the point stands still.

    It is 1 / trace(S⁻¹) of the Schur complement S of the position rows, from the factor: the square of the smallest
    singular value where that is far smaller than the others, else up to three times less.
    """
    a, b, c = W[og + 4, 3], W[og + 5, 3], W[og + 5, 4]
    e = a * c - b
    return 1.0 / (W[og + 3, 3] + W[og + 4, 4] * (a * a + 1.0) + W[og + 5, 5] * (e * e + c * c + 1.0))


@compile_kernel(**EXACT)
def solve_factored(W, og):
    """Multipliers of the right-hand side by the factor."""
    a, b, c, d = og, og + 1, og + 2, og + 3
    e, f = og + 4, og + 5
    y0 = W[a, RIGHT]
    y1 = W[b, RIGHT] - W[b, 0] * y0
    y2 = W[c, RIGHT] - W[c, 0] * y0 - W[c, 1] * y1
    y3 = W[d, RIGHT] - W[d, 0] * y0 - W[d, 1] * y1 - W[d, 2] * y2
    y4 = W[e, RIGHT] - W[e, 0] * y0 - W[e, 1] * y1 - W[e, 2] * y2 - W[e, 3] * y3
    y5 = W[f, RIGHT] - W[f, 0] * y0 - W[f, 1] * y1 - W[f, 2] * y2 - W[f, 3] * y3 - W[f, 4] * y4
    y5 = y5 * W[f, 5]
    y4 = y4 * W[e, 4] - W[f, 4] * y5
    y3 = y3 * W[d, 3] - W[e, 3] * y4 - W[f, 3] * y5
    y2 = y2 * W[c, 2] - W[d, 2] * y3 - W[e, 2] * y4 - W[f, 2] * y5
    y1 = y1 * W[b, 1] - W[c, 1] * y2 - W[d, 1] * y3 - W[e, 1] * y4 - W[f, 1] * y5
    y0 = y0 * W[a, 0] - W[b, 0] * y1 - W[c, 0] * y2 - W[d, 0] * y3 - W[e, 0] * y4 - W[f, 0] * y5
    for r, y in enumerate((y0, y1, y2, y3, y4, y5)):
        W[og + r, MULTIPLIER] = y


@compile_kernel(**EXACT)
def solve_point(W, og, e0, e1, e2, floor):
    """Multipliers (3,) of the position rows alone, of J J' in the task rows plus ``floor`` on its diagonal."""
    t = MATRIX
    i0 = 1.0 / (W[og, t] + floor)
    u10, u20 = W[og + 1, t], W[og + 2, t]
    l10, l20 = u10 * i0, u20 * i0
    i1 = 1.0 / max(W[og + 1, t + 1] + floor - l10 * u10, TINY)
    u21 = W[og + 2, t + 1] - l20 * u10
    l21 = u21 * i1
    i2 = 1.0 / max(W[og + 2, t + 2] + floor - l20 * u20 - l21 * u21, TINY)
    y1 = e1 - l10 * e0
    y2 = (e2 - l20 * e0 - l21 * y1) * i2
    y1 = y1 * i1 - l21 * y2
    return e0 * i0 - l10 * y1 - l20 * y2, y1, y2


@compile_kernel(**EXACT)
def joint_step(W, j, og):
    """Correction of joint row j that the multipliers ask for."""
    return (
        W[j, COLUMN] * W[og, MULTIPLIER]
        + W[j, COLUMN + 1] * W[og + 1, MULTIPLIER]
        + W[j, COLUMN + 2] * W[og + 2, MULTIPLIER]
        + W[j, COLUMN + 3] * W[og + 3, MULTIPLIER]
        + W[j, COLUMN + 4] * W[og + 4, MULTIPLIER]
        + W[j, COLUMN + 5] * W[og + 5, MULTIPLIER]
    )


@compile_kernel(**EXACT)
def factor_task(P, W, S, n, og, rows):
    """Factor J J' with what damps the orientation: nothing unless the posture makes a rotation of the tool weak.

    ``d² = ¼ (h₀ - h)² / h₀`` below the leverage h₀ is smooth in the posture, and no rotation asks the joints for more
    than 1.3 / sqrt(h₀) times its size. Fewer than six joints cannot rotate the tool at will: then h is 0.
    """
    first = int(P[S, FIRST])
    if first == rows:
        if factor(W, og) <= 0.0:
            damp(W, og, 0, rows, P[S, SINGULAR])
            factor(W, og)
        return
    least = P[S, LEVERAGE]
    h = 0.0
    if n >= 6 and factor(W, og) > 0.0:
        h = leverage(W, og)
        if h >= least:
            return
    damp(W, og, first, rows, 0.25 * (least - h) * (least - h) / least)
    if factor(W, og) <= 0.0:
        damp(W, og, 0, first, P[S, SINGULAR])
        factor(W, og)


@compile_kernel(**EXACT)
def aim(P, W, S, n, oj, og, rows):
    """Multipliers of the correction, within its limits; returns the flags."""
    flags = 0
    for r in range(6):
        W[og + r, RIGHT] = W[og + r, ERROR] + W[og + r, ADDED]
    far = math.sqrt(W[og, RIGHT] ** 2 + W[og + 1, RIGHT] ** 2 + W[og + 2, RIGHT] ** 2)
    if far > P[S, FARTHEST]:
        flags = SATURATED
        for r in range(3):
            W[og + r, RIGHT] *= P[S, FARTHEST] / far
    solve_factored(W, og)
    least, square = math.inf, 0.0
    for j in range(oj, oj + n):
        least = min(least, P[j, LARGEST])
        square += joint_step(W, j, og) ** 2
    # Point and rotation move the joints at right angles, so half the square leaves room for both.
    if 2.0 * square <= least * least:
        return flags
    if int(P[S, FIRST]) == rows:
        return flags | _within_whole(P, W, S, n, oj, og, rows)
    return flags | _within_point_first(P, W, S, n, oj, og)


@compile_kernel(**EXACT)
def _correction_size(P, W, n, oj, og):
    """Length of the correction of the multipliers, and its largest part of a limit."""
    square, part = 0.0, 0.0
    for j in range(oj, oj + n):
        step = joint_step(W, j, og)
        square += step * step
        part = max(part, abs(step) / P[j, LARGEST])
    return math.sqrt(square), part


@compile_kernel(**EXACT)
def _weak(P, S, error, length, part):
    """Damping (m/rad)² of a task that asks more of the joints than their limit: 0 unless the posture makes it weak.

    ``error / length`` is what a radian moves the task (m). The answer keeps to about the limit and fades out at the
    singular posture itself (after Maciejewski and Klein 1988), where its sign would change.
    """
    if length == 0.0:
        return 0.0
    gain = error / length
    bound = min(math.sqrt(P[S, WEAK]), gain * part)
    return 0.25 * max(0.0, bound * bound - gain * gain)


@compile_kernel(**EXACT)
def _scale(W, og, rows, part):
    for r in range(rows):
        W[og + r, MULTIPLIER] /= part


@compile_kernel(**EXACT)
def _within_whole(P, W, S, n, oj, og, rows):
    """All rows are one task: damped where the posture makes it weak, else scaled down to the limit."""
    length, part = _correction_size(P, W, n, oj, og)
    if part <= 1.0:
        return 0
    error = 0.0
    for r in range(rows):
        error += W[og + r, RIGHT] ** 2
    amount = _weak(P, S, math.sqrt(error), length, part)
    if amount > 0.0:
        damp(W, og, 0, rows, amount)
        factor(W, og)
        solve_factored(W, og)
        length, part = _correction_size(P, W, n, oj, og)
        damp(W, og, 0, rows, -amount)
        factor(W, og)
    if part > 1.0:
        _scale(W, og, rows, part)
    return DAMPED if amount > 0.0 else SATURATED


@compile_kernel(**EXACT)
def _within_point_first(P, W, S, n, oj, og):
    """The point keeps what it needs, the rotation gets what is left; then the point is damped, then scaled down."""
    e0, e1, e2 = W[og, RIGHT], W[og + 1, RIGHT], W[og + 2, RIGHT]
    y0, y1, y2 = solve_point(W, og, e0, e1, e2, P[S, SINGULAR])
    square, part, rotation = 0.0, 0.0, 0.0
    for j in range(oj, oj + n):
        step = W[j, COLUMN] * y0 + W[j, COLUMN + 1] * y1 + W[j, COLUMN + 2] * y2
        square += step * step
        part = max(part, abs(step) / P[j, LARGEST])
        rotation = max(rotation, abs(joint_step(W, j, og) - step) / P[j, LARGEST])
    if part <= 1.0:
        if part + rotation <= 1.0:
            return 0
        share = (1.0 - part) / rotation
        for r, y in enumerate((y0, y1, y2)):
            W[og + r, MULTIPLIER] = y + share * (W[og + r, MULTIPLIER] - y)
        for r in range(3, 6):
            W[og + r, MULTIPLIER] *= share
        return DAMPED
    amount = _weak(P, S, math.sqrt(e0 * e0 + e1 * e1 + e2 * e2), math.sqrt(square), part)
    if amount > 0.0:
        y0, y1, y2 = solve_point(W, og, e0, e1, e2, amount)
    W[og, MULTIPLIER], W[og + 1, MULTIPLIER], W[og + 2, MULTIPLIER] = y0, y1, y2
    for r in range(3, 6):
        W[og + r, MULTIPLIER] = 0.0
    _, part = _correction_size(P, W, n, oj, og)
    if part > 1.0:
        _scale(W, og, 3, part)
    return DAMPED if amount > 0.0 else SATURATED
