"""The cheapest path of lags through time: nearly constant, with a price on every jump."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from kilter_files.ground.arrays import Floats

STEP_SHARE = 0.25  # of the price of a jump, for one step of the grid: clocks that drift apart take one now and then


@dataclass(frozen=True)
class Stretch:
    """Chunks ``first`` to ``last`` (both in it) have lag number ``lag``."""

    first: int
    last: int
    lag: int


def cheapest(cost: Floats, jump_price: float) -> NDArray[np.int64]:
    """Return the lag number of every chunk of ``cost`` (chunks, lags) along the cheapest path (Viterbi)."""
    step_price = STEP_SHARE * jump_price
    total = cost[0].astype(np.float64)
    came = np.zeros(cost.shape, dtype=np.int32)
    here = np.arange(cost.shape[1], dtype=np.int32)
    for k in range(1, len(cost)):
        low = int(np.argmin(total))
        best, source = total.copy(), here.copy()
        for shift in (-1, 1):
            near = np.full_like(total, np.inf)
            near[max(0, shift) : len(total) + min(0, shift)] = total[max(0, -shift) : len(total) - max(0, shift)]
            better = near + step_price < best
            best, source = np.where(better, near + step_price, best), np.where(better, here - shift, source)
        jumped = total[low] + jump_price < best
        best, source = np.where(jumped, total[low] + jump_price, best), np.where(jumped, low, source)
        came[k], total = source, best + cost[k]
    path = np.empty(len(cost), dtype=np.int64)
    path[-1] = int(np.argmin(total))
    for k in range(len(cost) - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path


def stretches(path: NDArray[np.int64], near: int, chunks: int) -> list[Stretch]:
    """Cut a path where it changes by more than ``near`` within ``chunks`` chunks; slow drift stays one stretch."""
    cuts, k = [0], 1
    while k < len(path):
        after = path[k : k + chunks]
        moved = np.abs(after - path[k - 1])
        if path[k] != path[k - 1] and moved.max(initial=0) > near:
            # the change is over where the path has come to where it goes
            far = k + int(np.argmax(moved))
            cuts.append(k + int(np.argmax(np.abs(np.diff(path[k - 1 : far + 1])))))
            k = far + 1
        else:
            k += 1
    edges = [*cuts, len(path)]
    return [Stretch(a, b - 1, int(np.median(path[a:b]))) for a, b in pairwise(edges) if b > a]
