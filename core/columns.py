"""From local corrections at the joints to the motion of the tool: the chain rule of a model's effects."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from core.effects import BASE, TOOL, Derivative, Local

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ToolColumns:
    """Derivatives of N tool poses by the joints, ``JQ (N, 6, n)``, and by the twists behind them, ``JX (N, 6, 6 n + 12)``.

    ``frames (n, 3, 3)`` turn the frame after each joint's element into the joint frame.
    """

    frames: Floats
    JQ: Floats
    JX: Floats

    def put(self, out: Floats, column: int, d: Derivative) -> None:
        """Add what a derivative moves to a column of ``out (N, 6, K)``."""
        if d.dq is not None:
            out[:, :, column] += self.JQ[:, :, d.joint] * d.dq[:, None]
        if d.xi is not None:
            out[:, :, column] += self.twist(d.joint, d.xi)

    def twist(self, joint: int, xi: Floats) -> Floats:
        """Motion (N, 6) of the tool by a twist (N, 6) at a joint, :data:`BASE` or :data:`TOOL`."""
        n = self.JQ.shape[2]
        slot = {BASE: n, TOOL: n + 1}.get(joint, joint)
        if slot < n:
            xi = (xi.reshape(-1, 2, 3) @ self.frames[slot].T).reshape(-1, 6)
        return np.asarray(np.einsum("nij,nj->ni", self.JX[:, :, 6 * slot : 6 * slot + 6], xi))

    def by_loads(self, local: Local) -> Iterator[tuple[Floats, int | None]]:
        """Motion (N, 6) by the load of each joint (its number) and of the base (None), for slopes by the loads."""
        n = self.JQ.shape[2]
        if local.dq is not None:
            yield from ((self.JQ[:, :, j] * local.dq[:, [j]], j) for j in range(n) if np.any(local.dq[:, j]))
        if local.xi is not None:
            yield from ((self.twist(j, local.xi[:, j]), j) for j in range(n) if np.any(local.xi[:, j]))
        if local.base is not None:
            yield self.twist(BASE, local.base), None


@dataclass(frozen=True)
class Total:
    """Summed local corrections: ``dq (N, n)``, twists ``xi (N, n + 2, 6)`` (empty when none), position ``stretch (N, 1)``."""

    dq: Floats
    xi: Floats
    stretch: Floats | None
    parts: tuple[tuple[int, Local], ...]

    @staticmethod
    def of(parts: tuple[tuple[int, Local], ...], rows: int, frames: Floats) -> Total:
        """Sum the ``parts``, each with the place of its first value, over N ``rows``; ``frames`` as of ToolColumns."""
        n = len(frames)
        dq, stretch = np.zeros((rows, n)), None
        xi = np.zeros((0, n + 2, 6))
        for _, local in parts:
            dq = dq if local.dq is None else dq + local.dq
            if local.scale is not None:
                stretch = (1.0 if stretch is None else stretch) + local.scale[:, None]
            if local.xi is not None or local.base is not None or local.tool is not None:
                xi = xi if len(xi) else np.zeros((rows, n + 2, 6))
                xi[:, :n] += 0.0 if local.xi is None else _in_element_frames(local.xi, frames)
                xi[:, n] += 0.0 if local.base is None else local.base
                xi[:, n + 1] += 0.0 if local.tool is None else local.tool
        return Total(dq, xi, stretch, parts)


def _in_element_frames(xi: Floats, frames: Floats) -> Floats:
    """Turn twists (N, n, 6) from the joint frames into the frames after the joints' elements."""
    if np.array_equal(frames, np.broadcast_to(np.eye(3), frames.shape)):
        return xi
    split = xi.reshape(len(xi), len(frames), 2, 3)
    return np.asarray(np.einsum("jab,njkb->njka", frames, split).reshape(xi.shape))
