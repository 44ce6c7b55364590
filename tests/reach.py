"""Which tests a change can reach, by the graph of imports: `pytest --since COMMIT`, `make test SINCE=COMMIT`.

A test stands for its module and for what its fixtures use. What a text names (``"kilter_core.gap.find"``,
``f"kilter_client.cli.{module}"``) counts as imported, and so does a program that a test starts by its name.
"""

from __future__ import annotations

import inspect
import re
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType

import grimp
import pytest

REPOSITORY = Path(__file__).resolve().parent.parent
ROOTS = {
    "kilter_core": "core/",
    "kilter_service": "service/",
    "kilter_files": "clients/files/",
    "kilter_client": "clients/python/src/",
    **dict.fromkeys(("tests", "tools", "benchmarks"), ""),
}
NAMED = re.compile(rf"\b(?:{'|'.join(ROOTS)})\.[\w.]*")
FACE = re.compile(r"^from (\.[\w.]*) import", re.MULTILINE)
PROGRAMS = {
    "kilter_service.__main__": re.compile(r"""["/]kilterd["\s]|-m["\s,]+kilter_service\b"""),
    "kilter_client.cli": re.compile(r"""bin/kilter\b|[/\[(] ?"kilter"|\bKILTER\b"""),
}
# They have all that they fork: whether that is the client says who asks them.
FORKS = ("tests.service.fork_server", "tests.service.forked")
# Texts that are no module reach the tests of texts alone; any other file that is no module's reaches every test.
TEXTS = ("docs/", "changes/", "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
OF_TEXTS = "tests/contract/"


def changed_files(commit: str) -> set[str]:
    """Paths of files that differ from those of a commit, new ones among them."""
    asked = (["diff", "--name-only", "--no-renames", commit], ["ls-files", "--others", "--exclude-standard"])
    found = [subprocess.run(["git", *one], cwd=REPOSITORY, check=True, capture_output=True, text=True) for one in asked]
    return {line for one in found for line in one.stdout.splitlines()}


class Reach:
    """Modules and tests that a change of files can reach."""

    def __init__(self, changed: set[str]) -> None:
        graph = import_graph()
        known = graph.modules
        self._folders = [path.removesuffix("conftest.py") for path in changed if path.endswith("conftest.py")]
        found = {path: set(_modules_of(path, known)) for path in changed if not path.startswith(TEXTS)}
        self.everything = not all(found.values())
        self.modules = {one for modules in found.values() for one in modules}
        for module in self.modules & known:
            self.modules |= graph.find_downstream_modules(module)

    def includes(self, item: pytest.Item) -> bool:
        """Return whether the change can reach a test."""
        path = item.nodeid.partition("::")[0]
        if self.everything or path.startswith((OF_TEXTS, *self._folders)) or _module(path) in self.modules:
            return True
        fixtures = vars(item)["_fixtureinfo"].name2fixturedefs.values()
        return any(self.modules & modules_used_by(one.func) for known in fixtures for one in known)


def _modules_of(path: str, known: set[str]) -> Iterator[str]:
    """Yield the module that a file is, or all those of the package in which another file lies."""
    for package, root in ROOTS.items():
        if not path.startswith(f"{root}{package}/"):
            continue
        inside = Path(path.removeprefix(root))
        if inside.suffix == ".py":
            yield _module(str(inside))
            return
        name = next(name for folder in inside.parents if (name := ".".join(folder.parts)) in known)
        yield from (one for one in known if f"{one}.".startswith(f"{name}."))


@cache
def import_graph() -> grimp.ImportGraph:
    """Return the graph of the imports of all modules, by statements, faces and names in texts."""
    graph = grimp.build_graph(*ROOTS, cache_dir=None)
    for module in graph.modules:
        for name in {one for one in _named_by(module, graph.modules) if one in graph.modules and one != module}:
            graph.add_import(importer=module, imported=name)
    for imported in [one for one in graph.modules if one.startswith("kilter_client.")]:
        for module in FORKS:
            graph.remove_import(importer=module, imported=imported)
    return graph


def _named_by(module: str, known: set[str]) -> Iterator[str]:
    """Yield what the text of a module, or the stub of its face, names."""
    start = REPOSITORY / f"{ROOTS[module.partition('.')[0]]}{module.replace('.', '/')}"
    face = start / "__init__.pyi"
    if face.is_file():
        yield from (f"{module}{name}" for name in FACE.findall(face.read_text(encoding="utf-8")))
    file = start.with_suffix(".py") if start.with_suffix(".py").is_file() else start / "__init__.py"
    text = file.read_text(encoding="utf-8") if file.is_file() else ""
    for match in NAMED.finditer(text):
        name = match[0].removesuffix(".")
        if match[0].endswith(".") and text[match.end() : match.end() + 1] == "{":
            yield from (one for one in known if one.rpartition(".")[0] == name)
        while name not in known and "." in name:
            name = name.rpartition(".")[0]
        if "." in name:
            yield name
    if module.startswith("tests."):
        yield from (program for program, started in PROGRAMS.items() if started.search(text))


def _module(path: str) -> str:
    return path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")


@cache
def modules_used_by(function: object) -> frozenset[str]:
    """Return the modules of what a function uses by name, and those that it imports; of helpers beside it what these use."""
    return frozenset(_used_by(function, set()))


def _used_by(function: object, seen: set[object]) -> Iterator[str]:
    function = inspect.unwrap(function) if callable(function) else function
    if not isinstance(function, FunctionType) or function in seen:
        return
    seen.add(function)
    for name in _names_in(function.__code__):
        value = function.__globals__.get(name)
        beside = getattr(value, "__module__", None) == function.__module__
        if isinstance(value, ModuleType):
            yield value.__name__
        elif beside:
            for one in vars(value).values() if isinstance(value, type) else [value]:
                yield from _used_by(one, seen)
        else:
            yield getattr(value, "__module__", None) or name


def _names_in(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield from _names_in(one)
