"""Imports stand at the top of a module; inside a function only where the module must load without the package."""

from __future__ import annotations

import ast
import importlib
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from kilter_files.ground.later import Later

REPOSITORY = Path(__file__).resolve().parents[2]
PRODUCT = ("core/kilter_core", "service/kilter_service", "clients/files", "clients/python/src", "clients/lerobot")
MOST = 49  # import statements inside functions; only ever fewer


INDENTED = re.compile(r"^[ \t]+(?:import|from)\s", re.MULTILINE)


def deferred(text: str) -> set[tuple[int, str]]:
    """Line and text of each import statement that runs when a function is called."""
    if not INDENTED.search(text):  # most modules: it takes a tenth of the time
        return set()
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    return {
        (node.lineno, ast.unparse(node))
        for function in ast.walk(ast.parse(text))
        if isinstance(function, functions)
        for node in ast.walk(function)
        if isinstance(node, ast.Import | ast.ImportFrom)
    }


def test_few_imports_stand_inside_functions() -> None:
    files = [path for folder in PRODUCT for path in (REPOSITORY / folder).rglob("*.py")]
    assert files
    assert sum(len(deferred(path.read_text(encoding="utf-8"))) for path in files) <= MOST


def test_an_import_inside_a_function_is_counted_once() -> None:
    inside = "import a\ndef f():\n    import b\n    def g():\n        from c import d\n"
    assert {text for _, text in deferred(inside)} == {"import b", "from c import d"}


GATES = ("kilter_files.ground.later", "kilter_service.ground.core", "kilter_client.files")


@pytest.mark.parametrize("name", GATES)
def test_what_a_gate_hands_out_is_what_the_types_are_checked_against(name: str) -> None:
    """A package may call a function as one of its modules: the types would be checked against one, and the other be used."""
    gate = importlib.import_module(name)
    assert gate.__file__ is not None
    (checked,) = [
        node for node in ast.parse(Path(gate.__file__).read_text(encoding="utf-8")).body if isinstance(node, ast.If)
    ]
    found: dict[str, ModuleType] = {}
    for node in checked.body:
        assert isinstance(node, ast.Import | ast.ImportFrom)
        for one in node.names:
            if isinstance(node, ast.Import):
                importlib.import_module(one.name)
                found[one.asname or one.name] = sys.modules[one.name]
            else:
                package = importlib.import_module(str(node.module))
                found[one.asname or one.name] = getattr(package, one.name, None) or importlib.import_module(
                    f"{node.module}.{one.name}"
                )
    assert {one: getattr(it, "__name__", "") for one, it in found.items()} == {
        one: it._name for one, it in vars(gate).items() if isinstance(it, Later)
    }
    assert all(isinstance(it, ModuleType) for it in found.values())


HANDED_OUT = re.compile(r'^    (\w+) = Later\("([\w.]+)"\)$', re.MULTILINE)


def test_what_a_module_loads_later_is_what_its_types_are_checked_against() -> None:
    """Also where a module has such names for itself only."""
    wrong, found = [], 0
    for path in [path for folder in PRODUCT for path in (REPOSITORY / folder).rglob("*.py")]:
        text = path.read_text(encoding="utf-8")
        later = dict(HANDED_OUT.findall(text))
        if not later:
            continue
        (checked,) = [
            n for n in ast.parse(text).body if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"
        ]
        named = {
            one.asname or one.name: f"{node.module}.{one.name}" if isinstance(node, ast.ImportFrom) else one.name
            for node in checked.body
            if isinstance(node, ast.Import | ast.ImportFrom)
            for one in node.names
        }
        found += len(later)
        wrong += [f"{path.name}: {name}" for name, module in later.items() if named.get(name) != module]
    assert found > 100
    assert wrong == []
