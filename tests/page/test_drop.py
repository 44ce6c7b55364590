"""Dropping a file: what is understood is shown, the column map is edited, and nothing is stored before it is said."""

from __future__ import annotations

import csv
import hashlib
import html
import io
import json
import re
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.private_files import Scratch
from kilter_service.page.drop import drafts
from tests.clients.files.formats.test_lerobot import SERVOS, calibration, dataset
from tests.service.conftest import Katana

from .conftest import opened
from .test_login import csrf, logged_in, token_of

REPOSITORY = Path(__file__).resolve().parents[2]
MEASURED = REPOSITORY / "docs" / "tutorial" / "measured.csv"


@pytest.fixture(scope="module")
def robot(server: httpx.Client) -> str:
    server.post("/v1/robots", json=Katana.document).raise_for_status()
    return Katana.name


def lab_table(names: tuple[str, ...] = ("A1", "A2", "A3", "A4", "A5", "X", "Y", "Z")) -> bytes:
    """A lab's own table: semicolons, decimal commas, and names that no contract knows."""
    columns = Katana().columns(30, seed=7)
    out = io.StringIO(newline="")
    writer = csv.writer(out, delimiter=";", lineterminator="\n")
    writer.writerow(names)
    writer.writerows([f"{value:.6f}".replace(".", ",") for value in row] for row in zip(*columns.values(), strict=True))
    return out.getvalue().encode()


def dropped(client: httpx.Client, robot: str, name: str, content: bytes, **headers: str) -> str:
    """Send a file as the page does; returns the address of what was understood."""
    answer = client.post(f"/robots/{robot}/campaigns/new/file", params={"name": name}, content=content, headers=headers)
    assert answer.status_code == 201, answer.text
    return str(answer.json()["address"])


def campaigns_of(server: httpx.Client, robot: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = server.get(f"/v1/robots/{robot}/campaigns").raise_for_status().json()["campaigns"]
    return found


def shown_sha256(text: str) -> str:
    found = re.search(r'name="sha256" value="([0-9a-f]{64})"', text)
    assert found is not None, text
    return found[1]


def zipped(folder: Path, only: str = "") -> bytes:
    """The files of a folder, or one part of it, as an archive."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for file in sorted(folder.rglob("*")):
            if file.relative_to(folder).as_posix().startswith(only):
                archive.write(file, file.relative_to(folder))
    return out.getvalue()


@pytest.fixture(scope="module")
def lab(server: httpx.Client, robot: str) -> str:
    """A draft that tests look at and leave as it is."""
    return dropped(server, robot, "lab.csv", lab_table())


def test_a_file_is_understood_and_stored_once_when_it_is_said(server: httpx.Client, robot: str) -> None:
    before = len(campaigns_of(server, robot))
    address = dropped(server, robot, "measured.csv", MEASURED.read_bytes())
    text = server.get(address).raise_for_status().text
    assert "138 rows at 118 poses" in text
    assert hashlib.sha256(MEASURED.read_bytes()).hexdigest() in text
    assert len(campaigns_of(server, robot)) == before
    form = {"sha256": shown_sha256(text), "name": "dropped", "role": "validation", "payload_kg": "1,5"}
    places = {server.post(f"{address}/store", data=form).headers["location"] for _ in range(2)}
    assert len(places) == 1
    made = [one for one in campaigns_of(server, robot) if one["name"] == "dropped"]
    assert [(one["rows"], one["role"], one["conditions"]["payload_kg"]) for one in made] == [(138, "validation", 1.5)]
    assert made[0]["uploads"][0]["sha256"] == hashlib.sha256(MEASURED.read_bytes()).hexdigest()


def test_a_map_is_drafted_and_changed_and_the_file_read_anew(server: httpx.Client, robot: str) -> None:
    address = dropped(server, robot, "lab.csv", lab_table(("A1", "A2", "A3", "A4", "A5", "u", "v", "w")))
    text = server.get(address).text
    assert "Not understood yet" in text
    assert 'value="w"' in text
    names = ["A1", "A2", "A3", "A4", "A5", "u", "v", "w"]
    targets = ["q1", "q2", "q3", "q4", "q5", "x", "y", "z"]
    form = {"column": names, "target": targets, "unit": ["deg"] * 5 + ["mm"] * 3}
    text = server.post(f"{address}/columns", data=form).raise_for_status().text
    assert "30 rows at 30 poses" in text, text
    sha256 = shown_sha256(text)
    stored = server.post(f"{address}/store", data={"sha256": sha256, "name": "lab"})
    assert stored.status_code == 303, stored.text
    campaign = server.get(f"/v1{stored.headers['location']}").json()
    assert set(campaign["uploads"][0]["columns"]) == {*(f"q{k}_deg" for k in range(1, 6)), "x_mm", "y_mm", "z_mm"}
    assert 'from = "u"' in campaign["notes"]


def test_a_file_whose_rows_are_mixed_up_says_so(server: httpx.Client, robot: str) -> None:
    """Joints of another row at 40 poses that were visited twice: neither "understood" nor a noise of hundreds of mm."""
    columns = Katana().columns(40, seed=8)
    shuffled = [17 * k % 40 for k in range(40)]
    rows = {
        name: [values[k] for k in shuffled] * 2 if name.startswith("q") else [*values, *values[::-1]]
        for name, values in columns.items()
    }
    lines = [",".join(rows), *(",".join(map(repr, row)) for row in zip(*rows.values(), strict=True))]
    before = len(campaigns_of(server, robot))
    text = server.get(dropped(server, robot, "mixed.csv", "\n".join(lines).encode())).text
    assert "These rows cannot be stored yet." in text
    assert "Joints and positions do not belong together" in text
    assert "Understood." not in text
    assert "not told by rows that are mixed up" in text
    assert len(campaigns_of(server, robot)) == before


def test_what_is_stored_is_what_was_looked_at(server: httpx.Client, robot: str) -> None:
    address = dropped(server, robot, "twice.csv", lab_table())
    seen = shown_sha256(server.get(address).text)
    changed = server.get(address).text.partition('name="text"')[2].partition(">")[2].partition("</textarea>")[0]
    text = changed.replace("&#34;", '"').replace("&#39;", "'").replace('unit = "mm"', 'unit = "m"')
    server.post(f"{address}/map", data={"text": text}).raise_for_status()
    refused = server.post(f"{address}/store", data={"sha256": seen, "name": "other"})
    assert refused.status_code in (400, 422), refused.text
    assert all(one["name"] != "other" for one in campaigns_of(server, robot))


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ({"column": ["A1", "A2"], "target": ["q1", "q1"], "unit": ["deg", "deg"]}, "Two columns of the file"),
        ({"column": ["nothing"], "target": ["q1"], "unit": ["deg"]}, "not of this file"),
        ({"column": ["A1"], "target": ["q1"], "unit": []}, ""),
        ({"column": ["A1"], "target": ["<script>"], "unit": ["deg"]}, "not a column of Kilter"),
    ],
)
def test_a_map_that_cannot_be_is_refused_where_it_arises(
    server: httpx.Client, lab: str, form: dict[str, list[str]], said: str
) -> None:
    answer = server.post(f"{lab}/columns", data=form)
    assert answer.status_code in (200, 422)
    assert 'role="alert"' in answer.text
    assert said in answer.text
    assert "<script>alert" not in answer.text
    assert "q1&lt;" not in answer.text


def test_a_draft_is_of_the_login_that_made_it(server: httpx.Client, robot: str, lab: str) -> None:
    with logged_in(server, token_of(server, "operator", "somebody-else")["token"]) as other:
        refused = other.get(lab)
        assert refused.status_code == 404
        assert "nothing of it was stored" in refused.text
        own = dropped(other, robot, "own.csv", lab_table(), **csrf(other))
        assert other.get(own).status_code == 200
    assert server.get(own).status_code == 404


def test_viewers_drop_nothing_and_a_drop_needs_the_token_of_the_page(server: httpx.Client, robot: str) -> None:
    place = f"/robots/{robot}/campaigns/new/file"
    with logged_in(server, token_of(server, "viewer", "looks-only")["token"]) as viewer:
        assert viewer.post(place, content=b"a", headers=csrf(viewer)).status_code == 403
        assert "needs the role operator" in viewer.get(f"/robots/{robot}/campaigns/new").text
    with logged_in(server, token_of(server, "operator", "no-csrf")["token"]) as client:
        assert client.post(place, content=b"a").status_code == 403


def test_drafts_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scratch = Scratch(tmp_path)
    kept = drafts.Drafts(scratch)
    made = [kept.new("arm", "me", f"{k}.csv") for k in range(drafts.MOST_OF_ONE + 1)]
    assert not made[0].folder.exists()
    assert all(kept.get("arm", "me", one.id) is one for one in made[1:])
    for robot, owner in (("arm", "you"), ("other", "me")):
        with pytest.raises(ServiceError, match="no longer here"):
            kept.get(robot, owner, made[-1].id)
    monkeypatch.setattr(drafts, "KEPT_S", -1.0)
    with pytest.raises(ServiceError, match="no longer here"):
        kept.get("arm", "me", made[-1].id)
    assert not made[-1].folder.exists()
    scratch.close()


def test_what_has_no_rows_alone_says_where_it_belongs(server: httpx.Client, robot: str, tmp_path: Path) -> None:
    """Parts of LeRobot's data sets, calibrations and models of MuJoCo, which people drop beside their measurements."""
    servos, made = calibration(tmp_path), dataset(tmp_path / "set", "v3.0", [np.zeros((8, 6))], SERVOS)
    wraps = json.loads(servos.read_text())
    wraps["elbow_flex"]["range_max"] = 5000
    rows = next(made.glob("data/**/*.parquet")).read_bytes()
    for name, content, said in (
        ("my_arm.json", servos.read_bytes(), "a calibration of servos has no rows"),
        ("wraps.json", json.dumps(wraps).encode(), "it wraps within the range"),
        ("info.json", (made / "meta/info.json").read_bytes(), "Match the whole folder with a recording"),
        ("file-000.parquet", rows, "Match the whole folder with a recording"),
        ("cut.parquet", rows[: len(rows) // 2], "is not a Parquet file"),
        ("set.zip", zipped(made), "is a ZIP archive of a LeRobot data set. Unpack it, and match its folder"),
        ("my-arm.zip", zipped(servos.parent, "my_arm.json"), "a spreadsheet (my_arm.json). Unpack it"),
        (
            "so101.xml",
            b'<?xml version="1.0"?><mujoco><include file="so101.xml"/></mujoco>',
            "a model of MuJoCo has no rows",
        ),
    ):
        shown = html.unescape(server.get(dropped(server, robot, name, content)).text)
        assert said in " ".join(shown.split()), name
        assert str(tmp_path) not in shown


@pytest.mark.parametrize("version", ["v2.1", "v3.0"])
def test_every_part_of_a_data_set_says_where_it_belongs(
    server: httpx.Client, robot: str, tmp_path: Path, version: str
) -> None:
    made = dataset(tmp_path / "set", version, [np.zeros((8, 6))] * 2, SERVOS, video=True)
    for part in sorted(path for path in made.rglob("*") if path.is_file()):
        said = "is a video" if part.suffix == ".mp4" else "Match the whole folder with a recording"
        shown = html.unescape(server.get(dropped(server, robot, part.name, part.read_bytes())).text)
        assert said in " ".join(shown.split()), part


@pytest.mark.short_path
def test_people_who_drop_a_zipped_data_set_read_what_to_do(
    page: Page, server: httpx.Client, robot: str, tmp_path: Path
) -> None:
    file = tmp_path / "my-set.zip"
    file.write_bytes(zipped(dataset(tmp_path / "my-set", "v3.0", [np.zeros((8, 6))], SERVOS).parent, "my-set"))
    page.goto(f"/robots/{robot}/campaigns/new")
    page.locator("#file").set_input_files(file)
    page.wait_for_url("**/campaigns/new/*")
    told = page.get_by_role("alert")
    expect(told).to_contain_text("my-set.zip: is a ZIP archive of a LeRobot data set. Unpack it")
    expect(told).to_contain_text("kilter measure match RECORDING FOLDER --calibration JSON --norm-mode MODE")
    assert page.get_by_role("button", name="Store", exact=True).count() == 0


def test_names_of_files_are_shown_as_text_and_lead_nowhere(server: httpx.Client, robot: str) -> None:
    address = dropped(
        server,
        robot,
        '../../<script>alert(1)</script>"\\.csv',
        lab_table(("<b>a</b>", "b", "c", "d", "e", "x", "y", "z")),
    )
    text = server.get(address).text
    assert "<script>alert" not in text
    assert "<b>a</b>" not in text
    assert "&lt;b&gt;a" in text


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("../../etc/passwd", "passwd"),
        ("", "file-dropped"),
        ("rows", "file-rows"),
        ("C:\\data\\a b.csv", "a b.csv"),
        ("...", "file-dropped"),
    ],
)
def test_a_file_stays_in_its_folder(name: str, expected: str) -> None:
    assert drafts.plain_name(name) == expected


@pytest.mark.short_path
def test_people_drop_edit_and_store(page: Page, server: httpx.Client, robot: str, tmp_path: Path) -> None:
    file = tmp_path / "lab.csv"
    file.write_bytes(lab_table(("A1", "A2", "A3", "A4", "A5", "X", "Y", "height")))
    page.goto(f"/robots/{robot}/campaigns/new")
    page.locator("#file").set_input_files(file)
    page.wait_for_url("**/campaigns/new/*")
    for column, target in (("X", "x"), ("Y", "y"), ("height", "z")):
        with page.expect_response("**/columns"):
            page.get_by_label(f"What {column} is").select_option(target)
        expect(page.locator("fieldset.plain")).to_be_enabled()
    page.get_by_text("Understood.").wait_for()
    found = Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
    name = f"people {page.viewport_size}"
    page.get_by_label("Name", exact=True).fill(name)
    page.get_by_role("button", name="Store", exact=True).click()
    page.wait_for_url("**/campaigns/cmp_*")
    assert page.get_by_role("heading", name=name, exact=True).is_visible()
    assert any(one["name"] == name for one in campaigns_of(server, robot))


REAL = (
    ("fanuc-r2000-3markers/calibration_dataset.mat", "MATLAB, up to version 7", "q(:,1)"),
    ("talos-arm/talos_left_arm_02_10_contact.csv", "delimited text", "arm_left_1_joint"),
    ("tdms-samples/raw1.tdms", "LabVIEW's TDMS", "Layer Data"),
)


IPA = "ipa-ur10-lasertracker/Series_B/measurements_joint_configurations.csv"


def test_a_file_of_a_known_device_needs_no_map_and_may_have_one(
    chromium: Browser, server: httpx.Client, robot: str, shared_data: Path
) -> None:
    """Who drops it sees that it was recognised, and which column became what; the columns show when they want a map."""
    server.post("/v1/robots", json={"name": "ur", "convention": "preset", "preset": "ur10"}).raise_for_status()
    with opened(chromium, server) as page:
        page.goto("/robots/ur/campaigns/new")
        page.locator("#file").set_input_files(shared_data / IPA)
        page.wait_for_url("**/campaigns/new/*")
        assert page.get_by_text("A campaign of Fraunhofer IPA's laser tracker data set", exact=True).first.is_visible()
        page.get_by_text("Understood.").wait_for()
        assert "q1_rad to q6_rad from the six joints [rad]" in page.locator("main").inner_text()
        assert page.locator("table.column-map").count() == 0
        page.get_by_label("Read it", exact=True).select_option("map")
        page.get_by_role("button", name="Read again").click()
        page.locator("table.column-map").get_by_text("shoulder_pan_joint").first.wait_for()


def test_real_files_are_understood_in_the_browser(
    chromium: Browser, server: httpx.Client, robot: str, shared_data: Path
) -> None:
    with opened(chromium, server) as page:
        for path, kind, column in REAL:
            page.goto(f"/robots/{robot}/campaigns/new")
            page.locator("#file").set_input_files(shared_data / path)
            page.wait_for_url("**/campaigns/new/*")
            assert page.get_by_text(kind, exact=True).first.is_visible(), path
            assert page.locator("table.column-map").get_by_text(column).first.is_visible(), path


def test_what_reads_a_drop_starts_without_arrow() -> None:
    """It is started for each file, and few are Parquet."""
    code = "import sys, kilter_service.page.drop.child; print({'numpy', 'pyarrow'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
