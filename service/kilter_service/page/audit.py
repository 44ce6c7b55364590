"""The audit, for admins: entries in words."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Annotated, Any

from fastapi import Query, Request
from fastapi.responses import HTMLResponse

from kilter_core.errors import CoreError
from kilter_service.campaigns import service as campaigns
from kilter_service.contract.server import AuditEntry
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import display_name
from kilter_service.ground.paging import Page
from kilter_service.jobs import service as jobs
from kilter_service.page.answers import render, router
from kilter_service.page.shared.lists import Asked, select_page
from kilter_service.versions import service as versions
from kilter_service.web import audit
from kilter_service.web.routing import DatabaseOfApp

# What the method and path of a route did; names in braces are those of what was changed, of campaigns, versions and jobs with
# what they are: "version spring", and of one without a name "the search of 2026-11-02 14:05:09".
DONE: Mapping[str, str] = {
    "DELETE /v1/campaigns/{campaign}": "discarded the unfinished {campaign}",
    "DELETE /v1/robots/{robot}": "deleted robot {robot}",
    "DELETE /v1/robots/{robot}/meshes/{link}": "removed the shape of link {link} of {robot}",
    "DELETE /v1/tokens/{token}": "withdrew the token {token}",
    "PATCH /v1/campaigns/{campaign}": "changed the name or notes of {campaign}",
    "PATCH /v1/robots/{robot}": "changed what is said of robot {robot}",
    "PATCH /v1/versions/{version}": "changed the name or notes of {version}",
    "POST /access": "made a token",
    "POST /access/{token}/revoke": "withdrew the token {token}",
    "POST /campaigns/{campaign}/change": "changed the name or notes of {campaign}",
    "POST /campaigns/{campaign}/restore": "brought {campaign} back into use",
    "POST /campaigns/{campaign}/retire": "took {campaign} out of use",
    "POST /campaigns/{campaign}/rows/aside": "set rows aside: stored {campaign} without them",
    "POST /jobs/{job}/cancel": "cancelled {job}",
    "POST /jobs/{job}/gap/again": "asked for {job}, a search once more",
    "POST /jobs/{job}/gap/plan": "asked for {job}, a plan of poses",
    "POST /login": "logged in",
    "POST /login/link": "logged in by a link",
    "POST /logout": "logged out",
    "POST /new-robot": "added robot {robot}",
    "POST /robots/{robot}/campaigns/new/{draft}/rig": "gave the cameras and boards of views for {robot}",
    "POST /robots/{robot}/campaigns/new/{draft}/store": "stored {campaign} of {robot}",
    "POST /robots/{robot}/remarks": "noted something on {robot}",
    "POST /robots/{robot}/compensation": "said whether the controller of {robot} corrects by itself",
    "POST /robots/{robot}/jobs": "asked for {job} of {robot}",
    "POST /robots/{robot}/goals": "said how good {robot} must be",
    "POST /robots/{robot}/steps": "took the next step with {robot}",
    "POST /robots/{robot}/repairs": "recorded a repair of {robot}",
    "POST /robots/{robot}/repairs/{repair}/remove": "removed a repair of {robot}",
    "POST /robots/{robot}/meshes/{link}": "gave link {link} of {robot} a shape",
    "POST /robots/{robot}/meshes/{link}/remove": "removed the shape of link {link} of {robot}",
    "POST /robots/{robot}/rollback": "went back to {version} of {robot}",
    "POST /v1/campaigns/{campaign}/commit": "completed {campaign}",
    "POST /v1/campaigns/{campaign}/observations": "sent rows to {campaign}",
    "POST /v1/campaigns/{campaign}/purge": "purged {campaign}",
    "POST /v1/campaigns/{campaign}/restore": "brought {campaign} back into use",
    "POST /v1/campaigns/{campaign}/retire": "took {campaign} out of use",
    "POST /v1/fleet-jobs": "asked for a job of several robots",
    "POST /v1/fleet-jobs/{fleet_job}/cancel": "cancelled a job of several robots",
    "POST /v1/instruments": "stored an instrument",
    "POST /v1/jobs": "asked for {job} of {robot}",
    "POST /v1/jobs/{job}/cancel": "cancelled {job}",
    "POST /v1/login-links": "made a link to log in with",
    "POST /v1/robots": "added robot {robot}",
    "POST /v1/robots/{robot}/repairs": "recorded a repair of {robot}",
    "DELETE /v1/robots/{robot}/repairs/{repair}": "removed a repair of {robot}",
    "POST /v1/robots/{robot}/campaigns": "added {campaign} to {robot}",
    "POST /v1/robots/{robot}/purge": "purged robot {robot}",
    "POST /v1/robots/{robot}/restore": "brought robot {robot} back into use",
    "POST /v1/robots/{robot}/retire": "took robot {robot} out of use",
    "POST /v1/robots/{robot}/rollback": "went back to {version} of {robot}",
    "POST /v1/robots/{robot}/stream/sessions": "opened a session of the stream of {robot}",
    "POST /v1/tokens": "made a token",
    "POST /v1/versions/{version}/activate": "activated {version} of {robot}",
    "POST /v1/versions/{version}/purge": "purged {version}",
    "POST /v1/versions/{version}/restore": "brought {version} back into use",
    "POST /v1/versions/{version}/retire": "took {version} out of use",
    "POST /versions/{version}/activate": "activated {version} of {robot}",
    "PUT /v1/robots/{robot}/meshes/{link}": "gave link {link} of {robot} a shape",
    "kilterd worker": "finished {job} of {robot}",
}
# Why a request was refused, by the code of its answer.
REFUSED: Mapping[str, str] = {
    "csrf_missing": "the form came from elsewhere",
    "host_refused": "the server has another name",
    "origin_refused": "a page of another site asked",
    "proxy_only": "it did not come through the proxy",
    "role_too_low": "the role does not suffice",
    "several": "for several reasons",
    "token_ended": "the token or link had ended or was used already",
    "token_limited": "the token is for other robots",
    "token_missing": "no token",
    "token_wrong": "a wrong token",
}
KINDS = {"campaigns": "campaign", "versions": "version", "jobs": "job"}  # tables, as paths call their entries
GET: Mapping[str, Callable[[Database, str], Any]] = {
    "campaign": campaigns.get,
    "version": versions.get,
    "job": jobs.get,
}
UNKNOWN = "one that is gone"


def describe_entries(database: Database, entries: Iterable[AuditEntry]) -> list[tuple[AuditEntry, str, str]]:
    """Put entries in words, with names instead of ids: each with what it did, and the reason that was given, if one was."""
    known = _Names(database)
    return [(one, _describe_action(one, known), _reason(one)) for one in entries]


def _describe_action(entry: AuditEntry, known: _Names) -> str:
    refused = dict(_iter_changes(entry)).get("refused")
    if isinstance(refused, dict):
        code, times = str(refused.get("code", "")), int(refused.get("times", 1))
        often = "once" if times == 1 else f"{times} times"
        return f"was refused {often} at {entry.route}: {REFUSED.get(code, code)}"  # nothing is known of what it would change
    template = DONE.get(entry.route)
    if template is None:
        return f"changed something by {entry.route}"
    return template.format_map(known.template_values(entry))


def _reason(entry: AuditEntry) -> str:
    """Why it was done, where somebody said so."""
    for _, after in _iter_changes(entry):
        if isinstance(after, dict) and isinstance(after.get("reason"), str) and after["reason"]:
            return str(after["reason"])
    return ""


def _iter_changes(entry: AuditEntry) -> Iterator[tuple[str, object]]:
    """Each thing that was changed with what it is since, or with what it was where it is gone."""
    for one in entry.changes:
        try:
            yield one.thing, json.loads(one.after or one.before or "null")
        except ValueError:
            continue


class _Names:
    """What the ids of entries stand for; each is looked up once."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._found: dict[str, tuple[str, str]] = {}

    def template_values(self, entry: AuditEntry) -> dict[str, str]:
        """Return a name for whatever a template may say."""
        place = json.loads(entry.place)
        ids = {name: str(value) for name, value in place.items()} if isinstance(place, dict) else {}
        told = dict.fromkeys(("robot", "campaign", "version", "job", "link", "token"), UNKNOWN) | ids
        for thing, after in _iter_changes(entry):
            table, _, key = thing.partition("/")
            if table in KINDS and (KINDS[table] not in ids or entry.route.endswith("/aside")):
                told[KINDS[table]] = key
            elif table == "robots" and isinstance(after, dict) and "name" in after:
                told["robot"] = str(after["name"])
            elif thing == "active_version" and isinstance(after, str):
                told["version"] = after
        return self._resolve_names(told)

    def _resolve_names(self, told: dict[str, str]) -> dict[str, str]:
        for kind in KINDS.values():
            if told[kind] == UNKNOWN:
                told[kind] = f"a {kind} that is gone"
            else:
                name, robot = self._look_up(kind, told[kind])
                told[kind] = name
                if told["robot"] == UNKNOWN and robot:
                    told["robot"] = robot
        return told

    def _look_up(self, kind: str, key: str) -> tuple[str, str]:
        if key not in self._found:
            try:
                one = GET[kind](self._database, key)
                named = one.name or (display_name(one) if getattr(one, "number", 0) else "")
                self._found[key] = f"{kind} {named}" if named else f"the {display_name(one)}", one.robot
            except CoreError:
                self._found[key] = f"{kind} {key}", ""
        return self._found[key]


AT_ONCE = 1000


def find_entries(database: Database, robot: str, actor: str, asked: Asked) -> dict[str, Any]:
    """Return entries about a robot, by somebody, newest first; empty texts ask for all. ``broken``: the record is not whole."""
    ids = _ids(database, robot) if robot else frozenset()
    kept: list[AuditEntry] = []
    total = 0
    after: tuple[str, ...] | None = None
    while True:
        page = audit.list_entries(database, Page(AT_ONCE, after))
        total += len(page.entries)
        kept += [one for one in page.entries if actor in ("", one.actor) and (not robot or _is_about(one, robot, ids))]
        if page.next is None:
            break
        after = (str(page.entries[-1].number),)
    head, broken = _state(database)
    # A search looks in what was done, and in all that the entry holds.
    shown = select_page(kept[::-1], asked, lambda one: f"{DONE.get(one.route, '')} {one.content}", {})
    entries = describe_entries(database, shown.shown)
    return {"part": shown, "entries": entries, "total": total, "head": head, "broken": broken}


def _state(database: Database) -> tuple[str, str]:
    """The last entry of a record that is whole, or what is wrong with it."""
    try:
        head = audit.verify(database)
    except ServiceError as error:
        return "", error.message
    return f"{head.number}:{head.sha256}", ""


def _is_about(entry: AuditEntry, robot: str, ids: frozenset[str]) -> bool:
    """Whether an entry names a robot or what belongs to it: in its address, or in what it changed."""
    place = json.loads(entry.place)
    if isinstance(place, dict) and ids & {str(value) for value in place.values()}:
        return True
    quoted = json.dumps(robot)
    return any(quoted in one.after or quoted in one.before or ids & set(one.thing.split()) for one in entry.changes)


def _ids(database: Database, robot: str) -> frozenset[str]:
    """Names of a robot and of all that belongs to it; of one that is not there any more its own."""
    try:
        ids = [one.id for one in campaigns.list_campaigns(database, robot, Page(), with_retired=True).campaigns]
        ids += [one.id for one in versions.list_versions(database, robot, Page(), with_retired=True).versions]
        ids += [one.id for one in jobs.list_jobs(database, robot, Page()).jobs]
    except ServiceError:
        return frozenset({robot})
    return frozenset({robot, *ids})


Name = Annotated[str, Query(max_length=200)]


@router.get("/audit")
def show_audit(request: Request, database: DatabaseOfApp, robot: Name = "", actor: Name = "") -> HTMLResponse:
    """Show the newest entries, and whether the record is whole."""
    asked = Asked.from_request(request, ("robot", "actor"))
    found = find_entries(database, robot.strip(), actor.strip(), asked)
    return render(request, "audit/list.html", found=found, robot=robot, actor_wanted=actor)
