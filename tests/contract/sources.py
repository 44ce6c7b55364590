"""Python sources as the tests of the repository's shape ask for them: each is parsed once, and its tree is not kept."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).resolve().parents[2]
_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")  # where a statement has others
_LEAVES = (ast.Name, ast.expr_context, ast.operator, ast.unaryop, ast.cmpop, ast.boolop)


class Function(NamedTuple):
    """A function: its name, and how many lines its statements take, without those of functions in it."""

    name: str
    lines: int


class Source(NamedTuple):
    """What a source says of itself."""

    name: str  # its path in the repository
    text: str
    is_empty: bool  # of statements
    docstring: str | None
    imported: frozenset[str]  # modules, but for relative imports
    functions: tuple[Function, ...]


def modules(*folders: str) -> Iterator[Path]:
    """Python files of folders of the repository."""
    for folder in folders:
        yield from sorted((REPOSITORY / folder).rglob("*.py"))


@cache
def source(path: Path) -> Source:
    """Read a file."""
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    inside = tuple(statements(tree))
    return Source(
        path.relative_to(REPOSITORY).as_posix(), text, not tree.body, ast.get_docstring(tree),
        frozenset(name for statement in inside for name in _imported(statement)),
        tuple(
            Function(one.name, _own_lines(one))
            for one in inside
            if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)
        ),
    )  # fmt: skip


def _own_lines(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    body = function.body[ast.get_docstring(function) is not None :]
    inner = (one for one in statements(function) if one is not function and isinstance(one, ast.FunctionDef))
    return sum(_span(one) for one in body) - sum(map(_span, inner))


def _span(one: ast.stmt) -> int:
    return (one.end_lineno or one.lineno) - one.lineno + 1


def statements(tree: ast.AST) -> Iterator[ast.AST]:
    """All statements, those inside others too: few beside all nodes, and no expression has any."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for block in _BLOCKS:
            waiting += getattr(node, block, ())


def nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """All nodes as `ast.walk` has them but for names and operators, in another order, in a fraction of its time."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for value in vars(node).values():
            if isinstance(value, list):
                waiting += [one for one in value if isinstance(one, ast.AST)]
            elif isinstance(value, ast.AST) and not isinstance(value, _LEAVES):
                waiting.append(value)


def _imported(statement: ast.AST) -> Iterator[str]:
    if isinstance(statement, ast.Import):
        yield from (alias.name for alias in statement.names)
    elif isinstance(statement, ast.ImportFrom) and statement.module and statement.level == 0:
        yield statement.module
