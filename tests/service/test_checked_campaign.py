"""A check of rows together with the campaign that they would make: what a form must be, and that nothing is stored."""

from __future__ import annotations

import hashlib
import json
from base64 import b64encode
from functools import cache
from typing import Any

import httpx
import pytest

from tests.service.test_pixels import SCENE, campaign, columns, csv, described, seen

ADDRESS = "/v1/robots/watched/observations/check"
Form = dict[str, Any]


@pytest.fixture
def watched(shared_client: httpx.Client) -> httpx.Client:
    shared_client.post("/v1/robots", json=SCENE.drawn.document() | {"name": "watched"})
    return shared_client


@cache
def twelve() -> dict[str, list[Any]]:
    """Rows of twelve views: forms are made while tests are collected, by each process that does so."""
    return columns(seen(12))


def form(rows: dict[str, list[Any]] | None = None, media: str = "text/csv", **stated: Any) -> Form:
    table = rows or twelve()
    wanted = {"name": "to check", "conditions": described(SCENE)} | stated
    content = csv(table) if media == "text/csv" else json.dumps(table)
    return {"campaign": (None, json.dumps(wanted)), "rows": ("views", content, media)}


def checked(client: httpx.Client, files: Form, **params: str) -> dict[str, Any]:
    return dict(client.post(ADDRESS, files=files, params=params).json())


@pytest.mark.parametrize("media", ["text/csv", "application/json"])
def test_rows_are_checked_with_the_campaign_and_nothing_is_stored(watched: httpx.Client, media: str) -> None:
    before = watched.get("/v1/robots/watched/campaigns").json()["campaigns"]
    assert checked(watched, form(media=media))["rows"] == 12
    assert watched.get("/v1/robots/watched/campaigns").json()["campaigns"] == before


@pytest.mark.parametrize(
    ("files", "code", "said"),
    [
        ({"rows": form()["rows"]}, "payload_invalid", "The form must have campaign, JSON without a filename, and rows"),
        ({"campaign": form()["campaign"]}, "payload_invalid", "The form must have campaign"),
        (form() | {"campaign": (None, "{")}, "payload_invalid", "is not JSON"),
        (form() | {"more": ("more", b"1")}, "payload_invalid", "Too many files"),
        (form() | {"rows": ("views", b"\x89PNG", "image/png")}, "media_type_unsupported", "image/png is not read"),
        (form() | {"campaign": (None, " " * (5 << 20))}, "payload_invalid", "exceeded maximum size"),
        (form(name=""), "payload_invalid", "body.name"),
        (form(conditions={}), "cameras_missing", "`kilter measure see` writes them (`kilter upload --cameras`)"),
        (form(columns(seen(3)) | {"u1_px": [2500.0] * 3, "v1_px": [5.0] * 3}), "outside_picture", "Row 1, column 'u1_px'"),
    ],
)  # fmt: skip
def test_what_the_form_lacks_is_named(watched: httpx.Client, files: Form, code: str, said: str) -> None:
    refused = checked(watched, files)
    assert refused["code"] == code
    assert said in refused["detail"]
    assert checked(watched, form())["rows"] == 12  # the remedy


def test_the_digest_is_that_of_the_whole_form(watched: httpx.Client) -> None:
    request = watched.build_request("POST", ADDRESS, files=form())
    body, kind = request.read(), request.headers["content-type"]
    for content, status in ((body, 200), (body.replace(b"q1_deg", b"q1_rad"), 400)):
        digest = f"sha-256=:{b64encode(hashlib.sha256(body).digest()).decode()}:"
        answer = watched.post(ADDRESS, content=content, headers={"content-type": kind, "content-digest": digest})
        assert answer.status_code == status
    assert watched.post(ADDRESS, content=body, headers={"content-type": "multipart/form-data"}).json()["code"] == (
        "payload_invalid"
    )


def test_rows_that_would_be_added_are_checked_as_those_of_that_campaign(watched: httpx.Client) -> None:
    made = campaign(watched, described(SCENE), "added to")
    text, headers = csv(columns(seen(3)) | {"camera": ["door"] * 3}), {"content-type": "text/csv"}
    asked = watched.post(ADDRESS, content=text.encode(), headers=headers, params={"campaign": made})
    assert asked.json()["code"] == "camera_unknown"
    assert watched.post(ADDRESS, content=text.encode(), headers=headers).status_code == 200  # of any campaign
    watched.post("/v1/robots", json=SCENE.drawn.document() | {"name": "another"})
    other = "/v1/robots/another/observations/check"
    refused = watched.post(other, content=text.encode(), headers=headers, params={"campaign": made})
    assert (refused.status_code, refused.json()["code"]) == (404, "campaign_not_found")
