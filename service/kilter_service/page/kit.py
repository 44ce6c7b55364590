"""What the kit says of an arm: views so far, those still missing, and what the newest identification found in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from fastapi import Request
from fastapi.responses import HTMLResponse

from kilter_core.errors import RobotError
from kilter_files import rig as files_rig
from kilter_files.rig import (
    NOTHING,
    Capture,
    Rig,
    Row,
    coverage_columns,
    describe_tool_error,
    describe_views,
    result_summary,
)
from kilter_service.campaigns import looking
from kilter_service.campaigns import service as campaigns
from kilter_service.campaigns.facts import campaign_cache_key
from kilter_service.contract.campaigns import Campaign
from kilter_service.contract.versions import Version
from kilter_service.ground.db import Database
from kilter_service.ground.limits import Recent
from kilter_service.ground.paging import Page
from kilter_service.ground.wire import to_deg
from kilter_service.page.answers import render, router
from kilter_service.robots import service as robots
from kilter_service.robots.documents import convert
from kilter_service.versions import service as versions
from kilter_service.web.routing import DatabaseOfApp

NEWEST = Page(limit=20)
CORNER = "u1_px"  # a column that only views have
BACKLASH = "backlash_load_"
# A page that is open asks every few seconds, and neither the rows of a campaign nor a version change.
_rows = Recent[list[Row]](40)
_tables = Recent[bytes](40)
_chains = Recent[dict[str, Any]](40)
_captures = Recent[Capture](40)
Views = Mapping[str, Sequence[Row]]  # by the id of their campaign


Arm = tuple[str, Sequence[Mapping[str, Any]], Mapping[str, Any]]  # digest, joints, document of convention ``chain``


def _capture(arm: Arm, views: Views, used: Sequence[Campaign]) -> Capture:
    """What the views of some campaigns cover."""
    sha256, joints, chain = arm
    rows = [row for one in used for row in views[one.id]]
    key = (sha256, *map(campaign_cache_key, used))
    return _captures.get(key, lambda: files_rig.coverage(rows, joints, chain, _rig(used)))


def shown_kit(database: Database, name: str) -> dict[str, Any]:
    """Return an arm, its campaigns of views, what they cover, and what was found; None where there is nothing yet."""
    robot = robots.get(database, name)
    joints = [joint.model_dump() for joint in robot.joints]
    used, rows = [], dict[str, list[Row]]()
    for campaign in campaigns.list_campaigns(database, name, NEWEST).campaigns:
        views = _rows.get(campaign_cache_key(campaign), partial(_views, database, campaign, len(joints)))
        if views:
            used.append(campaign)
            rows[campaign.id] = views
    arm = (robot.sha256, joints, _chains.get(robot.sha256, partial(convert, robot.document, "chain")))
    capture = _capture(arm, rows, used) if rows else None
    return {
        "robot": robot,
        "campaigns": used,
        "capture": capture,
        "seen": "" if capture is None else describe_views(capture.views, capture.poses, capture.payloads_kg),
        "found": _find_newest_result(database, name, rows, used, arm),
        "steps": files_rig.steps(robot.name),  # one command or sentence each
    }


def _views(database: Database, campaign: Campaign, joints: int) -> list[Row]:
    """The rows of a campaign of views; nothing of another one."""
    if all(column.name != CORNER for column in looking.columns(database, campaign.id)):
        return []
    table = looking.load_campaign_rows(database, campaign.id).table
    columns: dict[str, Sequence[float | None]] = {}
    for name in coverage_columns(joints, _rig([campaign])):
        in_rad = name.replace("_deg", "_rad")
        if name in table.column_names:
            columns[name] = table[name].to_pylist()
        elif in_rad in table.column_names:
            columns[name] = [None if value is None else to_deg(value) for value in table[in_rad].to_pylist()]
    return [{name: values[k] for name, values in columns.items()} for k in range(table.num_rows)]


def _rig(used: Sequence[Campaign]) -> Rig:
    """Cameras and boards of some campaigns: those of the newest, where they differ."""
    some = next((one.conditions for one in reversed(used) if one.conditions.cameras), None)
    parts = {"cameras": some and some.cameras, "boards": some and some.boards}
    return {name: [one.model_dump() for one in listed or []] for name, listed in parts.items()}


def _find_newest_result(
    database: Database, robot: str, views: Views, used: Sequence[Campaign], arm: Arm
) -> dict[str, Any] | None:
    """What the newest version says that was made from such views with backlash among its effects."""
    for summary in versions.list_versions(database, robot, NEWEST).versions:
        version = versions.get(database, summary.id)
        named = {one.id for one in version.campaigns}
        from_views = [one for one in used if one.id in named]
        if from_views and any(one.name.startswith(BACKLASH) for one in version.parameters):
            return _found_from_version(database, version, arm[1], _capture(arm, views, from_views).untold)
    return None


def _found_from_version(
    database: Database, version: Version, joints: Sequence[Mapping[str, Any]], untold: Mapping[int, str]
) -> dict[str, Any]:
    """What a version says of the arm: sentences, the largest first, warnings, and the error of the tool."""
    table = _tables.get(version.id, lambda: _table(database, version.id))
    told = result_summary(version.model_dump(), joints, table, untold)
    off_by = describe_tool_error(told["before_mm"], told["after_mm"])
    return {"version": version, "lines": told["lines"] or [NOTHING], "warnings": told["warnings"], "off_by": off_by}


def _table(database: Database, version_id: str) -> bytes:
    """The version as a table, whose comments tell its zeros; nothing where no table describes its chain."""
    try:
        text = versions.export_version(database, version_id, "mdh-csv").text
    except RobotError:
        return b""
    return text if isinstance(text, bytes) else text.encode()


@router.get("/robots/{robot}/kit")
def kit(robot: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show how far the views of an arm go, and what they said of it."""
    return render(request, "kit/kit.html", shown=shown_kit(database, robot))
