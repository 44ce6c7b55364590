"""Shell blocks of the documentation are commands as printed: one to a line, understood by the shell and by Kilter."""

from __future__ import annotations

import re
import shlex
import subprocess
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = [*(REPOSITORY / "docs").rglob("*.md"), *REPOSITORY.glob("*.md"), *REPOSITORY.glob("c*/**/README.md")]
BLOCK = re.compile(r"^( *)```(sh(?: [^\n]*)?)?\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
OWN = {"kilter", "kilterd"}
COMMANDS = OWN | {"cat", "curl", "docker", "export", "grep", "head", "make", "pip", "python3.11", "ros2", "systemctl"}
ENDS = {";", "&&", "||", "|", "&", "\n"}
# A package on no registry: what is told to be installed is a folder of the repository, or of others.
OF_KILTER = re.compile(r"pip install(?: -\S+(?: \S+)?)* ['\"]?kilter[\w-]*(?:\[|[\s'\"`]|$)")


def commands(block: str) -> Iterator[list[str]]:
    """Return the words of each command of a block."""
    lexer = shlex.shlex(block.replace("\\\n", " "), posix=True, punctuation_chars=";&|()\n")
    lexer.whitespace, lexer.whitespace_split, lexer.commenters = " \t\r", True, "#"
    words: list[str] = []
    for word in lexer:
        if set(word) <= set("".join(ENDS)) and word:
            if words:
                yield words
            words = []
        else:
            words.append(word)
    if words:
        yield words


def assigned(word: str) -> bool:
    return re.match(r"[A-Z_][A-Z_0-9]*=", word) is not None


def shell_blocks(page: Path) -> Iterator[str]:
    for _, kind, block in BLOCK.findall(page.read_text(encoding="utf-8")):
        first = next(iter(block.split()), "")
        if kind or first in COMMANDS:
            yield textwrap.dedent(block)


def wrong(block: str) -> list[str]:
    """What a shell, or a reader who copies the block, would stumble over."""
    done = subprocess.run(["bash", "-n"], input=block, text=True, capture_output=True, check=False)
    found = [done.stderr] if done.returncode else []
    for words in [] if found else commands(block):
        named = [word for word in words if not assigned(word)]
        if words[0] == "export" and any(map(assigned, words[1:])) and not all(map(assigned, words[1:])):
            found.append(f"export sets {words[1:]}")
        elif named and named[0] in OWN and "kilterd" in named[1:]:
            found.append(f"two commands in one line: {words}")
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_every_block_is_commands_as_printed(page: Path) -> None:
    assert [fault for block in shell_blocks(page) for fault in wrong(block)] == []


@pytest.mark.parametrize(
    "block",
    ["export A='{\"x\":\n1}' export B=0 kilterd serve\n", "kilterd migrate kilterd serve\n", "kilter robot add 'x\n"],
)
def test_a_wrapped_block_is_found(block: str) -> None:
    assert wrong(block)


def test_no_page_and_no_sentence_installs_kilter_from_a_registry() -> None:
    sources = [path for root in ("service", "clients", "core") for path in (REPOSITORY / root).rglob("*.py")]
    templates = (REPOSITORY / "service").rglob("*.html")
    found = {
        str(path.relative_to(REPOSITORY))
        for path in [*PAGES, *sources, *templates]
        if path.name != "CHANGELOG.md" and OF_KILTER.search(path.read_text(encoding="utf-8"))
    }
    assert found == set()
