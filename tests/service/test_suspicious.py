"""One list of the rows that look wrong, of real jobs on rows of which two are known to be wild."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from kilter_client import Kilter
from kilter_client.cli.suspicious import show_suspicious
from tests.service.conftest import Katana, WorkerProcess

Until = Callable[..., None]
WILD = {18: 25.0, 61: -18.0}  # row from 1: by how much its x is off, mm
EARLIER = 30  # rows of the first of two files


def stored(client: httpx.Client, katana: Katana, name: str) -> str:
    """A campaign in two files whose wild rows are known."""
    columns = {key: np.array(values) for key, values in katana.columns(70, seed=4).items()}
    for row, away in WILD.items():
        columns["x_mm"][row - 1] += away
    made = client.post(f"/v1/robots/{katana.name}/campaigns", json={"name": name}).raise_for_status().json()["id"]
    for part in (slice(None, EARLIER), slice(EARLIER, None)):
        rows = {key: values[part].tolist() for key, values in columns.items()}
        client.post(f"/v1/campaigns/{made}/observations", json=rows).raise_for_status()
    return str(made)


def done(client: httpx.Client, until: Until, **job: Any) -> dict[str, Any]:
    made = client.post("/v1/jobs", json={"robot": Katana.name, **job}).raise_for_status().json()["id"]
    read = lambda: client.get(f"/v1/jobs/{made}").json()  # noqa: E731
    until(lambda: read()["state"] in ("succeeded", "failed"))
    assert read()["state"] == "succeeded", read()["error"]
    return dict(read())


def rows_of(text: str) -> list[tuple[str, ...]]:
    """Row, sayer and sizes of the tables of suspicious rows in a page or report."""
    found = []
    for table in re.findall(r'<table class="suspicious".*?</table>', text, re.DOTALL):
        head = re.findall(r"<th scope=\"col\"[^>]*>(.*?)</th>", table)
        for line in re.findall(r"<tr[^>]*><th scope=\"row\">.*?</tr>", table, re.DOTALL):
            cells = [
                html.unescape(re.sub(r"<[^>]*>", "", cell)).strip() for cell in re.findall(r"<t[hd].*?</t[hd]>", line)
            ]
            told = dict(zip(head, cells, strict=True))
            for name in [
                one for one in told if one.startswith("Off by, ")
            ]:  # its unit stands in the head of the column
                told["Off by"] = f"{told[name]} {name.removeprefix('Off by, ')}"
            # A page links an unnamed version, a report on paper has its number.
            who = re.sub(r" (that made \S+ v\d+|\(its version, its job\)|\(its job\))$", "", told["Says who"])
            found.append((told["Row"], told["Off by"], told["Standard deviations"], who, told["Why"]))
    return sorted(found)


def test_every_surface_names_the_same_rows(
    client: httpx.Client, katana: Katana, worker: WorkerProcess, until: Until, capsys: pytest.CaptureFixture[str]
) -> None:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    campaign = stored(client, katana, "wild")
    worker.start()
    options = {"level": 2, "loss": "tukey"}
    fitted = done(client, until, kind="identify", campaigns=[campaign], options=options)
    searched = done(
        client, until, kind="gap", campaigns=[campaign], validation=0.25,
        options={"effects": ["encoder_scale"], "resamples": 2, "permutations": 5},
    )  # fmt: skip
    told = client.get(f"/v1/campaigns/{campaign}/suspicious").raise_for_status().json()
    assert (told["rows"], told["count"]) == (70, len({one["row"] for one in told["found"]}))
    by = {
        who: {one["row"] for one in told["found"] if one["said_by"] == who}
        for who in ("rows", "identification", "search")
    }
    assert all(set(WILD) <= named for named in by.values()), by
    for one in told["found"]:
        if one["row"] in WILD:
            assert one["mm"] == pytest.approx(abs(WILD[one["row"]]), rel=0.3)
            assert one["sigma"] > 5.0
        assert (one["file"], one["file_row"]) == (
            (1, one["row"]) if one["row"] <= EARLIER else (2, one["row"] - EARLIER)
        )

    # What a search leaves out of its own errors its version leaves out too, and both say how many rows that is.
    held = [one for one in told["found"] if one["held_out"]]
    gap = searched["result"]["gap"]
    version = searched["result"]["version_id"]
    told_of = client.get(f"/v1/versions/{version}").json()["metrics"]["validation"]
    assert told_of["left_out"] == gap["held_out_set_aside"] == len(held)
    assert told_of["identified"]["rms_mm"] == pytest.approx(gap["validation_after_mm"], rel=0.05)

    pages = [
        f"/campaigns/{campaign}", f"/versions/{version}", f"/versions/{fitted['result']['version_id']}",
        f"/jobs/{searched['id']}", f"/jobs/{fitted['id']}", f"/versions/{version}/report",
        f"/versions/{fitted['result']['version_id']}/report",
    ]  # fmt: skip
    shown = {page: client.get(page).raise_for_status().text for page in pages}
    first = rows_of(shown[pages[0]])
    assert len(first) == len(told["found"])
    for page, text in shown.items():
        assert rows_of(text) == first, page
        assert told["sentence"] in text, page
    with Kilter(str(client.base_url), client.headers["authorization"].removeprefix("Bearer ")) as kilter:
        typed = kilter.suspicious(campaign)
        assert [(one.row, one.mm, one.sigma) for one in typed.found] == [
            (one["row"], one["mm"], one["sigma"]) for one in told["found"]
        ]
        show_suspicious(kilter.campaigns.suspicious(campaign))
    said = capsys.readouterr().out
    assert told["sentence"] in said
    assert "61 (row 31 of file 2)" in said


def test_a_campaign_without_wild_rows_says_so_and_one_that_is_gone_says_nothing(
    client: httpx.Client, katana: Katana
) -> None:
    campaign = katana.campaign(client, 40)
    told = client.get(f"/v1/campaigns/{campaign}/suspicious").raise_for_status().json()
    assert (told["count"], told["found"]) == (0, [])
    assert told["sentence"] in client.get(f"/campaigns/{campaign}").text
    assert client.get("/v1/campaigns/cmp_0000000000000000/suspicious").status_code == 404
    empty = client.post(f"/v1/robots/{katana.name}/campaigns", json={"name": "empty"}).raise_for_status().json()["id"]
    assert client.get(f"/v1/campaigns/{empty}/suspicious").raise_for_status().json()["rows"] == 0
