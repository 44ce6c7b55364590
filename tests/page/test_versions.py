"""Versions on the page: what each holds, how two differ, and activating one with open eyes."""

from __future__ import annotations

import csv
import html
import io
import re
from pathlib import Path

import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page
from sqlalchemy import update

from kilter_service.ground.db.tables import ChunkRow

from .conftest import opened
from .made import SCRIPT, Made, made, made_fixtures
from .test_login import csrf, logged_in, token_of

there, server = made_fixtures(active=False)


def activate(there: Made, version: str, **wish: object) -> None:
    there.client.post(f"/v1/versions/{version}/activate", json=wish).raise_for_status()


def active(there: Made) -> str:
    return str(there.client.get(f"/v1/robots/{there.robot}").json()["active_version"])


def words(text: str) -> str:
    return html.unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", text)))


def test_the_history_says_lineage_and_who_activated_what(there: Made) -> None:
    activate(there, there.poor)
    activate(there, there.good)
    text = there.client.get(f"/robots/{there.robot}/versions").text
    assert f'href="/versions/{there.poor}">version 1</a></td>' in text  # where the good one started
    said = words(text)
    assert "nominal robot" in said
    assert "0.0200 held out" in said  # of the good version, in the unit of the other
    assert "0.900 held out" in said
    assert "Error, mm" in said  # the head of the column
    assert said.count("admin activated version ") == 2
    assert "version 2 is active, since" in said


def test_a_version_says_what_it_knows_and_what_it_does_not(there: Made) -> None:
    said = words(there.client.get(f"/versions/{there.good}").text)
    assert "a_2 mm 190.00000 190.03100 ± 0.00070 0.03100 " in said
    assert "190.0296 to 190.0324 " in said  # 1.96 standard deviations
    assert "Not identifiable" in said
    assert "At their nominal values: beta_5 ." in said
    assert "One guess of many that fit as well, so read them only together: d_5 ." in said
    report = words(there.client.get(f"/versions/{there.good}/report").text)
    assert "cannot determine beta_5: their values are those of the nominal robot." in report
    assert "cannot determine d_5: their values are not nominal" in report
    assert "mean error on held-out poses; 95 % interval 17.1 µm to 22.9 µm" in said  # 20 ± 1.96 · 9.28 / √40
    assert "Registration only (base and tool) 0.950" in said


def test_what_people_wrote_is_text(there: Made) -> None:
    there.client.patch(f"/v1/versions/{there.poor}", json={"notes": SCRIPT}).raise_for_status()
    for path in (f"/versions/{there.poor}", f"/robots/{there.robot}/versions"):
        text = there.client.get(path).text
        assert SCRIPT not in text
        assert "&lt;script&gt;" in text


def test_files_say_what_they_leave_out(there: Made) -> None:
    text = there.client.get(f"/versions/{there.good}/exports").text
    for name in ("json", "urdf", "dh-csv", "mdh-csv", "matlab"):
        answer = there.client.get(f"/v1/versions/{there.good}/export", params={"format": name})
        assert f"/v1/versions/{there.good}/export?format={name}" in text
        notes = answer.headers.get("kilter-notes", "")
        assert all(note in words(text) for note in notes.split(" | "))
    assert "six revolute joints" in text  # why there is no file for a Universal Robots driver


def test_contributions_are_those_of_the_exports(there: Made) -> None:
    text = words(there.client.get(f"/versions/{there.good}/contributions").text)
    notes = there.client.get(f"/v1/versions/{there.good}/export", params={"format": "urdf"}).headers["kilter-notes"]
    for effect, rms, largest in re.findall(r"Left out: (\w+), ([\d.]+) mm rms and ([\d.]+) mm", notes):
        row = re.search(rf" {effect} ([\d.e-]+) ([\d.e-]+) ", text)
        assert row is not None, effect
        assert float(row[1]) == pytest.approx(float(rms), abs=6e-4, rel=6e-3)
        assert float(row[2]) == pytest.approx(float(largest), abs=6e-4, rel=6e-3)


def sizes(there: Made, version: str) -> np.ndarray:
    """Errors of the rows as the interface has them."""
    answer = there.client.get(f"/v1/versions/{version}/residuals", params={"campaign": there.campaign})
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    return np.array([np.hypot(np.hypot(float(r["dx_mm"]), float(r["dy_mm"])), float(r["dz_mm"])) for r in rows])


def test_where_a_version_corrects_is_a_table_and_a_map(there: Made) -> None:
    assert f'hx-get="/versions/{there.good}/workspace"' in there.client.get(f"/versions/{there.good}").text
    part = there.client.get(f"/versions/{there.good}/workspace", headers={"HX-Request": "true"}).raise_for_status().text
    counts = [int(count) for count in re.findall(r'<td class="number">(\d+)</td>', part.partition("</table>")[0])]
    assert sum(counts) == 500
    assert "corrected to within what is stated" in part
    assert part.count("<circle") >= counts[0]
    assert "height above the base, mm" in part


def test_two_versions_are_compared_on_the_same_rows(there: Made) -> None:
    answer = there.client.get(f"/versions/{there.poor}/compare/{there.good}", params={"campaign": there.campaign})
    said = words(answer.text)
    poor, good = sizes(there, there.poor), sizes(there, there.good)
    assert "On the same 60 rows" in said
    assert f"mean {poor.mean():.3g} {good.mean():.3g} " in said
    assert f"largest {poor.max():.3g} {good.max():.3g} " in said
    assert f" 95 {np.percentile(poor, 95):.3g} {np.percentile(good, 95):.3g} " in said
    assert "Only version 2 has: clearance_tilt" in said
    plain = words(there.client.get(f"/versions/nominal/compare/{there.good}").text)
    assert "nominal robot and version 2" in plain


def test_a_campaign_of_another_robot_is_refused_with_words(there: Made) -> None:
    answer = there.client.get(
        f"/versions/{there.poor}/compare/{there.good}", params={"campaign": "cmp_0000000000000000"}
    )
    assert "There is no campaign" in words(answer.text)


def open_dialog(page: Page, version: str) -> None:
    page.goto(f"/versions/{version}")
    page.get_by_role("button", name="Activate…").click()
    page.get_by_role("button", name="Activate now").wait_for()


@pytest.mark.short_path
def test_a_version_is_activated_through_the_dialog_that_says_what_changes(there: Made, page: Page) -> None:
    activate(there, there.poor, force=True, reason="for the test")
    open_dialog(page, there.good)
    ahead = there.client.get(f"/v1/versions/{there.good}/preview").json()
    said = page.get_by_role("dialog").inner_text()
    assert f"Largest correction of the tool: {ahead['largest_mm']:.2f} mm" in said
    assert all(joint["joint"] in said for joint in ahead["joints"])
    assert re.search(r"Error on its own held-out poses, mm\s+0\.900\s+0\.0200", said)
    page.get_by_role("button", name="Leave it as it is").click()
    assert active(there) == there.poor
    page.get_by_role("button", name="Activate…").click()
    page.get_by_role("button", name="Activate now").click()
    page.wait_for_url(f"**/robots/{there.robot}")
    assert active(there) == there.good
    page.goto(f"/robots/{there.robot}/versions")
    page.get_by_role("button", name="Go back to the version before…").click()
    page.get_by_role("button", name="Go back now").click()
    page.wait_for_url(f"**/robots/{there.robot}")
    assert active(there) == there.poor


def test_a_refusal_says_why_and_only_then_it_can_be_forced(there: Made, chromium: Browser) -> None:
    activate(there, there.good)
    with opened(chromium, there.client) as page:
        open_dialog(page, there.poor)
        assert page.get_by_label("Reason").count() == 0
        page.get_by_role("button", name="Activate now").click()
        alert = page.get_by_role("dialog").get_by_role("alert")
        alert.wait_for()
        assert "it was not fitted to" in alert.inner_text()
        assert "identify again" in alert.inner_text()
        assert active(there) == there.good
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
        page.get_by_label("Reason").fill("the gear was <b>changed</b>")
        page.get_by_label("I want it although").check()
        page.get_by_role("button", name="Activate now").click()
        page.wait_for_url(f"**/robots/{there.robot}")
        assert page.get_by_text("the gear was <b>changed</b>").is_visible()
    last = there.client.get(f"/v1/robots/{there.robot}/activations").json()["activations"][0]
    assert (last["version_id"], last["forced"], last["reason"]) == (there.poor, True, "the gear was <b>changed</b>")


def test_who_was_overtaken_is_told_and_changes_nothing(there: Made, chromium: Browser) -> None:
    activate(there, there.poor, force=True, reason="for the test")
    with opened(chromium, there.client, "tablet") as page:
        open_dialog(page, there.good)
        activate(there, there.good)
        activate(there, there.poor, force=True, reason="somebody else")
        page.get_by_role("button", name="Activate now").click()
        alert = page.get_by_role("dialog").get_by_role("alert")
        alert.wait_for()
        assert "Another version was active when you looked" in alert.inner_text()
    assert active(there) == there.poor


def test_who_may_only_look_sees_why_a_button_is_disabled(there: Made, chromium: Browser) -> None:
    activate(there, there.good)
    token = token_of(there.client, "viewer", "visitor")["token"]
    with logged_in(there.client, token) as client:
        text = client.get(f"/versions/{there.poor}").text
        assert '<button type="button" disabled>Activate…</button>' in text
        assert "needs the role operator" in text
        refused = client.post(f"/versions/{there.poor}/activate", data={"etag": "*"}, headers=csrf(client))
        assert refused.status_code == 403
    assert active(there) == there.good


def test_nothing_is_activated_without_the_state_it_starts_from(there: Made) -> None:
    activate(there, there.good)
    for data in ({}, {"etag": '"activation-0"'}):
        assert there.client.post(f"/versions/{there.poor}/activate", data=data).status_code in (412, 422)
    forced = there.client.post(f"/versions/{there.poor}/activate", data={"etag": "*", "force": "true"})
    assert "Say why" in forced.text
    assert active(there) == there.good


def test_nothing_stands_in_the_way_of_anybody(there: Made, chromium: Browser) -> None:
    with opened(chromium, there.client, "tablet") as page:
        for path in (
            f"/robots/{there.robot}/versions", f"/versions/{there.good}", f"/versions/{there.poor}/compare/{there.good}",
        ):  # fmt: skip
            page.goto(path)
            page.wait_for_load_state("networkidle")
            found = Axe().run(page)
            assert found.violations_count == 0, found.generate_report()


def test_errors_are_shown_by_what_may_cause_them(there: Made) -> None:
    wanted = {"campaign": there.campaign}
    page = there.client.get(f"/versions/{there.good}/by-factor", params=wanted).text
    assert page.count("Error by the reading of ") >= 5
    rows = list(
        csv.DictReader(io.StringIO(there.client.get(f"/v1/versions/{there.good}/residuals", params=wanted).text))
    )
    sizes = np.array([np.sqrt(sum(float(row[f"d{axis}_mm"]) ** 2 for axis in "xyz")) for row in rows])
    table = page.rpartition("Numbers of Error in the order of the rows")[2].partition("</table>")[0]
    cells = [
        [words(cell).strip() for cell in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", line)]
        for line in re.findall(r"<tr>(.*?)</tr>", table, re.DOTALL)
    ]
    scale = {"Mean error, µm": 1e-3, "Mean error, mm": 1.0}[cells.pop(0)[1]]
    assert sum(int(line[3]) for line in cells) == len(rows)
    for line, part in zip(cells, np.array_split(sizes, len(cells)), strict=True):
        assert float(line[1]) * scale == pytest.approx(part.mean(), rel=0.01)


def test_a_version_of_no_campaign_says_so(there: Made) -> None:
    refused = there.client.get(f"/versions/{there.good}/by-factor")
    assert refused.status_code == 400
    assert "made from no campaign" in refused.text


def test_errors_by_cause_stand_in_nobodys_way(chromium: Browser, server: httpx.Client, there: Made) -> None:
    with opened(chromium, server) as page:
        page.goto(f"/versions/{there.good}")
        page.locator("#by-factor").scroll_into_view_if_needed()
        page.locator("#by-factor").get_by_text("made from no campaign").wait_for()  # htmx has asked
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()


def damaged(there: Made) -> None:
    """Take the rows of the campaign away from under the database: whatever reads them fails in a way nobody foresaw."""
    with there.database.engine.begin() as connection:
        connection.execute(update(ChunkRow).values(parquet=b"PAR1 and then nothing that a reader knows"))


def test_a_part_that_fails_is_a_sentence_and_keeps_nobody_from_going_back(tmp_path: Path, migrated: Path) -> None:
    with made(tmp_path, migrated) as there:
        activate(there, there.poor)
        activate(there, there.good)
        damaged(there)
        part = {"HX-Request": "true"}
        dialog = there.client.get(f"/robots/{there.robot}/rollback", headers=part).raise_for_status()
        assert "What it would correct could not be computed" in words(dialog.text)
        etag = re.search(r'name="etag" value="([^"]*)"', dialog.text)
        assert etag is not None
        assert "Go back now" in dialog.text
        for path in (
            f"/versions/{there.poor}/by-factor?campaign={there.campaign}",
            f"/versions/{there.good}/by-factor?campaign={there.campaign}",
        ):
            answer = there.client.get(path, headers=part)
            assert answer.status_code in (400, 500), path
            assert answer.headers["content-type"].startswith("text/html"), path
            assert 'role="alert"' in answer.text, path
            assert "{" not in words(answer.text), path
        gone = there.client.get("/no/such/part", headers=part)
        assert (gone.status_code, gone.headers["content-type"]) == (404, "text/html; charset=utf-8")
        page = there.client.get(f"/versions/{there.poor}/by-factor?campaign={there.campaign}")
        assert page.headers["content-type"].startswith("text/html")
        assert "To the robots" in page.text
        sent = there.client.post(f"/robots/{there.robot}/rollback", data={"etag": html.unescape(etag[1])}, headers=part)
        assert sent.status_code < 500, sent.text
        assert active(there) == there.poor
