"""Ten questions about one robot: whoever asks, wherever, hears the same numbers.

The robot is simulated in Pinocchio: two fits, a search, three campaigns, a crash before the last of them, two wild rows.
"""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli.correction.correct import _show_status
from kilter_client.cli.reports.results import show_activations, show_job, show_version
from kilter_client.cli.suspicious import show_suspicious
from kilter_service.page.words import format_in_largest_unit, mm
from tests.core.truth import ur10, with_hidden_errors
from tests.service.conftest import WorkerProcess
from tests.service.test_suspicious import rows_of

Until = Callable[..., None]
ROBOT, CRASH_DEG, NOISE_MM, ECCENTRIC_DEG = "asked", 0.3, 0.02, 0.06
FITTED = {"effects": [{"id": "eccentricity", "joints": [3]}], "loss": "tukey"}
WILD = {12: 30.0, 40: -22.0}
FLEET, OVERVIEW, HISTORY = "/", f"/robots/{ROBOT}", f"/robots/{ROBOT}/versions"


def rows(seed: int, count: int, crash_deg: float = 0.0) -> dict[str, list[float]]:
    """What a tracker sees of the arm at random poses, by Pinocchio; after the crash joint 2 stands elsewhere."""
    random = np.random.default_rng(seed)
    arm = with_hidden_errors(ur10(), np.random.default_rng(1))
    q = random.uniform(-2.5, 2.5, (count, 6))
    there = q.copy()
    there[:, 2] += np.radians(ECCENTRIC_DEG) * np.sin(q[:, 2])
    there[:, 1] += np.radians(crash_deg)
    points = arm.poses(there)[0] * 1e3 + random.normal(0.0, NOISE_MM, (count, 3))
    out = {f"q{k + 1}_deg": np.degrees(q[:, k]).tolist() for k in range(6)}
    return out | {f"{axis}_mm": points[:, k].tolist() for k, axis in enumerate("xyz")}


class Asked:
    """The server with everything done, and what every view says."""

    def __init__(self, client: httpx.Client, until: Until) -> None:
        self.client, self._until = client, until
        client.post("/v1/robots", json=ur10().document() | {"name": ROBOT}).raise_for_status()
        first = rows(1, 60)
        for row, away in WILD.items():
            first["y_mm"][row - 1] += away
        self.first, self.second = self._sent("first", first), self._sent("second", rows(2, 60))

    def fill(self) -> None:
        """Two fits, a search, the crash, an evaluation, and who activated what."""
        self.older = self._done(kind="identify", campaigns=[self.first], validation=[self.second], options={"level": 1})
        self.newer = self._done(kind="identify", campaigns=[self.first], validation=[self.second], options=FITTED)
        self.search = self._done(
            kind="gap", campaigns=[self.first], validation=[self.second],
            options={"effects": ["encoder_scale", "eccentricity"], "resamples": 2, "permutations": 5},
        )  # fmt: skip
        for job, why in ((self.older, "the first"), (self.newer, "the second is better")):
            body = {"force": True, "reason": why}
            self.client.post(f"/v1/versions/{self.made(job)}/activate", json=body).raise_for_status()
        self.third = self._sent("after the crash", rows(3, 40, CRASH_DEG))
        self.judged = self._done(kind="evaluate", campaigns=[self.third])

    def _sent(self, name: str, columns: dict[str, list[float]]) -> str:
        made = self.client.post(f"/v1/robots/{ROBOT}/campaigns", json={"name": name}).raise_for_status().json()["id"]
        self.client.post(f"/v1/campaigns/{made}/observations", json=columns).raise_for_status()
        return str(made)

    def _done(self, **job: Any) -> dict[str, Any]:
        made = self.client.post("/v1/jobs", json={"robot": ROBOT, **job}).raise_for_status().json()["id"]
        read = lambda: self.get(f"/v1/jobs/{made}")  # noqa: E731
        self._until(lambda: read()["state"] in ("succeeded", "failed"))
        assert read()["state"] == "succeeded", read()["error"]
        return dict(read())

    def made(self, job: dict[str, Any]) -> str:
        return str(job["result"]["version_id"])

    def get(self, address: str) -> Any:
        return self.client.get(address).raise_for_status().json()

    def text(self, address: str) -> str:
        return self.client.get(address).raise_for_status().text

    def words(self, address: str) -> str:
        return html.unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", self.text(address))))

    def version(self, job: dict[str, Any]) -> str:
        return f"/versions/{self.made(job)}"


@pytest.fixture
def asked(client: httpx.Client, worker: WorkerProcess, until: Until) -> Asked:
    found = Asked(client, until)
    worker.start()
    found.fill()
    return found


@pytest.fixture
def kilter(client: httpx.Client) -> Iterator[Kilter]:
    with Kilter(str(client.base_url), client.headers["authorization"].removeprefix("Bearer ")) as found:
        yield found


def test_no_two_views_contradict_each_other(asked: Asked, kilter: Kilter, capsys: pytest.CaptureFixture[str]) -> None:
    for question in (
        how_good_today, what_is_wrong, what_was_it_before, did_it_help, who_activated, what_next, is_the_stream_well,
        which_rows, what_does_an_effect_do, undo,
    ):  # fmt: skip
        capsys.readouterr()
        question(asked, kilter, capsys.readouterr)


def large(text: str) -> list[str]:
    """The numbers that stand large on a page."""
    return [html.unescape(one) for one in re.findall(r'<(?:p class="large|span class="huge)">(.*?)</(?:p|span)>', text)]


def fleet_error(asked: Asked) -> str:
    """The number of the robot in the fleet, with the unit of its column."""
    text = asked.text(FLEET)
    unit = re.findall(r">Error, (µm|mm)", html.unescape(text))[0]
    row = text.partition(f'<tr data-robot="{ROBOT}">')[2]
    return f"{re.findall(r'<td class=.number.>([^<]*)</td>', row)[0]} {unit}"


def how_good_today(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    mean = asked.judged["result"]["metrics"][asked.third]["identified"]["mean_mm"]
    fit = asked.newer["result"]["metrics"]["validation"]["identified"]["mean_mm"]
    assert mean > 2.0 > 3 * fit, (mean, fit)  # the crash is there
    today = asked.get(f"/v1/robots/{ROBOT}/today")
    assert (
        today["newest"]["errors"]["identified"]["mean_mm"]
        == kilter.today(ROBOT).newest.errors.identified.mean_mm
        == mean
    )
    assert today["own"]["errors"]["identified"]["mean_mm"] == fit
    when = today["newest"]["campaigns"][0]["when"]
    assert fleet_error(asked) == mm(mean)
    assert large(asked.text(OVERVIEW)) == [mm(mean)]
    assert "mean error on rows that no fit used" in asked.words(OVERVIEW)
    for page in (FLEET, OVERVIEW):
        said = asked.words(page)
        assert re.search(rf"after the crash ?, {re.escape(when)}", said), page
        assert today["compared"].partition("`")[0].strip() in said, page
    # Beside today's number the worst poses and the picture are those of the same rows.
    assert "the worst poses on after the crash" in asked.words(OVERVIEW)
    for page in (asked.version(asked.newer), f"{asked.version(asked.newer)}/report"):
        assert today["sentences"][0] in asked.words(page), page
    # The number of the fit stands on the version's own page, beside that of today; others say nothing of today.
    assert large(asked.text(asked.version(asked.newer))) == [mm(fit)]
    assert "Today:" not in asked.words(asked.version(asked.older))
    _show_status({"url": "", **kilter.health(), "today": kilter.robots.today(ROBOT)})
    printed = read().out
    assert all(one in printed for one in today["sentences"])
    # The sentence has the number and the unit of the large one on the page.
    assert f"Mean error {large(asked.text(OVERVIEW))[0]} " in printed
    assert f"{mm(mean)}" in asked.words(f"/jobs/{asked.judged['id']}")


def what_is_wrong(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    result = asked.search["result"]
    missing = asked.get(f"/v1/robots/{ROBOT}/today")["missing"]
    assert missing["job_id"] == asked.search["id"]
    assert [(one["id"], one["joints"]) for one in missing["named"]] == [
        (one["id"], one["joints"] or []) for one in result["effects"]
    ]
    overview, story = asked.words(OVERVIEW), asked.words(f"/jobs/{asked.search['id']}")
    assert missing["sentence"] in overview
    assert f"Open: {missing['open']}" in overview
    assert result["sentence"] in story
    assert result["sentence"] in asked.words(f"{asked.version(asked.search)}/report")
    show_job(kilter.jobs.get(asked.search["id"]))
    printed = read().out
    for one in result["effects"]:
        assert one["verdict"].replace("_", " ") in story
        assert one["verdict"].replace("_", " ") in printed.replace("_", " ")
    typed = kilter.job(asked.search["id"]).result
    assert [(one.id, one.verdict) for one in typed.effects] == [
        (one["id"], one["verdict"]) for one in result["effects"]
    ]
    lacking = overview.partition("Missing in it")[2].partition("how sure")[0]
    assert [one["words"] in lacking for one in missing["named"]] == [not one["corrected"] for one in missing["named"]]


def what_was_it_before(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    for job in (asked.older, asked.newer):
        held = job["result"]["metrics"]["validation"]
        told = asked.get(f"/v1{asked.version(job)}")["metrics"]["validation"]
        assert told == held
        before = mm(held["registration_only"]["mean_mm"])
        number, unit = before.split()
        for page in (asked.version(job), f"{asked.version(job)}/report", f"/jobs/{job['id']}"):
            said = asked.words(page)  # in a table the unit stands in the head of its column
            assert before in said or (f" {number} " in said and f", {unit} " in said), page
        headline = asked.get(f"/v1{asked.version(job)}")["headline"]
        assert "Before: nominal arm, base and tool fitted." in headline
        show_version(kilter.versions.get(asked.made(job)))
        assert f"{held['registration_only']['mean_mm']:.4g}" in read().out


def did_it_help(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    history = asked.words(HISTORY)
    jobs = (asked.older, asked.newer, asked.search)
    errors = [asked.get(f"/v1{asked.version(job)}")["metrics"]["validation"] for job in jobs]
    worst = max(held["identified"]["mean_mm"] for held in errors)  # the list is written in the unit of its largest
    for job, held in zip(jobs, errors, strict=True):
        after = format_in_largest_unit(
            held["identified"]["mean_mm"], held["identified"]["max_mm"]
        )  # a card has one unit
        assert large(asked.text(asked.version(job))) == [after]
        number, unit = format_in_largest_unit(held["identified"]["mean_mm"], worst).split()
        assert f" {number} " in history
        assert f", {unit} " in history
        said = asked.words(f"{asked.version(job)}/report")
        assert all(line in said for line in job["result"]["headline"].replace("`", "").splitlines())
        left = "no row left out" if held["left_out"] == 0 else f"{held['left_out']} row"
        for page in (asked.version(job), f"{asked.version(job)}/report", f"/jobs/{job['id']}"):
            assert left in asked.words(page), page
        assert kilter.version(asked.made(job)).metrics.validation.identified.mean_mm == held["identified"]["mean_mm"]
    gap = asked.search["result"]["gap"]
    held = asked.get(f"/v1{asked.version(asked.search)}")["metrics"]["validation"]
    assert held["left_out"] == gap["held_out_set_aside"]
    assert held["identified"]["rms_mm"] == pytest.approx(gap["validation_after_mm"], rel=0.02)


def who_activated(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    log = asked.get(f"/v1/robots/{ROBOT}/activations")["activations"]
    assert [one["version_id"] for one in log] == [asked.made(asked.newer), asked.made(asked.older)]
    last = log[0]
    assert asked.get(f"/v1/robots/{ROBOT}")["active_version"] == last["version_id"]
    overview, history = asked.words(OVERVIEW), asked.words(HISTORY)
    assert f"by {last['actor']}" in overview.partition("Activated")[2][:80]
    for one in log:
        assert one["reason"] in history
        assert one["actor"] in history
        assert one["reason"] in asked.words(f"/versions/{one['version_id']}/report")
    show_activations({"activations": kilter.versions.activations(ROBOT)})
    printed = read().out
    assert all(one["version_id"] in printed and one["reason"] in printed for one in log)
    assert [(one.version_id, one.reason) for one in kilter.activations(ROBOT)] == [
        (one["version_id"], one["reason"]) for one in log
    ]


def what_next(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    poses = len(asked.search["result"]["next_poses"] or [])
    assert asked.get(f"/v1/robots/{ROBOT}/today")["missing"]["next_poses"] == poses
    assert len(kilter.job(asked.search["id"]).result.next_poses) == poses
    overview = asked.words(OVERVIEW)
    assert (f"{poses} poses would tell" in overview) == (poses > 0)
    assert asked.text(f"/jobs/{asked.search['id']}").count('<td class="joints">') == poses


def is_the_stream_well(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    fleet = re.findall(r'<td class="by"><a [^>]*>[^<]*</a>, ([^<]*)</td>', asked.text(FLEET))
    overview = re.findall(rf'<a href="/robots/{ROBOT}/stream">([^<]*)</a>', asked.text(OVERVIEW))
    assert len(fleet) == 1
    assert fleet[0] in overview
    assert fleet[0] in asked.words(f"/robots/{ROBOT}/stream")


def which_rows(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    told = {one: asked.get(f"/v1/campaigns/{one}/suspicious") for one in (asked.first, asked.second, asked.third)}
    assert set(WILD) <= {one["row"] for one in told[asked.first]["found"]}
    both = sorted(row for one in (asked.first, asked.second) for row in rows_of(asked.text(f"/campaigns/{one}")))
    assert len(both) == sum(len(told[one]["found"]) for one in (asked.first, asked.second))
    for job in (asked.older, asked.newer, asked.search):
        for page in (asked.version(job), f"{asked.version(job)}/report", f"/jobs/{job['id']}"):
            assert rows_of(asked.text(page)) == both, page
    count = told[asked.first]["count"] + told[asked.second]["count"]
    assert f"Rows that look wrong {count} rows" in asked.words(OVERVIEW)
    for one, document in told.items():
        show_suspicious(kilter.campaigns.suspicious(one))
        assert document["sentence"] in read().out
        assert document["sentence"] in asked.words(f"/campaigns/{one}")
        assert kilter.suspicious(one).count == document["count"]


def what_does_an_effect_do(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    page, report = (
        asked.text(f"{asked.version(asked.newer)}/contributions"),
        asked.text(f"{asked.version(asked.newer)}/report"),
    )
    cells = re.compile(r'<td class="number">([^<]*)</td>')
    table = report.partition('<table class="effects"')[2].partition("</table>")[0]
    rms = [html.unescape(one) for one in cells.findall(table)]
    assert rms or not asked.get(f"/v1{asked.version(asked.newer)}")["effects"]
    told = html.unescape(page)
    assert [one.removesuffix(" mm") for one in rms] == cells.findall(told), told


def undo(asked: Asked, kilter: Kilter, read: Callable[[], Any]) -> None:
    back = asked.made(asked.older)
    done = kilter.rollback(ROBOT)
    assert done.id == back
    assert asked.get(f"/v1/robots/{ROBOT}")["active_version"] == back
    assert asked.get(f"/v1/robots/{ROBOT}/today")["version_id"] == back
    for page, place in ((FLEET, '<td class="by">'), (OVERVIEW, "Corrected by")):
        assert back in asked.text(page).partition(place)[2][:200], page
    held = asked.get(f"/v1{asked.version(asked.older)}")["metrics"]["validation"]["identified"]["mean_mm"]
    assert (fleet_error(asked), large(asked.text(OVERVIEW))) == (mm(held), [mm(held)])
    for page in (FLEET, OVERVIEW):
        assert "after the crash" in asked.words(page).partition("not evaluated")[2], page
    assert "not active" in asked.words(asked.version(asked.newer))
