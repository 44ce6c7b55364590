"""Where a version is less sure than it says: boxes of wanted joint values, compiled."""

from __future__ import annotations

from kilter_core.arm.kernels.compiled import EXACT, compile_kernel
from kilter_core.correct.kernels.layout import DOUBT_AT, DOUBTS, HIGHEST_OF_BOX, LOWEST_OF_BOX, UNSURE, WANTED


@compile_kernel(**EXACT)
def flag_doubts(P, W, S, n, m):
    """Return the flag UNSURE where the wanted joints are in a box of doubt, else 0."""
    first = int(P[S, DOUBT_AT])
    bounded = min(n, HIGHEST_OF_BOX - LOWEST_OF_BOX)
    for row in range(first, first + int(P[S, DOUBTS])):
        inside = 1
        for i in range(bounded):
            wanted = W[m + 1 + i, WANTED]
            if not P[row, LOWEST_OF_BOX + i] <= wanted <= P[row, HIGHEST_OF_BOX + i]:
                inside = 0
        if inside != 0:
            return UNSURE
    return 0
