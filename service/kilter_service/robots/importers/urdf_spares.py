"""Which constants of a URDF say what others say too: rotations about a joint's axis, and shifts along it.

A joint's origin has six numbers. Rotating about the axis of the joint, or about that of the joint before, is what their
zero offsets do, and shifting along an axis is the same before the joint as behind it. Of each such set one is identified:
four numbers of a revolute joint, two of a prismatic one (Mooring, Roth and Driels 1991).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from kilter_core.types import Floats
from kilter_service.robots.importers.urdf_tree import MOVING, UrdfJoint

SUFFIXES = ("x", "y", "z", "rz", "ry", "rx")
LENGTH_M = 0.3  # of an arm: over it a rotation is compared with a shift
ALIKE = 1e-6  # share within which two are alike, and the first is kept
NOTHING = 1e-6  # of a unit column: dependent on those kept


def spares(path: Sequence[UrdfJoint]) -> frozenset[str]:
    """Names of the constants that are not identified beside the others, of the moving joints of an arm in order."""
    # Joints whose zero offsets act at the next one alike wherever it stands, and the way (4, 4) there from each.
    before: list[tuple[UrdfJoint, Floats]] = []
    out: list[str] = []
    last = max(k for k, joint in enumerate(path) if joint.moves)
    for k, joint in enumerate(path):
        before = [(one, way @ joint.origin) for one, way in before]
        if joint.moves:
            said = [
                *_by_itself(joint, last=k == last),
                *(twist for one in before for twist in _twists_of_earlier_joint(*one)),
            ]
            kept = _independent(_constants(joint), np.array(said).reshape(-1, 6).T)
            out += [f"{joint.name}_{suffix}" for n, suffix in enumerate(SUFFIXES) if n not in kept]
            # Prismatic joints in a row only shift: each of their zero offsets is the same shift behind all of them.
            run = [b for b in before if _is_prismatic(b[0])] if _is_prismatic(joint) else []
            before = [*run, (joint, np.eye(4))]
    return frozenset(out)


def _is_prismatic(joint: UrdfJoint) -> bool:
    return MOVING[joint.kind] == "prismatic"


def _by_itself(joint: UrdfJoint, *, last: bool) -> Iterator[Floats]:
    """Twists (6,) behind the origin that the zero offset says, or the next origin: shifts (3,), then rotations (3,)."""
    prismatic, axis = _is_prismatic(joint), joint.axis
    follows = joint.mimic is not None  # its zero offset is not a parameter
    if prismatic and not last:
        yield from np.eye(6)[:3]
        yield np.r_[0.0, 0.0, 0.0, axis]
    elif prismatic and not follows:
        yield np.r_[axis, 0.0, 0.0, 0.0]
    elif not prismatic:
        if not (last and follows):
            yield np.r_[0.0, 0.0, 0.0, axis]
        if not last:
            yield np.r_[axis, 0.0, 0.0, 0.0]


def _twists_of_earlier_joint(before: UrdfJoint, T: Floats) -> Iterator[Floats]:
    """Twist (6,) in a frame at ``T`` (4, 4) behind a joint that this joint's zero offset says."""
    if before.mimic is not None:
        return
    R, p = T[:3, :3], T[:3, 3]
    if _is_prismatic(before):
        yield np.r_[R.T @ before.axis, 0.0, 0.0, 0.0]
    else:
        yield np.r_[R.T @ np.cross(before.axis, p), R.T @ before.axis]


def _constants(joint: UrdfJoint) -> Floats:
    """Twists (6, 6) in the frame behind the origin, a column for each of :data:`SUFFIXES`."""
    out = np.zeros((6, 6))
    out[:3, :3] = joint.origin[:3, :3].T
    out[3:, 3:] = np.eye(3)[::-1]
    return out


def _independent(constants: Floats, said: Floats) -> set[int]:
    """Places of the columns (6, 6) that say most beside what is ``said (6, K)`` already and each other."""
    scale = np.r_[np.full(3, 1.0 / LENGTH_M), np.ones(3)][:, None]
    left, known = constants * scale, said * scale
    left = left / np.linalg.norm(left, axis=0)
    basis, size, _ = np.linalg.svd(known, full_matrices=False)
    # Of axes in one line two zero offsets say the same, and of two prismatic joints both say shifts: what counts is what
    # is said, not how often.
    basis = basis[:, size > NOTHING]
    left = left - basis @ (basis.T @ left)
    kept: set[int] = set()
    for _ in range(6 - basis.shape[1]):
        length = np.linalg.norm(left, axis=0)
        if length.max() < NOTHING:
            break
        best = int(np.flatnonzero(length >= (1.0 - ALIKE) * length.max())[0])
        kept.add(best)
        along = left[:, best] / length[best]
        left = left - np.outer(along, along @ left)
    return kept
