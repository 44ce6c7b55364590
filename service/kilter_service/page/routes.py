"""All routes of the page: whoever imports this has them; the first that fits an address answers."""

from __future__ import annotations

from fastapi import APIRouter

from kilter_service.page import access, audit, campaign, fleet, kit, new_robot, robot, stream
from kilter_service.page.answers import assets, router
from kilter_service.page.drop import routes as drop
from kilter_service.page.gap import story
from kilter_service.page.jobs import routes as jobs
from kilter_service.page.report import routes as report
from kilter_service.page.versions import routes as versions

VIEWS = (access, fleet, robot, versions, drop, campaign, stream, report, audit, story, jobs, new_robot, kit)
ROUTERS: tuple[APIRouter, ...] = (assets, router)
