"""Who may do what with which robot: tokens, their roles and robots, against a server with a database of its own."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import closing
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import pytest
from sqlalchemy import text

from kilter_core.twin import thesis_katana
from kilter_service.ground.db import Database
from kilter_service.ground.db.row import utc_now
from kilter_service.ground.db.tables import CampaignRow, FleetJobRow, FleetRobotRow, JobRow, TokenRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.run import app as application
from kilter_service.run.app import create_app
from kilter_service.versions import store
from kilter_service.versions.store import NewVersion
from kilter_service.web.auth.policy import PAGE_RULES, RULES
from kilter_service.web.auth.token import admin_token
from kilter_service.web.logins import get_valid_token, hash_secret
from kilter_service.web.routing import GuardedRoute

from .conftest import new_database, ready, served

OWN, OTHER = "mine", "theirs"
# Written out again, so that a change of the policy is seen: the role that each route needs.
NEEDED = {
    "viewer": """GET /v1/whoami POST /v1/login-links GET /v1/robots GET /v1/robots/{robot} GET /v1/robots/{robot}/campaigns
        GET /v1/robots/{robot}/versions GET /v1/robots/{robot}/activations GET /v1/robots/{robot}/meshes
        GET /v1/robots/{robot}/bridges
        GET /v1/robots/{robot}/today GET /v1/robots/{robot}/drift GET /v1/drift GET /v1/robots/{robot}/acceptance
        GET /v1/instruments
        GET /v1/robots/{robot}/meshes/{link} GET /v1/campaigns/{campaign} GET /v1/jobs
        GET /v1/jobs/{job} GET /v1/jobs/{job}/events GET /v1/versions/{version} GET /v1/resolve GET /v1/tombstones
        GET /v1/versions/{version}/preview GET /v1/versions/{a}/diff/{b} GET /v1/versions/{version}/residuals
        GET /v1/campaigns/{campaign}/suspicious GET /v1/campaigns/{campaign}/observations
        GET /v1/robots/{robot}/urdf-shapes
        GET /v1/versions/{version}/export GET /metrics GET /v1/fleet-jobs GET /v1/fleet-jobs/{fleet_job}
        GET /v1/instruments""",
    "operator": """POST /v1/robots/check POST /v1/robots/convert POST /v1/robots/from-circles POST /v1/frames
        POST /v1/robots/{robot}/forward POST /v1/robots/{robot}/inverse
        POST /v1/robots/{robot}/correct POST /v1/robots/{robot}/torques
        POST /v1/robots/{robot}/campaigns PATCH /v1/campaigns/{campaign}
        POST /v1/campaigns/{campaign}/commit POST /v1/campaigns/{campaign}/observations
        POST /v1/campaigns/{campaign}/retire POST /v1/campaigns/{campaign}/restore DELETE /v1/campaigns/{campaign}
        POST /v1/robots/{robot}/observations/check
        POST /v1/jobs POST /v1/jobs/check POST /v1/jobs/{job}/cancel PATCH /v1/versions/{version}
        POST /v1/versions/{version}/retire POST /v1/versions/{version}/restore POST /v1/versions/{version}/activate
        POST /v1/robots/{robot}/rollback POST /v1/robots/{robot}/stream/sessions
        POST /v1/robots/{robot}/repairs DELETE /v1/robots/{robot}/repairs/{repair}
        PUT /v1/robots/{robot}/bridges/{bridge}
        POST /v1/fleet-jobs POST /v1/fleet-jobs/{fleet_job}/cancel""",
    "admin": """POST /v1/robots PATCH /v1/robots/{robot} DELETE /v1/robots/{robot} POST /v1/robots/{robot}/retire
        POST /v1/robots/{robot}/restore POST /v1/robots/{robot}/purge POST /v1/campaigns/{campaign}/purge
        POST /v1/versions/{version}/purge GET /v1/tokens POST /v1/tokens DELETE /v1/tokens/{token} GET /v1/audit
        PUT /v1/robots/{robot}/meshes/{link} DELETE /v1/robots/{robot}/meshes/{link}
        POST /v1/instruments""",
}
# Of the page every view is a viewer's and every change an operator's, but for these.
PAGE_OPEN = "GET /assets/{name} GET /login POST /login POST /login/link POST /logout"
PAGE_ADMIN = """POST /new-robot POST /robots/{robot}/remarks POST /robots/{robot}/compensation
    POST /robots/{robot}/goals
    POST /robots/{robot}/meshes/{link} POST /robots/{robot}/meshes/{link}/remove
    GET /audit GET /access POST /access POST /access/{token}/revoke"""
ROLES = ("viewer", "operator", "admin")
WHOLE_SERVER = (
    "GET /v1/tokens",
    "POST /v1/tokens",
    "DELETE /v1/tokens/{token}",
    "GET /v1/audit",
    "GET /metrics",
    "POST /v1/instruments",
)


def routes(role: str) -> list[str]:
    return as_routes(NEEDED[role])


def as_routes(text: str) -> list[str]:
    words = text.split()
    return [f"{method} {path}" for method, path in zip(words[::2], words[1::2], strict=True)]


class House(NamedTuple):
    client: httpx.Client
    settings: Settings
    database: Database
    tokens: dict[str, str]

    def ask(self, route: str, token: str | None, of: str = OWN, **more: Any) -> httpx.Response:
        method, path = route.split()
        end = {OWN: "0123456789abcdef", OTHER: "f" * 16}.get(of, "0" * 16)
        names = {"robot": of, "campaign": f"cmp_{end}", "version": f"ver_{end}", "a": f"ver_{end}", "b": "nominal"}
        headers = {} if token is None else {"Authorization": f"Bearer {self.tokens.get(token, token)}"}
        path = path.format(
            **names,
            job=f"job_{end}",
            fleet_job=f"flt_{end}",
            token="tok_0",
            link="base",
            bridge="0" * 16,
            repair="rep_0",
            draft="0" * 24,
        )
        return self.client.request(method, path, headers={**headers, **more.pop("headers", {})}, **more)


def furnish(database: Database) -> None:
    calibration = thesis_katana().truth.to_document()
    fields: dict[str, Any] = {"device": "", "role": "train", "conditions": {}, "notes": ""}
    for robot_id, end in ((1, "0123456789abcdef"), (2, "f" * 16)):
        limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
        report = {"parameters": [], "metrics": {}, "noise_mm": 0.01}
        new = NewVersion(calibration, report, {"names": [], "matrix": []}, [], limits, None, "test")
        with database.transaction() as session:
            session.add(CampaignRow(id=f"cmp_{end}", name="c", robot_id=robot_id, **fields))
            session.add(JobRow(id=f"job_{end}", kind="identify", robot_id=robot_id, state="succeeded",
                               request={"kind": "identify", "robot": OWN if robot_id == 1 else OTHER}))  # fmt: skip
            session.flush()
            store.add(session, robot_id, f"job_{end}", new)
            session.add(FleetJobRow(id=f"flt_{end}", request={}))
            session.flush()
            session.add(FleetRobotRow(fleet_id=f"flt_{end}", robot_id=robot_id, job_id=f"job_{end}"))


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[House]:
    with new_database() as url:
        settings = Settings(data=tmp_path_factory.mktemp("house"), database_url=url, host="127.0.0.1", token=None)
        ready(settings, migrated)
        database = Database(settings.database)
        with served(create_app(settings)) as client:
            tokens = {"server": admin_token(settings)}
            house = House(client, settings, database, tokens)
            for name in (OWN, OTHER):
                robot = {"name": name, "convention": "preset", "preset": "katana450-chapter5"}
                assert house.ask("POST /v1/robots", "server", json=robot).status_code == 201
            furnish(database)
            for role in ROLES:
                for name, robots in ((role, None), (f"{role} of {OWN}", [OWN])):
                    wanted = {"name": f"the-{name}".replace(" ", "-"), "role": role, "robots": robots}
                    made = house.ask("POST /v1/tokens", "server", json=wanted)
                    assert made.status_code == 201, made.text
                    tokens[name] = made.json()["token"]
            yield house
        database.close()


def looked_up(route: str) -> str:
    """Robot to ask about: what computes for long is asked about a version that does not exist."""
    return (
        "nobody"
        if any(
            word in route for word in ("/preview", "/diff/", "/residuals", "/suspicious", "/export", "/observations")
        )
        else OWN
    )


def refusal(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


def test_every_route_of_the_application_has_a_stated_role() -> None:
    there = set()
    for router in (*application.ROUTERS, application.health, application.docs_page):
        for route in router.routes:
            assert isinstance(route, GuardedRoute), route
            there |= {f"{method} {route.path}" for method in route.methods}
    stated = {route: rule.role for route, rule in RULES.items() if rule.role is not None}
    assert there == set(RULES), there ^ set(RULES)
    assert stated == {route: role for role in ROLES for route in routes(role)}


def low_roles() -> Iterator[tuple[str, str, str]]:
    for needed in ROLES:
        for route in routes(needed):
            for role in ROLES[: ROLES.index(needed)]:
                yield role, route, OWN
                yield role, route, OTHER


def test_a_role_that_is_too_low_is_refused_on_every_route(house: House) -> None:
    """Before the body is read: what is sent could not be parsed."""
    cases = list(low_roles())
    assert len(cases) >= 60
    for role, route, robot in cases:
        found = house.ask(route, role, robot, content=b"{", headers={"Content-Type": "application/json"})
        assert refusal(found) == (403, "role_too_low"), (role, route, robot, found.text)


def pages() -> Iterator[tuple[str, str]]:
    """Routes of the page with the role that each needs."""
    admins = as_routes(PAGE_ADMIN)
    for route in PAGE_RULES.keys() - as_routes(PAGE_OPEN):
        yield route, "admin" if route in admins else "viewer" if route.startswith("GET ") else "operator"


def test_a_role_that_is_too_low_is_refused_on_every_route_of_the_page(house: House) -> None:
    assert dict(pages()) == {route: rule.role for route, rule in PAGE_RULES.items() if rule.role is not None}
    for route, needed in pages():
        for role in ROLES[: ROLES.index(needed)]:
            for robot in (OWN, OTHER):
                found = house.ask(route, role, robot, content=b"{")
                assert (found.status_code, "role_too_low" in found.text) == (403, True), (role, route, found.text[:500])


def test_a_limited_token_sees_nothing_of_others_on_the_page(house: House) -> None:
    for route, needed in pages():
        found = None
        if any(f"{{{name}}}" in route for name in ("robot", "campaign", "version", "a", "job")):
            found, refused = house.ask(route, f"{needed} of {OWN}", OTHER, content=b"{"), 404
        elif PAGE_RULES[route].server:
            found, refused = house.ask(route, f"{needed} of {OWN}", content=b"{"), 403
        assert found is None or found.status_code == refused, (route, found.text[:500])


def limited() -> Iterator[tuple[str, str]]:
    for needed in ROLES:
        for route in routes(needed):
            if any(f"{{{name}}}" in route for name in ("robot", "campaign", "version", "a", "job")):
                yield needed, route


def test_what_belongs_to_another_robot_does_not_exist_for_a_limited_token(house: House) -> None:
    cases = list(limited())
    assert len(cases) >= 30
    for role, route in cases:
        found = house.ask(route, f"{role} of {OWN}", OTHER, content=b"{", headers={"Content-Type": "application/json"})
        assert found.status_code == 404, (route, found.text)
        code = found.json()["code"]
        assert code in {"robot_not_found", "campaign_not_found", "version_not_found", "job_not_found"}, (route, code)
        assert OTHER not in found.json()["detail"].replace(f"'{OTHER}'", ""), found.text  # only as it was asked for


def test_what_concerns_the_whole_server_is_refused_to_a_limited_token(house: House) -> None:
    for route in WHOLE_SERVER:
        assert refusal(house.ask(route, f"admin of {OWN}", json={})) == (403, "token_limited"), route


def test_every_role_may_do_its_own(house: House) -> None:
    """Nothing is sent, so what changes something is refused for its shape, not at the gate."""
    harmless = [
        route for needed in ROLES for route in routes(needed)
        if not any(word in route for word in ("/purge", "DELETE", "/retire", "/restore", "/events"))
    ]  # fmt: skip
    assert len(harmless) > 35
    for route in harmless:
        needed = next(role for role in ROLES if route in routes(role))
        for token in (needed,) if route in WHOLE_SERVER else (needed, f"{needed} of {OWN}"):
            found = house.ask(route, token, looked_up(route), json={"nothing": 0})
            assert found.status_code not in (401, 403), (token, route, found.text)


def test_no_token_reads_directly_and_does_nothing_else(house: House) -> None:
    for needed in ROLES:
        for route in routes(needed):
            if "/events" in route:
                continue
            found = house.ask(route, None, looked_up(route))
            if needed == "viewer" and route != "POST /v1/login-links":  # a link is in the name of a token
                assert found.status_code != 401, route
            else:
                assert refusal(found) == (401, "token_missing"), route
            assert refusal(house.ask(route, None, headers={"X-Forwarded-For": "203.0.113.9"})) == (401, "token_missing")


def test_lists_hold_only_the_robots_of_the_token(house: House) -> None:
    mine = f"viewer of {OWN}"
    assert [robot["name"] for robot in house.ask("GET /v1/robots", mine).json()["robots"]] == [OWN]
    assert {job["robot"] for job in house.ask("GET /v1/jobs", mine).json()["jobs"]} == {OWN}
    assert {job["robot"] for job in house.ask("GET /v1/jobs", "viewer").json()["jobs"]} == {OWN, OTHER}
    foreign = house.ask("GET /v1/resolve", mine, params={"kind": "campaign", "reference": "cmp_ffff"})
    assert refusal(foreign) == (404, "campaign_not_found")
    assert OTHER not in foreign.text
    found = house.ask("GET /v1/resolve", mine, params={"kind": "campaign", "reference": "latest"})
    assert found.json()["robot"] == OWN  # for others it is ambiguous
    assert refusal(house.ask("GET /v1/jobs", mine, params={"robot": OTHER})) == (404, "robot_not_found")


def test_a_limited_token_makes_no_job_of_another_robot(house: House) -> None:
    job = {"kind": "identify", "robot": OTHER, "campaigns": ["cmp_" + "f" * 16]}
    for route in ("POST /v1/jobs", "POST /v1/jobs/check"):
        assert refusal(house.ask(route, f"operator of {OWN}", json=job)) == (404, "robot_not_found")
        mixed = job | {"robot": OWN}
        assert refusal(house.ask(route, f"operator of {OWN}", json=mixed)) == (404, "campaign_not_found")
    path = {"content": b"t_s,q1_deg\n0,0\n", "headers": {"Content-Type": "text/csv"}}
    found = house.ask(
        "POST /v1/robots/{robot}/correct", f"operator of {OWN}", params={"version": "ver_" + "f" * 16}, **path
    )
    assert refusal(found) == (404, "version_not_found")


def test_a_limited_admin_adds_no_other_robot(house: House) -> None:
    robot = {"name": "third", "convention": "preset", "preset": "ur10"}
    assert refusal(house.ask("POST /v1/robots", f"admin of {OWN}", json=robot)) == (403, "token_limited")
    assert refusal(house.ask("POST /v1/robots", f"admin of {OWN}", json=robot | {"name": OTHER})) == (
        403,
        "token_limited",
    )


def test_a_token_says_who_one_is(house: House) -> None:
    found = house.ask("GET /v1/whoami", f"operator of {OWN}").json()
    assert (found["actor"], found["role"], found["robots"]) == (f"the-operator-of-{OWN}", "operator", [OWN])
    assert house.ask("GET /v1/whoami", "server").json()["actor"] == "admin"
    assert house.ask("GET /v1/whoami", None).json() == {
        "actor": "anybody", "token_id": "", "role": "viewer", "robots": None,
    }  # fmt: skip


def test_of_a_secret_only_its_hash_is_stored(house: House) -> None:
    secret = house.tokens["viewer"]
    assert len(secret.removeprefix("kilter_")) == 43  # 256 bits
    with house.database.reading() as session:
        rows = session.execute(text("SELECT * FROM tokens")).mappings().all()
        audit = session.execute(text("SELECT content FROM audit")).scalars().all()
    assert hashlib.sha256(secret.encode()).hexdigest() in {row["sha256"] for row in rows}
    assert secret not in f"{rows}{audit}"
    assert "token" not in house.ask("GET /v1/tokens", "server").json()["tokens"][0]


def test_a_token_ends_when_it_is_revoked_or_expires(house: House) -> None:
    made = house.ask("POST /v1/tokens", "admin", json={"name": "guest", "role": "viewer", "days": 1}).json()
    assert refusal(house.ask("POST /v1/tokens", "admin", json={"name": "guest", "role": "viewer"})) == (
        409,
        "name_taken",
    )
    assert house.ask("GET /v1/whoami", made["token"]).json()["actor"] == "guest"
    with house.database.transaction() as session:
        session.get_one(TokenRow, made["id"]).expires_at = utc_now() - timedelta(seconds=1)
    assert refusal(house.ask("GET /v1/whoami", made["token"])) == (401, "token_ended")
    again = house.ask("POST /v1/tokens", "admin", json={"name": "guest", "role": "viewer", "days": None}).json()
    assert again["expires_at"] is None
    path = f"/v1/tokens/{again['id']}"
    gone = house.client.delete(path, headers={"Authorization": f"Bearer {house.tokens['admin']}"}).json()
    assert (gone["revoked_by"], gone["revoked_at"] is not None) == ("the-admin", True)
    assert refusal(house.ask("GET /v1/whoami", again["token"])) == (401, "token_ended")


@pytest.mark.parametrize(
    "altered", ["revoked_at = NULL, revoked_by = ''", "role = 'admin'", "robots = NULL", "id = 'tok_of_nobody'"]
)
def test_a_token_that_was_altered_past_kilter_does_not_work(house: House, altered: str) -> None:
    wanted = {"name": "left", "role": "viewer", "robots": [OWN]}
    made = house.ask("POST /v1/tokens", "admin", json=wanted).json()
    assert house.ask("GET /v1/whoami", made["token"]).status_code == 200
    house.ask("POST /v1/robots/check", "admin", json={})  # what the audit says meanwhile is read on
    if "revoked" in altered:
        head = {"Authorization": f"Bearer {house.tokens['admin']}"}
        house.client.delete(f"/v1/tokens/{made['id']}", headers=head).raise_for_status()
    with house.database.engine.begin() as connection:
        connection.execute(text(f"UPDATE tokens SET {altered} WHERE id = :id"), {"id": made["id"]})
    try:
        for _ in range(2):
            assert refusal(house.ask("GET /v1/whoami", made["token"])) == (401, "token_ended")
        with closing(Database(house.settings.database)) as anew, pytest.raises(ServiceError, match="past Kilter"):
            get_valid_token(anew, hash_secret(made["token"]))
        assert house.ask("GET /v1/whoami", "viewer").status_code == 200
    finally:
        with house.database.engine.begin() as connection:
            connection.execute(text("DELETE FROM tokens WHERE name = 'left'"))


@pytest.mark.parametrize("given", ["wrong", "kilter_" + "A" * 43, "tok_0", "'; DROP TABLE tokens; --"])
def test_an_unknown_token_is_refused_even_where_none_is_needed(house: House, given: str) -> None:
    assert refusal(house.ask("GET /v1/robots", given)) == (401, "token_wrong")


@pytest.mark.parametrize("name", ["anybody", "", "a b", "x" * 65, "\u202eadmin", "nul\x00"])
def test_names_that_would_mislead_are_refused(house: House, name: str) -> None:
    found = house.ask("POST /v1/tokens", "server", json={"name": name, "role": "viewer"})
    assert found.status_code in (400, 422), found.text


def test_changes_are_recorded_under_the_name_of_the_token(house: House) -> None:
    house.ask("POST /v1/campaigns/{campaign}/retire", f"operator of {OWN}").raise_for_status()
    with house.database.reading() as session:
        row = session.get_one(CampaignRow, "cmp_0123456789abcdef")
        assert row.retired_by == f"the-operator-of-{OWN}"
    house.ask("POST /v1/campaigns/{campaign}/restore", f"operator of {OWN}").raise_for_status()
