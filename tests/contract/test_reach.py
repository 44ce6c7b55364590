"""What `make test SINCE=COMMIT` chooses: the tests that a change can reach, by whatever way one is started."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from kilter_core.errors import CoreError
from tests.reach import Reach, modules_used_by
from tests.service.forked import ForkedPopen

UNMOVED = "tests.core.test_transforms"


@pytest.mark.parametrize(
    ("path", "reached", "unreached"),
    [
        ("core/kilter_core/motion/search.py", "tests.core.motion.test_find", UNMOVED),
        ("core/kilter_core/motion/search.py", "tests.service.test_activation_guard", UNMOVED),
        ("service/kilter_service/page/fleet.py", "tests.page.test_fleet", "tests.core.gap.test_claims"),
        ("service/kilter_service/page/static/kilter.css", "tests.page.test_fleet", UNMOVED),
        ("service/kilter_service/jobs/kinds/evaluate.py", "tests.service.test_workers", "tests.core.gap.test_claims"),
        ("clients/python/src/kilter_client/cli/demo.py", "tests.clients.test_cli", "tests.service.test_jobs"),
        ("tests/core/truth.py", "tests.service.test_activation_guard", "tests.page.test_login"),
    ],
)
def test_a_change_reaches_what_imports_it_by_a_statement_a_face_or_a_name(
    path: str, reached: str, unreached: str
) -> None:
    found = Reach({path}).modules
    assert reached in found
    assert unreached not in found


def test_what_belongs_to_no_module_reaches_all_and_a_text_the_tests_of_texts() -> None:
    assert Reach({"constraints.txt"}).everything
    texts = Reach({"docs/reference/cli.md.in"})
    assert not texts.everything
    assert texts.modules == set()


@contextmanager
def _started() -> Iterator[None]:
    ForkedPopen([])
    yield


class _Lab:
    def run(self) -> None:
        from kilter_client.cli import groups

        groups.register()  # type: ignore[attr-defined]


def test_a_fixture_reaches_what_it_its_helpers_and_its_classes_use() -> None:
    def fixture() -> None:
        with _started():
            _Lab().run()
        raise CoreError

    found = modules_used_by(fixture)
    assert {"tests.service.forked", "kilter_client.cli", "kilter_core.errors"} <= found
