"""Where a variable of a kernel lives: which names a statement has, and in which block C may declare them."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence


def names_of(node: ast.AST) -> list[str]:
    """Names in the order of their appearance, each once."""
    return list(dict.fromkeys(part.id for part in in_order(node) if isinstance(part, ast.Name)))


def in_order(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes as they stand in the source."""
    yield node
    for child in ast.iter_child_nodes(node):
        yield from in_order(child)


def loop_names(statement: ast.stmt) -> list[str]:
    """Names that a loop gives its values."""
    return names_of(statement.target) if isinstance(statement, ast.For) else []


def spread(statement: ast.stmt, name: str) -> bool:
    """Whether a name lives in more than one block of a statement, or from one pass of a loop to the next."""
    match statement:
        case ast.If(test=test, body=body, orelse=other):
            places = [names_of(test), *[[n for s in block for n in names_of(s)] for block in (body, other)]]
            if sum(name in place for place in places) > 1:
                # An elif chain or two branches that each assign it first may declare it each.
                return name in places[0] or not all(assigned_first(block, name) for block in (body, other) if block)
            return not all(assigned_first(block, name) for block in (body, other) if block)
        case ast.While(test=head, body=body) | ast.For(iter=head, body=body):
            return name in names_of(head) or not assigned_first(body, name)
    return False


def assigned_first(body: Sequence[ast.stmt], name: str) -> bool:
    """Whether the first thing that a block does with a name is to assign it."""
    for statement in body:
        if name not in names_of(statement):
            continue
        match statement:
            case ast.Assign(targets=targets, value=value):
                return name not in names_of(value) and any(
                    name in [n.id for n in (t.elts if isinstance(t, ast.Tuple) else [t]) if isinstance(n, ast.Name)]
                    for t in targets
                )
            case ast.For() | ast.If() | ast.While():
                if name in loop_names(statement):
                    return True
                later = body[list(body).index(statement) + 1 :]
                if any(name in names_of(other) for other in later):
                    return False
                return not spread(statement, name)
        return False
    return True


def same_place(target: ast.expr, value: ast.expr) -> bool:
    """Whether assigning the target would change what the value is made of."""
    if isinstance(target, ast.Name):
        return target.id in names_of(value)
    text = ast.unparse(target)
    return any(ast.unparse(part) == text for part in ast.walk(value) if isinstance(part, ast.Subscript))
