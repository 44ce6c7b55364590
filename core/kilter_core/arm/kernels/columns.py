"""The chain rule of effects, row by row: what local corrections move of the tool, compiled."""

from __future__ import annotations

from kilter_core.arm.kernels.compiled import compile_kernel


@compile_kernel()
def put_turn(out, column, JQ, joint, dq):
    """Add to ``out[:, :, column]`` what ``dq (N,)`` of a joint moves by ``JQ (N, m, n)``."""
    for row in range(out.shape[0]):
        for i in range(JQ.shape[1]):
            out[row, i, column] += JQ[row, i, joint] * dq[row]


@compile_kernel()
def put_twist(out, column, JX, slot, frame, xi):
    """The same of twists ``xi (N, 6)``, rotated by ``frame (3, 3)``, at a slot of ``JX (N, m, 6 S)``."""
    for row in range(out.shape[0]):
        for half in range(2):
            for a in range(3):
                v = 0.0
                for b in range(3):
                    v += frame[a, b] * xi[row, 3 * half + b]
                if v == 0.0:
                    continue
                for i in range(JX.shape[1]):
                    out[row, i, column] += JX[row, i, 6 * slot + 3 * half + a] * v


@compile_kernel()
def put_loads(out, places, moved, load, errors):
    """Add ``moved (N, m)`` times row ``errors[k]`` of ``load (K, N)`` to each column ``places[k]`` of ``out (N, m, P)``."""
    for row in range(out.shape[0]):
        for k in range(places.shape[0]):
            by = load[errors[k], row]
            for i in range(moved.shape[1]):
                out[row, i, places[k]] += moved[row, i] * by
