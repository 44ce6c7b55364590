"""The examples of the documentation run: every block marked "tested", page by page, against a real server.

A page's blocks share one working folder, in which ``docs`` is the documentation. A block marked ``tested with FOLDER``
also finds there the files of that folder of real measurements.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tools.local_server import LocalServer, local_server

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
BLOCK = re.compile(r"^```(sh|python) tested(?: with (\S+))?\n(.*?)^```", re.MULTILINE | re.DOTALL)
DEADLINE_S = 240


@dataclass(frozen=True)
class Example:
    """One tested block of a page."""

    language: str
    data: str | None
    source: str


def examples(page: Path) -> list[Example]:
    return [Example(*found) for found in BLOCK.findall(page.read_text(encoding="utf-8"))]


PAGES = [page for page in sorted([*DOCS.rglob("*.md"), REPOSITORY / "README.md"]) if examples(page)]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalServer]:
    with local_server(tmp_path_factory.mktemp("server")) as started:
        yield started


def link_measurements(folder: Path, request: pytest.FixtureRequest, data: str) -> None:
    source = request.getfixturevalue("shared_data") / data
    assert source.is_dir(), f"{source} does not exist"
    for file in source.iterdir():
        if not (folder / file.name).exists():
            (folder / file.name).symlink_to(file)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_examples_run(page: Path, server: LocalServer, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    (tmp_path / "docs").symlink_to(DOCS)
    for example in examples(page):
        if example.data:
            link_measurements(tmp_path, request, example.data)
        command = ["bash", "-euo", "pipefail", "-c"] if example.language == "sh" else [sys.executable, "-c"]
        done = subprocess.run(
            [*command, example.source],
            cwd=tmp_path,
            env=server.environment(),
            capture_output=True,
            text=True,
            timeout=DEADLINE_S,
            check=False,
        )
        assert done.returncode == 0, f"{example.source}\n{done.stdout}\n{done.stderr}"
