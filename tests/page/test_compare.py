"""Any two versions compared pose by pose: against counts and probabilities worked out here."""

from __future__ import annotations

import csv
import html
import io
import json
import math
import re

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser
from sqlalchemy import text

from kilter_core.twin import thesis_katana
from kilter_service.page.words import chance as written
from kilter_service.page.words import format_in_shared_unit
from kilter_service.versions.predictions.differences import _beyond as beyond
from kilter_service.versions.predictions.differences import chance
from tests.service.conftest import Katana

from .conftest import opened
from .made import Made, made_fixtures, stored
from .test_robot import words

there, server = made_fixtures(active=False)


def sizes(there: Made, version: str, campaign: str) -> np.ndarray:
    """Sizes (N,) mm of the errors as the interface has them."""
    answer = there.client.get(f"/v1/versions/{version}/residuals", params={"campaign": campaign})
    rows = csv.DictReader(io.StringIO(answer.text))
    return np.array([math.dist((0, 0, 0), [float(row[f"d{axis}_mm"]) for axis in "xyz"]) for row in rows])


def compared(there: Made, campaign: str) -> str:
    address = f"/versions/{there.poor}/compare/{there.good}"
    return there.client.get(address, params={"campaign": campaign}).raise_for_status().text


@pytest.mark.parametrize(("better", "worse"), [(47, 3), (3, 47), (5, 5), (1, 0), (0, 0), (60, 0)])
def test_the_sign_test_is_exact(better: int, worse: int) -> None:
    count = better + worse
    tail = sum(math.comb(count, k) for k in range(min(better, worse) + 1)) / 2**count
    assert chance(better, worse) == pytest.approx(min(2 * tail, 1.0), rel=1e-9)


def test_probabilities_and_lengths_are_written_as_people_read_them() -> None:
    assert [written(one) for one in (0.42, 0.0123, 1.2e-9, 3e-18)] == ["0.42", "0.012", "below 1e-6", "below 1e-6"]
    assert [format_in_shared_unit(one, 0.05) for one in (0.05, 0.0012)] == ["50.0 µm", "1.2 µm"]
    assert [format_in_shared_unit(one, 1.25) for one in (1.25, 0.0201)] == ["1.25 mm", "0.02 mm"]


def test_two_versions_are_paired_row_by_row(there: Made) -> None:
    text = compared(there, there.campaign)
    said = words(text)
    difference = sizes(there, there.poor, there.campaign) - sizes(there, there.good, there.campaign)
    better = int((difference > 0).sum())
    assert better >= 55
    assert f"version 2 is better on {better} of 60 rows" in said
    assert f"with probability {written(chance(better, 60 - better))} (exact sign test)" in said
    mean = float(difference.mean())
    assert f"It leaves {mean:.3g} mm less on average" in said or f"It leaves {mean:.2f} mm less on average" in said
    half = 2.0010 * float(difference.std(ddof=1)) / math.sqrt(60)  # Student's quantile with 59 degrees of freedom
    found = re.search(r"how much less: ([\d.]+) mm to ([\d.]+) mm", said)
    assert found is not None
    assert [float(v) for v in found.groups()] == pytest.approx([mean - half, mean + half], abs=0.006)
    rows = set(re.findall(r'data-row="([^"]+)"', text))
    assert rows == {f"{there.campaign}/{k}" for k in range(1, 61)}
    both = re.search(r"version 1 leaves [\d.]+ (\S+) on average and version 2 [\d.]+ (\S+)\. ", said)
    assert both is not None, said[:900]
    assert both.groups() == ("mm", "mm")  # one unit, that of the larger


def test_rows_of_one_pose_count_once(there: Made) -> None:
    rows = {
        name: [value for value in column for _ in range(3)] for name, column in Katana().columns(12, seed=9).items()
    }
    new = {"name": "repeats"}
    campaign = there.client.post(f"/v1/robots/{there.robot}/campaigns", json=new).raise_for_status().json()["id"]
    there.client.post(f"/v1/campaigns/{campaign}/observations", json=rows).raise_for_status()
    said = words(compared(there, campaign))
    assert re.search(r"version 2 is better on 1[0-2] of 12 poses", said)
    assert "Rows of one pose count once." in said


@pytest.mark.parametrize(
    ("change", "sigmas", "moved"),
    [(0.1, (0.03, 0.04), True), (0.09, (0.03, 0.04), False), (0.001, (None, None), True), (0.0, (None, None), False)],
)
def test_parameters_moved_by_more_than_both_uncertainties(
    change: float, sigmas: tuple[float | None, float | None], moved: bool
) -> None:
    assert beyond(change, *sigmas) is moved


def test_rows_that_a_job_set_aside_count_and_the_comparison_says_so(there: Made) -> None:
    """A search said 24.5 um of itself and the comparison 41.7 um, of the same campaign: one row made the difference."""
    with there.database.transaction() as session:
        kept = session.execute(text("SELECT report FROM versions WHERE id = :id"), {"id": there.good}).scalar_one()
        aside = [{"campaign": there.campaign, "row": row, "residual_mm": 1.0} for row in (3, 7)]
        changed = json.dumps({**json.loads(kept), "set_aside": aside})
        session.execute(text("UPDATE versions SET report = :r WHERE id = :id"), {"r": changed, "id": there.good})
    try:
        said = words(compared(there, there.campaign))
    finally:
        with there.database.transaction() as session:
            session.execute(text("UPDATE versions SET report = :r WHERE id = :id"), {"r": kept, "id": there.good})
    assert "2 of these rows were set aside by the job of version 2, whose own errors leave them out." in said
    assert "set aside by the job" not in words(compared(there, there.campaign))


def test_the_page_says_what_the_interface_answers(there: Made) -> None:
    address = f"/v1/versions/{there.poor}/diff/{there.good}"
    answer = there.client.get(address, params={"campaign": there.campaign}).raise_for_status().json()
    paired = answer["paired"]
    assert (paired["rows"], paired["poses"], paired["held_out"], answer["not_paired"]) == (60, 60, True, "")
    assert paired["sentence"] in words(compared(there, there.campaign))
    difference = sizes(there, there.poor, there.campaign) - sizes(there, there.good, there.campaign)
    assert paired["better"] == int((difference > 0).sum())
    assert paired["less_mm"] == pytest.approx(float(difference.mean()), abs=1e-6)
    by_job = there.client.get(f"/v1/versions/job_{there.poor[4:]}/diff/job_{there.good[4:]}").raise_for_status().json()
    assert (by_job["a"], by_job["b"]) == (there.poor, there.good)
    newest = there.client.get(f"/v1/robots/{there.robot}/campaigns").json()["campaigns"][-1]["id"]
    assert by_job["paired"]["campaigns"] == [newest]  # neither was made from a campaign


def test_searches_that_are_ticked_are_compared_by_their_versions(there: Made) -> None:
    jobs = [f"job_{one[4:]}" for one in (there.poor, there.good)]
    sent = there.client.get("/jobs/compare", params={"job": jobs}, follow_redirects=True)
    assert str(sent.url).endswith(f"/versions/{there.poor}/compare/{there.good}")
    assert "is better on" in words(sent.text)
    one = there.client.get("/jobs/compare", params={"job": jobs[:1]})
    assert (one.status_code, "at least two searches" in words(one.text)) == (400, True)


def test_versions_that_are_ticked_are_compared(there: Made) -> None:
    place = f"/robots/{there.robot}/versions/compare"
    ticked = there.client.get(f"/robots/{there.robot}/versions").text
    assert set(re.findall(r'type="checkbox" name="version" value="([^"]+)"', ticked)) == {there.good, there.poor}
    two = there.client.get(place, params={"version": [there.poor, there.good]}, follow_redirects=False)
    assert two.headers["location"] == f"/versions/{there.poor}/compare/{there.good}"
    one = there.client.get(place, params={"version": [there.poor]})
    assert (one.status_code, "at least two" in words(one.text)) == (400, True)


def test_two_are_ticked_and_compared_in_the_browser(there: Made, chromium: Browser) -> None:
    with opened(chromium, there.client) as page:
        page.goto(f"/robots/{there.robot}/versions")
        for box in page.get_by_role("checkbox", name="Compare").all():
            box.check()
        page.get_by_role("button", name="Compare those ticked").click()
        page.get_by_text("is better on").wait_for()
        page.goto(f"{page.url.partition('?')[0]}?campaign={there.campaign}")
        page.locator("svg [data-row]").first.click()
        page.locator(".row-tray").get_by_text("1 row chosen").wait_for()
        assert page.locator("svg [data-chosen]").count() == 2  # from above and from the side
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()


def test_many_rows_are_paired_after_the_view_is_there(there: Made, chromium: Browser) -> None:
    """Pairing 100 000 rows takes ten seconds, in which nothing was shown; parameters and campaigns are there at once."""
    new = {"name": "many rows"}
    campaign = there.client.post(f"/v1/robots/{there.robot}/campaigns", json=new).raise_for_status().json()["id"]
    columns = {name: list(values) for name, values in Katana().columns(5200, seed=11).items()}
    there.client.post(f"/v1/campaigns/{campaign}/observations", json=columns).raise_for_status()
    first = compared(there, campaign)
    assert "Comparing 5\u202f200 rows pose by pose" in html.unescape(first)
    assert ("is better on" in first, "What differs" in first) == (False, True)
    address = re.search(r'<a href="([^"]+rows=true[^"]+)"', first)  # for those without JavaScript
    assert address is not None
    whole = there.client.get(html.unescape(address[1])).raise_for_status().text
    said = re.search(r"version 2 is better on [^.]+", words(whole))
    assert said is not None
    assert "Comparing" not in words(whole)
    third = stored(there.database, 3, thesis_katana().truth, there.good, 0.02, [0.03, 0.0007])
    several = f"/robots/{there.robot}/versions/compare?" + "&".join(
        f"version={one}" for one in (there.poor, there.good, third)
    )
    begun = html.unescape(there.client.get(several).raise_for_status().text)
    assert "Comparing 5\u202f200 rows pose by pose" in begun
    assert ("of 5\u202f200 rows" in begun, "Parameters that moved" in begun) == (False, True)
    told = words(there.client.get(f"{several}&rows=true").raise_for_status().text)
    assert "Comparing" not in told
    assert len(re.findall(r"of 5.200 rows", told)) == 2
    with opened(chromium, there.client) as page:
        page.goto(several)
        page.get_by_text(re.compile(r"of 5.200 rows$")).first.wait_for()
        assert page.locator("#same-rows .note").count() == 0
        page.goto(f"/versions/{there.poor}/compare/{there.good}?campaign={campaign}")
        page.get_by_text("is better on").wait_for()
        assert said[0] in words(page.content())
        assert page.locator("#same-rows").count() == 1
        page.locator("svg [data-row]").first.click()
        page.locator(".row-tray").get_by_text("1 row chosen").wait_for()
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            found = Axe().run(page)
            assert found.violations_count == 0, found.generate_report()
