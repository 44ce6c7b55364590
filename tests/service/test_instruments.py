"""Instruments: permissible error and certificate, named by campaigns, with a warning where the certificate did not hold."""

from __future__ import annotations

import html
import json
import re
from datetime import UTC, date, datetime
from typing import Any

import httpx
import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_client.errors import ApiError, ConflictError, UsageError
from tests.service.conftest import Katana

TRACKER: dict[str, Any] = {
    "name": "tracker-2026",
    "kind": "laser_tracker",
    "serial_number": "502113",
    "mpe_standard": "iso_10360_10",
    "mpe_um": 15.0,
    "mpe_um_per_m": 6.0,
    "certificate": "K-1234",
    "certified_on": "2026-01-10",
    "valid_until": "2026-10-31",
}


def connected(client: httpx.Client) -> Kilter:
    return Kilter(str(client.base_url), client.headers["authorization"].removeprefix("Bearer "))


@pytest.mark.both_databases
def test_an_instrument_is_stored_once_and_never_changed(client: httpx.Client) -> None:
    first = client.post("/v1/instruments", json=TRACKER)
    assert first.status_code == 201
    assert {key: first.json()[key] for key in TRACKER} == TRACKER
    assert client.post("/v1/instruments", json=TRACKER).status_code == 200
    other = client.post("/v1/instruments", json={**TRACKER, "certificate": "K-2345"})
    assert (other.status_code, other.json()["code"]) == (409, "instrument_exists")
    assert "another name" in other.json()["detail"]
    client.post("/v1/instruments", json={**TRACKER, "name": "camera", "kind": "camera", "mpe_standard": "other"})
    pages, after = [], None
    while True:
        found = client.get("/v1/instruments", params={"limit": 1, **({"after": after} if after else {})}).json()
        pages.append([one["name"] for one in found["instruments"]])
        after = found["next"]
        if after is None:
            break
    assert pages == [["camera"], ["tracker-2026"]]
    assert client.get("/v1/instruments").json()["instruments"][1]["certificate"] == "K-1234"


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"mpe_um": 0.0, "mpe_um_per_m": 0.0}, "no instrument is without error"),
        ({"mpe_um": -1.0}, "greater than or equal to 0"),
        ({"valid_until": "2025-12-31"}, "valid_until is before certified_on"),
        ({"kind": "camera"}, "is of kind laser_tracker, not camera"),
        ({"kind": "tracker"}, "laser_tracker"),
        ({"valid_until": "31.10.2026"}, "valid_until"),
        ({"name": "my tracker"}, "name"),
        ({"serial_number": ""}, "serial_number"),
    ],
)
def test_what_no_instrument_can_be_is_refused(shared_client: httpx.Client, wrong: dict[str, Any], said: str) -> None:
    answer = shared_client.post("/v1/instruments", json={**TRACKER, **wrong})
    assert answer.status_code == 422
    assert said in answer.text
    assert TRACKER["name"] not in [one["name"] for one in shared_client.get("/v1/instruments").json()["instruments"]]


def test_a_token_of_some_robots_may_name_instruments_and_not_add_any(client: httpx.Client, katana: Katana) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    limited = client.post("/v1/tokens", json={"name": "left", "role": "admin", "robots": ["katana"]}).raise_for_status()
    headers = {"Authorization": f"Bearer {limited.json()['token']}"}
    assert client.post("/v1/instruments", json=TRACKER, headers=headers).status_code == 403
    client.post("/v1/instruments", json=TRACKER).raise_for_status()
    wanted = {"name": "a", "instrument": "tracker-2026"}
    made = client.post("/v1/robots/katana/campaigns", json=wanted, headers=headers).raise_for_status()
    assert made.json()["instrument"] == "tracker-2026"


@pytest.mark.parametrize(
    ("day", "code"),
    [
        ("2026-10-31", None),
        ("2026-11-01", "instrument_expired"),
        ("2026-01-10", None),
        ("2026-01-09", "instrument_not_yet_certified"),
    ],
)
def test_a_campaign_is_warned_of_when_the_certificate_did_not_hold(
    client: httpx.Client, katana: Katana, day: str, code: str | None
) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    client.post("/v1/instruments", json=TRACKER).raise_for_status()
    wanted = {"name": "a", "instrument": "tracker-2026", "measured_at": f"{day}T12:00:00+00:00"}
    made = client.post("/v1/robots/katana/campaigns", json=wanted).raise_for_status().json()
    expected = [] if code is None else [code]
    assert [one["code"] for one in made["warnings"]] == expected
    address = f"/v1/campaigns/{made['id']}"
    sent = client.post(f"{address}/observations", json=katana.columns(20)).raise_for_status().json()
    assert [one["code"] for one in sent["warnings"] if one["code"].startswith("instrument")] == expected
    for shown in (client.get(address).json(), client.get("/v1/robots/katana/campaigns").json()["campaigns"][0]):
        assert (shown["instrument"], [one["code"] for one in shown["warnings"]]) == ("tracker-2026", expected)
    page = html.unescape(client.get(f"/campaigns/{made['id']}").text)
    assert "tracker-2026" in page
    assert ("held until 2026-10-31" in page) == (code == "instrument_expired")


def test_where_no_day_is_stated_the_day_of_storing_counts(client: httpx.Client, katana: Katana) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    today = datetime.now(UTC).date()
    for name, until, codes in (
        ("old", date(2020, 1, 1), ["instrument_expired"]),
        ("new", date(today.year + 2, 1, 1), []),
    ):
        end = {"name": name, "certified_on": None, "valid_until": until.isoformat()}
        client.post("/v1/instruments", json={**TRACKER, **end}).raise_for_status()
        made = client.post("/v1/robots/katana/campaigns", json={"name": name, "instrument": name}).json()
        assert [one["code"] for one in made["warnings"]] == codes
    missing = client.post("/v1/robots/katana/campaigns", json={"name": "x", "instrument": "none"})
    assert (missing.status_code, missing.json()["code"]) == (404, "instrument_not_found")
    assert "There are: new, old." in missing.json()["detail"]
    plain = client.post("/v1/robots/katana/campaigns", json={"name": "y"}).raise_for_status().json()
    assert (plain["instrument"], plain["warnings"]) == (None, [])


def test_the_library_adds_lists_and_names_them(client: httpx.Client, katana: Katana) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    with connected(client) as kilter:
        made = kilter.add_instrument(
            "tracker", "laser_tracker", "502113", mpe_um=15, mpe_um_per_m=6, mpe_standard="iso_10360_10",
            certificate="K-1", certified_on=date(2026, 1, 10), valid_until="2026-10-31",
        )  # fmt: skip
        assert (made.mpe_um, made.certified_on) == (15.0, "2026-01-10")
        assert [one.name for one in kilter.instruments()] == ["tracker"]
        at = datetime(2026, 11, 2, tzinfo=UTC)
        sent = kilter.upload(
            "katana", katana.columns(20), name="a", instrument="tracker", measured_at=at, progress=False
        )
        assert [one.code for one in sent.warnings][:1] == ["instrument_expired"]
        assert kilter.campaign(sent.campaign_id).instrument == "tracker"
        with pytest.raises(UsageError, match="2026-11-02"):
            kilter.add_instrument("b", "other", "1", mpe_um=1, valid_until="tomorrow")
        with pytest.raises(ConflictError):
            kilter.add_instrument("tracker", "other", "1", mpe_um=1)
        with pytest.raises(ApiError, match="no instrument"):
            kilter.upload("katana", katana.columns(20), name="b", instrument="nothing", progress=False)


def test_the_command_adds_and_lists_them(
    client: httpx.Client, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("KILTER_URL", str(client.base_url))
    monkeypatch.setenv("KILTER_TOKEN", client.headers["authorization"].removeprefix("Bearer "))

    def kilter(*words: str, code: int = 0) -> str:
        assert run(list(words)) == code
        return re.sub(r"\s+", " ", capsys.readouterr().out)

    assert "no instrument yet" in kilter("instrument", "list")
    given = ["instrument", "add", "tracker", "--kind", "laser_tracker", "--serial-number", "502113", "--mpe-um", "15"]
    said = kilter(*given, "--mpe-um-per-m", "6", "--certificate", "K-1", "--valid-until", "2026-10-31")
    assert "MPE 15 um + 6 um/m x L" in said
    assert "tracker laser_tracker 502113 15 um + 6 um/m x L other K-1 2026-10-31" in kilter("instrument", "list")
    assert json.loads(kilter("instrument", "list", "--json"))["instruments"][0]["mpe_um_per_m"] == 6.0
    kilter(*given[:3], "--kind", "camera", *given[5:], code=1)
    kilter(*given, "--valid-until", "soon", code=2)
