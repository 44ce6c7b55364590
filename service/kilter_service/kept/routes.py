"""References and tombstones over HTTP.

From a prefix, a name or `latest` to the one thing that it refers to.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Query

from kilter_service.contract.wording import By, Kind, ResolvedReference, TombstoneList
from kilter_service.ground import store
from kilter_service.ground.db import Database, Session
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.paging import Page, in_time
from kilter_service.ground.store import LATEST, PREFIXES, Found
from kilter_service.robots import store as robots
from kilter_service.web.routing import DatabaseOfApp, GuardedRoute, PageOfList

router = APIRouter(prefix="/v1", tags=["references"], route_class=GuardedRoute)


@router.get("/resolve")
def resolve(
    kind: Kind,
    reference: Annotated[
        str, Query(min_length=1, max_length=200, description="An id or its beginning, a name, or `latest`.")
    ],
    database: DatabaseOfApp,
    robot: Annotated[str | None, Query(max_length=64, description="Look among those of this robot only.")] = None,
) -> ResolvedReference:
    """Find the one campaign, version or job that a beginning of its id, its name, or `latest` refers to."""
    return resolve_reference(database, kind, reference, robot)


@router.get("/tombstones")
def tombstones(
    database: DatabaseOfApp,
    page: PageOfList,
    robot: Annotated[str | None, Query(max_length=64, description="Of this robot only.")] = None,
) -> TombstoneList:
    """List what was purged: its hash, who purged it, and when."""
    return list_tombstones(database, robot, page)


HEXADECIMAL = re.compile("[0-9a-f]+")
LEAST = 4  # digits of an id without what it begins with: a mistyped name of one letter would find something by chance
MOST_NAMED = 10


def resolve_reference(database: Database, kind: Kind, reference: str, robot: str | None) -> ResolvedReference:
    """Find what a reference refers to, among those of one robot or of all.

    A name takes precedence over the prefix of an id, because somebody chose it. What is in use takes precedence over
    what is retired.

    Raises:
        ServiceError: nothing, or more than one thing.

    """
    with database.reading() as session:
        robot_id = None if robot is None else robots.get(session, robot).id
        if reference == LATEST:
            found = store.newest(session, kind, robot_id)
            return _resolve_single(session, kind, reference, robot, robot_id, found, "latest")
        named = store.find_by_name(session, kind, robot_id, reference)
        numbered = store.find_by_number(session, robot_id, reference) if kind == "version" else []
        if numbered:  # somebody may have called another version so: then neither is guessed
            both = {one.id: one for one in (*numbered, *_prefer_in_use(named))}
            return _resolve_single(session, kind, reference, robot, robot_id, list(both.values()), "number")
        if named:
            newest_job = named[:1] if kind == "job" else named
            return _resolve_single(session, kind, reference, robot, robot_id, _prefer_in_use(newest_job), "name")
        text = reference.removeprefix(PREFIXES[kind])
        is_prefix = HEXADECIMAL.fullmatch(text) and (text != reference or len(text) >= LEAST)
        found = store.find_by_id_prefix(session, kind, robot_id, reference) if is_prefix else []
        exact = [one for one in found if one.id == reference]
        by: By = "id" if exact else "prefix"
        return _resolve_single(session, kind, reference, robot, robot_id, exact or found, by)


def _prefer_in_use(found: Sequence[Found]) -> Sequence[Found]:
    return [one for one in found if one.in_use] or found


def _resolve_single(
    session: Session,
    kind: Kind,
    reference: str,
    robot: str | None,
    robot_id: int | None,
    found: Sequence[Found],
    by: By,
) -> ResolvedReference:
    if not found:
        raise _nothing(session, kind, reference, robot, robot_id)
    if len(found) > 1:
        raise _several(kind, reference, found, by)
    return ResolvedReference(
        kind=kind, id=found[0].id, robot=found[0].robot, name=found[0].name, by=by, number=found[0].number
    )


def _nothing(session: Session, kind: Kind, reference: str, robot: str | None, robot_id: int | None) -> ServiceError:
    other = next((name for name, prefix in PREFIXES.items() if name != kind and reference.startswith(prefix)), None)
    there = store.newest(session, kind, robot_id, MOST_NAMED)
    has = "There is" if robot is None else f"Robot {robot!r} has"
    text = f"{has} no {kind}" + ("" if reference == LATEST else f" {reference!r}") + "."
    text += store.gone(session, kind, reference)
    if other is not None:
        text += f" That is an id of a {other}."
    listed = ", ".join(_describe_match(one, robot is None) for one in there[:MOST_NAMED])
    text += f" There are: {listed}." if listed else ""
    return ServiceError(text, code=f"{kind}_not_found", **{kind: reference})


def _several(kind: Kind, reference: str, found: Sequence[Found], by: str) -> ServiceError:
    listed = ", ".join(_describe_match(one, True) for one in found[:MOST_NAMED])
    more = f" and {len(found) - MOST_NAMED} more" if len(found) > MOST_NAMED else ""
    several_robots = len({one.robot for one in found}) > 1
    chosen = by in ("name", "number")
    remedy = "name its robot (--robot)" if by == "latest" or (chosen and several_robots) else "type more of it"
    if chosen and not several_robots:
        remedy = "give the id"
    return ServiceError(
        f"{reference!r} may be any of {len(found)} {kind}s, {listed}{more}: {remedy}.",
        code="reference_ambiguous",
        candidates=[one.id for one in found],
        robots=sorted({one.robot for one in found}),
    )


def _describe_match(one: Found, with_robot: bool) -> str:
    number = f" v{one.number}" if one.number else ""
    name = f" {one.name!r}" if one.name else ""
    return f"{one.id}{number}{name}" + (f" of robot {one.robot!r}" if with_robot else "")


def list_tombstones(database: Database, robot: str | None, page: Page) -> TombstoneList:
    """Return what was purged."""
    with database.reading() as session:
        found = store.tombstones(session, robot, page)
    shown, cursor = page.cut(found, lambda tombstone: in_time(tombstone.at, tombstone.id))
    return TombstoneList(tombstones=list(shown), next=cursor)
