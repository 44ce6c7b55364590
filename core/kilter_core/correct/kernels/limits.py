"""The correction that a step asks for, within its limits, compiled: the tool point first, its orientation second.

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
    DAMPED,
    ERROR,
    FARTHEST,
    FIRST,
    LARGEST,
    LEVERAGE,
    MULTIPLIER,
    RIGHT,
    SATURATED,
    SINGULAR,
    WEAK,
)
from kilter_core.correct.kernels.solver import (
    damp,
    factor,
    joint_step,
    leverage,
    solve_factored,
    solve_point,
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
