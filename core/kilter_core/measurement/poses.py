"""Poses of the tool, and how well position and rotation are known together.

A view knows the tilt of its board badly, and a wrong tilt moves the tool by its lever: the two errors go together, over half
a metre and more for a camera on the flange. Taken apart, as the deviation of each axis alone, most of what the view knows is
lost. So the rotation is weighed by its own covariance, and the position by what is left of its own beside the rotation, with
the lever taken off: together they hold all that the six by six covariance says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kilter_core.measurement.kind import POINTS, TURNS, Block, Rows, ToolKind
from kilter_core.model import Calibration, Prediction
from kilter_core.observations import Observations
from kilter_core.transforms import right_jacobian_inverse, rotation_log
from kilter_core.types import Floats


@dataclass(frozen=True)
class Poses(ToolKind):
    """Rows with a position and an orientation."""

    name = "poses"
    summary = "position and orientation of the tool"
    with_orientation = True

    observations: Observations

    @classmethod
    def from_rows(cls, rows: Rows) -> Poses | None:
        """Rows that have both."""
        o = rows.observations
        if rows.relative or o.position is None or o.rotation is None or o.markers is not None:
            return None
        return cls(o)

    @property
    def column(self) -> Floats:
        """Positions."""
        assert self.observations.position is not None
        return self.observations.position

    def scalars(self) -> int:
        """Six of every measured pose."""
        return 2 * super().scalars()

    def blocks(self, prediction: Prediction, J: Floats | None = None) -> tuple[Block, ...]:
        """Position (N, 1, 3) m and rotation vector (N, 1, 3) rad, measured minus predicted.

        Where rows say how position and rotation are known together, both are weighed by it: the position is that which is
        left beside what the rotation, with its lever, explains.
        """
        rotation = self.observations.rotation
        assert rotation is not None
        points = self.column - prediction.position
        turns = rotation_log(rotation @ prediction.rotation.transpose(0, 2, 1))
        d_points = None if J is None else J[:, :3, :]
        d_turns = None if J is None else right_jacobian_inverse(turns) @ J[:, 3:6, :]
        W = self.observations.pose_weight
        if W is not None:
            both = (W @ np.concatenate([points, turns], axis=1)[:, :, None])[:, :, 0]
            points, turns = both[:, :3], both[:, 3:]
        if W is not None and d_points is not None and d_turns is not None:
            d_both = W @ np.concatenate([d_points, d_turns], axis=1)
            d_points, d_turns = d_both[:, :3], d_both[:, 3:]
        return (
            Block(POINTS, points[:, None], None if d_points is None else d_points[:, None]),
            Block(TURNS, turns[:, None], None if d_turns is None else d_turns[:, None], "rad"),
        )

    def errors(self, calibration: Calibration) -> tuple[Floats, Floats | None]:
        """Errors (K, 3) m and (K,) rad of the poses, none weighed."""
        if self.observations.pose_weight is None:
            return super().errors(calibration)
        return Poses(replace(self.observations, pose_weight=None)).errors(calibration)


Scale = tuple[float, float]
"""Standard deviations m and rad that weighed numbers of points and of rotations are told in."""
DEVIATIONS: Scale = (1.0, 1.0)  # plain numbers, whose covariance is one


def typical_deviations(covariance: Floats) -> Scale:
    """The typical deviations of poses with a covariance (N, 6, 6): m beside their rotation, and rad."""
    beside, _, turn = _split_covariance(covariance)
    m, rad = (float(np.sqrt(np.median(np.trace(C, axis1=1, axis2=2) / 3.0))) for C in (beside, turn))
    return m, rad


def weights(covariance: Floats, scale: Scale) -> Floats:
    """Matrices (N, 6, 6) that take errors of poses (m, rad) to numbers of deviations ``scale``, independent of each other.

    The square of what they give is that of the errors by the inverse of their ``covariance (N, 6, 6)``.
    """
    beside, lever, turn = _split_covariance(covariance)
    W = np.zeros_like(covariance)
    W[:, :3, :3] = scale[0] * _root_inverse(beside)
    W[:, :3, 3:] = -W[:, :3, :3] @ lever
    W[:, 3:, 3:] = scale[1] * _root_inverse(turn)
    return W


def beside_rotation(weight: Floats) -> float:
    """Typical deviation m of a coordinate beside the rotation, of poses weighed (N, 6, 6) in numbers of deviations."""
    root = np.linalg.inv(weight[:, :3, :3])
    return float(np.sqrt(np.median(np.sum(root**2, axis=(1, 2)) / 3.0)))


def _split_covariance(covariance: Floats) -> tuple[Floats, Floats, Floats]:
    """Covariance of the position beside the rotation, how it follows the rotation, and that of the rotation; (N, 3, 3) each."""
    P, Q, R = covariance[:, :3, :3], covariance[:, :3, 3:], covariance[:, 3:, 3:]
    lever = Q @ np.linalg.inv(R)
    return np.asarray(P - lever @ Q.transpose(0, 2, 1)), np.asarray(lever), R


def _root_inverse(C: Floats) -> Floats:
    """Symmetric roots of inverses (N, 3, 3): they keep the axes of what they weigh."""
    w, V = np.linalg.eigh(C)
    return np.asarray((V / np.sqrt(w)[:, None, :]) @ V.transpose(0, 2, 1))
