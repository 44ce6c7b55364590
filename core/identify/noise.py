"""Measurement noise from repeats of a pose, the only estimate that owes nothing to the model."""

from __future__ import annotations

import numpy as np

from core.observations import Observations


def repeat_sigma(observations: Observations) -> float | None:
    """Pooled standard deviation (m) of a coordinate between repeats of a pose, None without repeats.

    Markers count as their own points; rows with an unseen marker are left out.
    """
    points = observations.markers if observations.markers is not None else observations.position
    if points is None:
        return None
    flat = points.reshape(len(points), -1)
    groups = observations.pose_groups()
    complete = ~np.isnan(flat).any(axis=1)
    flat, groups = flat[complete], groups[complete]
    counts = np.bincount(groups)
    if not np.any(counts > 1):
        return None
    means = (
        np.stack([np.bincount(groups, weights=column) for column in flat.T], axis=1) / np.maximum(counts, 1)[:, None]
    )
    freedom = int(np.sum(counts[counts > 1] - 1)) * flat.shape[1]
    return float(np.sqrt(np.sum((flat - means[groups]) ** 2) / freedom))
