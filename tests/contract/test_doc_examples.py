"""The examples of the documentation run: every block marked "tested", page by page, against a real server.

A page's blocks share one working folder, in which ``docs`` and ``clients`` are the repository's. A block marked
``tested with FOLDER`` also finds there the files of that folder of real measurements. Where a page writes ``cmp_1``,
``ver_2`` or ``job_1`` the test puts the first campaign's, second version's or first job's id that the page's commands
have printed, as its reader does.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from kilter_client.requests.connection import LocalServer, local_server
from tests.service.forked import KILTER, ForkedPopen

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
BLOCK = re.compile(
    r"^```(?:(sh|python) tested|text (?=printed))(?: with (\S+)|printed)?\n(.*?)^```", re.MULTILINE | re.DOTALL
)
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w.]*\w)")
WITHIN = 0.15  # share by which a printed number may differ from the page's
IDENTIFIER = re.compile(r"\b(?:cmp|ver|job)_[0-9a-f]{8,}\b")
PLACEHOLDER = re.compile(r"\b(cmp|ver|job)_(\d)\b")
SHELL = re.compile(r"[|<>;&$*?`~(){}\[\]!\\]")  # what makes of a line more than a command and its words
DEADLINE_S = 240


@dataclass(frozen=True)
class Example:
    """One tested block of a page."""

    language: str  # empty: what the block before it prints, in part
    data: str | None
    source: str


def examples(page: Path) -> list[Example]:
    return [Example(*found) for found in BLOCK.findall(page.read_text(encoding="utf-8"))]


PAGES = [page for page in sorted([*DOCS.rglob("*.md"), REPOSITORY / "README.md"]) if examples(page)]


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalServer]:
    with local_server(tmp_path_factory.mktemp("server"), ForkedPopen) as started:
        yield started


def link_measurements(folder: Path, request: pytest.FixtureRequest, data: str) -> None:
    source = request.getfixturevalue("shared_data") / data
    assert source.is_dir(), f"{source} does not exist"
    for file in source.iterdir():
        if not (folder / file.name).exists():
            (folder / file.name).symlink_to(file)


def with_identifiers(source: str, printed: list[str]) -> str:
    def put(match: re.Match[str]) -> str:
        known = [identifier for identifier in dict.fromkeys(printed) if identifier.startswith(match[1])]
        return known[int(match[2]) - 1]

    return PLACEHOLDER.sub(put, source)


def says_the_same(expected: str, line: str) -> bool:
    """Whether a printed line has the words of a page's line, or begins with them, and its numbers within a share."""
    begun = expected.removesuffix(" ...")
    said = [re.sub(r"\s+", " ", NUMBER.sub("#", one)).strip() for one in (begun, line)]
    numbers = zip(NUMBER.findall(begun), NUMBER.findall(line), strict=False)
    same = said[0] == said[1] if begun == expected else said[1].startswith(said[0])
    return same and all(abs(float(a) - float(b)) <= WITHIN * float(a) + 1e-9 for a, b in numbers)


def start(language: str, source: str, **options: Any) -> subprocess.Popen[str]:
    """Start a step of a block: a fork where a line is a command of Kilter alone, which needs no shell."""
    if language != "sh":
        return subprocess.Popen([sys.executable, "-c", source], **options)
    if source.startswith("kilter ") and not SHELL.search(source):
        return ForkedPopen([*KILTER, *shlex.split(source)[1:]], **options)
    return subprocess.Popen(["bash", "-euo", "pipefail", "-c", source], **options)


def run(example: Example, folder: Path, server: LocalServer, printed: list[str]) -> str:
    """Run a block and return what it printed; shell blocks by lines, since one may need an id printed before."""
    out = ""
    steps = [example.source]
    if example.language == "sh":
        steps = [line.partition("  #")[0] for line in example.source.splitlines() if line.strip()]
    options = {"cwd": folder, "env": server.environment(), "text": True}
    for source in (with_identifiers(step, printed) for step in steps):
        with start(example.language, source, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options) as step:
            try:
                said, complaints = step.communicate(timeout=DEADLINE_S)
            except subprocess.TimeoutExpired:
                step.kill()
                raise
        assert step.returncode == 0, f"{source}\n{said}\n{complaints}"
        printed += IDENTIFIER.findall(said + complaints)
        out += said
    return out


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_examples_run(page: Path, server: LocalServer, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    for name in ("docs", "clients"):
        (tmp_path / name).symlink_to(REPOSITORY / name)
    printed: list[str] = []
    out = ""
    for example in examples(page):
        if not example.language:
            for line in filter(str.strip, example.source.splitlines()):
                assert any(says_the_same(line, one) for one in out.splitlines()), f"not printed:\n{line}\n\n{out}"
            continue
        if example.data:
            link_measurements(tmp_path, request, example.data)
        out = run(example, tmp_path, server, printed)


def test_what_a_page_says_is_printed_is_compared_by_words_and_numbers() -> None:
    assert says_the_same(" backlash  2-5  0.046-0.068 deg  certain", "backlash 2-5 0.047-0.070 deg certain")
    assert not says_the_same("backlash 0.046 deg certain", "backlash 0.046 deg probable")
    assert not says_the_same("backlash 0.046 deg", "backlash 0.086 deg")
    assert says_the_same("ok: 40 poses agree ...", "ok: 41 poses agree with the version.")
    assert not says_the_same("ok: 40 poses agree ...", "ok: 80 poses agree with the version.")
    assert not says_the_same("ok: 40 poses agree", "ok: 40 poses agree with the version.")


MOST_COMMANDS = 12


def test_the_way_in_is_short_and_copies_no_id() -> None:
    """From a DH table and a lab's own CSV over identify, gap, activate and correct to an export."""
    page = examples(DOCS / "how-to" / "from-your-files.md")
    commands = [line for one in page if one.language for line in one.source.splitlines() if line.strip()]
    assert len(commands) <= MOST_COMMANDS
    assert all(line.startswith("kilter ") for line in commands)
    assert not [line for line in commands if IDENTIFIER.search(line) or PLACEHOLDER.search(line)]
    words = [line.split()[1:3] for line in commands]
    verbs = [inside if first in ("measure", "version") else first for first, inside in words]
    wanted = iter(("robot", "inspect", "upload", "identify", "gap", "activate", "correct", "export"))
    step = next(wanted)
    for verb in verbs:
        step = next(wanted, "") if verb == step else step
    assert step == "", f"{step} does not come in its order"
