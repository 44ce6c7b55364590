"""The axes of an arm as screws, and a frame on each of them, of which URDF and MATLAB's rigidBodyTree are made."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from kilter_core.arm.chain import Chain
from kilter_core.errors import RobotError
from kilter_core.transforms import align_z_axis, inverse, rotations_about
from kilter_core.types import Bools, Floats, Ints


@dataclass(frozen=True)
class JointFrames:
    """``origin (M, 4, 4)`` of each axis in the frame before, z along the axis, and ``end (4, 4)`` from the last to the tip."""

    origin: Floats
    end: Floats


def joint_frames(screws: Screws) -> JointFrames:
    """Frames on the axes at zero, as near as they can be to those before: the tip's first, so plain arms stay plain."""
    T, origins = np.eye(4), []
    for direction, point in zip(screws.direction, screws.point, strict=True):
        frame = np.eye(4)
        frame[:3, :3] = align_z_axis(T[:3, :3], direction)
        frame[:3, 3] = point
        origins.append(inverse(T) @ frame)
        T = frame
    return JointFrames(np.array(origins), inverse(T) @ screws.home)


@dataclass(frozen=True)
class Screws:
    """M moving axes at zero joints: T(q) = exp(S_1 r_1 q_j1) ... exp(S_M r_M q_jM) home.

    ``direction (M, 3)`` unit, ``point (M, 3)`` m on the axis, ``prismatic (M,)``, ``joint (M,)`` that drives it times
    ``ratio (M,)``, ``home (4, 4)``. Everything is in the base frame.
    """

    direction: Floats
    point: Floats
    prismatic: Bools
    joint: Ints
    ratio: Floats
    home: Floats

    def __len__(self) -> int:
        return len(self.joint)

    def compose_with_poses(self, before: Floats, after: Floats) -> Screws:
        """The arm ``before · T(q) · after`` for two poses (4, 4)."""
        R, p = before[:3, :3], before[:3, 3]
        return replace(
            self, direction=self.direction @ R.T, point=self.point @ R.T + p, home=before @ self.home @ after
        )

    def poses(self, q: Floats) -> Floats:
        """Poses (N, 4, 4) at joints ``q (N, n)``."""
        *_, moved = self.link_motions(q)
        return np.asarray(moved @ self.home)

    def link_motions(self, q: Floats) -> Iterator[Floats]:
        """Rigid motions (N, 4, 4) of the base and of the link behind each axis at joints ``q (N, n)``, from joints zero."""
        T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
        yield T
        for k in range(len(self)):
            T = T @ self._motion(k, q[:, self.joint[k]] * self.ratio[k])
            yield T

    def _motion(self, k: int, amount: Floats) -> Floats:
        """Rigid motions (N, 4, 4) by ``amount (N,)`` along or about axis k."""
        out = np.broadcast_to(np.eye(4), (len(amount), 4, 4)).copy()
        w = self.direction[k]
        if self.prismatic[k]:
            out[:, :3, 3] = amount[:, None] * w
            return out
        out[:, :3, :3] = rotations_about(w, amount)
        out[:, :3, 3] = self.point[k] - out[:, :3, :3] @ self.point[k]
        return out

    def one_axis_per_joint(self) -> Screws:
        """The same arm with ratios 1, axes reversed where a ratio is -1.

        Raises:
            RobotError: a joint drives more than one axis, or one with a ratio; the message names it.

        """
        for j in range(int(self.joint.max()) + 1):
            ratios = self.ratio[self.joint == j]
            if len(ratios) != 1 or abs(ratios[0]) != 1.0:
                raise RobotError(
                    f"Joint {j + 1} moves {len(ratios)} axes with ratios {ratios.tolist()}: this format knows one axis "
                    "per joint. Export JSON, or URDF for a joint that others follow.",
                    joint=j + 1,
                )
        if np.any(np.diff(self.joint) < 0):
            raise RobotError("The joints are not in their order along the chain: this format cannot say so.")
        return replace(self, direction=self.direction * self.ratio[:, None], ratio=np.ones(len(self)))


def chain_frames(chain: Chain, values: Floats | None = None) -> Floats:
    """Poses (E + 1, 4, 4) before the first and after each of E elements, at zero joints.

    ``values`` are the named constants, in the order of ``chain.named``; the nominal ones when None.
    """
    constants = np.array([e.value for e in chain.elements])
    if values is not None:
        constants[list(chain.named_elements)] = values
    frames = [np.eye(4)]
    for e, value in zip(chain.elements, constants, strict=True):
        frames.append(frames[-1] @ e.axis.motion(float(value)))
    return np.array(frames)


def screws_of_chain(chain: Chain, values: Floats | None = None) -> Screws:
    """Axes of a chain whose named constants have ``values``, see :func:`chain_frames`."""
    frames = chain_frames(chain, values)
    moving = [k for k, e in enumerate(chain.elements) if e.joint is not None]
    elements = [chain.elements[k] for k in moving]
    return Screws(
        direction=np.array([frames[k][:3, e.axis % 3] for k, e in zip(moving, elements, strict=True)]),
        point=frames[moving, :3, 3],
        prismatic=np.array([not e.axis.rotates for e in elements]),
        joint=np.array([e.joint for e in elements], dtype=np.int64),
        ratio=np.array([e.ratio for e in elements]),
        home=frames[-1],
    )
