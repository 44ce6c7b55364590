"""Where the joints of a chain stand while its elements are walked along, compiled. ``primary (n,)`` are their elements."""

from __future__ import annotations

from kilter_core.arm.kernels.compiled import UNCOUNTED, compile_kernel
from kilter_core.arm.kernels.frames import exponential, right_multiply


@compile_kernel(**UNCOUNTED)
def next_joint(primary, i):
    """Joint whose element follows that of joint i, -1 for the last; mimic elements can make it another than i + 1."""
    found = -1
    for k in range(primary.shape[0]):
        if primary[k] > primary[i] and (found < 0 or primary[k] < primary[found]):
            found = k
    return found


@compile_kernel(**UNCOUNTED)
def mark_starts(primary, e, p, starts):
    """Keep in ``starts (n, 3)`` the point p before element e where that is the element of a joint."""
    for i in range(primary.shape[0]):
        if primary[i] == e:
            for a in range(3):
                starts[i, a] = p[a]


@compile_kernel(**UNCOUNTED)
def mark_frames(primary, joint_frame, e, R, p, frames, origins):
    """Keep origin and joint frame after element e where that is the element of a joint."""
    for i in range(primary.shape[0]):
        if primary[i] == e:
            F = joint_frame[i]
            for a in range(3):
                origins[i, a] = p[a]
                for b in range(3):
                    frames[i, a, b] = R[a, 0] * F[0, b] + R[a, 1] * F[1, b] + R[a, 2] * F[2, b]


@compile_kernel(**UNCOUNTED)
def add_twist(slot, row, e, xi, R, p, step_R, step_p, scratch):
    """Apply the twist behind element e of a row, if it has one, to the frame (R, p); ``slot (E,)`` says which of ``xi``."""
    s = slot[e]
    if s >= 0 and xi.shape[0] > 0:
        exponential(xi[row, s], step_R, step_p, scratch)
        right_multiply(R, p, step_R, step_p)
