"""Figures and tables as files, as the browser makes them."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from PIL import Image
from playwright.sync_api import Browser, Page

from tests.service.conftest import Katana

from .conftest import opened
from .made import Made, made_fixtures

there, server = made_fixtures(active=False)


def saved(page: Page, label: str) -> tuple[str, bytes]:
    """Name and content of the file that a button gives."""
    with page.expect_download() as download:
        page.get_by_role("button", name=label, exact=True).click()
    return download.value.suggested_filename, Path(download.value.path()).read_bytes()


def test_all_rows_of_a_campaign_are_a_file(there: Made) -> None:
    text = there.client.get(f"/campaigns/{there.campaign}").text
    address = f"/campaigns/{there.campaign}/rows.csv?rows=1-60"
    assert f'href="{address}"' in text
    rows = list(csv.DictReader(io.StringIO(there.client.get(address).raise_for_status().text)))
    assert [float(one["q1_deg"]) for one in rows] == pytest.approx(Katana().columns(60, seed=3)["q1_deg"])


def test_figures_and_tables_are_saved(there: Made, chromium: Browser) -> None:
    with opened(chromium, there.client) as page:
        page.goto(f"/campaigns/{there.campaign}")
        name, content = saved(page, "Save From above as SVG")
        assert name == "from-above.svg"
        root = ElementTree.fromstring(content)
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert len(root.findall(".//{http://www.w3.org/2000/svg}circle")) >= 60
        name, content = saved(page, "Save From above as PNG")
        picture = Image.open(io.BytesIO(content)).convert("RGB")
        box = [float(v) for v in root.attrib["viewBox"].split()]
        assert picture.size == (2 * box[2], 2 * box[3])
        seen = np.asarray(picture)
        assert (seen[2, 2] == 255).all()  # white paper
        assert (np.abs(seen.astype(int) - (0, 114, 178)).sum(axis=2) < 30).sum() > 60 * 20  # blue points
        name, content = saved(page, "Save the numbers of From above as CSV")
        rows = list(csv.DictReader(io.StringIO(content.decode())))
        assert name == "from-above.csv"
        assert [float(one["x, mm"]) for one in rows] == pytest.approx(Katana().columns(60, seed=3)["x_mm"], abs=1.0)
        name, content = saved(page, "Save Columns as CSV")
        assert next(csv.reader(io.StringIO(content.decode()))) == [
            "Column", "What it is", "Shown in", "Lowest", "Highest", "Gaps",
        ]  # fmt: skip
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
