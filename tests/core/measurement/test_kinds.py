"""Nobody asks of which kind a measurement is: a kind answers what is asked of it."""

from __future__ import annotations

import ast
from pathlib import Path

import kilter_core
from kilter_core.gap.search.sources.link_source import LinkSource
from kilter_core.gap.search.sources.source import Source
from kilter_core.gap.search.sources.tool_source import ToolSource
from kilter_core.measurement import Measurement
from kilter_core.measurement.kind import Kind
from kilter_core.measurement.registry import KINDS

NAMES = {cls.__name__ for cls in (*KINDS, Kind, Measurement, Source, ToolSource, LinkSource)}
ASKING = {"isinstance", "issubclass", "type"}


def asks(call: ast.Call) -> bool:
    """Whether a call looks at the class of an object, or at one of these classes."""
    if not isinstance(call.func, ast.Name) or call.func.id not in ASKING:
        return False
    return any(isinstance(node, ast.Name) and node.id in NAMES for arg in call.args for node in ast.walk(arg))


def test_no_room_of_the_core_branches_on_the_kind_of_a_measurement() -> None:
    root = Path(kilter_core.__file__).parent
    found = [
        f"{path.relative_to(root)}:{node.lineno}"
        for path in sorted(root.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and asks(node)
    ]
    assert found == []


def test_every_kind_is_a_file_of_its_own() -> None:
    modules = [kind.__module__ for kind in KINDS]
    assert len(set(modules)) == len(modules)
    assert len({kind.name for kind in KINDS}) == len(KINDS)
