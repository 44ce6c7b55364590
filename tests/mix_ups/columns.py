"""Campaigns as columns that an upload takes."""

from __future__ import annotations

import numpy as np

from kilter_core.observations import Observations
from tests.core.truth import Floats
from tests.mix_ups.campaigns import Genuine

Columns = dict[str, list[float]]


def columns_of(g: Genuine, rows: Observations | None = None) -> Columns:
    """Joints in deg and mm, points in mm, orientations as quaternions."""
    seen = g.rows if rows is None else rows
    kinds = [joint.kind for joint in g.robot.joints]
    out: dict[str, Floats] = {}
    for k, kind in enumerate(kinds):
        turns = kind == "revolute"
        out[f"q{k + 1}_{'deg' if turns else 'mm'}"] = seen.q[:, k] * (180.0 / np.pi if turns else 1e3)
    if seen.markers is not None:
        for m in range(seen.markers.shape[1]):
            out |= {f"m{m + 1}{axis}_mm": 1e3 * seen.markers[:, m, k] for k, axis in enumerate("xyz")}
    if seen.position is not None:
        out |= {f"{axis}_mm": 1e3 * seen.position[:, k] for k, axis in enumerate("xyz")}
    if seen.rotation is not None:
        out |= dict(zip(("qw", "qx", "qy", "qz"), _quaternions(seen.rotation).T, strict=True))
    if seen.session is not None:
        out["session"] = seen.session.astype(float)
    if seen.payload_kg is not None:
        out["payload_kg"] = seen.payload_kg
    return {name: [float(value) for value in values] for name, values in out.items()}


def _quaternions(R: Floats) -> Floats:
    """Quaternions (N, 4), w first, of rotations (N, 3, 3): the eigenvector of Bar-Itzhack's matrix."""
    K = np.empty((len(R), 4, 4))
    trace = np.trace(R, axis1=1, axis2=2)
    vee = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    K[:, 0, 0], K[:, 0, 1:], K[:, 1:, 0] = trace, vee, vee
    K[:, 1:, 1:] = R + R.transpose(0, 2, 1) - trace[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.eigh(K)[1][:, :, -1])
