"""Nothing under the GPL is needed at run time; the LGPL only where the page says why."""

from __future__ import annotations

from tools.licences import EXTRAS, LESSER_GPL_TAKEN, OURS, PAGE, closure, licence_of, refused


def test_what_is_needed_may_be_used() -> None:
    names = set[str]().union(*(closure(ours, frozenset(EXTRAS.get(ours, ()))) for ours in OURS))
    assert {"numpy", "sqlalchemy", "httpx", "pyyaml", "psycopg"} <= names
    assert not refused({name: licence_of(name) for name in names})


def test_the_page_says_which_parts_are_under_the_lgpl() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert all(f"`{name}`: " in text for name in LESSER_GPL_TAKEN)


def test_the_gpl_and_licences_that_nobody_stated_are_refused() -> None:
    found = refused({
        "free": "MIT", "copyleft": "GPL-3.0-or-later", "network": "AGPL-3.0", "lesser": "LGPL-2.1-only",
        "psycopg": "LGPL-3.0-only", "silent": "not stated", "older": "GNU General Public License v2 (GPLv2)",
    })  # fmt: skip
    assert [line.split()[0] for line in found] == ["copyleft", "lesser", "network", "older", "silent"]


def test_the_core_needs_numbers_only() -> None:
    assert closure("kilter-core") == {"numba", "llvmlite", "numpy", "scipy", "lazy-loader", "packaging"}
