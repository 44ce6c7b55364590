"""Imports stand at the top of a module; inside a function only where the module must load without the package."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

import pytest

from kilter_files.ground.later import Later

REPOSITORY = Path(__file__).resolve().parents[2]
PRODUCT = ("core/kilter_core", "service/kilter_service", "clients/files", "clients/python/src", "clients/lerobot")
MOST = 57  # import statements inside functions; only ever fewer, but for eight by which the API does without scipy


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


def waiting(text: str) -> dict[str, tuple[str, str]]:
    """What a module imports later: for each name the package, empty for a module by its own name, and the module in it."""
    blocks = [
        node
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.With) and "later(__name__)" in [ast.unparse(it.context_expr) for it in node.items]
    ]
    return {
        one.asname or one.name: (str(node.module), one.name) if isinstance(node, ast.ImportFrom) else ("", one.name)
        for block in blocks
        for node in block.body
        if isinstance(node, ast.Import | ast.ImportFrom)
        for one in node.names
    }


def test_what_a_module_imports_later_is_what_its_types_are_checked_against() -> None:
    """A package may call a function as one of its modules: the types would be checked against one, and the other be used."""
    wrong, found = [], 0
    for path in [path for folder in PRODUCT for path in (REPOSITORY / folder).rglob("*.py")]:
        text = path.read_text(encoding="utf-8")
        for called, (package, name) in waiting(text).items() if "later(__name__)" in text else ():
            found += 1
            module = importlib.import_module(f"{package}.{name}" if package else name)
            if package and getattr(importlib.import_module(package), name) is not module:
                wrong.append(f"{path.name}: {called}")
    assert found > 100
    assert wrong == []


@pytest.mark.parametrize("name", ["kilter_files.ground.later", "kilter_service.ground.core", "kilter_client.files"])
def test_a_gate_hands_out_what_it_imports_later(name: str) -> None:
    gate = importlib.import_module(name)
    assert gate.__file__ is not None
    said = waiting(Path(gate.__file__).read_text(encoding="utf-8"))
    assert {called: f"{package}.{one}".lstrip(".") for called, (package, one) in said.items()} == {
        called: it._name for called, it in vars(gate).items() if isinstance(it, Later)
    }
