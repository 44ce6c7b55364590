"""The example alerts and the table of metrics name what the server gives."""

from __future__ import annotations

import re
from pathlib import Path

import yaml
from prometheus_client.parser import text_string_to_metric_families

from kilter_service.ground.db import Database, revision
from kilter_service.ground.settings import Settings
from kilter_service.versions import metrics

REPOSITORY = Path(__file__).resolve().parents[2]
RULES = REPOSITORY / "examples" / "monitoring" / "alerts.yml"
PAGE = REPOSITORY / "docs" / "how-to" / "monitor-a-server.md"
NAME = re.compile(r"\b(?:kilter|process)_[a-z_]+\b")
SUFFIX = re.compile(r"_(?:total|bucket|count|sum|created)$")


def given(folder: Path) -> set[str]:
    """Names of the metrics of a server that has just started."""
    database = Database(f"sqlite:///{folder / 'kilter.sqlite'}")
    revision.migrate(database)
    try:
        page = metrics.text(database, Settings(data=folder)).decode()
    finally:
        database.close()
    return {family.name for family in text_string_to_metric_families(page)}


def test_every_metric_of_the_alerts_and_of_the_page_exists(tmp_path: Path) -> None:
    known = given(tmp_path)
    rules = [rule for group in yaml.safe_load(RULES.read_text())["groups"] for rule in group["rules"]]
    assert len(rules) >= 8
    named = {name for rule in rules for name in NAME.findall(rule["expr"])}
    named |= set(re.findall(r"^\| `((?:kilter|process)_\w+)`", PAGE.read_text(), re.MULTILINE))
    assert {name for name in named if SUFFIX.sub("", name) not in known} == set()


def test_every_metric_of_kilter_is_on_the_page(tmp_path: Path) -> None:
    page = set(NAME.findall(PAGE.read_text()))
    known = {name for name in given(tmp_path) if name.startswith("kilter_")}
    assert {name for name in known if name not in page and f"{name}_total" not in page} == set()


def test_every_rule_says_what_it_is_about() -> None:
    for group in yaml.safe_load(RULES.read_text())["groups"]:
        for rule in group["rules"]:
            assert rule["annotations"]["summary"], rule["alert"]
            assert rule["labels"]["severity"] in ("page", "warn"), rule["alert"]
