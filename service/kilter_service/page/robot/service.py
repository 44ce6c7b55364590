"""What the first view of a robot answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns.suspicious import service as suspicious
from kilter_service.contract.campaigns import Campaign, SuspiciousRows
from kilter_service.contract.jobs.gap import GAP, GapResult
from kilter_service.contract.jobs.job import JobSummary
from kilter_service.contract.robot_reports import RobotReport
from kilter_service.contract.today import Today
from kilter_service.contract.versions import Activation, Version, VersionSummary
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page
from kilter_service.ground.settings import Settings
from kilter_service.jobs import service as jobs
from kilter_service.page.shared.accuracy import Accuracy, accuracy_today
from kilter_service.page.shared.control_chart import Watched, draw_check_history
from kilter_service.page.shared.correcting import Correcting, corrector
from kilter_service.page.shared.error_budget import Budget, error_budget
from kilter_service.page.shared.state import State, assess_robot_state
from kilter_service.robots import service as robots
from kilter_service.robots.compensation import WORDS
from kilter_service.versions import service as versions
from kilter_service.versions.drift import service as drift
from kilter_service.versions.today import service as today

NEWEST = Page(limit=50)


@dataclass(frozen=True)
class Shown:
    """A robot; ``version`` is the active one, ``candidate`` a newer one that is not, ``looked_at`` the one of the picture,
    ``other`` the one that is drawn beside it.
    """

    robot: RobotReport
    today: Today
    version: Version | None
    accuracy: Accuracy | None
    activation: Activation | None
    earlier: bool  # whether there is an activation before it, to go back to
    candidate: VersionSummary | None
    correcting: Correcting
    latest: JobSummary | None
    campaigns: Sequence[Campaign]
    versions: Sequence[VersionSummary]
    looked_at: VersionSummary | None
    other: VersionSummary | None
    campaign: Campaign | None
    suspicious: Sequence[SuspiciousRows]
    watched: Watched
    budget: Budget | None
    chosen: bool  # whether the address says what is drawn
    controllers: Mapping[str, str] = field(default_factory=lambda: WORDS)

    @property
    def state(self) -> State:
        """How the robot stands."""
        return assess_robot_state(self.today, self.correcting)

    @property
    def unseen(self) -> int:
        """How many parameters the measurements of the active version could not tell."""
        rows = [] if self.version is None else self.version.parameters
        return sum(one.identifiable is False or one.value is None for one in rows)


def shown_robot(
    database: Database, settings: Settings, name: str, version: str | None, campaign: str | None, other: str = ""
) -> Shown:
    """Return what the view shows; ``version`` and ``campaign`` are those of the picture, where they were chosen."""
    robot, now = robots.get(database, name), today.of_robot(database, name)
    active = None if robot.active_version is None else versions.get(database, robot.active_version)
    log = versions.activations(database, name, Page(limit=2)).activations
    made = versions.list_versions(database, name, NEWEST).versions
    newest = jobs.list_jobs(database, name, Page(limit=1)).jobs
    measured = [one for one in campaigns.list_campaigns(database, name, Page()).campaigns if one.rows]
    beside = _version(database, name, made, other)
    looked_at = _version(database, name, made, version) or active or (made[0] if made else None)
    older = {one.id: one for one in (active, looked_at, beside) if one is not None}
    return Shown(
        robot=robot,
        today=now,
        version=active,
        accuracy=accuracy_today(now),
        activation=log[0] if log else None,
        earlier=len(log) > 1,
        candidate=next((one for one in made if not one.active), None) if made and not made[0].active else None,
        correcting=corrector(database, settings).describe_correction(
            name, robot.active_version, robot.controller_compensation
        ),
        latest=newest[0] if newest else None,
        campaigns=measured,
        versions=[*made, *(one for key, one in older.items() if key not in {each.id for each in made})],
        looked_at=looked_at,
        other=beside,
        campaign=_campaign(database, measured, looked_at, campaign, now),
        watched=draw_check_history(drift.of_robot(database, name), now),
        budget=error_budget(now, active, _search_of(database, active, now)),
        suspicious=[] if active is None else suspicious.of_campaigns(database, (one.id for one in active.campaigns)),
        chosen=bool(version or campaign or other),
    )


def _version(
    database: Database, robot: str, newest: Sequence[VersionSummary], wanted: str | None
) -> VersionSummary | None:
    """A version that the address names, of this robot, however many came after it; None: there is none such."""
    if not wanted:
        return None
    if found := next((one for one in newest if one.id == wanted), None):
        return found
    try:
        older = versions.get(database, wanted)
    except ServiceError:
        return None
    return older if older.robot == robot else None


@dataclass(frozen=True)
class Standing:
    """What every view of a robot says first: its state, and today's number with where it is from."""

    robot: RobotReport
    state: State
    accuracy: Accuracy | None
    seen_on: str  # campaign and date of the number


def standing(database: Database, settings: Settings, name: str) -> Standing:
    """Return how a robot stands, from what its overview says."""
    robot, now = robots.get(database, name), today.of_robot(database, name)
    accuracy = accuracy_today(now)
    correcting = corrector(database, settings).describe_correction(
        name, robot.active_version, robot.controller_compensation
    )
    measured = [] if now.newest is None else now.newest.campaigns
    seen_on = ", ".join(f"{one.name}, {one.when}" for one in measured)
    return Standing(robot, assess_robot_state(now, correcting), accuracy, seen_on)


def _search_of(database: Database, version: Version | None, now: Today) -> GapResult | None:
    """The gap search that made a version, if it is the newest; None: another job did."""
    if version is None or now.missing is None or now.missing.job_id != version.job_id:
        return None
    job = jobs.get(database, version.job_id)
    return job.result if GAP.is_kind_of(job) else None


def _campaign(
    database: Database, measured: Sequence[Campaign], version: VersionSummary | None, wanted: str | None, now: Today
) -> Campaign | None:
    """The campaign that was chosen, else that of today's errors, else one that no fit used, else the newest."""
    by_id = {one.id: one for one in measured}
    if wanted in by_id:
        return by_id[wanted]
    if version is not None and version.id == now.version_id and now.newest is not None:
        for seen in now.newest.campaigns:  # the picture beside today's number shows today's rows
            if seen.id in by_id:
                return by_id[seen.id]
    used = [] if version is None else versions.get(database, version.id).campaigns
    for use in ("validation", "confirmation", "train"):
        for one in used:
            if one.use == use and one.id in by_id:
                return by_id[one.id]
    return measured[-1] if measured else None
