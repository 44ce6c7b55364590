"""What a version was fitted to, as far as a check asks: at which temperatures, to which rows; and which checks agreed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime

from kilter_service.campaigns import store as campaigns
from kilter_service.ground.db import Session
from kilter_service.ground.errors import ServiceError
from kilter_service.jobs.kind import Dates, FitOfVersion
from kilter_service.robots.repairs import store as repairs
from kilter_service.versions import store as versions
from kilter_service.versions.drift import store as drift
from kilter_service.versions.predictions.unfitted_rows import Archive


def load_version_fit(session: Session, version: str, named: Sequence[str]) -> FitOfVersion:
    """Return what a version, and those that it continues, were fitted to, against the campaigns that a job names."""
    trained = [one for training in versions.trainings(session, version) for one in training.campaigns]
    hashes = {sha256 for _, each in trained for sha256 in each}
    robot = versions.get(session, version).robot_id
    archive = Archive(session, robot)
    fitted = {c: archive.count_fitted_rows(version, c) for c in named}
    files = {c for c in named if any(upload.sha256 in hashes for upload in campaigns.uploads_of_campaign(session, c))}
    shared = [c for c in named if c in files or fitted[c]]
    seen = [value for campaign in {one for one, _ in trained} for value in _temperatures(session, campaign)]
    made = drift.of_version(session, robot, version, named)
    repaired = repairs.last_repair(session, robot)  # since then the arm is another one: no check agreed with it yet
    good = [one for one in made if one.result.get("verdict") == "ok" and (repaired is None or one.at >= repaired.at)]
    dates = Dates(
        max(drift.measurement_times_and_digests(session, named)[0].values(), default=None),
        max((one.at for one in made), default=None),
        max(
            (at for at in (_stated_measurement_time(session, one) for one, _ in trained) if at is not None),
            default=None,
        ),
    )
    agreeing = tuple(one for one in good if dates.rows is None or one.at <= dates.rows)
    temperatures = (min(seen), max(seen)) if seen else None
    used = frozenset(name for name in (_instrument(session, one) for one, _ in trained) if name is not None)
    return FitOfVersion(temperatures, tuple(shared), agreeing, fitted, dates, used)


def _stated_measurement_time(session: Session, campaign: str) -> datetime | None:
    """When a campaign was measured, as somebody stated; None: nobody did, or it was purged."""
    try:
        return campaigns.get(session, campaign).measured_at
    except ServiceError:
        return None


def _instrument(session: Session, campaign: str) -> str | None:
    """What a campaign was measured with; None: it does not say, or was purged."""
    try:
        return campaigns.get(session, campaign).instrument
    except ServiceError:
        return None


def _temperatures(session: Session, campaign: str) -> Iterator[float]:
    """Temperatures of a campaign: its lowest and highest row, else what was stated for the whole; none of a purged one."""
    try:
        stated = campaigns.get(session, campaign).conditions.get("temperature_c")
    except ServiceError:
        return
    if any("temperature_c" in upload.columns for upload in campaigns.uploads_of_campaign(session, campaign)):
        column = campaigns.table(session, campaign).column("temperature_c").to_numpy(zero_copy_only=False)
        yield from (float(column.min()), float(column.max()))
    elif stated is not None:
        yield float(stated)
