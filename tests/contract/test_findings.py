"""What is found is a code with its context: nothing reads a number or a decision back from its sentence."""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from tests.contract.sources import modules, nodes

SENTENCES = {"message", "sentence", "detail"}
# A sentence is put in the words of another surface, whole: nothing is decided by what it says.
REWORDED = {
    "progress.py: COMMANDS.split(sentence)",
    "references.py: ROUTE.sub(lambda found: ROUTES.get(found[0], 'another command'), detail)",
    "new_robot.py: error.detail.replace(f'{path}', path.name)",
    "results.py: FIRST.split(one['sentence'], maxsplit=1)",  # its first part, for a cell
    "standing.py: drift.sentence.partition(': ')",
}
READS = {
    "startswith",
    "endswith",
    "split",
    "rsplit",
    "partition",
    "rpartition",
    "replace",
    "find",
    "index",
    "count",
    "removeprefix",
    "removesuffix",
    "search",
    "match",
    "fullmatch",
    "findall",
    "finditer",
    "sub",
}


def is_sentence(node: ast.expr) -> bool:
    """Whether an expression is a message or the like: `one["message"]`, `error.message`, `sentence`, `str(one.detail)`."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "str" and node.args:
        return is_sentence(node.args[0])
    if isinstance(node, ast.Subscript):
        return isinstance(node.slice, ast.Constant) and node.slice.value in SENTENCES
    return (
        node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
    ) in SENTENCES


def readings(text: str) -> Iterator[str]:
    """Expressions that look into a sentence."""
    for node in nodes(ast.parse(text)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in READS:
            if is_sentence(node.func.value) or any(map(is_sentence, node.args)):
                yield ast.unparse(node)
        elif (
            isinstance(node, ast.Compare)
            and isinstance(node.ops[0], ast.In | ast.NotIn)
            and is_sentence(node.comparators[0])
        ):
            yield ast.unparse(node)


@pytest.mark.parametrize(
    "text",
    [
        'one["message"].split(" Say ")',
        "'alive' in check.detail",
        "PATTERN.match(sentence)",
        'str(w["message"]).find("x")',
    ],
)
def test_a_reading_of_a_sentence_is_seen(text: str) -> None:
    assert list(readings(text)) == [ast.unparse(ast.parse(text))]


def test_nothing_reads_a_sentence_back() -> None:
    found = {
        f"{path.name}: {one}"
        for path in modules("core", "service", "clients/python/src")
        for one in readings(path.read_text())
    }
    assert found == REWORDED
