"""What can be done with versions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kilter_service.campaigns import store as campaigns
from kilter_service.contract.previews import VersionPreview
from kilter_service.contract.versions import ActivationList, Version, VersionList, VersionSummary
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page, in_time
from kilter_service.ground.references import store as references
from kilter_service.robots import store as robots
from kilter_service.robots.exporters.exportable import Exportable
from kilter_service.robots.exporters.registry import Exported, export
from kilter_service.robots.into_controller import said_of_controller
from kilter_service.versions import store, wire
from kilter_service.versions.predictions import at_pose as poses
from kilter_service.versions.predictions import contributions as moves
from kilter_service.versions.predictions import joint_space
from kilter_service.versions.predictions import places as measured
from kilter_service.versions.predictions import residuals as left
from kilter_service.versions.predictions import workspace as space
from kilter_service.versions.predictions.preview import preview as looked_at

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


def list_versions(database: Database, robot: str, page: Page, with_retired: bool = False) -> VersionList:
    """List the versions of a robot; ``with_retired`` those that are out of use too."""
    with database.reading() as session:
        found = store.listed(session, robots.get(session, robot).id, page, with_retired)
    shown, cursor = page.cut(found, lambda version: in_time(version.created_at, version.id))
    return VersionList(versions=[wire.listed(version) for version in shown], next=cursor)


def active_of_robots(database: Database) -> dict[str, VersionSummary]:
    """Return the versions that robots are corrected with, by robot."""
    with database.reading() as session:
        return {found.robot: wire.summary(found) for found in store.active_of_robots(session)}


def get(database: Database, version_id: str) -> Version:
    """Return a version."""
    with database.reading() as session:
        return wire.version(store.get(session, version_id))


def made_with(database: Database, campaign_id: str) -> list[Version]:
    """Return the versions that were made with a campaign, newest first."""
    with database.reading() as session:
        campaign = campaigns.get(session, campaign_id)
        found = [store.get(session, one) for one in references.citing_campaign(session, campaign.robot_id, campaign_id)]
    return [wire.version(one) for one in sorted(found, key=lambda one: one.created_at, reverse=True)]


def activations(database: Database, robot: str, page: Page) -> ActivationList:
    """Return who activated which version of a robot, and when."""
    with database.reading() as session:
        found = store.activations(session, robots.get(session, robot).id, page)
    shown, cursor = page.cut(found, lambda entry: (str(entry.id),))
    return ActivationList(activations=[wire.activation(entry) for entry in shown], next=cursor)


def exported(database: Database, version_id: str, format_name: str) -> Exported:
    """Return a version as a file of another tool's format, and what to say of a controller that is given it."""
    with database.reading() as session:
        record = store.get(session, version_id)
        robot = robots.get(session, record.robot)
    found = export(format_name, Exportable(robot, wire.version(record), record.calibration))
    return found._replace(notes=(*found.notes, *said_of_controller(format_name, robot)))


def preview(database: Database, version_id: str, temperature_c: float | None) -> VersionPreview:
    """Say how a version would correct, without activating it."""
    return looked_at(database, version_id, temperature_c)


def residuals(database: Database, version_id: str, campaigns: Sequence[str], media: str) -> bytes:
    """Return what a version leaves of every row of campaigns, as a file."""
    return left.residuals(database, version_id, campaigns, media)


def contributions(database: Database, version_id: str) -> tuple[int, list[moves.Contribution]]:
    """Say how far each effect of a version moves the tool, and over how many poses."""
    return moves.contributions(database, version_id)


def places(database: Database, version_id: str, campaign: str) -> measured.Places:
    """Return the errors of a campaign's rows where they were measured: nominal, with registration only, with a version."""
    return measured.places(database, version_id, campaign)


def joint_errors(database: Database, version_id: str, campaign: str) -> Floats:
    """Return the errors of the rows of :func:`places` as the least motions (N, n) of the joints, rad or m."""
    return joint_space.joint_errors(database, version_id, campaign)


def at_pose(
    database: Database, version_id: str, q: Floats | None, campaign: str, row: int, temperature_c: float | None
) -> poses.AtPose:
    """Say where the tool is at a pose, what moves it there, and how well that is known."""
    return poses.at_pose(database, version_id, q, campaign, row, temperature_c)


def workspace(database: Database, version_id: str, temperature_c: float | None) -> space.Workspace:
    """Say what a version does at poses all over the joint limits, and where their tools are."""
    return space.workspace(database, version_id, temperature_c)


def reach(database: Database, version_id: str) -> measured.Reach:
    """Return how far a version corrects the tool, and how well it knows it, all over the joint limits."""
    return measured.reach(database, version_id)
