"""Values that JSON and addresses can hold and nothing behind them: each refused with its place."""

from __future__ import annotations

import base64
import json
import re
import unicodedata
from typing import Any

import httpx
import pytest

HIDDEN = ["\u202e", "\u2066", "\u200b", "\u200d", "\ufeff", "\u2028", "\x1b", "\x7f", "\x85", "\xad", "\U000e0041"]


def post(client: httpx.Client, path: str, body: bytes) -> Any:
    return client.post(path, content=body, headers={"Content-Type": "application/json"})


def refused(answer: httpx.Response, *words: str) -> None:
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert all(word in answer.json()["detail"] for word in words), answer.text


@pytest.fixture(scope="module")
def robot(shared_client: httpx.Client) -> str:
    document = {"name": "r", "convention": "preset", "preset": "katana450-chapter5"}
    shared_client.post("/v1/robots", json=document).raise_for_status()
    return "r"


@pytest.mark.parametrize("mark", HIDDEN)
def test_names_hold_no_character_that_nobody_sees(shared_client: httpx.Client, robot: str, mark: str) -> None:
    assert unicodedata.category(mark) in {"Cc", "Cf", "Zl"}
    body = json.dumps({"name": f"ab{mark}c"}).encode()
    answer = post(shared_client, f"/v1/robots/{robot}/campaigns", body)
    refused(answer, "body.name", f"U+{ord(mark):04X} at 3", "leave that character out")


def test_notes_have_lines_but_names_do_not(shared_client: httpx.Client, robot: str) -> None:
    named = {"name": "lines", "notes": "one\n\ttwo\r\nüñ 日本 🤖"}
    assert shared_client.post(f"/v1/robots/{robot}/campaigns", json=named).json()["notes"] == named["notes"]
    answer = shared_client.post(f"/v1/robots/{robot}/campaigns", json={"name": "a\nb"})
    refused(answer, "body.name", "U+000A")
    answer = shared_client.patch(f"/v1/robots/{robot}", json={"remarks": "a\u202eb"})
    refused(answer, "body.remarks", "U+202E")


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b'{"name": "\\u0000"}', ["body.name", "U+0000"]),
        (b'{"name": "\\ud800"}', ["body.name", "U+D800"]),
        (b'{"\\ud800": 1}', ["body", "U+D800"]),
        (b'{"name": "a", "name": "b"}', ["'name' twice"]),
        (b'{"name": "a", "conditions": {"payload_kg": 1e300}}', ["body.conditions.payload_kg", "1e+15"]),
        (b'{"name": "a", "conditions": {"payload_kg": %s}}' % (b"9" * 30), ["body.conditions.payload_kg", "1e+15"]),
        (b'{"name": "a", "conditions": {"payload_kg": 1e999}}', ["body.conditions.payload_kg"]),
        (b'{"name": %s}' % (b"9" * 5000), ["not JSON"]),
        (b'{"a":' * 40 + b"1" + b"}" * 40, ["nested deeper than 32"]),
        (b"[" * 100_000, ["nested deeper than 32"]),
    ],
)
def test_bodies_hold_no_value_that_breaks_what_reads_them(
    shared_client: httpx.Client, robot: str, body: bytes, words: list[str]
) -> None:
    refused(post(shared_client, f"/v1/robots/{robot}/campaigns", body), *words)


@pytest.mark.parametrize("address", ["/v1/robots/a%00b", "/v1/jobs?robot=%00", "/v1/versions/%00/export"])
def test_addresses_hold_no_nul(shared_client: httpx.Client, address: str) -> None:
    refused(shared_client.get(address), "U+0000")


def test_a_urdf_names_its_joints_visibly(shared_client: httpx.Client) -> None:
    urdf = (
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j&#x202e;1" type="continuous"><parent link="a"/>'
        '<child link="b"/><axis xyz="0 0 1"/></joint></robot>'
    )
    document = {"name": "u", "convention": "urdf", "urdf": urdf, "base_link": "a", "tip_link": "b"}
    answer = shared_client.post("/v1/robots/check", json=document)
    assert answer.status_code == 400
    assert "U+202E" in answer.json()["detail"]


@pytest.mark.parametrize("key", [["\ud800"], ["\x00"], ["2026-01-01T00:00:00+00:00", "\ud800"]])
def test_a_cursor_holds_no_such_text_either(shared_client: httpx.Client, key: list[str]) -> None:
    after = base64.urlsafe_b64encode(json.dumps(key).encode()).decode().rstrip("=")
    for address in ("/v1/robots", "/v1/jobs", "/v1/tombstones"):
        refused(shared_client.get(address, params={"after": after}), "not a cursor")


def test_a_parameter_that_no_address_has_is_refused_with_what_was_meant(
    shared_client: httpx.Client, robot: str
) -> None:
    """Misspelt, it had no effect: a path was corrected by the active version instead of the one that was asked for."""
    answer = shared_client.get("/v1/jobs?limt=3")
    refused(answer, "query.limt is not a parameter of this address; did you mean limit?")
    rows = {f"q{j + 1}_deg": [0.0] for j in range(6)}
    refused(shared_client.post(f"/v1/robots/{robot}/correct?versoin=ver_1", json=rows), "did you mean version?")
    refused(shared_client.get("/v1/health/live?x=1"), "query.x is not a parameter of this address; it takes none.")
    assert shared_client.get(f"/robots/{robot}?from=newsletter").status_code == 200


def test_every_address_refuses_a_parameter_that_it_does_not_have(shared_client: httpx.Client) -> None:
    """Whatever the method, and before anything is looked for or done: names in the address are made up."""
    described = shared_client.get("/openapi.json").json()["paths"]
    asked = [
        (method.upper(), re.sub(r"\{\w+\}", "nobody", path), {one["name"] for one in what.get("parameters", ())})
        for path, methods in described.items()
        for method, what in methods.items()
    ]
    assert len(asked) > 60
    assert {path.split("/")[1] for _, path, _ in asked} == {"v1", "metrics"}
    for method, path, known in asked:
        assert "kilt" not in known
        answer = shared_client.request(method, path, params={"kilt": "1"})
        assert answer.status_code == 422, (method, path, answer.text)
        assert "query.kilt is not a parameter of this address" in answer.json()["detail"], (method, path)
