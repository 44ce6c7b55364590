"""The dashboard for Grafana asks for what a real server's `/metrics` gives, with labels that are there."""

from __future__ import annotations

import json
import re
from itertools import combinations
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from kilter_service.ground.db import Database
from kilter_service.stream.corrector.fast_path import WORDS, Counters
from kilter_service.web import store as health

DASHBOARD = Path(__file__).resolve().parents[2] / "examples" / "monitoring" / "dashboard.json"
SAMPLE = re.compile(r"\b((?:kilter|process)_[a-z_]+)(?:\{([^}]*)\})?")
SUFFIXES = {"counter": ("_total",), "histogram": ("_bucket", "_sum", "_count"), "gauge": ("",)}
OF_PROMETHEUS = {"instance", "job"}  # which it adds to whatever it asks for


@pytest.fixture
def board() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(DASHBOARD.read_text(encoding="utf-8"))
    return found


@pytest.fixture
def labels(client: httpx.Client, database: Database, katana: Any) -> dict[str, set[str]]:
    """Labels of each sample of a server that has a stream, and a job that ended and one that waits."""
    campaign = katana.campaign(client, 30)
    job = {"kind": "identify", "robot": katana.name, "campaigns": [campaign]}
    ended = client.post("/v1/jobs", json=job).raise_for_status().json()["id"]
    client.post(f"/v1/jobs/{ended}/cancel").raise_for_status()
    client.post("/v1/jobs", json=job).raise_for_status()
    assert client.get("/v1/robots/nobody").status_code == 404
    counters = Counters(np.zeros(WORDS, dtype=np.int64))
    counters.count(0, 0)
    place = {"robot": katana.name, "stream": "main", "version_id": "ver_1", "epoch": 1}
    stream = {**place, **counters.document(), "by_time": counters.by_time}
    with database.transaction() as session:
        health.beat(session, "corrector", "local", 1, {"streams": [stream]})
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for suffix in SUFFIXES.get(family.type, ("",)):
            found.setdefault(family.name + suffix, set())
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


def asked(board: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Title, expression and legend of everything that the dashboard asks for."""
    shown = [
        (panel["title"], target["expr"], target["legendFormat"])
        for panel in board["panels"]
        for target in panel.get("targets", ())
    ]
    variables = [one for one in board["templating"]["list"] if one["type"] == "query"]
    return [*shown, *((one["name"], one["query"]["query"], "") for one in variables)]


def test_every_metric_of_the_dashboard_and_every_label_is_given(
    board: dict[str, Any], labels: dict[str, set[str]]
) -> None:
    for title, expression, legend in asked(board):
        named = SAMPLE.findall(expression)
        assert named, title
        for metric, where in named:
            assert metric in labels, (title, metric)
            known = labels[metric] | OF_PROMETHEUS
            wanted = set(re.findall(r"(\w+)\s*[=!]~?\"", where))
            for group in re.findall(r"\bby \(([^)]*)\)", expression):
                wanted |= {label.strip() for label in group.split(",")}
            wanted |= set(re.findall(r"\{\{(\w+)\}\}", legend))
            wanted |= set(re.findall(r"label_values\(\w+, (\w+)\)", expression))
            assert wanted <= known, (title, metric, wanted - known)


def test_what_falls_at_a_restart_is_asked_for_as_a_rate(board: dict[str, Any]) -> None:
    for title, expression, _ in asked(board):
        for counter in re.findall(r"\b\w+_(?:total|bucket)\b", expression):
            if "label_values" not in expression:
                assert re.search(rf"(?:rate|increase)\({counter}\{{", expression), title
        assert expression.count("(") == expression.count(")")


def test_panels_say_what_they_show_and_do_not_overlap(board: dict[str, Any]) -> None:
    panels = [panel for panel in board["panels"] if panel["type"] != "row"]
    assert len(panels) > 15
    for panel in panels:
        assert panel["description"], panel["title"]
        assert panel["fieldConfig"]["defaults"]["unit"], panel["title"]
        assert {panel["datasource"]["uid"], *(one["datasource"]["uid"] for one in panel["targets"])} == {
            "${datasource}"
        }
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"])
    for one, other in combinations([panel["gridPos"] for panel in board["panels"]], 2):
        beside = one["x"] + one["w"] <= other["x"] or other["x"] + other["w"] <= one["x"]
        assert beside or one["y"] + one["h"] <= other["y"] or other["y"] + other["h"] <= one["y"]
    assert max(panel["gridPos"]["x"] + panel["gridPos"]["w"] for panel in board["panels"]) == 24
