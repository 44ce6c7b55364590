"""A gap search on the page: what a real worker found is shown as the interface says it, and can be followed up."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser
from scipy.stats import t as student_t

from kilter_service.contract.gap_details import Evidence, Gates
from kilter_service.contract.jobs.gap import GapResult
from kilter_service.ground.db import Database
from kilter_service.ground.settings import Settings
from kilter_service.page.gap.effects import GATES, describe_evidence
from kilter_service.page.shared.curves import (
    Point,
    bin_points,
    branches,
    curves,
    own_curves,
    student,
)
from kilter_service.page.shared.naming import format_effect_at_joints
from kilter_service.page.words import number, of_joints
from kilter_service.run.app import create_app
from kilter_service.web.auth.token import admin_token
from tests.service.conftest import Katana, WorkerProcess, new_database, ready, served, wait_for
from tests.service.test_gap import FINAL, Arm

from .conftest import opened
from .test_login import csrf, logged_in, token_of

EVIL = "<script>alert(1)</script>"


@dataclass
class Hunted:
    """A server with finished searches: ``open`` proposes poses, ``closed`` held poses out."""

    client: httpx.Client
    robot: str
    campaign: str
    other: str
    open: dict[str, Any]
    closed: dict[str, Any]
    waiting: str


@pytest.fixture(scope="module")
def hunted(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Hunted]:
    with new_database() as url:
        settings = Settings(data=tmp_path_factory.mktemp("gap"), database_url=url, host="127.0.0.1", token=None)
        ready(settings, migrated)
        database = Database(settings.database)
        worker = WorkerProcess(settings, database)
        try:
            with served(create_app(settings)) as client:
                client.headers["Authorization"] = f"Bearer {admin_token(settings)}"
                worker.start()
                yield _hunt(client, worker)
        finally:
            worker.kill()
            database.close()


def _hunt(client: httpx.Client, worker: WorkerProcess) -> Hunted:
    arm = Arm(client)
    campaign = arm.upload()
    asked = [arm.ask(campaign), arm.ask(campaign, validation=0.25)]
    addresses = [answer.raise_for_status().headers["location"] for answer in asked]
    wait_for(lambda: all(client.get(address).json()["state"] in FINAL for address in addresses))
    worker.kill()
    other = arm.upload({name: values[:20] for name, values in arm.columns.items()})
    client.patch(f"/v1/campaigns/{other}", json={"name": EVIL}).raise_for_status()
    waiting = arm.ask(campaign).raise_for_status().json()["id"]
    first, second = (client.get(address).json() for address in addresses)
    return Hunted(client, arm.name, campaign, other, first, second, waiting)


class _Text(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.parts: list[str] = []

    def handle_data(self, data: str) -> None:
        self.parts.append(data)


def text_of(answer: httpx.Response) -> str:
    """What people read of a page."""
    assert answer.status_code == 200, answer.text
    reader = _Text()
    reader.feed(answer.text)
    return " ".join(" ".join(reader.parts).split())


def bare(text: str) -> str:
    """A text without spaces and backticks: what stands between these is shown as code."""
    return re.sub(r"[\s`]", "", text)


def story(hunted: Hunted, job: dict[str, Any]) -> str:
    return text_of(hunted.client.get(f"/jobs/{job['id']}"))


def test_the_page_says_what_the_interface_says(hunted: Hunted) -> None:
    for job in (hunted.open, hunted.closed):
        said, result = story(hunted, job), job["result"]
        assert result["sentence"] in said
        assert bare(result["headline"]) in bare(said)
        for effect in result["effects"]:
            assert f"{effect['id']} of joint {effect['joints'][0]}" in said
            assert f"{effect['gain_mm']:.3g}" in said
            for amount in effect["parameters"]:
                assert f"{amount['interval_low']:.3g} to {amount['interval_high']:.3g}" in said
        listed = result["load_model"]
        assert ("Masses and centres:" in said) == bool(listed)
        assert f"{sum(one['seen'] for one in listed)} of {len(listed)} seen by the data" in said or not listed
        for row in result["not_testable"]:
            assert row["reason"] in said
            assert row["remedy"] in said
        for pose in result["next_poses"]:
            assert ", ".join(f"{q:.2f}" for q in pose["q_deg"]) in said


def test_the_level_of_the_claim_and_what_would_raise_it(hunted: Hunted) -> None:
    effect = hunted.open["result"]["effects"][0]
    said = story(hunted, hunted.open)
    assert effect["verdict"] == "provisional"
    assert "What would decide it" in said
    assert effect["to_confirm"]
    assert all(bare(remedy) in bare(said) for remedy in effect["to_confirm"])
    failed = [name for name, passed in effect["gates"].items() if passed is False]
    assert failed == ["unseen_poses"]
    assert f"{GATES['unseen_poses'][0]} no 0 poses" in said
    closed = story(hunted, hunted.closed)
    assert "Reversal error, like backlash: joint 1 class confirmed" in closed  # friction does it as well
    assert "friction from torques times compliance from loads" in closed


def test_every_test_of_an_effect_has_words() -> None:
    assert set(GATES) == set(Gates.model_fields)
    assert all(describe_evidence(name, Evidence()) for name in GATES)


def test_candidates_have_their_outcome_and_its_reason(hunted: Hunted) -> None:
    said = story(hunted, hunted.closed)
    result = hunted.closed["result"]
    named = {(e["id"], j) for e in result["effects"] for j in e["joints"]}
    refused = {
        (row["id"], int(found[1]))
        for row in result["smallest_detectable"]
        if (found := re.search(r"_(\d+)$", row["parameter"]))
    } - named
    assert said.count(" refused ") >= len(refused)
    scores = {(one["id"], joint): one for one in result["refused"] for joint in one["joints"] or []}
    for name, joint in refused:
        score = scores.get((name, joint))
        why = "explains nothing of its own"
        if score is not None:
            assert score["p_value"] > 0.01
            why = f"no better than chance: explains {number(100 * score['explains'], 2)} % of what is left"
        assert f"{name.replace('_', ' ')} of joint {joint} refused {why}" in said


def test_where_the_model_was_wrong(hunted: Hunted) -> None:
    worst = max(
        (p for p in hunted.closed["result"]["where"] if p["p_value"] < 0.05 and "contrast" not in p["factor"]),
        key=lambda p: p["excess"],
    )
    said = story(hunted, hunted.closed)
    assert f"Clearest: {worst['factor']}: {worst['level']} ({np.sqrt(1 + worst['excess']):.2g} times" in said


def test_the_curve_goes_through_the_binned_residuals(hunted: Hunted) -> None:
    traces = hunted.closed["result"]["figures"]["residual_joint_1"]["data"]
    partial = np.array(traces[1]["y"]) + np.array(traces[2]["y"])
    body = hunted.client.get(f"/jobs/{hunted.closed['id']}").text
    table = body.partition('aria-label="Numbers of Residual along what joint 1 moves"')[2].partition("</table>")[0]
    rows = re.findall(r'<td class="number">([^<]*)</td>' * 4, table.replace("\n", ""))
    counts, means = np.array([int(row[0]) for row in rows]), np.array([float(row[1]) for row in rows])
    assert counts.sum() == len(partial)
    assert np.sum(counts * means) / counts.sum() == pytest.approx(partial.mean(), abs=1e-4)
    curve = np.array([float(row[3]) for row in rows])
    assert np.all(np.abs(curve - means) <= 3 * np.array([float(row[2]) for row in rows]))
    assert curve.min() < 0 < curve.max()  # the two sides of a backlash


def test_an_effect_is_drawn_over_what_it_follows(hunted: Hunted) -> None:
    result = hunted.closed["result"]
    (curve,) = result["effect_curves"]
    (effect,) = result["effects"]
    (amount,) = effect["parameters"]
    assert (curve["id"], curve["joint"], curve["follows"], curve["unit"]) == ("backlash", 1, "q", "deg")
    distance = curve["distance"]
    assert distance["value"] == pytest.approx(amount["value"], rel=1e-6)
    assert amount["interval_low"] == pytest.approx(distance["low"], rel=0.02)
    body = hunted.client.get(f"/jobs/{hunted.closed['id']}").text
    figure = body.partition("<title>Backlash of joint 1 over angle of joint 1</title>")[2].partition("</svg>")[0]
    assert f">{number(abs(distance['value']))} deg</text>" in figure  # between the two sides
    assert figure.count("<polygon") == 2  # a band of each side
    assert figure.count("<circle") + figure.count('<rect x="') > len(curve["visits"]["x"])
    assert ">angle of joint 1, deg<" in figure
    assert ">what joint 1 rotates by, deg<" in figure
    said, visits = story(hunted, hunted.closed), curve["visits"]
    near = sum(abs(y - c) <= h for y, c, h in zip(visits["y"], visits["curve"], visits["half"], strict=True))
    assert near > 0.85 * len(visits["x"])
    assert f"within the 95 % interval of {near} of {len(visits['x'])} visits" in said
    assert f"joint 1 stands {number(abs(distance['value']))} deg" in said
    assert f"leaves {number(curve['rival']['times'])} times the squares" in said
    assert f"refused: {format_effect_at_joints(curve['rival']['id'], curve['rival']['joints'])}" in figure


def test_the_report_has_the_same_curve(hunted: Hunted) -> None:
    title = "<title>Backlash of joint 1 over angle of joint 1</title>"
    pages = [hunted.client.get(f"/jobs/{hunted.closed['id']}{end}").text for end in ("", "/report")]
    drawn = [page.rpartition(title)[2].partition("</svg>")[0] for page in pages]  # the card above has a size of its own
    assert drawn[0] == drawn[1] != ""


def test_an_earlier_result_has_its_residuals_only(hunted: Hunted) -> None:
    earlier = GapResult.model_validate({**hunted.closed["result"], "effect_curves": None})
    assert own_curves(earlier.effect_curves) == []
    assert [one.joint for one in curves(earlier.figures, "mm")] == [1]


def test_the_gap_closes_in_steps(hunted: Hunted) -> None:
    bars = hunted.closed["result"]["figures"]["gap_bar"]["data"]
    body = hunted.client.get(f"/jobs/{hunted.closed['id']}").text
    for place, label in enumerate(bars[0]["y"]):
        cells = f'<th scope="row">{label}</th><td class="number">{number(bars[0]["x"][place])}</td>'
        assert f'{cells}<td class="number">{number(bars[1]["x"][place])}</td>' in body
    errors, held = bars[1]["error_x"], np.array(bars[1]["x"])
    low, high = held - errors["arrayminus"], held + errors["array"]
    for place in range(len(held) - 1):
        assert f"{low[place]:.3g} to {high[place]:.3g}" in body
    report = text_of(hunted.client.get(f"/jobs/{hunted.closed['id']}/report"))
    for text in (
        f"On held-out poses the error falls from {number(held[0])} to {number(held[-2])} mm",
        f"{low[0]:.3g} to {high[0]:.3g}",
    ):
        assert text in report
    table = report.partition("Moves the tool, rms, ")[2]
    per_mm = {"µm": 1e3, "mm": 1.0}[table.partition(",")[0].split()[0]]  # the unit stands in the head
    for effect in hunted.closed["result"]["effects"]:
        joints, moves = of_joints(effect["joints"]), number(per_mm * effect["moves_mm"])
        assert re.search(rf"{effect['id']} {joints} .*? {re.escape(moves)} ", table)


def test_bins_hold_their_points_and_intervals() -> None:
    assert [student(n) for n in (5, 11, 60)] == pytest.approx([student_t.ppf(0.975, n) for n in (5, 11, 60)], rel=2e-3)
    rng = np.random.default_rng(1)
    angles = np.sort(rng.uniform(-90, 90, 60))
    noise = rng.normal(0, 0.1, 60)
    lines = [Point(float(a), float(a / 90 + e), float(a / 90)) for a, e in zip(angles, noise, strict=True)]
    assert [len(part) for part in branches(lines)] == [60]
    found = bin_points(lines)
    assert sum(each.count for each in found) == 60
    first = noise[: found[0].count]
    half = student_t.ppf(0.975, len(first) - 1) * first.std(ddof=1) / np.sqrt(len(first))
    assert found[0].half == pytest.approx(half, rel=5e-3)
    side = rng.choice([-1.0, 1.0], 60)
    two = [Point(float(a), float(s), float(s)) for a, s in zip(angles, side, strict=True)]
    assert sorted(len(part) for part in branches(two)) == sorted([int(sum(side > 0)), int(sum(side < 0))])


def test_the_next_poses_are_those_of_the_interface(hunted: Hunted) -> None:
    answer = hunted.client.get(f"/jobs/{hunted.open['id']}/poses.csv")
    assert answer.text == hunted.open["result"]["next_poses_csv"]
    assert answer.text.startswith("q1_deg,")
    assert f"poses-{hunted.open['id']}.csv" in answer.headers["content-disposition"]
    none = hunted.client.get(f"/jobs/{hunted.closed['id']}/poses.csv")
    assert none.status_code == 400
    assert "proposes no poses" in none.text


def test_one_button_plans_poses_another_searches_again(hunted: Hunted) -> None:
    client = hunted.client
    with logged_in(client, token_of(client, "operator", "planner")["token"]) as person:
        sent = {**csrf(person), "HX-Request": "true"}
        planned = person.post(f"/jobs/{hunted.open['id']}/gap/plan", headers=sent)
        assert planned.status_code == 204, planned.text
        job = client.get(f"/v1{planned.headers['hx-redirect']}").json()
        assert (job["kind"], job["options"]["purpose"]) == ("plan", "separate")
        assert job["options"]["version"] == hunted.open["result"]["version_id"]
        for use, field in (("rows", "campaigns"), ("confirmation", "confirmation")):
            form = {"campaign": hunted.other, "use": use}
            again = person.post(f"/jobs/{hunted.closed['id']}/gap/again", data=form, headers=sent)
            assert again.status_code == 204, again.text
            asked = client.get(f"/v1{again.headers['hx-redirect']}").json()
            assert asked[field][-1] == hunted.other
            assert hunted.campaign in asked["campaigns"]
            assert (asked["options"], asked["validation"]) == (hunted.closed["options"], 0.25)


def test_measurements_of_the_poses_lead_back_to_the_search(hunted: Hunted) -> None:
    client, search = hunted.client, hunted.open["id"]
    robot = f"/robots/{hunted.robot}/campaigns/new"
    assert f'data-job="{search}"' in client.get(robot, params={"job": search}).text
    assert client.get(robot, params={"job": "job_0000000000000000"}).status_code == 404
    columns = Katana().columns(8, seed=4)
    content = "\n".join(",".join(map(str, row)) for row in ([*columns], *zip(*columns.values(), strict=True)))
    dropped = client.post(f"{robot}/file", params={"name": "next.csv", "job": search}, content=content.encode())
    address = dropped.json()["address"]
    sha256 = re.search(r'name="sha256" value="([0-9a-f]{64})"', client.get(address).text)
    assert sha256
    stored = client.post(f"{address}/store", data={"sha256": sha256[1], "name": "next"})
    assert stored.headers["location"].endswith(f"?job={search}")
    again = client.get(f"/campaigns/{hunted.other}", params={"job": search}).text
    assert f'hx-post="/jobs/{search}/gap/again"' in again
    assert "Search again with this campaign" in again
    assert "uses this campaign already" in client.get(f"/campaigns/{hunted.campaign}", params={"job": search}).text
    plan = client.post(f"/jobs/{search}/gap/plan", headers={"HX-Request": "true"}).headers["hx-redirect"]
    planned = client.get(f"/campaigns/{hunted.other}", params={"job": plan.rpartition("/")[2]}).text
    assert f'hx-post="/jobs/{search}/gap/again"' in planned
    client.post("/v1/robots", json={"name": "elsewhere", "convention": "preset", "preset": "katana450-chapter5"})
    refused = client.get("/robots/elsewhere/campaigns/new", params={"job": search})
    assert refused.status_code == 400
    assert "leave it out of the address" in refused.text


def test_changes_are_refused_where_they_arise(hunted: Hunted) -> None:
    client, address = hunted.client, f"/jobs/{hunted.open['id']}"
    form = {"campaign": hunted.other, "use": "rows"}
    with logged_in(client, token_of(client, "viewer", "looker")["token"]) as person:
        assert person.get(address).text.count(" disabled") >= 2
        for path, data in ((f"{address}/gap/plan", None), (f"{address}/gap/again", form)):
            refused = person.post(path, data=data, headers={**csrf(person), "HX-Request": "true"})
            assert refused.status_code == 403
            assert 'data-code="role_too_low"' in refused.text
    with logged_in(client, token_of(client, "operator", "careless")["token"]) as person:
        assert 'data-code="csrf_missing"' in person.post(f"{address}/gap/plan", headers={"HX-Request": "true"}).text
        sent = {**csrf(person), "HX-Request": "true"}
        missing = person.post(f"{address}/gap/again", data={"campaign": "cmp_none", "use": "rows"}, headers=sent)
        assert missing.status_code == 404
        twice = person.post(
            f"{address}/gap/again", data={"campaign": hunted.campaign, "use": "confirmation"}, headers=sent
        )
        assert 'data-code="campaigns_invalid"' in twice.text


def test_other_jobs_have_no_story(hunted: Hunted) -> None:
    client = hunted.client
    assert "Waiting for a worker" in text_of(client.get(f"/jobs/{hunted.waiting}"))
    assert client.get("/jobs/job_0000000000000000").status_code == 404
    body = {"kind": "plan", "robot": hunted.robot, "options": {"purpose": "iso9283"}}
    plan = client.post("/v1/jobs", json=body).raise_for_status().json()["id"]
    refused = client.post(f"/jobs/{plan}/gap/plan")
    assert refused.status_code == 400
    assert "is not a gap search" in refused.text
    assert "proposes no poses" in client.get(f"/jobs/{plan}/poses.csv").text


def test_what_people_named_is_escaped(hunted: Hunted) -> None:
    body = hunted.client.get(f"/jobs/{hunted.open['id']}").text
    assert EVIL not in body
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in body


@pytest.mark.short_path
@pytest.mark.parametrize(("size", "job"), [("desktop", "closed"), ("tablet", "open")])
def test_nothing_stands_in_the_way_of_anybody(hunted: Hunted, chromium: Browser, size: str, job: str) -> None:
    with opened(chromium, hunted.client, size) as page:
        page.goto(f"/jobs/{getattr(hunted, job)['id']}")
        found = Axe().run(page)
        assert found.violations_count == 0, found.generate_report()
        assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
        assert page.locator("main").evaluate("e => e.getBoundingClientRect().bottom") <= 1400
        assert len(page.locator("main").inner_text().split()) <= 400
        assert page.locator(".effect .chips li").count() >= 4
        page.locator(".decide summary").click()
        page.get_by_label("as a confirmation").check()
        page.get_by_role("button", name="Search again with it").click()
        page.wait_for_url(re.compile(r"/jobs/job_[0-9a-f]{16}$"))


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("width", [1440, 390])
def test_the_curve_can_be_read(hunted: Hunted, chromium: Browser, theme: str, width: int) -> None:
    folder = Path(__file__).parents[2] / "build" / "page-screenshots"
    folder.mkdir(parents=True, exist_ok=True)
    with opened(chromium, hunted.client) as page:
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=theme)  # type: ignore[arg-type]
        page.goto(f"/jobs/{hunted.closed['id']}")
        effects = page.locator("#effects")
        effects.screenshot(path=folder / f"effect-{width}-{theme}.png")
        assert effects.evaluate("e => e.scrollWidth <= e.clientWidth")
        assert effects.locator("svg text").first.evaluate("e => e.getBoundingClientRect().height") >= 9
        found = Axe().run(page, context="#effects")
        assert found.violations_count == 0, found.generate_report()
