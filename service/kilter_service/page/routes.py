"""All routes of the page."""

from __future__ import annotations

from fastapi import APIRouter

from kilter_service.page.access.routes import router as access
from kilter_service.page.assets import router as assets
from kilter_service.page.audit.routes import router as audit
from kilter_service.page.campaign.routes import router as campaign
from kilter_service.page.correct.routes import router as correct
from kilter_service.page.drop.routes import router as drop
from kilter_service.page.find.routes import router as find
from kilter_service.page.fleet.routes import router as fleet
from kilter_service.page.gap.routes import router as gap
from kilter_service.page.job_list.routes import router as job_list
from kilter_service.page.jobs.routes import router as jobs
from kilter_service.page.kit.routes import router as kit
from kilter_service.page.login.routes import router as login
from kilter_service.page.new_robot.routes import router as new_robot
from kilter_service.page.report.routes import router as report
from kilter_service.page.robot.routes import router as robot
from kilter_service.page.stream.routes import router as stream
from kilter_service.page.versions.routes import router as versions

ROUTERS: tuple[APIRouter, ...] = (
    assets,
    login,
    fleet,
    find,
    robot,
    versions,
    drop,
    campaign,
    stream,
    report,
    audit,
    job_list,
    gap,
    jobs,
    new_robot,
    correct,
    kit,
    access,
)
