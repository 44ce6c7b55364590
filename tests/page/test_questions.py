"""The fifteen questions that a user asks, each answered in at most two clicks from the first page.

Each question names the routes it needs. Where one of them is not there, the question is skipped and says which.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from kilter_client import Kilter
from kilter_client.requests.calls import robots as calls
from kilter_service.web.auth.policy import PAGE_RULES
from tests.page.conftest import opened
from tools.draw_page_picture import Lab, lab, moving

pytestmark = pytest.mark.slow
OVERVIEW, JOB, VERSION = "GET /robots/{robot}", "GET /jobs/{job}", "GET /versions/{version}"
MOST_CLICKS = 2  # from the first page, where the first one opens the robot


@dataclass(frozen=True)
class Question:
    """What is asked; the links to click, by name, once the robot is opened; where the answer then is, and what it says."""

    asked: str
    clicks: tuple[str, ...]
    place: str
    answer: str
    needs: tuple[str, ...]
    at: str = ""  # where it is asked; empty: of the robot


COMPARE = "GET /versions/{a}/compare/{b}"
FLEET, POSE = "GET /", "GET /robots/{robot}/pose"
QUESTIONS = (
    Question("How good is it today?", (), ".verdict .today", r"\d (µm|mm).*mean error", (OVERVIEW,)),
    Question("What is wrong?", (), ".verdict", r"(Outside|Near|calibrated|corrected|Within).*\w+", (OVERVIEW,)),
    Question("What was it before?", (), ".shares", r"geometry.*\d.*corrected", (OVERVIEW,)),
    Question("Did it help on unseen poses?", (), ".verdict .today", r"held-out poses.*Without the version \d", (OVERVIEW,)),
    Question("Who activated it?", (), "table.six", r"Activated.*by \w+", (OVERVIEW,)),
    Question("What do I measure next?", (r"^\d+ poses$",), "#next", r"\d", (OVERVIEW, JOB)),
    Question(
        "Is the stream well?", ("^Stream$",), '.stream[data-name="main"]',
        r"corrected.*Version in use.*the active one", (OVERVIEW, "GET /robots/{robot}/stream"),
    ),
    Question("Which rows are suspicious?", (r"^\d+ rows?$",), "#suspicious", r"rows? looks? wrong\.", (OVERVIEW, VERSION)),
    Question("What does an effect do at this pose?", ("^Choose version, pose and view$",), "[data-asked]",
             r"moves it by \d.*(tilt|backlash|compliance).* \d", (OVERVIEW, POSE)),
    Question("How do I undo that?", ("^go back",), "main", r"Go back to .* on .*\?.*Go back now",
             (OVERVIEW, "GET /robots/{robot}/rollback")),
    Question("Has it moved since last week?", (), "#checks", r"(Not c|C)hecked", (OVERVIEW,)),
    Question("Is it within tolerance?", (), ".verdict", r"Tolerance 0\.3 mm: \d", (OVERVIEW,)),
    Question("How do the last two compare?", ("^compare$",), "main", r"differ|Parameters|errors", (OVERVIEW, COMPARE)),
    Question("Which of twelve needs attention?", (), "main",
             r"11\s*not known.*1\s*good.*Not calibrated.*arm-\d.*Add measurements", (FLEET,), "/"),
    # that it takes eight clicks in all, test_first_calibration counts
    Question("How do I begin with a new arm?", ("^New robot$",), "main", "A robot that Kilter knows", (FLEET,), "/"),
)  # fmt: skip


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """A robot about which everything can be asked: measured, identified, searched, activated, and moving."""
    if OVERVIEW not in PAGE_RULES:
        pytest.skip("the robot's page is not there")
    with lab(tmp_path_factory.mktemp("questions")) as made:
        with Kilter(made.server.url) as kilter:
            found = kilter.versions.list(made.robot)
            other = next(one["id"] for one in found if one["id"] != made.version)
            kilter.versions.activate(other, force=True, reason="for the test")  # so that there is one to go back to
            kilter.versions.activate(made.version, force=True, reason="for the test")
            kilter.run(calls.set_tolerance(made.robot, 0.3, None))
            for k in range(11):
                kilter.robots.add({"name": f"arm-{k}", "convention": "preset", "preset": "katana450-chapter5"})
            kilter.jobs.run("gap", made.robot, [made.train], [made.held_out], {}, timeout_s=300.0)
        with moving(made.server.data, made.robot):
            yield made


@pytest.fixture
def page(chromium: Browser, asked: Lab) -> Iterator[Page]:
    headers = {"Authorization": f"Bearer {asked.token}"}
    with (
        httpx.Client(base_url=asked.server.url, headers=headers, timeout=60) as client,
        opened(chromium, client) as page,
    ):
        page.goto("/")
        page.get_by_role("link", name=asked.robot, exact=True).click()
        page.wait_for_url(f"**/robots/{asked.robot}")
        yield page


def test_no_question_takes_more_than_two_clicks() -> None:
    assert all(len(question.clicks) + (not question.at) <= MOST_CLICKS for question in QUESTIONS)
    assert len(QUESTIONS) == 15


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda question: question.asked)
def test_a_question_is_answered(page: Page, question: Question) -> None:
    missing = [route for route in question.needs if route not in PAGE_RULES]
    if missing:
        pytest.skip(f"these views are not there: {', '.join(missing)}")
    if question.at:
        page.goto(question.at)
    for name in question.clicks:
        words = re.compile(name)
        page.get_by_role("link", name=words).or_(page.locator("summary").filter(has_text=words)).first.click()
        page.wait_for_load_state()
    expect(page.locator(question.place).first).to_contain_text(re.compile(question.answer, re.DOTALL), timeout=15_000)


def test_the_pictures_of_the_page_are_kept(page: Page) -> None:
    folder = Path(__file__).parents[2] / "build" / "page-screenshots"
    folder.mkdir(parents=True, exist_ok=True)
    page.wait_for_timeout(3000)
    page.screenshot(path=folder / "overview.png", full_page=True)
    assert (folder / "overview.png").stat().st_size > 20_000
