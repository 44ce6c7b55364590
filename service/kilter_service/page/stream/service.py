"""What the view of a stream shows before the first news comes."""

from __future__ import annotations

from dataclasses import dataclass

from kilter_service.contract.bridges import Bridge
from kilter_service.contract.versions import Activation
from kilter_service.ground.called import display_name
from kilter_service.ground.db import Database
from kilter_service.ground.paging import Page
from kilter_service.ground.settings import Settings
from kilter_service.page.shared.correcting import Correcting, corrector
from kilter_service.robots import service as robots
from kilter_service.stream.bridges import service as known_bridges
from kilter_service.stream.live import service as live
from kilter_service.stream.live.heard import WHY
from kilter_service.stream.live.session import read_corrector_place
from kilter_service.stream.live.shown import RobotShown
from kilter_service.versions import service as versions

MOST_NAMES = 200  # of versions: one that corrects is hardly ever older


@dataclass(frozen=True)
class StreamView:
    """Streams of a robot, what is said of them elsewhere, who activated the active version, and why setpoints are refused."""

    shown: RobotShown
    activation: Activation | None
    reasons: dict[str, str]
    endpoint: str
    correcting: Correcting
    bridges: list[Bridge]
    names: dict[str, str]  # of its newest versions, by id


def view(database: Database, settings: Settings, robot: str) -> StreamView:
    """Return what is shown.

    Raises:
        ServiceError: no such robot.

    """
    shown = live.load_robot_view(database, settings, robot)
    entries = versions.activations(database, robot, Page(limit=1)).activations
    place = read_corrector_place(settings.corrector_file)
    endpoint = place.endpoint if place else settings.zenoh_listen
    arm = robots.get(database, robot)
    correcting = corrector(database, settings).describe_correction(
        robot, arm.active_version, arm.controller_compensation
    )
    bridges = known_bridges.of_robot(database, robot).bridges
    return StreamView(
        shown, entries[0] if entries else None, WHY, endpoint, correcting, bridges, version_names_by_id(database, robot)
    )


def version_names_by_id(database: Database, robot: str) -> dict[str, str]:
    """Return what the newest versions of a robot are called, by id."""
    return {
        one.id: display_name(one) for one in versions.list_versions(database, robot, Page(limit=MOST_NAMES)).versions
    }
