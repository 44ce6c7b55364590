"""What a version leaves of every row of its campaigns: a table in which anybody can check it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kilter_core.types import Bools
from kilter_files.ground.later import pa
from kilter_service.campaigns import store as campaigns
from kilter_service.ground.core import core_evaluate, core_identify, core_measurement
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.tables.writing import write_table
from kilter_service.versions import store, wire
from kilter_service.versions.predictions.unfitted_rows import Archive
from kilter_service.versions.records import VersionRecord

if TYPE_CHECKING:
    from kilter_core.identify import Predictive
    from kilter_core.model import Calibration
    from kilter_core.observations import Observations

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
