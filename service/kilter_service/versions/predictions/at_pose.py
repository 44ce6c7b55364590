"""What a version says of one pose: where the tool is, what moves it, effect by effect, and how well that is known.

What a version does where the robot is driven, before it is activated: the correction itself, at those poses.

:func:`over_poses` is for whoever decides by it, such as the guard of activation; :func:`preview` says it over the wire.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from kilter_core.observations import Observations
from kilter_core.types import QUANTILE, Floats
from kilter_service.campaigns import store as campaigns
from kilter_service.contract.streams import Status
from kilter_service.contract.versions import CorrectionLimits, VersionPreview
from kilter_service.ground import correction_outcome as outcome
from kilter_service.ground.core import core_correct, core_identify, core_model, transforms
from kilter_service.ground.correction_limits import correction_options
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.tables.assemble import with_default_load
from kilter_service.ground.wire import to_mm
from kilter_service.versions import store, wire
from kilter_service.versions.records import PreviewedPoses

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.correct import CorrectionOptions
    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration


@dataclass(frozen=True)
class Part:
    """Something that moves the tool: by how much, ``size`` m, with the ends of its 95 % interval; None: not known."""

    name: str
    size: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class AtPose:
    """A pose ``q (n,)``, rad or m. ``tool (3,)`` m is where a version has the tool, ``moved (3,)`` m how far that is from where
    the nominal robot expects it, both in the frame of the robot's base; ``sigma`` m the standard deviation of the tool in the
    worst direction, None where nothing is known of it. ``status`` is the correction's verdict; ``missing`` are the effects
    whose columns the pose lacks.
    """

    q: Floats
    tool: Floats
    moved: Floats
    status: str
    parts: tuple[Part, ...]
    missing: tuple[str, ...]
    sigma: float | None


def at_pose(
    database: Database, version: str, q: Floats | None, campaign: str, row: int, temperature_c: float | None
) -> AtPose:
    """Look at joints ``q``, by default those of a measured row; its load, temperature and directions hold either way.

    Raises:
        ServiceError: no such version, campaign or row, or joints of another arm.

    """
    with database.reading() as session:
        limits = CorrectionLimits(**store.get(session, version).limits)
        options = correction_options(limits, temperature_c, rules=store.activation_rules(session, version))
        calibration, known = store.calibration(session, version), store.load_predictive(session, version)
        rows = _rows(session, calibration, q, campaign, row)
    return _predict_at_pose(calibration, known, rows, options)


def _rows(session: Session, calibration: Calibration, q: Floats | None, campaign: str, row: int) -> Observations:
    n = calibration.robot.n_joints
    if q is not None and len(q) != n:
        raise ServiceError(f"The arm has {n} joints, not {len(q)}: give one number for each.", code="payload_invalid")
    if not campaign:
        there = np.zeros(n) if q is None else q
        return with_default_load(Observations(q=there[None, :]), calibration.robot)
    whole = campaigns.observations(session, campaign, calibration.robot)
    if not 1 <= row <= len(whole):
        raise ServiceError(f"The campaign has no row {row}: choose one from 1 to {len(whole)}.", code="payload_invalid")
    one = whole.select(np.array([row - 1]))
    kept = {name: getattr(one, name) for name in ("payload_kg", "payload_com", "temperature_c", "direction")}
    return Observations(q=one.q if q is None else q[None, :], **kept)


def _predict_at_pose(
    calibration: Calibration,
    known: Predictive | None,
    rows: Observations,
    options: CorrectionOptions,
) -> AtPose:
    arm, wanted = core_identify.acting(calibration, rows), calibration.nominal_in_wanted_frames()
    to_base = transforms.inverse(np.asarray(wanted.model.T_base))
    tool, expected = arm.predict(rows).position[0], wanted.predict(rows).position[0]
    done = core_correct.correct_trajectory(arm, rows, options)
    there = {effect.id for effect in arm.model.effects}
    missing = [one.id for one in calibration.model.effects if one.stage != "measurement" and one.id not in there]
    sigma = None if known is None else float(known.of_the_tool(calibration, rows).max()) / QUANTILE
    return AtPose(
        rows.q[0],
        to_base[:3, :3] @ tool + to_base[:3, 3],
        to_base[:3, :3] @ (tool - expected),
        Status(int(done.status[0])).name,
        tuple(_iter_contributions(arm, known, rows, expected)),
        tuple(dict.fromkeys(missing)),
        sigma,
    )


def _iter_contributions(
    arm: Calibration, known: Predictive | None, rows: Observations, expected: Floats
) -> Iterator[Part]:
    """What geometry and each effect move the tool by, the geometry first, then the largest."""
    model = arm.model
    rigid = arm.with_effects([]).predict(rows).position[0] - expected
    # With the base: what a first link does a base does too, so either alone is hardly known, and both together are.
    yield _contribution_with_interval("geometry", rigid, arm, known, rows, range(model.n_geometric))
    slices = model.effect_slices()
    moved = model.contribution(rows, arm.values)
    for key, shift in sorted(moved.items(), key=lambda one: -float(np.linalg.norm(one[1][0]))):
        where = slices[key]
        yield _contribution_with_interval(
            key.partition("#")[0], shift[0], arm, known, rows, range(where.start, where.stop)
        )


def _contribution_with_interval(
    name: str, shift: Floats, arm: Calibration, known: Predictive | None, rows: Observations, own: Sequence[int]
) -> Part:
    """The size of a movement with its 95 % interval along itself, by the covariance of the parameters that make it."""
    size = float(np.linalg.norm(shift))
    free = [k for k in own if known is not None and arm.names[k] in known.names]
    if known is None or not free or size == 0.0:
        return Part(name, size, None, None)
    place = [known.names.index(arm.names[k]) for k in free]
    jacobian = arm.model.jacobian(rows, arm.values, np.array(free, dtype=np.int64), False)[1][0, :3]
    along = np.asarray((shift / size) @ jacobian)
    variance = float(np.einsum("i,ij,j", along, known.covariance[np.ix_(place, place)], along))
    half = QUANTILE * math.sqrt(max(variance, 0.0))
    return Part(name, size, size - half, size + half)


class Contribution(NamedTuple):
    """Movement of the tool by an effect, mm; None where it acts only with what poses alone do not state."""

    effect: str
    rms_mm: float | None
    largest_mm: float | None


def contributions(database: Database, version_id: str) -> tuple[int, list[Contribution]]:
    """Return the number of poses, and the effects of a version, the largest first."""
    with database.reading() as session:
        calibration = store.calibration(session, version_id)
    arm = [effect for effect in calibration.model.effects if effect.stage != "measurement"]
    kept = calibration.with_effects([effect for effect in arm if core_model.acts_at_rest(effect)])
    rows = core_model.workspace(calibration.robot)
    moved = {}
    for name, shift in kept.model.contribution(rows, kept.values).items():
        size = to_mm(np.linalg.norm(shift, axis=1))
        moved[name.partition("#")[0]] = (float(np.sqrt(np.mean(size**2))), float(size.max()))
    found = [Contribution(effect.id, *moved.get(effect.id, (None, None))) for effect in arm]
    return len(rows), sorted(found, key=lambda one: -(one.rms_mm or 0.0))


Within = Literal["campaigns", "limits"]

MOST_POSES = 2000
DRAWN_POSES = 500
FREE_TURN_RAD, FREE_SHIFT_M = math.pi, 0.5  # of a joint without limits


def preview(database: Database, version_id: str, temperature_c: float | None) -> VersionPreview:
    """Say what a version does over the robot's poses; nothing is stored.

    Raises:
        ServiceError: no such version.

    """
    robot, within, found = over_poses(database, version_id, temperature_c)
    return wire.preview(version_id, robot, found, within, temperature_c)


def over_poses(
    database: Database, version_id: str, temperature_c: float | None
) -> tuple[Robot, Within, PreviewedPoses]:
    """Correct the poses that the robot was driven to ("campaigns"), else poses drawn within its joint limits ("limits").

    Raises:
        ServiceError: no such version.

    """
    with database.reading() as session:
        record = store.get(session, version_id)
        calibration, known = store.calibration(session, version_id), store.load_predictive(session, version_id)
        driven = campaigns.driven(session, record.robot_id, calibration.robot, MOST_POSES)
    q = drawn(calibration.robot) if driven is None else driven[:MOST_POSES]
    found = at_poses(calibration, known, CorrectionLimits(**record.limits), q, temperature_c)
    return calibration.robot, "limits" if driven is None else "campaigns", found


def at_poses(
    calibration: Calibration,
    known: Predictive | None,
    limits: CorrectionLimits,
    q: Floats,
    temperature_c: float | None = None,
) -> PreviewedPoses:
    """Correct poses ``q (N, n)`` as `correct` corrects a file of them without times, within these limits."""
    found = outcome.correct(calibration, Observations(q=q), correction_options(limits, temperature_c), known)
    with np.errstate(over="ignore"):  # a version of nonsense moves the tool beyond all numbers
        moved = np.linalg.norm(found.done.error_removed, axis=1)
    return PreviewedPoses(
        q=q,
        words=tuple(found.words),
        moved=moved,
        left=found.remaining_errors,
        delta=found.done.q - q,
        unsupported=found.done.not_corrected,
        where_stated=found.done.where_stated,
    )


def drawn(robot: Robot, count: int = DRAWN_POSES) -> Floats:
    """Poses (N, n), rad or m, all over the limits; the same every time."""
    free = np.array([FREE_SHIFT_M if joint.kind == "prismatic" else FREE_TURN_RAD for joint in robot.joints])
    low, high = np.maximum(robot.limits[:, 0], -free), np.minimum(robot.limits[:, 1], free)
    outside = low > high  # limits that lie beyond a full turn
    low, high = np.where(outside, robot.limits[:, 0], low), np.where(outside, robot.limits[:, 1], high)
    return np.random.default_rng(0).uniform(low, high, (count, len(free)))
