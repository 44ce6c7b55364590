"""Decisions about a tolerance: on held-out rows only, with the instrument's error in the guard band, the same everywhere."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli import run
from kilter_service.page import words
from tests.service.conftest import Katana, WorkerProcess
from tests.service.test_budgets import TRACKER, campaign, done

Until = Callable[..., None]


@pytest.fixture
def arm(client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until) -> dict[str, str]:
    """An active version of 60 rows of a campaign, of which 15 were held out, and 40 rows of another with an instrument."""
    client.post("/v1/robots", json={**katana.document, "controller_compensation": "none"}).raise_for_status()
    client.post("/v1/instruments", json=TRACKER).raise_for_status()
    first = campaign(client, katana, "first", 60, 1)
    worker.start()
    made = done(client, until, kind="identify", campaigns=[first], validation=0.25, options={"level": 2})["result"]
    client.post(f"/v1/versions/{made['version_id']}/activate").raise_for_status()
    second = campaign(client, katana, "second", 40, 2, instrument="tracker")
    return {"version": made["version_id"], "first": first, "second": second}


def decide(client: httpx.Client, tolerance_mm: float, **asked: Any) -> dict[str, Any]:
    answer = client.get("/v1/robots/katana/acceptance", params={"tolerance_mm": tolerance_mm, **asked})
    found: dict[str, Any] = answer.raise_for_status().json()
    return found


def test_a_decision_rests_on_held_out_rows_and_the_guard_band(
    client: httpx.Client, katana: Katana, arm: dict[str, str], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    # Today's number is of the 15 held-out rows of the first campaign, which names no instrument: nothing is proved.
    found = decide(client, 5.0)
    assert (found["decision"], [one["id"] for one in found["campaigns"]]) == ("not_proved", [arm["first"]])
    assert (found["rows"], [one["code"] for one in found["lacking"]]) == (15, ["instrument_not_named"])
    assert decide(client, 5.0, instrument="tracker")["decision"] == "accepted"

    found = decide(client, 5.0, campaign=arm["second"])
    (one,) = found["campaigns"]
    assert (found["decision"], found["rows"], one["instrument"]) == ("accepted", 40, "tracker")
    assert found["lacking"] == []
    residuals = client.get(
        f"/v1/versions/{arm['version']}/residuals", params={"campaign": arm["second"], "format": "json"}
    )
    table = residuals.raise_for_status().json()
    sizes = np.linalg.norm([table[f"d{axis}_mm"] for axis in "xyz"], axis=0)
    assert one["largest_mm"] == pytest.approx(sizes.max(), rel=1e-6)
    assert one["error_mm"] == pytest.approx(sizes[one["row"] - 1], rel=1e-6)
    assert one["provable_mm"] == pytest.approx(one["error_mm"] + one["guard_band_mm"])
    assert one["guard_band_mm"] > 2.0 * 0.015 / np.sqrt(3.0)  # of the instrument alone
    assert one["after"]["max_mm"] < one["before"]["max_mm"]
    columns = katana.columns(40, 2)
    assert found["span_mm"]["x"] == pytest.approx([min(columns["x_mm"]), max(columns["x_mm"])])
    version = client.get(f"/v1/versions/{arm['version']}").json()
    assert (found["version_sha256"], found["robot_sha256"]) == (version["sha256"], version["robot_sha256"])
    assert one["sha256"] == [client.get(f"/v1/campaigns/{arm['second']}").json()["uploads"][0]["sha256"]]

    error, guard, provable = one["error_mm"], one["guard_band_mm"], one["provable_mm"]
    assert decide(client, provable * 1.0001, campaign=arm["second"])["decision"] == "accepted"
    between = decide(client, provable * 0.9999, campaign=arm["second"])
    assert between["decision"] == "not_proved"
    assert "These rows prove" in between["sentence"]
    far = 0.5 * (one["largest_mm"] - guard)
    decision = decide(client, max(far, 1e-6), campaign=arm["second"])["decision"]
    assert decision == ("rejected" if far > 0 else "not_proved")
    assert error <= one["largest_mm"] + 1e-12

    # Library and command say the same.
    token = client.headers["authorization"].removeprefix("Bearer ")
    with Kilter(str(client.base_url), token) as kilter:
        assert kilter.accept("katana", 5.0, campaigns=[arm["second"]]).provable_mm == provable
        again = kilter.accept("katana", 5.0, campaigns=[arm["second"]], refit=["base", "tool"])
        assert tuple(again.campaigns[0].refit) == ("base", "tool")
    monkeypatch.setenv("KILTER_URL", str(client.base_url))
    monkeypatch.setenv("KILTER_TOKEN", token)
    given = ["accept", "katana", "--campaign", "second", "--tolerance"]
    for tolerance, code in ((5.0, 0), (provable * 0.9999, 4)):
        assert run([*given, str(tolerance)]) == code
    said = capsys.readouterr().out
    assert "Accepted: all 40 held-out rows prove 5 mm" in said
    assert "Neither is proved" in said
    assert run([*given, "5", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["provable_mm"] == provable
    assert run([*given, "-1"]) != 0


def test_what_proves_nothing_is_refused(
    client: httpx.Client, katana: Katana, arm: dict[str, str], until: Until
) -> None:
    for wrong in ("0", "-0.3", "nan", "inf", "much"):
        assert client.get("/v1/robots/katana/acceptance", params={"tolerance_mm": wrong}).status_code == 422
    assert client.get("/v1/robots/katana/acceptance").status_code == 422
    whole = done(client, until, kind="identify", campaigns=[arm["second"]], options={"level": 2})["result"][
        "version_id"
    ]
    fitted = client.get(
        "/v1/robots/katana/acceptance", params={"tolerance_mm": 1, "version": whole, "campaign": arm["second"]}
    )
    assert (fitted.status_code, fitted.json()["code"]) == (409, "nothing_held_out")
    assert "--validation 0.3" in fitted.json()["detail"]
    unknown = client.get("/v1/robots/katana/acceptance", params={"tolerance_mm": 1, "instrument": "none"})
    assert (unknown.status_code, unknown.json()["code"]) == (404, "instrument_not_found")
    # A certificate that did not hold proves nothing.
    old = {**TRACKER, "name": "old", "valid_until": "2020-01-01"}
    client.post("/v1/instruments", json=old).raise_for_status()
    third = campaign(client, katana, "third", 20, 5, instrument="old")
    found = decide(client, 5.0, campaign=third)
    assert (found["decision"], [one["code"] for one in found["lacking"]]) == ("not_proved", ["instrument_expired"])
    # A robot that is far off is rejected whatever the guard band.
    columns = katana.columns(20, 6)
    columns["x_mm"] = [value + 20.0 for value in columns["x_mm"]]
    made = client.post("/v1/robots/katana/campaigns", json={"name": "moved", "instrument": "tracker"}).json()["id"]
    client.post(f"/v1/campaigns/{made}/observations", json=columns).raise_for_status()
    found = decide(client, 5.0, campaign=made, refit="none")
    assert found["decision"] == "rejected"
    assert decide(client, 5.0, campaign=made, refit="base")["decision"] == "accepted"


def plain(text: str) -> str:
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<(title|desc)>.*?</\1>|<[^>]+>", " ", text)))


def test_the_first_page_of_the_report_has_the_numbers_of_the_interface(
    client: httpx.Client, arm: dict[str, str]
) -> None:
    pdfium = pytest.importorskip("pypdfium2")
    pytest.importorskip("weasyprint")
    report, asked = f"/versions/{arm['version']}/report", {"tolerance_mm": 0.3, "campaign": arm["second"]}
    found = decide(client, 0.3, campaign=arm["second"])
    (one,) = found["campaigns"]
    shown = client.get(report, params=asked).raise_for_status().text
    page = plain(shown.partition('class="first"')[2].partition("</section>")[0])
    document = pdfium.PdfDocument(client.get(f"{report}.pdf", params=asked, timeout=240).raise_for_status().content)
    pages = [re.sub(r"\s+", " ", one.get_textpage().get_text_bounded()) for one in document]
    document.close()
    budget = one["budget"]
    # One table is written in one unit, that of its largest length, which its heads name.
    merits = [one[stage][size] for stage in ("before", "after") for size in ("mean_mm", "rms_mm", "p95_mm", "max_mm")]
    parts = [part[size] for part in budget["contributions"] for size in ("half_width_mm", "standard_mm")]
    sums = [budget["expanded_mm"], budget["measured_expanded_mm"]]
    numbers = [
        *(words.bare(length, words.largest(column)) for column in (merits, parts, sums) for length in column if length),
        *(f", {words.unit(words.largest(column))}" for column in (merits, parts, sums)),
        words.mm(found["provable_mm"]),
        found["sentence"], "ISO 14253-1", "Katana".lower(), "with tracker",
    ]  # fmt: skip
    for text in (page, pages[0]):
        for number in numbers:
            assert number in text, (number, text)
    joined = pages[0].replace(" ", "")
    for sha256 in (found["version_sha256"], found["robot_sha256"], *one["sha256"]):
        assert sha256 in page
        assert sha256 in joined
    assert shown.count("<circle") + shown.count("<rect") + shown.count("<path") > 40  # the places, from two sides
    # One page that stands for itself; the rest of the report follows.
    assert "CALIBRATION REPORT" in pages[1].upper()
    assert "CALIBRATION REPORT" not in pages[0].upper()
    assert f"report.pdf?{shown.partition('report.pdf?')[2].partition(chr(34))[0]}".count("tolerance_mm=0.3") == 1
    assert client.get(report, params={"tolerance_mm": "-1"}).status_code == 422


def first_page(client: httpx.Client, version: str) -> tuple[str, str]:
    """The decision, and the first page of a report without a tolerance in plain words."""
    shown = client.get(f"/versions/{version}/report").raise_for_status().text
    part = shown.partition('class="first"')[2].partition("</section>")[0]
    return part.partition('data-decision="')[2].partition('"')[0], plain(part)


def shows(page: str, budget: dict[str, Any], stages: list[dict[str, Any]]) -> None:
    """The sums of the budget and the errors of the stages stand there, below heads with their unit."""
    sums = [budget["expanded_mm"], budget["measured_expanded_mm"]]
    errors = [stage[size] for stage in stages for size in ("mean_mm", "rms_mm", "p95_mm", "max_mm")]
    for column in (sums, errors):
        most = words.largest(column)
        assert f", {words.unit(most)}" in page
        assert all(words.bare(length, most) in page for length in column)


def test_the_first_page_without_a_tolerance_has_the_budget_and_says_how_to_have_it_decided(
    client: httpx.Client, katana: Katana, arm: dict[str, str], until: Until
) -> None:
    decision, page = first_page(client, arm["version"])
    found = decide(client, 5.0)  # of the 15 rows that were held out, which name no instrument
    assert decision == "none"
    assert "no tolerance was stated" in page
    assert "kilter version accept katana --tolerance 0.3" in page
    assert f"As it is, these rows prove none: {found['lacking'][0]['message'][:40]}" in page
    assert "they prove" not in page
    one = found["campaigns"][0]
    shows(page, one["budget"], [one["before"], one["after"]])
    client.post(f"/v1/campaigns/{arm['second']}/retire").raise_for_status()
    whole = done(client, until, kind="identify", campaigns=[arm["first"]], options={"level": 2})["result"]
    decision, page = first_page(client, whole["version_id"])  # nothing is held out: the budget is that of the fit
    assert (decision, "No row with a measured place is left" in page) == ("none", True)
    fitted = whole["metrics"]["train"]
    shows(page, fitted["budget"], [fitted["registration_only"], fitted["identified"]])
    assert "fitted rows, calibrated" in page


def test_a_campaign_of_too_few_poses_is_left_out_with_a_warning_or_refused_by_its_name(
    client: httpx.Client, katana: Katana, arm: dict[str, str], until: Until
) -> None:
    few = campaign(client, katana, "few", 2, 3, instrument="tracker")
    made = done(client, until, kind="identify", campaigns=[arm["first"]], options={"level": 2})["result"]["version_id"]
    found = decide(client, 5.0, version=made, instrument="tracker")
    assert [one["id"] for one in found["campaigns"]] == [arm["second"]]
    assert [(one["code"], one["campaigns"]) for one in found["warnings"]][:1] == [("campaign_not_judged", [few])]
    refused = client.get("/v1/robots/katana/acceptance", params={"tolerance_mm": 5.0, "version": made, "campaign": few})
    assert (refused.status_code, refused.json()["code"]) == (400, "too_few_poses")
    assert f"Campaign {few} has too few distinct poses to be judged" in refused.json()["detail"]
