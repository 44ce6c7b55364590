"""The rows of a robot that versions were not fitted to: always whole poses, because a repeat of a pose reveals its errors.

What a version leaves of every row of its campaigns: a table in which anybody can check it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kilter_core.errors import CoreError, FindingDocument
from kilter_core.observations import (
    Observations,
    is_trajectory,
    numbered_poses,
    rounded_poses,
    rows_beyond_chance,
    segments,
)
from kilter_core.types import Bools, Floats, Ints
from kilter_files.ground.later import pa
from kilter_service.campaigns import store as campaigns
from kilter_service.contract.versions import Objection
from kilter_service.ground.core import core_evaluate, core_identify, core_measurement
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.tables.writing import write_table
from kilter_service.robots import store as robots
from kilter_service.versions import store, wire
from kilter_service.versions.objections import ERRORS_OF_DOUBT, SHARE_OF_DOUBT, variance
from kilter_service.versions.records import VersionRecord
from kilter_service.versions.store import Training

if TYPE_CHECKING:
    from kilter_core.arm import Robot
    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations


NUMBERS_EACH = 6  # coordinates for each parameter of a re-zeroing, from which on it took little of their errors
MOST_ROWS = 1_000_000  # read of campaigns nobody trained on, the newest first: some seconds


@dataclass(frozen=True)
class Unseen:
    """Rows by campaign, the campaigns that were left unread or could not be, and where in its campaign each row is, from 0."""

    rows: dict[str, Observations]
    left_out: dict[str, str]
    places: dict[str, Ints] = field(default_factory=dict)


@dataclass
class Archive:
    """The rows of one robot as they are stored; every campaign is read once."""

    session: Session
    robot_id: int
    left_out: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.robot: Robot = robots.core_robot(self.session, self.robot_id)
        self._read: dict[str, Observations | None] = {}

    def rows(self, campaign_id: str) -> Observations | None:
        """All rows of a campaign; None when it has none that can be read."""
        if campaign_id not in self._read:
            try:
                self._read[campaign_id] = campaigns.observations(self.session, campaign_id, self.robot)
            except CoreError as error:
                self._read[campaign_id], self.left_out[campaign_id] = None, error.message
        return self._read[campaign_id]

    def mark_uploaded_rows(self, campaign_id: str, hashes: Collection[str]) -> Bools:
        """Mark the rows of a campaign that came in uploads with these hashes."""
        uploads = campaigns.uploads_of_campaign(self.session, campaign_id)
        return np.repeat([u.sha256 in hashes for u in uploads], [u.rows for u in uploads]).astype(bool)

    def mark_fitted_rows(self, version: str, campaign_id: str) -> Bools:
        """Mark the rows of a campaign that a version, or one that it continues, was fitted to."""
        return self._collect_training(store.trainings(self.session, version)).mask(campaign_id)

    def count_fitted_rows(self, version: str, campaign_id: str) -> int:
        """Count the rows of a campaign that a version, or one that it continues, was fitted to, in whatever order or file.

        A motion may have a few by chance: an arm at rest reads the same twice.
        """
        rows = self.rows(campaign_id)
        if rows is None:
            return 0
        trained = self._collect_training(store.trainings(self.session, version))
        marked = int(trained.mask(campaign_id).sum())
        return max([marked, *(len(rows_beyond_chance(part, rows)) for part in trained.fitted_rows())])

    def unseen(self, versions: Iterable[str]) -> Unseen:
        """Rows at poses none of these versions was fitted to."""
        return self.unfitted_rows(part for version in versions for part in store.trainings(self.session, version))

    def fitted_by_each(self, fits: Iterable[Iterable[Training]]) -> Unseen:
        """Rows that every one of these fits took."""
        all_trained = [self._collect_training(trainings) for trainings in fits]
        out = {}
        for campaign_id in self._worth_reading(set[str]().union(*(trained.rows for trained in all_trained))):
            rows = self.rows(campaign_id)
            if rows is None:
                continue
            shared = np.logical_and.reduce([trained.mask(campaign_id) for trained in all_trained])
            if shared.any():
                out[campaign_id] = rows.select(shared)
        return Unseen(out, dict(self.left_out))

    def _collect_training(self, trainings: Iterable[Training]) -> _Trained:
        trained = _Trained(self)
        for training in trainings:
            trained.add(training)
        return trained

    def unfitted_rows(self, trainings: Iterable[Training]) -> Unseen:
        """Rows at poses that nothing was fitted to."""
        trained = self._collect_training(trainings)
        poses = trained.poses()
        out, places = {}, {}
        for campaign_id in self._worth_reading(set(trained.rows)):
            rows = self.rows(campaign_id)
            if rows is None:
                continue
            free = _free(rows, trained.mask(campaign_id), poses) & ~trained.sent_again(rows)
            if free.any():
                out[campaign_id], places[campaign_id] = rows.select(free), np.flatnonzero(free)
        return Unseen(out, dict(self.left_out), places)

    def _worth_reading(self, always: set[str]) -> list[str]:
        chosen, read = [], 0
        for campaign_id in reversed(campaigns.ids_of_robot(self.session, self.robot_id)):
            count = sum(upload.rows for upload in campaigns.uploads_of_campaign(self.session, campaign_id))
            if count == 0:
                continue
            if campaign_id not in always and read + count > MOST_ROWS:
                self.left_out[campaign_id] = f"Campaign {campaign_id} was not read: newer ones hold rows enough."
                continue
            read += 0 if campaign_id in always else count
            chosen.append(campaign_id)
        return chosen


@dataclass
class _Trained:
    """Which rows were fitted: of each campaign a mask, by the hashes of the uploads a version names."""

    archive: Archive
    rows: dict[str, Bools] = field(default_factory=dict)
    hashes: set[str] = field(default_factory=set)  # of uploads that were fitted whole
    whole: set[str] = field(default_factory=set)  # campaigns whose poses are known to the version

    def add(self, training: Training) -> None:
        if not self._changed_little(training):
            self.whole.update(campaign_id for campaign_id, _ in training.campaigns)
        masks = None if training.fraction is None else self._split(training, training.fraction)
        for campaign_id, hashes in training.campaigns:
            named = self.archive.mark_uploaded_rows(campaign_id, hashes)
            mask = self.rows.setdefault(campaign_id, np.zeros(len(named), dtype=bool))
            if masks is None:
                self.hashes.update(hashes)
                mask |= named
            else:
                mask[np.flatnonzero(named)[masks[campaign_id]]] = True

    def mask(self, campaign_id: str) -> Bools:
        """Rows of a campaign that were fitted, there or as the same file in another campaign."""
        whole = self.archive.mark_uploaded_rows(campaign_id, self.hashes)
        return whole | self.rows.get(campaign_id, np.zeros(len(whole), dtype=bool))

    def poses(self) -> Floats:
        """Joints (N, n) of the poses at which a fit followed the errors, so that a repeat of them proves nothing.

        A re-zeroing that took one number from eighteen follows nothing: the same planned poses are measured every day, and
        those of a later day are new.
        """
        fitted = [rows.q for rows in self._fitted_rows_of_campaigns(self.whole)]
        return np.concatenate([np.zeros((0, self.archive.robot.n_joints)), *fitted])

    def sent_again(self, rows: Observations) -> Bools:
        """Mark rows that a re-zeroing took, in whatever file: their poses may come again, and they may not."""
        out = np.zeros(len(rows), dtype=bool)
        for part in self._fitted_rows_of_campaigns(set(self.rows) - self.whole):
            out[rows_beyond_chance(part, rows)] = True
        return out

    def _changed_little(self, training: Training) -> bool:
        """Whether so few parameters were taken from so many coordinates that these errors stayed as they were."""
        if training.changed is None:
            return False
        parts = [self.archive.rows(campaign_id) for campaign_id, _ in training.campaigns]
        return training.changed * NUMBERS_EACH <= sum(3 * len(rows) for rows in parts if rows is not None)

    def fitted_rows(self) -> list[Observations]:
        """The rows that were fitted, of each campaign that can be read."""
        return self._fitted_rows_of_campaigns(self.rows)

    def _fitted_rows_of_campaigns(self, campaigns: Iterable[str]) -> list[Observations]:
        parts = [(self.archive.rows(one), self.rows[one]) for one in campaigns if one in self.rows]
        return [rows.select(mask) for rows, mask in parts if rows is not None]

    def _split(self, training: Training, fraction: float) -> dict[str, Bools] | None:
        """Rows fitted of each campaign's named uploads, as the job drew them; None when that is no longer known."""
        try:
            parts = [
                campaigns.observations(self.archive.session, c, self.archive.robot, only=hashes)
                for c, hashes in training.campaigns
            ]
            whole = Observations.concatenate(campaigns.renumber_poses_and_sessions(parts))
            if training.rounded and whole.pose_id is None:
                whole = replace(whole, pose_id=rounded_poses(whole.q))
            inside = np.zeros(len(whole), dtype=bool)
            inside[_draw(training, whole, fraction)] = True
        except (CoreError, KeyError):
            return None
        ends = np.cumsum([len(part) for part in parts])[:-1]
        return dict(zip((c for c, _ in training.campaigns), np.split(inside, ends), strict=True))


def _draw(training: Training, rows: Observations, fraction: float) -> Ints:
    """Indices of the rows that a job fits when a fraction is held out."""
    if training.by_content:
        return core_identify.split(rows, fraction, training.seed)[0]
    return fitted_by_order(rows, fraction, training)


def _free(rows: Observations, trained: Bools, poses: Floats) -> Bools:
    """Rows whose whole pose is neither fitted nor at the joint readings of a pose that was."""
    numbers = numbered_poses(np.concatenate([poses, rows.q]))
    seen = trained | np.isin(numbers[len(poses) :], numbers[: len(poses)])
    groups = numbers[len(poses) :] if rows.pose_id is None else rows.pose_groups()
    return np.asarray(~np.isin(groups, np.unique(groups[seen])))


# How earlier releases drew held-out poses: by the order of the rows, each kind of job in a way of its own.
# Their versions were fitted to the rest, so what they were fitted to stays told as it was.


def fitted_by_order(rows: Observations, fraction: float, training: Training) -> Ints:
    """Indices of the rows that a job of an earlier release fitted when a fraction was held out."""
    search, placed = training.kind == "gap", core_measurement.placements(rows)
    if search and is_trajectory(rows):
        held = _of_motions(rows, fraction, training.seed)
    elif search and training.unasked and placed is None:
        held = _evenly(rows, fraction, training.seed)
    else:
        groups, few = (rows.pose_groups(), False) if placed is None else (placed[0], True)
        held = np.isin(groups, _drawn(int(groups.max()) + 1, fraction, training.seed, few))
    return np.flatnonzero(~held)


def _drawn(count: int, fraction: float, seed: int, few: bool) -> Ints:
    """Numbers that were held out of so many; of a few at least one."""
    held = round(fraction * count)
    held = min(max(held, 1), count - 1) if few else held
    return np.random.default_rng(seed).permutation(count)[:held]


def _evenly(rows: Observations, share: float, seed: int) -> NDArray[np.bool_]:
    groups = rows.pose_groups()
    again = np.bincount(groups) > 1
    rng = np.random.default_rng(seed)
    held = [rng.permutation(np.flatnonzero(kind))[: int(share * np.sum(kind))] for kind in (again, ~again)]
    return np.isin(groups, np.concatenate(held))


def _of_motions(rows: Observations, fraction: float, seed: int) -> NDArray[np.bool_]:
    motion = segments(rows)
    count = int(motion.max()) + 1
    if count == 1:
        return np.asarray(np.arange(len(rows)) >= round((1.0 - fraction) * len(rows)))
    return np.isin(motion, _drawn(count, fraction, seed, few=True))


CODE = "larger_own_error"
COMPARED = "own_errors_compared"
REMEDY = " Measure poses that neither was fitted to (kilter upload --role confirmation) and activate again."


@dataclass(frozen=True)
class OwnError:
    """Mean error of a version, mm, on so many rows of its own job, with the variance of its mean, mm^2."""

    mean: float
    rows: int
    doubt: float
    held_out: bool

    @staticmethod
    def from_report(report: Mapping[str, Any], block: str) -> OwnError | None:
        """The error on the rows of a block, "validation" or "train"; None: none is stored."""
        return OwnError.read((report.get("metrics") or {}).get(block) or {}, block == "validation")

    @staticmethod
    def read(rows: Mapping[str, Any], held_out: bool) -> OwnError | None:
        """The error of the identified model in stored errors of some rows; None: none is stored."""
        found = rows.get("identified") or {}
        if found.get("mean_mm") is None:
            return None
        count = max(int(rows.get("n") or 1), 1)
        return OwnError(float(found["mean_mm"]), count, variance(found) / count, held_out)

    def beyond(self, other: OwnError) -> bool:
        """Whether it is larger than another by more than chance explains."""
        margin = max(ERRORS_OF_DOUBT * math.sqrt(self.doubt + other.doubt), SHARE_OF_DOUBT * other.mean)
        return self.mean - other.mean > margin

    @property
    def words(self) -> str:
        """The number with what it is of."""
        return f"{self.mean:.4g} mm on {self.rows} rows that it {'held out' if self.held_out else 'was fitted to'}"


def compare_with_active(
    new: Mapping[str, Any], rival: Mapping[str, Any], active: str
) -> tuple[list[Objection], list[FindingDocument]]:
    """What the stored errors of a version say beside those of the active one: an objection, or a remark with both numbers.

    Errors of fitted rows flatter, the more so the fewer the rows: they count against the version only, and of the active
    one held-out rows are needed.
    """
    mine, other = (
        OwnError.from_report(new, "validation") or OwnError.from_report(new, "train"),
        OwnError.from_report(rival, "validation"),
    )
    if mine is None or other is None:
        return [], []
    message = (
        f"No measured pose is new to both it and version {active}, active now, so each is taken by its own rows: it leaves "
        f"{mine.words}, version {active} {other.words}."
    )
    if mine.beyond(other):
        return [Objection(code=CODE, message=message + REMEDY)], []
    return [], [FindingDocument.make(COMPARED, message)]


def larger(now: Mapping[str, Any], before: Mapping[str, Any]) -> float | None:
    """By how much, mm, the stored mean error of some rows is larger than that of others; None: chance explains it."""
    mine, other = OwnError.read(now, True), OwnError.read(before, True)
    return mine.mean - other.mean if mine is not None and other is not None and mine.beyond(other) else None


Columns = dict[str, Any]


@dataclass(frozen=True)
class Part:
    """A campaign's rows, which of them were fitted, and the rows (from 1) that were set aside.

    ``own``: the version was made from it.
    """

    campaign: str
    rows: Observations
    fitted: Bools
    set_aside: frozenset[int]
    own: bool

    def calibration_for_rows(self, calibration: Calibration) -> Calibration:
        """The version as it predicts these rows."""
        return calibration if self.own else calibration.for_another_campaign(self.rows)


def residuals(database: Database, version: str, wanted: Sequence[str], media: str) -> bytes:
    """Return the table of :func:`table` as CSV or Parquet."""
    return write_table(table(database, version, wanted), media)


def table(database: Database, version: str, wanted: Sequence[str], expected: bool = True) -> pa.Table:
    """Return what is left of the rows of campaigns, by default of all the version was made from.

    ``expected`` with half the interval that expects each row, which takes most of the time; without it they are empty.

    Raises:
        ServiceError: no such version or campaign, or a campaign of another robot.
        ObservationError: a campaign of contacts or distances, whose rows have no errors of their own.

    """
    with database.reading() as session:
        row = store.get(session, version)
        calibration, known = (
            store.calibration(session, version),
            store.load_predictive(session, version) if expected else None,
        )
        parts = list(load_parts(session, row, wanted))
        report = row.report
    if not parts:
        raise ServiceError(
            f"Version {version} was made from no campaign, so it leaves nothing: name campaigns, ?campaign=cmp_....",
            code="campaigns_invalid",
            version=version,
        )
    return pa.concat_tables([pa.table(_columns(part, calibration, known, report)) for part in parts])


def load_parts(session: Session, version: VersionRecord, wanted: Sequence[str]) -> Iterator[Part]:
    """Read the rows of campaigns, by default of all a version was made from, and what its fit did with each.

    Raises:
        ServiceError: a campaign of another robot.

    """
    archive, own = Archive(session, version.robot_id), store.training_campaign_ids(session, version.id)
    for campaign in wanted or dict.fromkeys(used["id"] for used in version.campaigns):
        if campaigns.whole(session, campaign).robot_id != version.robot_id:
            raise ServiceError(
                f"Campaign {campaign} is of another robot than version {version.id}: name campaigns of its robot.",
                code="option_invalid",
                campaign=campaign,
            )
        rows = campaigns.observations(session, campaign, archive.robot)
        named = version.report.get("set_aside") or []
        aside = [one["row"] for one in named if one["campaign"] == campaign]
        yield Part(campaign, rows, archive.mark_fitted_rows(version.id, campaign), frozenset(aside), campaign in own)


def _columns(part: Part, calibration: Calibration, known: Predictive | None, report: dict[str, Any]) -> Columns:
    count = len(part.rows)
    out: Columns = {"campaign": [part.campaign] * count, "row": np.arange(1, count + 1)}
    out |= _row_errors(part, calibration, known, report)
    out["set_aside"] = np.isin(out["row"], list(part.set_aside))
    out["held_out"] = ~part.fitted
    return out


def _row_errors(part: Part, calibration: Calibration, known: Predictive | None, report: dict[str, Any]) -> Columns:
    """Errors of the rows, and half the interval that expects them."""
    calibration = part.calibration_for_rows(calibration)
    count, shape = len(part.rows), calibration.marker_points
    error, u95 = np.full((count, 3), np.nan), np.full((count, 3), np.nan)
    turn, size = np.full(count, np.nan), np.full(count, np.nan)
    point_noise, turn_noise = wire.noise_from_report(report)
    for where, refit in iter_frame_groups(part, report):
        measurement = core_measurement.Measurement.from_observations(part.rows.select(where), shape, held=True)
        here = refit_frames(calibration, measurement, refit) if refit else calibration
        if not measurement.observes_places:  # views say it one by one, contacts and distances only together
            error[where], turn[where], size[where] = measurement.tool.row_errors(here)
            continue
        left = measurement.residual(here.predict(measurement.observations))
        error[where] = core_evaluate.mean_errors(left)
        half = None if known is None else core_evaluate.expected_error_half_widths(here, measurement, refit, known)
        u95[where] = np.nan if half is None else half
        if np.isnan(turn_noise):
            left = left.of_points()
        size[where] = core_identify.whitened_row_sizes(left, point_noise or np.nan, turn_noise or np.nan)
        if left.turns is not None:
            turn[where] = np.linalg.norm(left.turns, axis=1)
    return wire.residual_columns(error, u95, turn, size)


def iter_frame_groups(part: Part, report: dict[str, Any]) -> Iterator[tuple[Bools, tuple[str, ...]]]:
    """Rows given in one frame, and the frames that were fitted to them alone: a sheet lies in another place every time."""
    which: dict[int | None, tuple[str, ...]] = {}
    for frame in ("base", "tool"):
        for one in report.get(f"{frame}_refitted") or []:
            if one["campaign"] == part.campaign:
                which[one["session"]] = (*which.get(one["session"], ()), frame)
    session = np.zeros(len(part.rows)) if part.rows.session is None else part.rows.session
    rest = np.ones(len(part.rows), dtype=bool)
    for number, frames in which.items():
        mine = rest & (session == number) if number is not None else rest.copy()
        rest &= ~mine
        yield mine, frames
    if rest.any():
        yield rest, ()


def refit_frames(calibration: Calibration, measurement: Any, frames: Sequence[str]) -> Calibration:
    """Return a calibration with the frames in which it predicts these rows best."""
    return core_identify.with_own_frames(calibration, measurement, "huber", frames)
