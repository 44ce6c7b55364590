"""A robot that is corrected with a version after which very many were made: every view means the one that is active."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from kilter_core.twin import thesis_katana

from .made import Made, made, stored
from .test_robot import words

NEWER = 60


@pytest.fixture(scope="module")
def there(tmp_path_factory: pytest.TempPathFactory, migrated: Path) -> Iterator[Made]:
    with made(tmp_path_factory.mktemp("many"), migrated) as found:
        found.client.post(f"/v1/versions/{found.good}/activate").raise_for_status()
        truth = thesis_katana().truth
        for k in range(NEWER):
            stored(found.database, 100 + k, truth, found.good, 0.5, [0.031, 0.0007])
        yield found


def test_the_picture_is_of_the_active_version(there: Made) -> None:
    text = there.client.get(f"/robots/{there.robot}").raise_for_status().text
    assert f'data-version="{there.good}"' in text
    assert "The arm, with the errors on" in words(text)
    assert "version 2 (active)" in words(text)  # to be chosen again


def test_an_old_version_of_the_address_is_shown_and_one_of_nobody_is_not(there: Made) -> None:
    def of(version: str, other: str = "") -> str:
        return there.client.get(f"/robots/{there.robot}", params={"version": version, "other": other}).text

    assert f'data-version="{there.poor}"' in of(there.poor)
    assert f'data-other="{there.poor}"' in of(there.good, there.poor)
    assert f'data-version="{there.good}"' in of("ver_ffffffffffffffff")


def test_lists_read_no_covariance(there: Made) -> None:
    """A hundred kB of each version: 300 of them took seconds. Here one is broken, and nobody who lists versions sees it."""
    with there.database.transaction() as session:
        kept = session.execute(text("SELECT covariance FROM versions WHERE id = :id"), {"id": there.poor}).scalar_one()
        session.execute(text("UPDATE versions SET covariance = '{' WHERE id = :id"), {"id": there.poor})
    try:
        listed = there.client.get(f"/v1/robots/{there.robot}/versions", params={"limit": 200}).raise_for_status().json()
        there.client.get(f"/robots/{there.robot}/versions").raise_for_status()
    finally:
        with there.database.transaction() as session:
            session.execute(text("UPDATE versions SET covariance = :c WHERE id = :id"), {"c": kept, "id": there.poor})
    assert len(listed["versions"]) == NEWER + 2
    for one in listed["versions"][:: NEWER // 2]:  # each says what the version says
        whole = there.client.get(f"/v1/versions/{one['id']}").raise_for_status().json()
        assert {name: whole[name] for name in one} == one
        assert one["effects"]
        assert one["metrics"]["validation"]["n"] == 40


def test_a_version_offers_the_active_one_first_and_says_that_there_are_more(there: Made) -> None:
    page = there.client.get(f"/versions/{there.poor}").raise_for_status().text
    offered = page.split("Compare it with")[1].split("</ul>")[0]
    assert 0 < offered.index(there.good) < offered.index("version 1")
    assert "one of the others: tick any two in the list of versions" in words(offered)
    assert f'href="/robots/{there.robot}/versions"' in offered


def test_a_job_whose_result_is_not_stored_says_so_and_shows_a_way_out(there: Made) -> None:
    """It ended in an error of the server: the template asked for a version that nobody had given it."""
    page = there.client.get("/jobs/job_0000000000000001").raise_for_status().text
    assert "The job has succeeded, but its result is not stored." in words(page)
    assert f'href="/robots/{there.robot}/versions">versions of' in page
