"""Frames over HTTP; nothing is stored."""

from __future__ import annotations

from fastapi import APIRouter

from kilter_service.contract.kinematics import Frame, NewFrame
from kilter_service.robots.frames import service
from kilter_service.web.routing import GuardedRoute

router = APIRouter(prefix="/v1/frames", tags=["frames"], route_class=GuardedRoute)


@router.post("")
def make(frame: NewFrame) -> Frame:
    """Find a frame from digitised points: known points measured again, or a plane, a line in it and an origin."""
    return service.find_frame(frame)
