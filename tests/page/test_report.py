"""The report of a version: what it says is what the interface says, and its PDF is the same every time and fetches nothing."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser
from sqlalchemy import select

from kilter_core.twin import thesis_katana
from kilter_service.contract.versions import CorrectionLimits
from kilter_service.ground import child_process
from kilter_service.ground.db import Database
from kilter_service.ground.db.tables import JobRow, RobotRow, VersionRow
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.settings import Settings
from kilter_service.jobs import store as jobs
from kilter_service.jobs.kind import VersionContent
from kilter_service.page.report import routes
from kilter_service.run.app import create_app
from kilter_service.versions import store as versions
from kilter_service.versions.objections import objections_from_report
from kilter_service.versions.store import NewVersion
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, new_database, ready, served

from .conftest import opened

JOB, EVALUATION, DOUBTFUL = "job_00000000000000b1", "job_00000000000000b2", "job_00000000000000b4"
LINK = "https://elsewhere.test/beacon.png"
OPTIONS = {
    "kind": "identify", "robot": Katana.name, "name": "", "campaigns": [], "validation": None, "confirmation": [],
    "options": {},
}  # fmt: skip
ERRORS = {
    "n": 30,
    "nominal": {"mean_mm": 1.4, "rms_mm": 1.6, "p95_mm": 2.8, "max_mm": 2.9},
    "registration_only": {"mean_mm": 0.975, "rms_mm": 1.09, "p95_mm": 1.84, "max_mm": 2.19},
    "identified": {"mean_mm": 0.0181, "rms_mm": 0.0208, "p95_mm": 0.0348, "max_mm": 0.0503},
}
REPORT = {
    "noise_mm": 0.0081,
    "metrics": {"train": {"n": 60}, "validation": ERRORS},
    "warnings": [
        {"code": "no_repeats", "message": f"No `pose` was repeated <script>alert(1)</script> <img src='{LINK}'>."}
    ],
    "null_directions": [{"parameters": [], "sentence": "tool_z cannot be told from d_5 in these poses."}],
    "parameters": [
        {"name": "a_2", "unit": "mm", "value": 190.00421, "nominal": 190.0, "sigma": 0.0014, "identifiable": True},
        {"name": "d_5", "unit": "mm", "value": 200.0, "nominal": 200.0, "sigma": 5.0, "identifiable": False, "plausible": True},
        {"name": "backlash_load_2", "unit": "deg", "value": -0.17, "nominal": 0.0, "sigma": 0.02, "identifiable": True,
         "plausible": False},
        {"name": "backlash_load_3", "unit": "deg", "value": -0.01, "nominal": 0.0, "sigma": 0.02, "identifiable": True,
         "plausible": False},
    ],
}  # fmt: skip
EDGES = [0.01, 0.02, 0.05, 1.0, 2.0, 3.0]
FIGURES = {
    "held_out_errors": {
        "data": [
            {"type": "scatter", "name": f"{name}: median 1, rms 1 mm", "x": EDGES, "y": [*counts, 0]}
            for name, counts in {
                "before, nominal": [0, 0, 0, 10, 20], "registration only": [0, 0, 20, 5, 5], "identified": [16, 14, 0, 0, 0],
            }.items()
        ]
    }
}  # fmt: skip
ISO = {
    "version_id": "", "standard": "ISO 9283:1998", "refit": [],
    "iso9283": {
        "cmp_1": {"metrics": {"AP": {"mm": 0.123, "n": 30, "demands": 30}, "RP": {"mm": 0.045, "n": 5, "demands": 30}}}
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Settings]:
    with new_database() as url:
        yield Settings(data=tmp_path_factory.mktemp("report"), database_url=url, host="127.0.0.1", token=None)


@pytest.fixture(scope="module")
def server(settings: Settings, migrated: Path) -> Iterator[httpx.Client]:
    ready(settings, migrated)
    with served(create_app(settings)) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        yield client


@pytest.fixture(scope="module")
def version(server: httpx.Client, settings: Settings) -> str:
    """A version as a job would store it, and an evaluation of it by ISO 9283."""
    server.post("/v1/robots", json=Katana.document).raise_for_status()
    limits = {"max_joint_deg": 1.0, "max_position_mm": 5.0}
    calibration = thesis_katana().truth.to_document()
    new = NewVersion(calibration, REPORT, {"names": [], "matrix": [], "units": "SI"}, [], limits, None, "test")
    database = Database(settings.database)
    with database.transaction() as session:
        robot = session.execute(select(RobotRow.id).where(RobotRow.name == Katana.name)).scalar_one()
        session.add(
            JobRow(
                id=JOB, kind="identify", robot_id=robot, request=OPTIONS, state="succeeded", result={"figures": FIGURES},
                asked_by={"actor": "anna"},
            )
        )  # fmt: skip
        session.flush()
        made = versions.add(session, robot, JOB, new)
        request = {**OPTIONS, "kind": "evaluate"}
        result = {**ISO, "version_id": made}
        session.add(
            JobRow(id=EVALUATION, kind="evaluate", robot_id=robot, request=request, state="succeeded", result=result)
        )
        session.add(JobRow(id="job_00000000000000b3", kind="identify", robot_id=robot, request=OPTIONS, state="failed"))
    database.close()
    return made


def plain(html: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", html))


def test_the_report_says_what_the_interface_says(server: httpx.Client, version: str) -> None:
    told = server.get(f"/v1/versions/{version}").raise_for_status().json()
    html = server.get(f"/versions/{version}/report").raise_for_status().text
    text = plain(html)
    assert re.search(r"Mean error on \d+ unseen rows: 0\.97 -&gt; 0\.018 mm\. Before: nominal arm", text)
    assert "a_2 mm 190.0000 190.0042 ± 0.0014 0.0042 190.0015 to 190.0070 yes" in text
    assert "These poses cannot determine d_5" in text
    assert "tool_z cannot be told from d_5" in text
    for shown in (text, plain(server.get(f"/versions/{version}").raise_for_status().text)):
        assert "below 0, which cannot be: check masses, payload and how the base stands" in shown
        assert "not seen: below 0 by less than its uncertainty" in shown
        assert "larger than usual" not in shown
    assert told["sha256"] in text
    assert told["robot_sha256"] in text
    assert re.search(rf"{JOB}, identify; asked for [-0-9: ]+ UTC by anna, finished", text)
    assert "AP 0.123 30 30" in text
    assert "RP 0.0450 5 30 (too few: only a guideline)" in text
    for effect in told["effects"]:
        assert effect in text
    assert "<script>" not in html
    assert "&lt;script&gt;" in html
    assert "No <code>pose</code> was" in html


def test_the_report_says_which_share_has_which_error(server: httpx.Client, version: str) -> None:
    html = server.get(f"/versions/{version}/report").raise_for_status().text
    text = plain(html)
    assert (
        "Model Half of the rows are below, mm All are below, mm nominal robot 3.00 3.00 base and tool fitted only 1.00 3.00 "
        "calibrated 0.0200 0.0500" in text
    )
    drawn = html.partition("Share of held-out rows with at most an error")[2].partition("</svg>")[0]
    lines = re.findall(r"<polyline [^>]*>", drawn)
    assert len(lines) == 3
    assert len({re.sub(r"points=\"[^\"]*\"", "", line) for line in lines}) == 3  # told apart without colour, by dashes
    assert len(set(re.findall(r'stroke="([^"]*)"', "".join(lines)))) == 1
    assert "Share of fitted rows" not in html


def test_the_report_says_how_far_each_effect_moves_the_tool(server: httpx.Client, version: str) -> None:
    html = server.get(f"/versions/{version}/report").raise_for_status().text
    table = html.partition('<table class="effects"')[2].partition("</table>")[0]
    notes = server.get(f"/v1/versions/{version}/export", params={"format": "urdf"}).headers["kilter-notes"]
    told = re.findall(r"Left out: (\w+), ([\d.]+) mm rms and ([\d.]+) mm", notes)
    assert told
    (unit,) = set(re.findall(r">(?:Moves the tool, rms|largest), (mm|µm)<", table))
    scale = {"mm": 1.0, "µm": 1e-3}[unit]
    for effect, rms, largest in told:
        row = table.partition(f">{effect}<")[2].partition("</tr>")[0]
        sizes = [scale * float(one) for one in re.findall(r'class="number">([\d.]+)<', row)]
        assert sizes == pytest.approx([float(rms), float(largest)], abs=6e-4, rel=6e-3), effect


def test_the_tables_of_the_report_have_their_units_in_their_heads(server: httpx.Client, version: str) -> None:
    for address in (f"/versions/{version}/report", f"/jobs/{EVALUATION}/report"):
        html = server.get(address).raise_for_status().text
        cells = re.findall(r"<td[^>]*>([^<]*)</td>", html)
        assert len(cells) > 10
        assert [one for one in cells if re.fullmatch(r"-?[\d.]+ (mm|µm|deg|%)", one)] == []


def test_the_report_of_a_job_is_that_of_what_it_found(server: httpx.Client, version: str) -> None:
    text = plain(server.get(f"/jobs/{EVALUATION}/report").raise_for_status().text)
    assert "ISO 9283:1998" in text
    assert f"of version {version}" in text  # where it comes from
    assert re.search(r"evaluation of katana, [-0-9]+ [0-9:]+, [^,]+, katana v[0-9]+\.", text)
    refused = server.get("/jobs/job_00000000000000b3/report")
    assert refused.status_code == 422
    assert "when it has succeeded" in refused.text
    assert server.get("/versions/ver_0000000000000000/report").status_code == 404


def test_one_sentence_says_that_a_version_is_not_fit_to_correct_with(server: httpx.Client, settings: Settings) -> None:
    far = {"n": 30, "identified": {"mean_mm": 51.0}}
    made = doubtful(server, settings, {"metrics": {"train": ERRORS, "validation": far}})
    said = "Complete, but not fit to correct with: It leaves 51 mm on its own held-out rows, too large to"
    job, page = f"/jobs/{DOUBTFUL}", f"/versions/{made}"
    for address in (job, f"{job}/report", page, f"{page}/report"):
        assert plain(server.get(address).raise_for_status().text).count(said) == 1, address


def doubtful(server: httpx.Client, settings: Settings, report: dict[str, Any]) -> str:
    """A version with another report, stored as its job would store it; its id."""
    server.post("/v1/robots", json=Katana.document | {"name": "other"}).raise_for_status()
    limits = CorrectionLimits(max_joint_deg=1.0, max_position_mm=5.0)
    new = VersionContent(
        thesis_katana().truth.to_document(), report, {"names": [], "matrix": [], "units": "SI"}, limits
    )
    database = Database(settings.database)
    with database.transaction() as session:
        robot = session.execute(select(RobotRow.id).where(RobotRow.name == "other")).scalar_one()
        session.add(
            JobRow(id=DOUBTFUL, kind="identify", robot_id=robot, request=OPTIONS | {"robot": "other"}, state="running")
        )
        session.flush()
        jobs.succeed(session, DOUBTFUL, {}, new, None, objections_from_report(report, limits))
    with database.reading() as session:
        made = session.execute(select(VersionRow.id).where(VersionRow.job_id == DOUBTFUL)).scalar_one()
    database.close()
    return made


def test_the_pdf_is_the_same_every_time(server: httpx.Client, version: str) -> None:
    pytest.importorskip("weasyprint")
    pdfium = pytest.importorskip("pypdfium2")
    address = f"/versions/{version}/report.pdf"
    first, second = (server.get(address, timeout=240).raise_for_status() for _ in range(2))
    assert first.headers["content-type"] == "application/pdf"
    assert first.content == second.content
    document = pdfium.PdfDocument(io.BytesIO(first.content))
    pages = [page.get_textpage().get_text_bounded() for page in document]
    whole = " ".join(pages)
    assert f"Page 1 of {len(pages)}" in pages[0]
    assert "Signatures" in whole
    assert "0.0181" in whole
    assert LINK.encode() not in first.content
    width, height = document[0].get_size()
    assert (round(width), round(height)) == (595, 842)  # A4
    document.close()


def test_a_server_without_pango_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def without(module: str, folder: Path, *_: object) -> child_process.Ended:
        (folder / "lacking").write_text("cannot load library 'libpango-1.0-0'")
        return child_process.Ended(1, False, "")

    monkeypatch.setattr(child_process, "run", without)
    with pytest.raises(ServiceError, match="print the report from the browser") as caught:
        routes.pdf(tmp_path, "<p>a</p>", "")
    assert caught.value.code == "pdf_unavailable"
    assert "libpango" in caught.value.message


def test_the_report_stands_in_nobodys_way(chromium: Browser, server: httpx.Client, version: str) -> None:
    for size in ("desktop", "tablet"):
        with opened(chromium, server, size) as page:
            page.goto(f"/versions/{version}/report")
            found = Axe().run(page)
            assert found.violations_count == 0, found.generate_report()
            assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
            page.emulate_media(media="print")
            assert page.get_by_role("link", name="As PDF").is_hidden()
