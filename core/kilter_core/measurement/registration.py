"""Where the robot stands in the frame of the measurements, and where the measured point sits on its tool."""

from __future__ import annotations

import numpy as np

from kilter_core.measurement import Measurement
from kilter_core.measurement.frames import best_frames
from kilter_core.measurement.marker_shape import fit_poses
from kilter_core.model import RobotModel
from kilter_core.transforms import inverse, nearest_rotation
from kilter_core.types import Bools, Floats

FEWEST_POSES = 6  # nine unknowns at three numbers a pose: fewer, and the tool point would follow noise
MOST_POSES = 5000  # that a start is found from


def register(
    model: RobotModel, values: Floats, measurement: Measurement, *, base: bool = True, tool: bool = True
) -> tuple[Floats, Floats]:
    """Starting base and tool poses (4, 4) without any guess, from the model's flange poses.

    Both together are the best there are (:func:`kilter_core.measurement.frames.best_frames`), by positions and, where it
    was measured, by orientation; then the tool's rotation is the mean of (R F)' R_measured. Frames that are not free
    (``base``, ``tool``) are kept as the model has them.
    """
    if not (base or tool):
        return model.T_base, model.T_tool
    position, rotation, use = _measured_poses(measurement)
    T_base, T_tool = model.T_base.copy(), model.T_tool.copy()
    flange = _flange(model, values, measurement)
    f, F, p = flange[use, :3, 3], flange[use, :3, :3], position[use]
    if base and tool and len(p) >= FEWEST_POSES:
        some = slice(None, None, max(1, len(p) // MOST_POSES))
        turned = None if rotation is None else rotation[use][some]
        T_base, T_tool[:3, 3] = best_frames(f[some], F[some], p[some], T_tool[:3, 3], turned)
    elif base:
        T_base = _rigid(f + F @ T_tool[:3, 3], p)
    if tool:
        back = inverse(T_base)
        local = p @ back[:3, :3].T + back[:3, 3]
        T_tool[:3, 3] = np.einsum("nji,nj->ni", F, local - f).mean(axis=0)
        if rotation is not None:
            T_tool[:3, :3] = nearest_rotation(np.mean((T_base[:3, :3] @ F).transpose(0, 2, 1) @ rotation[use], axis=0))
    return T_base, T_tool


def _measured_poses(measurement: Measurement) -> tuple[Floats, Floats | None, Bools]:
    o = measurement.observations
    if measurement.marker_points is not None and o.markers_of_poses is not None:
        return fit_poses(measurement.marker_points, o.markers_of_poses)
    assert o.position is not None
    return o.position, o.rotation, measurement.tool.measured_row_mask()


def _flange(model: RobotModel, values: Floats, measurement: Measurement) -> Floats:
    """Flange poses (N, 4, 4) in the robot's base frame."""
    bare = model.in_frames(np.eye(4), np.eye(4))
    prediction = bare.predict(measurement.observations, values)
    out = np.tile(np.eye(4), (len(prediction.position), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = prediction.rotation, prediction.position
    return out


def _rigid(body: Floats, world: Floats) -> Floats:
    b, w = body.mean(axis=0), world.mean(axis=0)
    T = np.eye(4)
    T[:3, :3] = nearest_rotation((world - w).T @ (body - b))
    T[:3, 3] = w - T[:3, :3] @ b
    return T
