"""Imports stand at the top of a module; inside a function only where the module must load without the package."""

from __future__ import annotations

import ast
import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
PRODUCT = ("core/kilter_core", "service/kilter_service", "clients/files", "clients/python/src", "clients/lerobot")
MOST = 425  # import statements inside functions; only ever fewer


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
