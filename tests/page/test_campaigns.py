"""Campaigns on the page: what is stored, row by row without losing an extreme, rows set aside, and taking one out of use."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pyarrow as pa
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect
from pyarrow import parquet
from sqlalchemy import select

from kilter_core.twin import thesis_katana
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow, RobotRow
from kilter_service.ground.limits import Recent
from kilter_service.ground.settings import Settings
from kilter_service.page.chosen import thin_series
from kilter_service.run.app import create_app
from kilter_service.versions import store as versions
from kilter_service.versions.store import NewVersion
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, new_database, ready, served

from .conftest import opened
from .test_login import csrf, logged_in, token_of

PARQUET = {"content-type": "application/vnd.apache.parquet"}


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Settings]:
    with new_database() as url:
        yield Settings(data=tmp_path_factory.mktemp("campaigns"), database_url=url, host="127.0.0.1", token=None)


@pytest.fixture(scope="module")
def server(settings: Settings, migrated: Path) -> Iterator[httpx.Client]:
    ready(settings, migrated)
    with served(create_app(settings)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        yield client


@pytest.fixture(scope="module")
def database(settings: Settings, server: httpx.Client) -> Iterator[Database]:
    """The database of the server, past it."""
    database = Database(settings.database)
    yield database
    database.close()


@pytest.fixture(scope="module")
def campaign(server: httpx.Client) -> str:
    """A campaign with a wrong row, and a name that must be shown as text."""
    katana = Katana()
    server.post("/v1/robots", json=katana.document).raise_for_status()
    rows = katana.columns(50, seed=2)
    rows["x_mm"][20] += 80.0
    new = {"name": "<script>alert(1)</script>", "notes": "<b>bold</b>", "device": "tracker"}
    made = server.post(f"/v1/robots/{katana.name}/campaigns", json=new).raise_for_status().json()["id"]
    server.post(f"/v1/campaigns/{made}/observations", json=rows).raise_for_status()
    return str(made)


def test_the_list_and_the_campaign_say_what_the_interface_says(server: httpx.Client, campaign: str) -> None:
    told = server.get(f"/v1/campaigns/{campaign}").json()
    for address in (f"/robots/{Katana.name}/campaigns", f"/campaigns/{campaign}"):
        text = server.get(address).raise_for_status().text
        assert "<script>alert" not in text
        assert "&lt;script&gt;alert(1)&lt;/script&gt;" in text
    assert told["uploads"][0]["sha256"] in text
    assert "50 rows at 50 poses" in text
    assert "<b>bold</b>" not in text
    named = text.partition('id="doubts"')[2].partition("</section>")[0]
    assert '<th scope="row">21</th>' in named
    assert named.count('<th scope="row">') == 1


def test_rows_set_aside_are_named_with_the_version_that_did(
    server: httpx.Client, database: Database, campaign: str
) -> None:
    aside = [{"campaign": campaign, "row": 21, "residual_sigma": 61.5, "weight": 0.04}]
    used = [{"id": campaign, "name": "c", "role": "train", "use": "train", "rows": 50, "sha256": []}]
    report = {"parameters": [], "metrics": {"train": {"n": 1}}, "noise_mm": 0.01, "set_aside": aside}
    limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
    calibration = thesis_katana().truth.to_document()
    new = NewVersion(calibration, report, {"names": [], "matrix": [], "units": "SI"}, used, limits, None, "test")
    with database.transaction() as session:
        robot = session.execute(select(RobotRow.id).where(RobotRow.name == Katana.name)).scalar_one()
        session.add(JobRow(id="job_00000000000000aa", kind="identify", robot_id=robot, request={}, state="succeeded"))
        session.flush()
        version = versions.add(session, robot, "job_00000000000000aa", new)
    text = server.get(f"/campaigns/{campaign}").text
    told = text.partition('id="doubts"')[2].partition("</section>")[0]
    assert version in told
    assert "61.5" in told
    assert "4 %" in told
    assert f"/versions/{version}" in text.partition("Used by")[2].partition("</section>")[0]


@pytest.mark.parametrize("count", [10, 1000, 100_003])
def test_no_extreme_is_lost(count: int) -> None:
    random = np.random.default_rng(1)
    values = random.normal(0.0, 1.0, count)
    values[count // 3], values[count // 2] = 90.0, -90.0
    values[count // 5] = np.nan
    rows, shown = thin_series(values, 1, count, 200, keep=[count // 5 + 1])
    assert len(rows) <= max(401, 2 * 200 + 1)
    assert {90.0, -90.0} <= set(shown)
    assert count // 5 + 1 in rows
    assert rows == sorted(rows)
    assert all(value is None or value == values[row - 1] for row, value in zip(rows, shown, strict=True))
    if count > 400:  # of every pixel the least and the greatest
        edges = np.linspace(0, count, 201).astype(int)
        for first, last in itertools.pairwise(edges):
            inside = [
                value for row, value in zip(rows, shown, strict=True) if first < row <= last and value is not None
            ]
            assert (min(inside), max(inside)) == (np.nanmin(values[first:last]), np.nanmax(values[first:last]))


def test_columns_that_are_kept_are_bounded() -> None:
    kept = Recent[np.ndarray](3 * 800, lambda column: column.nbytes)
    for k in range(20):
        assert kept.get((str(k),), lambda k=k: np.full(100, float(k)))[0] == k
    assert len(kept._kept) == 3
    assert kept.get(("19",), lambda: pytest.fail("it was kept"))[0] == 19


def test_a_million_rows_are_drawn_at_once(server: httpx.Client) -> None:
    katana = Katana()
    server.post("/v1/robots", json=katana.document).raise_for_status()
    one = {name: np.array(values) for name, values in katana.columns(1000, seed=4).items()}
    table = pa.table({name: np.tile(values, 1000) for name, values in one.items()})
    sink = pa.BufferOutputStream()
    parquet.write_table(table, sink, compression="zstd")
    made = server.post(f"/v1/robots/{katana.name}/campaigns", json={"name": "million"}).json()["id"]
    sent = server.post(
        f"/v1/campaigns/{made}/observations", content=bytes(sink.getvalue()), headers=PARQUET, timeout=120
    )
    assert sent.status_code == 201, sent.text
    query = {"column": "x_mm", "first": 1, "last": 1_000_000, "width": 900}
    found = server.get(f"/campaigns/{made}/series.json", params=query, timeout=120).raise_for_status().json()
    assert found["rows"] == 1_000_000
    assert len(found["x"]) <= 1800
    assert (min(found["y"]), max(found["y"])) == pytest.approx((one["x_mm"].min(), one["x_mm"].max()))
    began = time.process_time()
    for k in range(10):  # the server is a thread of this process: its work counts
        server.get(f"/campaigns/{made}/series.json", params={**query, "first": 1 + k}).raise_for_status()
    print(f"a million rows, a column that is kept: {(time.process_time() - began) * 100:.0f} ms of processor time each")


def test_a_column_that_is_not_there_is_refused(server: httpx.Client, campaign: str) -> None:
    refused = server.get(f"/campaigns/{campaign}/series.json", params={"column": "nothing"})
    assert (refused.status_code, "no column" in refused.text) == (400, True)


def test_viewers_look_and_change_nothing(server: httpx.Client, campaign: str) -> None:
    with logged_in(server, token_of(server, "viewer", "reads-campaigns")["token"]) as viewer:
        assert "needs the role operator" in viewer.get(f"/campaigns/{campaign}").text
        for action in ("change", "retire", "restore"):
            form = {"name": "other"} if action == "change" else {}
            assert viewer.post(f"/campaigns/{campaign}/{action}", data=form, headers=csrf(viewer)).status_code == 403
    assert server.get(f"/v1/campaigns/{campaign}").json()["retired_at"] is None


def test_people_look_closer_and_take_it_out_of_use(page: Page, server: httpx.Client, campaign: str) -> None:
    page.goto(f"/campaigns/{campaign}")
    drawn = page.locator("[data-drawn]")
    drawn.wait_for()
    page.get_by_label("Column", exact=True).select_option("z_mm")
    page.locator("[data-drawn^=z_mm]").wait_for()
    page.locator(".u-over").scroll_into_view_if_needed()
    box = page.locator(".u-over").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.2 * box["width"], box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 50, steps=4)
    page.mouse.up()
    expect(page.locator("[data-drawn^=z_mm]")).not_to_have_attribute("data-drawn", "z_mm 1 50")
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
    page.get_by_role("button", name="Take it out of use").click()
    page.get_by_role("dialog").get_by_role("button", name="Take it out of use").click()
    page.get_by_text("Out of use since").wait_for()
    page.get_by_role("button", name="Bring it back into use").click()
    page.get_by_role("button", name="Take it out of use").wait_for()
    assert server.get(f"/v1/campaigns/{campaign}").json()["retired_at"] is None


def test_without_a_login_reads_are_shown(chromium: Browser, server: httpx.Client, campaign: str) -> None:
    with opened(chromium, server, token=False) as page:
        page.goto(f"/campaigns/{campaign}")
        assert page.get_by_text("needs the role operator").is_visible()
