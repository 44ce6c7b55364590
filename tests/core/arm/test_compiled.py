"""Compiled kernels are kept for the sources they were made of, wherever there is a place, and nothing happens at import."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from kilter_core.arm.kernels import compiled
from tests.core.arm import numba_process

HELPER = """
from kilter_core.arm.kernels.compiled import compile_kernel

@compile_kernel()
def amount(x):
    return {} * x
"""
CALLER = """
from kilter_core.arm.kernels.compiled import compile_kernel
from kilter_core.arm.kernels.helper import amount

@compile_kernel()
def twice(x):
    return 2 * amount(x)
"""
USE = """
from kilter_core.arm.kernels.caller import twice
print(twice({}), sum(twice.stats.cache_hits.values()))
"""


class Tree:
    """A package with two kernels, one of which calls the other, and the real ``compiled.py``."""

    def __init__(self, root: Path, written: Path) -> None:
        self.root, self.home, self.written, self.started = root, root / "home", written, 0
        self.home.mkdir()
        self.kernels = root / "kilter_core/arm/kernels"
        self.kernels.mkdir(parents=True)
        for folder in (self.kernels, self.kernels.parent, self.kernels.parent.parent):
            (folder / "__init__.py").touch()
        shutil.copy(compiled.__file__, self.kernels)
        (self.kernels / "helper.py").write_text(HELPER.format(10))
        (self.kernels / "caller.py").write_text(CALLER)

    def start(self, code: str, **variables: str) -> Callable[[], tuple[str, str]]:
        """Begin to run the code; what is returned waits for its end, and gives what it wrote to stdout and stderr."""
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("NUMBA", "XDG", "PYTHON"))}
        own = {**kept, "PYTHONPATH": str(self.root), "HOME": str(self.home), **variables}
        self.started += 1
        out, err = (self.written / f"{self.started}.{end}" for end in ("out", "err"))
        process = numba_process.start(code, own, out, err)

        def end() -> tuple[str, str]:
            process.join()
            assert process.exitcode == 0, err.read_text()
            return out.read_text(), err.read_text()

        return end

    def use(self, argument: str = "1", **variables: str) -> tuple[list[str], str]:
        """What ``twice`` gives in a process of its own and how often it was found compiled; what went to stderr."""
        out, err = self.start(USE.format(argument), **variables)()
        return out.split(), err

    def kept(self, place: Path | None = None) -> list[Path]:
        return sorted((place or self.root).rglob("*.nbc"))

    def close_the_package(self) -> None:
        """Take the place beside the sources away, as for a user that may not write there (root may everywhere)."""
        (self.kernels / "__pycache__").write_text("")


@pytest.fixture
def tree(tmp_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Tree:
    return Tree(tmp_path, tmp_path_factory.mktemp("written"))


def test_a_change_of_a_helper_reaches_its_caller(tree: Tree) -> None:
    assert tree.use() == (["20", "0"], "")
    before = tree.kept()
    assert {file.parent.name.split("-")[0] for file in before} == {"caller", "helper"}
    assert tree.use() == (["20", "1"], "")
    assert tree.kept() == before
    (tree.kernels / "helper.py").write_text(HELPER.format(11))
    assert tree.use() == (["22", "0"], "")
    after = tree.kept()
    assert len(after) == len(before)  # what older sources left is gone
    assert not set(after) & set(before)
    assert tree.use() == (["22", "1"], "")


def test_nothing_is_compiled_and_no_folder_is_made_at_import(tree: Tree) -> None:
    before = sorted(tree.root.rglob("*"))
    end = tree.start("from kilter_core.arm.kernels.caller import twice; print(twice.signatures)")
    assert end() == ("[]\n", "")
    assert sorted(tree.root.rglob("*")) == before


def test_a_folder_named_by_the_user_is_taken(tree: Tree) -> None:
    place = tree.root / "place"
    assert tree.use(NUMBA_CACHE_DIR=str(place)) == (["20", "0"], "")
    assert len(tree.kept(place)) == len(tree.kept()) == 2
    assert tree.use(NUMBA_CACHE_DIR=str(place)) == (["20", "1"], "")
    assert not (tree.kernels / "__pycache__").exists()


def test_what_lies_beside_the_sources_is_used_wherever_else_new_files_go(tree: Tree) -> None:
    """As an administrator compiles for services that may not write into the program's folder."""
    tree.use()
    place = tree.root / "place"
    assert tree.use(NUMBA_CACHE_DIR=str(place)) == (["20", "1"], "")
    assert not tree.kept(place)
    assert tree.use("1.5", NUMBA_CACHE_DIR=str(place)) == (["30.0", "0"], "")
    assert len(tree.kept(place)) == 2


def test_a_package_that_is_read_only_uses_the_cache_of_the_user(tree: Tree) -> None:
    tree.close_the_package()
    assert tree.use() == (["20", "0"], "")
    assert len(tree.kept(tree.home)) == 2
    assert tree.use() == (["20", "1"], "")


def test_without_any_place_kernels_are_compiled_each_time_and_the_remedy_is_named(tree: Tree) -> None:
    tree.close_the_package()
    tree.home.rmdir()
    tree.home.write_text("")
    for _ in range(2):
        out, warning = tree.use()
        assert out == ["20", "0"]
        assert warning.count("Set NUMBA_CACHE_DIR to a folder that is.") == 1
    assert not tree.kept()


def test_without_any_place_to_write_what_lies_beside_the_sources_serves(tree: Tree) -> None:
    tree.use()
    nowhere = (
        "from numba.core.caching import FunctionCache as cache; kind = cache._impl_class; "
        "cache._impl_class = type('Nowhere', (kind,), {'_locator_classes': []})"
    )
    out, _ = tree.start(nowhere + USE.format("1"))()
    assert out.split() == ["20", "1"]


def test_processes_that_start_at_once_do_not_mix_what_they_compile(tree: Tree) -> None:
    started = [tree.start(USE.format(argument)) for argument in ("1", "1.5", "1", "1.5")]
    found = [end() for end in started]
    assert [out.split()[:1] for out, _ in found] == [["20"], ["30.0"], ["20"], ["30.0"]], found
    assert tree.use("1), twice(1.5") == (["20", "30.0", "2"], "")


def test_a_torn_file_is_compiled_anew(tree: Tree) -> None:
    tree.use()
    for file, content in zip(tree.kept(), (b"", b"\x80"), strict=True):
        file.write_bytes(content)
    assert tree.use() == (["20", "0"], "")
    assert tree.use() == (["20", "1"], "")
    assert not list(tree.root.rglob("*.part"))
