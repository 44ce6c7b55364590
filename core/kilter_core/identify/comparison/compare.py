"""Whether a calibration predicts unseen poses worse than another, base and tool refitted to them.

The frames are fitted because they do not belong to the arm: a tracker that was set up again, or a tool that was mounted
again, must not count against a calibration. A pose counts once, however often it was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields

import numpy as np

from kilter_core.arm.robot import Robot
from kilter_core.errors import CoreError, NotConvergedError
from kilter_core.identify.estimate import registration_only
from kilter_core.identify.plausibility.plausibility import refuse_foreign
from kilter_core.measurement import Measurement
from kilter_core.measurement.contacts import LEAST_ROWS, group_contacts
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from kilter_core.observations.spread import evenly
from kilter_core.parameters import mm
from kilter_core.types import Bools, Floats

FEWEST_POSES = 8  # base and tool have 9 to 12 unknowns: fewer poses are explained by them whatever the arm is like
NOTHING = 0.5  # share of the scatter of the points that rows of no arm leave: chance explains little of it
DOUBTED = 0.03  # share from which mix-ups are looked for
ROWS_OF_A_POSE = 4  # repeats beyond tell nothing about the calibration


def errors_by_pose(calibration: Calibration, observations: Observations) -> Floats:
    """Mean distance (P,) m between measured and predicted points of each pose, in frames fitted to these rows.

    Raises:
        TooFewPosesError: too few poses for the frames. NotConvergedError: they have no best place.

    """
    observations = observations.select(_seen_row_mask(observations))
    measurement = Measurement.from_observations(observations)
    try:
        fitted = registration_only(calibration, measurement, "huber")  # a few wrong rows must not move all the others
    except NotConvergedError:
        fitted = registration_only(calibration, measurement)
    points = measurement.residual(fitted.predict(observations)).points
    rows = np.nanmean(np.linalg.norm(points, axis=-1), axis=1)
    groups = observations.pose_groups()
    return np.asarray(np.bincount(groups, weights=rows) / np.bincount(groups))


def _seen_row_mask(observations: Observations) -> Bools:
    if observations.markers is None:
        return np.ones(len(observations), dtype=bool)
    return np.asarray(np.isfinite(observations.markers[:, :, 0]).any(axis=1))


def lacking(calibration: Calibration, observations: Observations) -> list[str]:
    """Columns that the effects of a calibration need and the rows do not have."""
    observations = observations.with_tilt_as_condition()
    present = {f.name for f in fields(observations) if getattr(observations, f.name) is not None}
    available = frozenset({"moments"} | present)
    return sorted({name for effect in calibration.model.effects for name in effect.missing(available)})


def said_of_misfit(robot: Robot, observations: Observations, best: float) -> str | None:
    """Why rows of which the ``best`` of all models leaves so much, m mean, say nothing about any; None: they may.

    Rows that base and tool in any place leave scattered over the workspace follow no arm; where less is left, what is
    mixed up in them must be known.
    """
    points = observations.position if observations.markers is None else np.nanmean(observations.markers, axis=1)
    if points is None:
        return None
    size = float(np.sqrt(np.nanmean(np.sum((points - np.nanmean(points, axis=0)) ** 2, axis=1))))
    if best <= DOUBTED * size:
        return None
    try:
        refuse_foreign(Calibration.nominal(robot), Measurement.from_observations(observations))
    except CoreError as error:
        return error.message
    if best <= NOTHING * size:
        return None
    return f"Its points are {mm(size):.4g} mm apart (rms): joints and positions do not belong together."


def setups(observations: Observations) -> list[Observations]:
    """The rows by session: between sessions instrument and tool may have been set up anew."""
    if observations.session is None:
        return [observations]
    return [observations.select(observations.session == code) for code in np.unique(observations.session)]


def thin_poses(observations: Observations, poses: int) -> Observations:
    """At most so many poses, evenly chosen in their order, and a few rows of each.

    Of every socket, plane and bar at least so many rows stay as its own place takes, where it has them.
    """
    groups = observations.pose_groups()
    first = np.unique(groups, return_index=True)[1]
    in_order = groups[np.sort(first)]
    chosen = in_order[evenly(len(in_order), poses)]
    by_pose = np.argsort(groups, kind="stable")
    starts = np.searchsorted(groups[by_pose], np.arange(len(in_order)))
    repeat = np.empty(len(groups), dtype=np.int64)
    repeat[by_pose] = np.arange(len(groups)) - starts[groups[by_pose]]
    kept = np.isin(groups, chosen) & (repeat < ROWS_OF_A_POSE)
    for contact in group_contacts(observations):
        if int(kept[contact.rows].sum()) < LEAST_ROWS[contact.kind]:
            kept[contact.rows[evenly(len(contact.rows), LEAST_ROWS[contact.kind])]] = True
    return observations.select(np.flatnonzero(kept))


def count_poses(observations: Observations) -> int:
    """Number of distinct poses."""
    return int(observations.pose_groups().max()) + 1 if len(observations) else 0


def pool_setup_errors(errors: Sequence[Floats]) -> Floats:
    """Errors of several set-ups as one."""
    return np.concatenate(errors) if errors else np.zeros(0)
