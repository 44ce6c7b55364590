"""Where a version is wrong and how well it knows the tool: errors at the measured places, and over the workspace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.observations import Observations
from kilter_core.parameters import display_unit_and_scale
from kilter_core.types import QUANTILE, Bools, Floats, Ints
from kilter_service.campaigns import store as campaigns
from kilter_service.contract.streams import Status
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground.core import core_arm, core_correct, core_identify, core_measurement, core_model, transforms
from kilter_service.ground.correction_limits import correction_options
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.robots import store as robots
from kilter_service.versions import store
from kilter_service.versions.predictions.at_pose import at_poses, drawn
from kilter_service.versions.predictions.unfitted_rows import Part, iter_frame_groups, load_parts, refit_frames
from kilter_service.versions.records import PreviewedPoses

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.model import Calibration


MOST_ROWS, WORST = 8000, 500  # rows that are shown, and of these those that are there because they are the worst
SLICE, FITTED_ROWS = 50_000, 2000  # rows predicted at once, and those that registration is fitted to
DRAWN = 3000
STAGES = ("nominal", "registration_only", "identified")

DAMPING_M = 1e-3  # m/rad: near a singular pose no joint is asked to move without bound


@dataclass(frozen=True)
class Places:
    """Rows of a campaign, ``row (N,)`` from 1, in the frame of the robot's base; m, rad.

    ``at (N, 3)`` is where the version has the tool, ``left`` by stage the errors (N, 3), measured minus predicted. ``total``
    counts the rows with a measured point: of many some are kept, with the worst and the outermost among them.
    """

    robot: Robot
    row: Ints
    q: Floats
    at: Floats
    left: dict[str, Floats]
    held_out: Bools
    set_aside: Bools
    total: int


@dataclass(frozen=True)
class Reach:
    """Poses all over the joint limits: the tool ``points (N, 3)`` m in the frame of the robot's base, how far the correction
    moves it, ``before (N,)`` m, and the standard deviation of its position in the worst direction, ``after (N,)`` m.

    ``after`` is None where nothing is known of how certain the version is.
    """

    points: Floats
    before: Floats
    after: Floats | None


MOST_KEPT = 4
# A version never changes, nor do the rows of an upload: the view asks for its numbers twice.
_LATELY: dict[tuple[str, ...], Places] = {}


def geometry(database: Database, version_id: str) -> dict[str, float]:
    """Return the values that a version has for the elements of the chain, by name, m and rad."""
    with database.reading() as session:
        known = store.calibration(session, version_id)
    return dict(zip(known.names, known.values.tolist(), strict=True))


def prior_sigmas(database: Database, version_id: str) -> dict[str, float]:
    """Return the standard deviation that each parameter of a version had before the measurements, in its reported unit."""
    with database.reading() as session:
        known = store.calibration(session, version_id)
    return {one.name: one.prior_sigma * display_unit_and_scale(one.unit)[1] for one in known.model.parameters}


def places(database: Database, version: str, campaign: str) -> Places:
    """Return the errors of a campaign's rows with the nominal robot, with registration only, and with a version.

    Raises:
        ServiceError: no such version or campaign, one of another robot, or no point was measured in it.

    """
    with database.reading() as session:
        record = store.get(session, version)
        files = tuple(upload.sha256 for upload in campaigns.uploads_of_campaign(session, campaign))
        key = (version, campaign, *files)
        kept = _LATELY.get(key)  # another request may drop it between a look and a read
        if kept is not None and campaigns.whole(session, campaign).robot_id == record.robot_id:
            return kept
        calibration = store.calibration(session, version)
        (part,) = load_parts(session, record, [campaign])
    found = _build_places(part, calibration, record.report)
    while len(_LATELY) >= MOST_KEPT:
        _LATELY.pop(next(iter(_LATELY)), None)
    _LATELY[key] = found
    return found


def _build_places(part: Part, calibration: Calibration, report: dict[str, Any]) -> Places:
    calibration = part.calibration_for_rows(calibration)
    frames = [
        frame for where, refit in iter_frame_groups(part, report) if (frame := _frame(part, calibration, where, refit))
    ]
    if not frames:
        raise ServiceError(
            f"Campaign {part.campaign} has no measured point, so its errors have no place: choose another one.",
            code="campaigns_invalid",
            campaign=part.campaign,
        )
    at, size = np.concatenate([one.at for one in frames]), np.concatenate([one.size for one in frames])
    kept = np.zeros(len(at), dtype=bool)
    kept[spread(at, size)] = True
    chosen = np.split(kept, np.cumsum([len(one.rows) for one in frames])[:-1])
    row = np.concatenate([one.rows[mine] for one, mine in zip(frames, chosen, strict=True)])
    left = np.concatenate([_stages(part, one, mine) for one, mine in zip(frames, chosen, strict=True) if mine.any()])
    order = np.argsort(row)
    row, at, left = row[order], at[kept][order], left[order]
    return Places(
        calibration.robot,
        row + 1,
        part.rows.q[row],
        at,
        {name: left[:, k] for k, name in enumerate(STAGES)},
        ~part.fitted[row],
        np.isin(row + 1, list(part.set_aside)),
        len(kept),
    )


@dataclass(frozen=True)
class _Frame:
    """Rows that were given in one frame, ``rows (n,)`` from 0, with a measured point: where the version, whose base is that
    of these rows, has the tool (n, 3) m, and the size (n,) m of its errors.
    """

    here: Calibration
    rows: Ints
    at: Floats
    size: Floats


def _frame(part: Part, calibration: Calibration, where: Bools, refit: Sequence[str]) -> _Frame | None:
    rows = np.flatnonzero(where)
    shape = calibration.marker_points
    here = (
        refit_frames(calibration, core_measurement.Measurement.from_observations(part.rows.select(where), shape), refit)
        if refit
        else calibration
    )
    found = [_sizes(part, here, rows[k : k + SLICE]) for k in range(0, len(rows), SLICE)]
    if any(one is None for one in found):
        return None
    at, size = (np.concatenate([one[k] for one in found if one is not None]) for k in range(2))
    seen = ~np.isnan(size)
    return _Frame(here, rows[seen], at[seen], size[seen]) if seen.any() else None


def _sizes(part: Part, here: Calibration, rows: Ints) -> tuple[Floats, Floats] | None:
    """Places (n, 3) m of rows and the sizes (n,) m of their errors; None where no instrument saw a place."""
    measurement = core_measurement.Measurement.from_observations(part.rows.select(rows), here.marker_points, held=True)
    if measurement.tool.places_itself:
        at = here.predict(measurement.observations).position
        return in_base(here, at), np.linalg.norm(measurement.tool.row_errors(here)[0], axis=1)
    if not measurement.observes_places:
        return None
    predicted = here.predict(measurement.observations)
    size = np.linalg.norm(core_identify.mean_marker_error(measurement.residual(predicted).points), axis=1)
    return in_base(here, predicted.position), size


def _stages(part: Part, frame: _Frame, chosen: Bools) -> Floats:
    """Errors (n, 3, 3) m of the rows chosen, by stage; registration is fitted to some rows, evenly chosen."""
    nominal = core_model.Calibration.nominal(frame.here.robot)
    some = frame.rows[np.linspace(0, len(frame.rows) - 1, min(len(frame.rows), FITTED_ROWS)).astype(np.int64)]
    fitted = core_identify.registration_only(
        nominal,
        core_measurement.Measurement.from_observations(part.rows.select(some), frame.here.marker_points, held=True),
    )
    return _errors(part, dict(zip(STAGES, (nominal, fitted, frame.here), strict=True)), frame.rows[chosen])


def _errors(part: Part, stages: dict[str, Calibration], rows: Ints) -> Floats:
    """Errors (n, stages, 3) m of rows, in the axes of the robot's base."""
    measurement = core_measurement.Measurement.from_observations(
        part.rows.select(rows), stages[STAGES[-1]].marker_points, held=True
    )
    if measurement.tool.places_itself:
        return np.stack([measurement.tool.row_errors(stage)[0] for stage in stages.values()], axis=1)
    return np.stack(
        [core_identify.RowErrors.from_stages(stages, measurement, rows).left[name] for name in stages], axis=1
    )


def spread(at: Floats, size: Floats, most: int = MOST_ROWS) -> Ints:
    """Choose at most so many rows: evenly, with the worst and the outermost ones."""
    count = len(at)
    if count <= most:
        return np.arange(count)
    outermost = np.concatenate([at.argmin(axis=0), at.argmax(axis=0)])
    always = np.union1d(np.argsort(-size, kind="stable")[:WORST], outermost)
    evenly = np.linspace(0, count - 1, most - len(always)).astype(np.int64)
    return np.union1d(always, evenly)


def reach(database: Database, version: str) -> Reach:
    """Return how far a version corrects the tool, and how well it knows it, wherever it corrects within the joint limits."""
    with database.reading() as session:
        limits, rules = CorrectionLimits(**store.get(session, version).limits), store.activation_rules(session, version)
        calibration, known = store.calibration(session, version), store.load_predictive(session, version)
    rows = Observations(q=drawn(calibration.robot, DRAWN))
    done = core_correct.correct_trajectory(calibration, rows, correction_options(limits, None, rules=rules))
    good = done.status == Status.OK
    rows = rows.select(good)
    before = np.linalg.norm(done.error_removed[good], axis=1)
    after = None if known is None else known.of_the_tool(calibration, rows).max(axis=1) / QUANTILE
    points = core_identify.acting(calibration, rows).predict(rows).position
    return Reach(in_base(calibration, points), before, after)


def in_base(calibration: Calibration, points: Floats) -> Floats:
    """Points (N, 3) m of the measurements in the frame of the robot's base."""
    base = transforms.inverse(calibration.model.T_base @ core_arm.increment(calibration.values[:6]))
    return np.asarray(points @ base[:3, :3].T + base[:3, 3])


def joint_errors(database: Database, version: str, campaign: str) -> Floats:
    """Return for each of the rows of :func:`places` (N, n) the least motion of the joints, rad or m, that its error is.

    Raises:
        ServiceError: as :func:`places`.

    """
    found = places(database, version, campaign)
    with database.reading() as session:
        calibration = store.calibration(session, version)
        robot = robots.core_robot(session, campaigns.whole(session, campaign).robot_id)
        rows = campaigns.observations(session, campaign, robot).select(found.row - 1)
    _, jacobian = calibration.model.joint_jacobian(rows, calibration.values)
    return least_motion(_in_base(calibration, jacobian[:, :3]), found.left["identified"])


def least_motion(jacobian: Floats, error: Floats) -> Floats:
    """Motions (N, n) of the joints of least length that move tools by errors (N, 3) m; ``jacobian (N, 3, n)`` m/rad."""
    square = jacobian @ jacobian.transpose(0, 2, 1) + DAMPING_M**2 * np.eye(3)
    return np.asarray((jacobian.transpose(0, 2, 1) @ np.linalg.solve(square, error[:, :, None]))[:, :, 0])


def _in_base(calibration: Calibration, jacobian: Floats) -> Floats:
    """Derivatives (N, 3, n) of measured positions in the axes of the robot's base."""
    turn = (calibration.model.T_base @ core_arm.increment(calibration.values[:6]))[:3, :3]
    return np.asarray(turn.T @ jacobian)


@dataclass(frozen=True)
class Workspace:
    """Poses all over the joint limits: what the version does there, and the tool (N, 3) m in the robot's base frame."""

    robot: Robot
    limits: CorrectionLimits
    found: PreviewedPoses
    points: Floats


def workspace(database: Database, version_id: str, temperature_c: float | None) -> Workspace:
    """Correct poses drawn within the joint limits as `correct` does.

    Raises:
        ServiceError: no such version.

    """
    with database.reading() as session:
        limits = CorrectionLimits(**store.get(session, version_id).limits)
        calibration, known = store.calibration(session, version_id), store.load_predictive(session, version_id)
    q = drawn(calibration.robot)
    rows = Observations(q=q)
    points = in_base(calibration, core_identify.acting(calibration, rows).predict(rows).position)
    return Workspace(calibration.robot, limits, at_poses(calibration, known, limits, q, temperature_c), points)
