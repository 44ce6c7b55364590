"""The live view of a stream: a real corrector, a real controller, and Chromium in front of them."""

from __future__ import annotations

import html
import json
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import zenoh
from axe_playwright_python.sync_playwright import Axe
from fastapi import FastAPI
from playwright.sync_api import Browser, Page

from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from kilter_service.stream.corrector.session import config
from kilter_service.stream.live.followers import Viewers, get_viewers
from kilter_service.web.auth.token import admin_token
from tests.core.truth import Arm, Step
from tests.corrector.live import Line, point
from tests.page.conftest import opened
from tests.page.controlling import Controller, CorrectorProcess
from tests.service.conftest import ready, served, wait_for
from tests.service.made_versions import store_version

# The nominal Katana up to its tool, from its drawing.
KATANA = Arm(
    (
        Step("rz", joint=0), Step("rx", math.pi / 2), Step("rz", joint=1), Step("tx", 0.19), Step("rz", joint=2),
        Step("tx", 0.139), Step("rz", joint=3), Step("rx", -math.pi / 2), Step("tz", 0.1473), Step("rz", joint=4),
        Step("rx", math.pi / 2), Step("tz", 0.33),
    ),
    5,
)  # fmt: skip
ROBOT = {"name": "katana", "convention": "preset", "preset": "katana450-chapter5"}
LONGEST_S = 60.0


@dataclass
class Cell:
    """A server with a robot, its active version and a corrector."""

    client: httpx.Client
    settings: Settings
    corrector: CorrectorProcess
    version: str
    app: FastAPI

    @property
    def viewers(self) -> Viewers:
        return get_viewers(self.app)

    def events(
        self,
        robot: str = "katana",
        seconds: float = 2.0,
        client: httpx.Client | None = None,
        enough: Callable[[list[Any]], bool] | None = None,
    ) -> list[Any]:
        """What followers are told within so many seconds, or until it is enough."""
        told: list[Any] = []
        end = time.monotonic() + (seconds if enough is None else LONGEST_S)
        with (client or self.client).stream("GET", f"/robots/{robot}/stream/events", timeout=30) as answer:
            assert answer.status_code == 200, answer.read()
            for line in answer.iter_lines():
                if line.startswith("data: "):
                    told.append(json.loads(line.removeprefix("data: ")))
                if time.monotonic() > end or (told and enough is not None and enough(told)):
                    break
        return told


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Cell]:
    settings = Settings(data=tmp_path_factory.mktemp("cell"), port=0, zenoh_listen="tcp/127.0.0.1:0", host="127.0.0.1")
    ready(settings, migrated)
    corrector = CorrectorProcess(settings)
    app = create_app(settings)
    with served(app) as client:
        client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
        for name in ("katana", "other"):
            client.post("/v1/robots", json=ROBOT | {"name": name}).raise_for_status()
        database = Database(settings.database)
        version = store_version(database, "katana", 1)
        database.close()
        client.post(f"/v1/versions/{version}/activate", json={"force": True}).raise_for_status()
        corrector.start()
        try:
            yield Cell(client, settings, corrector, version, app)
        finally:
            corrector.stop()


@pytest.fixture
def controller(cell: Cell) -> Iterator[Controller]:
    with Controller(cell.settings.data, "katana") as controller:
        yield controller


def main_stream(told: dict[str, Any]) -> dict[str, Any]:
    return next(stream for stream in told["streams"] if stream["name"] == "main")


def test_a_robot_without_a_stream_says_so(cell: Cell) -> None:
    told = cell.events("other")[-1]
    assert (told["streams"], told["active_version"], told["bypass"]) == ([], None, "")
    assert told["reach"] == "connected"
    text = cell.client.get("/robots/other/stream").text
    assert "No stream has run" in text
    assert "every setpoint is refused" in text


def test_what_is_told_is_what_the_controller_got(cell: Cell, controller: Controller) -> None:
    def followed(told: list[Any]) -> bool:
        """Whether it was told again and again, at a rate; a busy machine takes its time for that."""
        streams = [main_stream(one) for one in told if one["streams"]]
        if not told[-1]["streams"] or len({one["received"] for one in streams}) < 10:
            return False
        return bool(20 < streams[-1]["rate_hz"] < 130)

    told = cell.events(enough=followed)
    assert followed(told)
    last = told[-1]
    stream = main_stream(last)
    assert last["active_version"] == stream["version_id"] == cell.version
    assert (stream["condition"], last["bypass"], stream["signed"]) == ("corrected", "", True)
    assert stream["received"] == stream["corrected"] + sum(stream["refusals"].values())
    counts, edges = stream["times"]["counts"], stream["times"]["from_us"]
    assert 0 < sum(counts) <= stream["received"]
    assert edges[0] == 0 < stream["times"]["p50_us"] <= stream["times"]["p99_us"] <= 2 * stream["times"]["largest_us"]


def test_the_shown_correction_moves_the_tool_as_far_as_is_said(cell: Cell, controller: Controller) -> None:

    def shown(told: list[Any]) -> bool:  # nothing is said of the tool while a version is ramped in
        return any(one["corrected"] >= 50 and one["tool_mm"] is not None for one in told[-1]["streams"])

    stream = main_stream(cell.events(enough=shown)[-1])
    wanted = np.radians([joint["wanted"] for joint in stream["joints"]])
    correction = np.radians([joint["correction"] for joint in stream["joints"]])
    assert np.abs(wanted - (0.1, 0.6, 0.4, 0.3, 0.2)).max() <= 0.2 + 1e-9
    points = KATANA.poses(np.array([wanted, wanted + correction]))[0]
    moved_mm = 1e3 * float(np.linalg.norm(points[1] - points[0]))
    assert moved_mm == pytest.approx(stream["tool_mm"], rel=0.1)
    assert 0.05 < moved_mm < 5.0


def test_refused_setpoints_are_a_bypass(cell: Cell, controller: Controller) -> None:
    controller.outside = True
    wait_for(lambda: controller.last is not None and controller.last.source == "bypass")

    def is_refused() -> bool:  # on a busy machine setpoints may be late meanwhile, which is said then
        told = cell.events(seconds=2.0)[-1]
        said = main_stream(told)["condition"] == "bypass" and "JOINT_LIMIT" in told["bypass"]
        return said and "uncorrected" in told["bypass"] and main_stream(told)["refusals"]["JOINT_LIMIT"] > 0

    wait_for(is_refused, 60.0)
    controller.outside = False

    def is_corrected() -> bool:
        told = cell.events(seconds=2.0)[-1]
        return (main_stream(told)["condition"], told["bypass"]) == ("corrected", "")

    wait_for(is_corrected, 60.0)


def test_setpoints_without_an_active_version_are_a_bypass(cell: Cell) -> None:
    root = "kilter/@v1/local/other"
    endpoint = json.loads(cell.settings.corrector_file.read_text())["endpoints"]["stream"]
    with Line((endpoint,), "bare", root) as line:
        for seq in range(1, 60):
            line.send(point(seq))
            if seq == 40:
                told = cell.events("other", seconds=0.0)
            time.sleep(0.02)
        told = cell.events("other", seconds=2.0)
    bare = next(stream for stream in told[0]["streams"] + told[-1]["streams"] if stream["name"] == "bare")
    assert bare["refusals"]["NO_VERSION"] >= 40
    assert bare["version_id"] is None


def test_a_token_of_another_robot_sees_nothing(cell: Cell) -> None:
    made = cell.client.post("/v1/tokens", json={"name": "limited", "role": "viewer", "robots": ["other"]}).json()
    with httpx.Client(
        base_url=cell.client.base_url, headers={"Authorization": f"Bearer {made['token']}"}, timeout=60
    ) as client:
        for path in ("/robots/katana/stream", "/robots/katana/stream/events", "/robots/nobody/stream/events"):
            assert client.get(path).status_code == 404
        assert cell.events("other", 0.5, client)[-1]["robot"] == "other"


def test_the_session_is_open_only_while_somebody_looks(cell: Cell, controller: Controller) -> None:
    viewers = cell.viewers
    for _ in range(5):  # also whoever comes while the session of the one before is being closed
        assert cell.events(seconds=0.3)
        wait_for(lambda: viewers.session is None, 20.0)
    with cell.client.stream("GET", "/robots/katana/stream/events") as first:
        next(first.iter_lines())
        wait_for(lambda: viewers.session is not None, 20.0)
        session = viewers.session
        told = cell.events("other", seconds=1.0)
        assert told
        assert viewers.session is session
    wait_for(lambda: viewers.session is None)


def test_forged_messages_are_not_believed(cell: Cell, controller: Controller) -> None:
    """Whoever reaches the corrector can publish on the key of a stream."""
    document = json.loads(cell.settings.corrector_file.read_text())
    with zenoh.open(config(None, (document["endpoints"]["stream"],))) as session:
        heard = session.declare_subscriber("kilter/@v1/local/katana/stream/main/live")
        true = json.loads(heard.recv().payload.to_bytes())
        forged = true | {"received": 10**9, "at_ns": time.time_ns() + 10**9}
        with cell.client.stream("GET", "/robots/katana/stream/events") as answer:
            lines = answer.iter_lines()
            end = time.monotonic() + 2.0
            while time.monotonic() < end:
                session.put("kilter/@v1/local/katana/stream/main/live", json.dumps(forged).encode())
                line = next(lines)
                if line.startswith("data: "):
                    told = json.loads(line.removeprefix("data: "))
                    assert all(stream["received"] < 10**8 for stream in told["streams"])


def shown(page: Page, field: str) -> str:
    return page.locator(f'.stream[data-name="main"] [data-field="{field}"]').inner_text()


@pytest.mark.parametrize("size", ["desktop", "tablet"])
def test_people_see_the_stream_live(chromium: Browser, cell: Cell, controller: Controller, size: str) -> None:
    with opened(chromium, cell.client, size) as page:
        page.goto("/robots/katana/stream")
        page.locator('.stream[data-name="main"] .badge', has_text="corrected").wait_for()
        page.locator(".u-over").first.wait_for()
        before = int(page.locator("[data-stream]").get_attribute("data-updates") or 0)
        page.wait_for_timeout(3000)
        after = int(page.locator("[data-stream]").get_attribute("data-updates") or 0)
        assert after - before >= 15
        assert page.locator('[data-live="bypass"]').is_hidden()
        used = page.locator('.stream[data-name="main"] [data-field="version"] a')
        assert used.get_attribute("href") == f"/versions/{cell.version}"
        assert "the active one" in shown(page, "version")
        assert shown(page, "tool").split()[1] in ("mm", "µm")
        assert shown(page, "joint").endswith("°")
        assert page.locator('[data-table="joints"] tbody tr').count() == 5
        assert drawn(page)
        if size == "desktop":
            found = Axe().run(page)
            assert found.violations_count == 0, found.generate_report()


def drawn(page: Page) -> bool:
    """Whether lines are drawn on both canvases: pixels of the lines' first colour."""
    script = """() => [...document.querySelectorAll(".live-plot canvas")].map((canvas) => {
        const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
        let found = 0;
        for (let k = 0; k < pixels.length; k += 4)
            if (pixels[k] < 30 && Math.abs(pixels[k + 1] - 114) < 30 && Math.abs(pixels[k + 2] - 178) < 30) found += 1;
        return found;
    })"""
    counts = page.evaluate(script)
    return len(counts) == 2 and all(count > 20 for count in counts)


@pytest.mark.slow
def test_a_corrector_that_goes_is_a_bypass_and_comes_back(chromium: Browser, cell: Cell) -> None:
    with opened(chromium, cell.client) as page:
        page.goto("/robots/katana/stream")
        page.locator('[data-live="corrector"]', has_text="answers; it started").wait_for()
        cell.corrector.stop()
        banner = page.locator('[data-live="bypass"]')
        banner.wait_for()
        assert "bypass: not corrected" in banner.inner_text().lower()
        assert "`" not in banner.inner_text()
        assert page.locator("[data-opening]").is_hidden()  # that it runs was said before
        assert "does not answer" in banner.inner_text()
        cell.corrector.start()
        banner.wait_for(state="hidden", timeout=20_000)
        with Controller(cell.settings.data, "katana", "again"):
            page.locator('.stream[data-name="again"] .badge', has_text="corrected").wait_for()


def test_the_last_minute_and_the_state_are_there_when_the_view_is_opened(cell: Cell, controller: Controller) -> None:
    def shown() -> tuple[list[dict[str, Any]], str]:
        text = cell.client.get("/robots/katana/stream").text
        found = re.search(r'data-name="main" data-minute="([^"]*)"', text)
        return (json.loads(html.unescape(found[1])) if found else []), text

    wait_for(lambda: len(shown()[0]) >= 4, LONGEST_S)
    minute, text = shown()
    times = [one["at_s"] for one in minute]
    assert times == sorted(times)
    assert all(
        0.5 < after - before < 30.0 for before, after in pairwise(times)
    )  # one a second, on a busy machine fewer
    assert time.time() - times[-1] < 30.0
    stream = main_stream(
        cell.events(enough=lambda told: bool(told[-1]["streams"] and told[-1]["streams"][0]["joints"]))[-1]
    )
    largest = max(abs(value) for one in minute for value in one["joints"])
    assert 0.0 < largest < 20 * max(abs(joint["correction"]) for joint in stream["joints"]) + 1.0
    assert all(len(one["joints"]) == 5 and one["tool_mm"] >= 0.0 for one in minute)
    section = text[text.index('data-name="main"') : text.index("</section>", text.index('data-name="main"'))]
    # a report may be a second old on a busy machine, and the controller then seems silent
    assert re.search(r"Every setpoint is corrected\.|Some setpoints are refused|No setpoint", section)
    assert re.search(r"<noscript><figure>\s*<svg", section)  # the same without JavaScript
    for joint in stream["joints"]:
        assert f'<th scope="row">{joint["name"]}</th>' in section
    assert text.count('class="state compact') + text.count('<div class="bypass" role="alert" data-live="bypass">') == 1
