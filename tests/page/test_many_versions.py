"""A robot that is corrected with a version after which very many were made: every view means the one that is active."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

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
    assert "Errors of version 2 on" in words(text)
    assert "version 2 (active)" in words(text)  # to be chosen again


def test_an_old_version_of_the_address_is_shown_and_one_of_nobody_is_not(there: Made) -> None:
    def of(version: str, other: str = "") -> str:
        return there.client.get(f"/robots/{there.robot}", params={"version": version, "other": other}).text

    assert f'data-version="{there.poor}"' in of(there.poor)
    assert f'data-other="{there.poor}"' in of(there.good, there.poor)
    assert f'data-version="{there.good}"' in of("ver_ffffffffffffffff")
