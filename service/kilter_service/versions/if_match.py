"""The state that a change of the active version starts from: its ETag, and `If-Match` that names it.

Versions in the address of a request: by id, or as `tour v2`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Header

from kilter_service.ground import store as references
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.robots import store as robots
from kilter_service.versions import store
from kilter_service.web.routing import DatabaseOfApp

ANY = "*"


def activation_etag(session: Session, robot_id: int) -> str:
    """Return the ETag of which version a robot is corrected with: every entry of the log is another state."""
    last = store.active_entry(session, robot_id)
    return f'"activation-{0 if last is None else last.id}"'


def tag_of_robot(database: Database, robot: str) -> str:
    """Return the same of the robot of this name."""
    with database.reading() as session:
        return activation_etag(session, robots.get(session, robot).id)


@dataclass(frozen=True)
class Expected:
    """The ETags of `If-Match`; None when the request does not say from which state it starts."""

    tags: tuple[str, ...] | None = None

    def check(self, session: Session, robot_id: int, becomes: str | None = None) -> None:
        """Refuse a change that starts from another state.

        ``becomes`` is the version that shall be active: when it is already, the same request came before, and is done.

        Raises:
            ServiceError: none of the tags is that of the present state.

        """
        last = store.active_entry(session, robot_id)
        if self.tags is None or (last is not None and (becomes == last.version_id or ANY in self.tags)):
            return
        tag = activation_etag(session, robot_id)
        if tag in self.tags:
            return
        now = (
            "no version is active"
            if last is None
            else f"version {last.version_id} is, since {last.at:%Y-%m-%d %H:%M} UTC"
        )
        raise ServiceError(
            f"Another version was active when you looked: now {now}{'' if last is None else f' by {last.actor}'}. Nothing "
            "was changed. Look at it (`kilter version activations ROBOT`), and ask again if you still want to.",
            code="activation_changed",
            etag=tag,
            active=None if last is None else last.version_id,
        )


async def expected_from_header(
    if_match: Annotated[
        str | None,
        Header(
            max_length=1000,
            description="ETag of the robot's activations as you read it: refused with 412 when another version is active now",
        ),
    ] = None,
) -> Expected:
    """Return what `If-Match` of a request says; a dependency of its route."""
    return Expected(None if if_match is None else tuple(part.strip() for part in if_match.split(",")))


ANY_STATE = Expected()
ExpectedState = Annotated[Expected, Depends(expected_from_header)]


def _id_in_address(database: Database, text: str) -> str:
    if " " not in text:
        return text
    with database.reading() as session:
        return references.version_id(session, text)


def _version_id(version: str, database: DatabaseOfApp) -> str:
    return _id_in_address(database, version)


def _first_version_id(a: str, database: DatabaseOfApp) -> str:
    return _id_in_address(database, a)


def _second_version_id(b: str, database: DatabaseOfApp) -> str:
    return _id_in_address(database, b)


AddressedVersion = Annotated[str, Depends(_version_id)]
FirstVersion = Annotated[str, Depends(_first_version_id)]
SecondVersion = Annotated[str, Depends(_second_version_id)]
