"""Swapped markers that no distance shows: sets that fit themselves in another order are recognised by their rotation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kilter_core.errors import ObservationError
from kilter_core.measurement import Measurement
from kilter_core.measurement.marker_checks import alike_orders, format_exchanged_markers
from kilter_core.measurement.marker_shape import fit_poses
from kilter_core.measurement.registration import register
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.parameters import degrees
from kilter_core.transforms import rotation_log
from kilter_core.types import Bools, Floats

NEAR_RAD = np.radians(15.0)  # of the nominal robot; a swap feigns rotations of 60 degrees and more
LARGE_RAD = np.radians(30.0)
LEAST_ROWS = 6


def refuse_feigned_turns(begin: Calibration, measurement: Measurement) -> None:
    """Compare the rotation that each row's markers show with the robot's.

    The markers' middle, which no swap moves, gives the base.

    Raises:
        ObservationError: ``markers_swapped``, with the first row and how many there are.

    """
    o, shape = measurement.observations, measurement.marker_points
    if shape is None or o.markers_of_poses is None:
        return
    if np.count_nonzero(~np.isnan(o.markers_of_poses).any(axis=(1, 2))) < LEAST_ROWS:
        return
    orders = [(order, rotation) for order, rotation in alike_orders(shape) if _angle(rotation[None])[0] > LARGE_RAD]
    if not orders:
        return
    rotations, usable = _tool_rotations(begin, measurement, shape, o.markers_of_poses)
    reference = rotations[_most_common(rotations)]
    off = _angle(reference.T @ rotations)
    feigned = [np.flatnonzero(_angle((reference @ rotation).T @ rotations) < NEAR_RAD) for _, rotation in orders]
    rows, order = max(
        ((rows, order) for rows, (order, _) in zip(feigned, orders, strict=True)), key=lambda pair: len(pair[0])
    )
    if len(rows) and np.count_nonzero(off < NEAR_RAD) + len(rows) > 0.9 * len(rotations):
        place = np.flatnonzero(usable)[rows]
        raise ObservationError(
            f"In {len(rows)} of {len(rotations)} rows, the first is row {place[0] + 1}, the markers show the tool rotated by "
            f"{degrees(off[rows[0]]):.0f} degrees against the robot, as if markers {format_exchanged_markers(order)} "
            "had changed places: "
            "number them the same in all rows, and space them unevenly so that it is noticed at once.",
            code="markers_swapped",
            row=int(place[0]) + 1,
            rows=len(rows),
            order=[k + 1 for k in order],
        )


def _tool_rotations(
    begin: Calibration, measurement: Measurement, shape: Floats, markers: Floats
) -> tuple[Floats, Bools]:
    """Rotation (K, 3, 3) of the marker shape on the flange in every usable row, by the robot as it begins."""
    middle = Measurement.from_observations(_without_rotations(measurement, markers))
    T_base, _ = register(begin.model, begin.values, middle)
    _, rotation, usable = fit_poses(shape, markers)
    bare = begin.model.in_frames(T_base, np.eye(4))
    flange = bare.predict(measurement.observations, begin.values).rotation
    return np.asarray(flange[usable].transpose(0, 2, 1) @ rotation[usable]), usable


def _without_rotations(measurement: Measurement, markers: Floats) -> Observations:
    seen = np.asarray(~np.isnan(markers).any(axis=(1, 2)))
    o = measurement.observations.select(seen)
    return replace(o, markers=None, tip=None, rotation=None, position=markers[seen].mean(axis=1))


def _most_common(rotations: Floats) -> int:
    """The row whose rotation most others share."""
    some = np.arange(len(rotations))[:: max(1, len(rotations) // 200)]
    return int(some[int(np.argmax([np.count_nonzero(_angle(rotations[k].T @ rotations) < NEAR_RAD) for k in some]))])


def _angle(rotations: Floats) -> Floats:
    return np.asarray(np.linalg.norm(rotation_log(rotations), axis=1))
