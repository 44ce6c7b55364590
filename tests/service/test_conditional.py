"""What a client has already is not sent again."""

from __future__ import annotations

from typing import Any

import httpx
import pytest

from tests.fuzz.world import World, world


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with world(tmp_path_factory.mktemp("conditional")) as found:
        yield found


def read(client: httpx.Client, address: str, tag: str | None = None) -> httpx.Response:
    return client.get(address, headers={} if tag is None else {"If-None-Match": tag})


@pytest.mark.parametrize(
    "address",
    ["versions/{version}", "versions/{version}/export", "versions/{version}/diff/nominal", "campaigns/{campaign}",
     "robots/{robot}", "robots/{robot}/versions", "jobs/{job}", "jobs"],
)  # fmt: skip
def test_an_answer_that_is_known_is_not_sent_again(filled: World, address: str) -> None:
    client = filled.client
    place = "/v1/" + address.format(**{name: ids[0] for name, ids in filled.known.items()})
    first = read(client, place).raise_for_status()
    tag = first.headers["etag"]
    for known in (tag, f"W/{tag}", f'"other", {tag}', "*"):
        again = read(client, place, known)
        assert (again.status_code, again.content) == (304, b""), known
        assert again.headers["etag"] == tag
        assert again.headers["cache-control"] == first.headers["cache-control"] == "private, no-cache"
    assert read(client, place, '"other"').content == first.content


def test_what_people_change_has_another_tag(filled: World) -> None:
    place = f"/v1/versions/{filled.known['version'][1]}"
    tag = read(filled.client, place).headers["etag"]
    filled.client.patch(place, json={"notes": "seen"}).raise_for_status()
    assert read(filled.client, place, tag).json()["notes"] == "seen"


def test_a_job_that_is_over_is_kept_for_good(filled: World) -> None:
    place = f"/v1/jobs/{filled.known['job'][2]}"
    assert "immutable" not in read(filled.client, place).headers["cache-control"]
    filled.client.post(f"{place}/cancel").raise_for_status()
    over = read(filled.client, place)
    assert over.headers["cache-control"] == "private, max-age=31536000, immutable"
    assert read(filled.client, place, over.headers["etag"]).status_code == 304


def test_refusals_and_changes_have_no_tag(filled: World) -> None:
    assert "etag" not in read(filled.client, "/v1/jobs/job_none", "*").headers
    place = f"/v1/campaigns/{filled.known['campaign'][0]}"
    assert "etag" not in filled.client.patch(place, json={}, headers={"If-None-Match": "*"}).headers


def test_the_interface_says_so(filled: World) -> None:
    paths = filled.client.get("/openapi.json").json()["paths"]
    assert "304" in paths["/v1/versions/{version}"]["get"]["responses"]
    assert "304" not in paths["/v1/versions/{version}"]["patch"]["responses"]
